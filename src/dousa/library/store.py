"""The motion library: one object for everything that is asked of it."""

from __future__ import annotations

import os
from types import TracebackType
from typing import TYPE_CHECKING, Literal

import sqlalchemy as sa

from dousa.errors import OptionError
from dousa.library._asking import Asking, JointMap, Paths, as_list
from dousa.library._finding import Finding
from dousa.library._jobs import check_jobs, choose_jobs
from dousa.library._managing import Managing
from dousa.library._opening import open_engine
from dousa.library._querying import Querying
from dousa.library.ingest import ReadOptions
from dousa.library.labels import parse_label_rule
from dousa.library.reports import AddReport, TrainReport
from dousa.library.schema import CLIP, TAKE

if TYPE_CHECKING:
    from dousa.library.adding import AddProgress
    from dousa.library.training import TrainProgress

__all__ = ["Library"]


class Library(Asking, Managing):
    """A collection of motion clips that can be trained and searched, made with ``Library.open``.

    Usable in a ``with`` statement, from several threads, and by several programs at once: each sees what the
    others wrote, and writers wait for each other.

    Parameters
    ----------
    engine, where : the database, with its tables; and its name for messages.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._querying = Querying(engine, where)
        self._finding = Finding(engine, where, self._querying)

    @classmethod
    def open(
        cls,
        path_or_url: str | os.PathLike[str],
        *,
        create: bool = False,
        read_only: bool = False,
        timeout: float = 5.0,
    ) -> Library:
        """Open a library, or make one.

        Parameters
        ----------
        path_or_url : a file of any name, by custom ``NAME.dousa``; or the SQLAlchemy URL of a database.
        create : a library that does not exist is made.
        read_only : refuse every change.
        timeout : s to wait while another program writes.

        Raises
        ------
        LibraryError : no library there, no such folder, no permission.
        LibraryDamagedError : not a library, or damaged.
        LibraryVersionError : written by a newer dousa.
        LibraryLockedError : another program is writing, longer than the timeout.
        """
        engine, where = open_engine(path_or_url, create=create, read_only=read_only, timeout=timeout)
        return cls(engine, where)

    @property
    def name(self) -> str:
        """The path or URL it was opened with."""
        return self._where

    def close(self) -> None:
        """Let go of the file; a closed library opens itself again when it is used."""
        self._engine.dispose()

    def __enter__(self) -> Library:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(
        self,
        paths: Paths,
        *,
        kind: Literal["clip", "take"] = "clip",
        category_from: str | None = "folder",
        performer_from: str | None = None,
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
        n_jobs: int | None = None,
        progress: AddProgress | None = None,
    ) -> AddReport:
        """Add motion files; files that are in the library already are left as they are.

        Written in portions: when the program is stopped, what was written stays, and the same call goes on
        from there. If the library is trained, new clips get their histograms at once, and the leaves of the
        forest learn from those that have a category; its questions stay until it is trained again.

        Parameters
        ----------
        paths : files, and folders that are searched at any depth.
        kind : ``"clip"``, files that each hold one thing that is done; ``"take"``, uncut recordings: nothing is
            learned from them, ``find`` looks into them, and they have no category. A file that is there already
            stays what it is.
        category_from, performer_from : rules for the labels, see ``dousa.library.labels``.
        joint_map, unit, up, skeleton : what the files do not say, see ``dousa.formats.read_motion`` and
            ``dousa.motion.canonicalise``; a file read with other ones than before is read again.
        n_jobs : files read at a time; by default every core, or what ``joblib.parallel_config`` says.
        progress : called with (files done, files, path of the last one).

        Returns
        -------
        What was added and what was not, and why; a file that cannot be used does not stop the others.

        Raises
        ------
        OptionError : a rule that cannot be understood, or another kind.
        LibraryError : the library cannot be written.
        """
        from dousa.library.adding import Adding

        check_jobs(n_jobs)
        if kind not in (CLIP, TAKE):
            raise OptionError(f"kind: expected '{CLIP}' or '{TAKE}', got {kind!r}")
        adding = Adding(
            self._engine,
            self._where,
            kind=kind,
            category_rule=parse_label_rule(category_from if kind == CLIP else None, "category"),
            performer_rule=parse_label_rule(performer_from, "performer"),
            options=ReadOptions(joint_map, unit, up, skeleton),
            known_forest=self._querying.forest,
        )
        return adding.run(as_list(paths), n_jobs, progress)

    def train(
        self,
        *,
        feature_set: str | None = None,
        n_trees: int = 100,
        n_trials: int | str | None = None,
        max_entropy: float = 0.0,
        bootstrap: bool = False,
        random_state: int | None = 0,
        n_jobs: int | None = None,
        progress: TrainProgress | None = None,
    ) -> TrainReport:
        """Train a new forest on all clips that have a category, and ask it about every clip and take.

        One transaction: stopped at any moment, the library keeps the forest it had.

        Parameters
        ----------
        feature_set : what it may ask about, a name in ``dousa.retrieval.FEATURE_SETS``: ``"paper"`` or
            ``"extended"``; None for ``DEFAULT_FEATURE_SET``.
        n_trees, max_entropy, bootstrap, random_state : as in ``dousa.retrieval.MotionForest``.
        n_trials : likewise; None for what suits the features.
        n_jobs : trees grown at a time, as in ``add``; the forest does not depend on it.
        progress : called with (steps done, steps, what comes now).

        Raises
        ------
        TrainingError : fewer than two categories.
        LibraryError : the library cannot be written.
        OptionError : no such features, or a number out of range.
        """
        from dousa.library.training import train_forest
        from dousa.retrieval import MotionForest
        from dousa.retrieval.feature_sets import DEFAULT_FEATURE_SET, get_feature_set

        kind = get_feature_set(DEFAULT_FEATURE_SET if feature_set is None else feature_set)
        forest = MotionForest(
            n_trees=n_trees,
            n_trials=kind.n_trials if n_trials is None else n_trials,
            max_entropy=max_entropy,
            bootstrap=bootstrap,
            thresholds=kind.thresholds,
            random_state=random_state,
            n_jobs=choose_jobs(n_jobs),
        )
        trained = train_forest(self._engine, self._where, forest, kind.name, n_jobs, progress)
        self._querying.forest, report = trained
        return report
