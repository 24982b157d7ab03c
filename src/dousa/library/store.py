"""The motion library: one object for everything that is asked of it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library import _contents, schema
from dousa.library._arrays import unpack
from dousa.library._engine import reading, writing
from dousa.library._jobs import check_jobs, choose_jobs
from dousa.library._opening import open_engine
from dousa.library._querying import Querying
from dousa.library._revision import next_revision
from dousa.library.ingest import ReadOptions
from dousa.library.labels import parse_label_rule
from dousa.library.reports import AddReport, Classification, ClipInfo, LibraryStats, SearchResult, TrainReport
from dousa.library.selection import UNCHANGED, Selection, Unchanged, select_ids

if TYPE_CHECKING:
    from dousa.library.adding import AddProgress
    from dousa.library.training import TrainProgress
    from dousa.motion import CanonicalMotion, Motion, Trajectories

__all__ = ["Library"]

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
JointMap = Mapping[str, str | Sequence[str]]


class Library:
    """A collection of motion clips that can be trained and searched, made with ``Library.open``.

    Usable in a ``with`` statement, from several threads, and by several programs at once: each sees what the
    others wrote, and writers wait for each other.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._querying = Querying(engine, where)

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
        from there. If the library is trained, new clips get their histograms at once.

        Parameters
        ----------
        paths : files, and folders that are searched at any depth.
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
        OptionError : a rule that cannot be understood.
        LibraryError : the library cannot be written.
        """
        from dousa.library.adding import Adding

        check_jobs(n_jobs)
        adding = Adding(
            self._engine,
            self._where,
            category_rule=parse_label_rule(category_from, "category"),
            performer_rule=parse_label_rule(performer_from, "performer"),
            options=ReadOptions(joint_map, unit, up, skeleton),
            known_forest=self._querying.forest,
        )
        return adding.run(_as_list(paths), n_jobs, progress)

    def train(
        self,
        *,
        n_trees: int = 100,
        n_trials: int | str | None = None,
        max_entropy: float = 0.0,
        bootstrap: bool = False,
        random_state: int | None = 0,
        n_jobs: int | None = None,
        progress: TrainProgress | None = None,
    ) -> TrainReport:
        """Train a new forest on all clips that have a category, and give every clip its histogram.

        One transaction: stopped at any moment, the library keeps the forest it had.

        Parameters
        ----------
        n_trees, n_trials, max_entropy, bootstrap, random_state : as in ``dousa.retrieval.MotionForest``.
        n_jobs : trees grown at a time, as in ``add``; the forest does not depend on it.
        progress : called with (steps done, steps, what comes now).

        Raises
        ------
        TrainingError : fewer than two categories.
        LibraryError : the library cannot be written.
        """
        from dousa.library.training import train_forest
        from dousa.retrieval import MotionForest

        forest = MotionForest(
            n_trees=n_trees,
            n_trials=n_trials,
            max_entropy=max_entropy,
            bootstrap=bootstrap,
            random_state=random_state,
            n_jobs=choose_jobs(n_jobs),
        )
        self._querying.forest, report = train_forest(self._engine, self._where, forest, progress)
        return report

    def search(
        self,
        query: int | str | os.PathLike[str] | CanonicalMotion | Motion | Trajectories,
        k: int = 10,
        *,
        same_category: bool = False,
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
    ) -> SearchResult:
        """The clips most like a motion, by eq. 8 of Hamada, Kuriyama, Mukai, nearest first.

        Among equal distances the share of trees decides in which query and clip end in the same leaf, then
        the distance of the pose features, then the path. A query that is in the library finds itself first.

        Parameters
        ----------
        query : a motion file, the number of a clip, or a motion.
        k : how many clips at most.
        same_category : only clips of the category that the forest takes the query for.
        joint_map, unit, up, skeleton : what the query file does not say.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the query cannot be used.
        LibraryError : no clip of this number, or the library cannot be read.
        OptionError : k below 1.
        """
        if k < 1:
            raise OptionError(f"expected a number of results of 1 or more, got {k}")
        options = ReadOptions(joint_map, unit, up, skeleton)
        return self._querying.search(query, k, same_category, options)

    def classify(
        self,
        paths: Paths,
        *,
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
        n_jobs: int | None = None,
    ) -> list[Classification]:
        """What the forest takes motion files for; they are not added.

        Parameters
        ----------
        paths : files, and folders that are searched at any depth.
        joint_map, unit, up, skeleton : what the files do not say.
        n_jobs : files read at a time, as in ``add``.

        Returns
        -------
        One answer per file; one that cannot be used has a ``problem`` instead of a category.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        LibraryError : the library cannot be read.
        """
        options = ReadOptions(joint_map, unit, up, skeleton)
        return self._querying.classify(_as_list(paths), options, n_jobs)

    def clips(
        self, selection: Selection | None = None, *, category: str | None = None, performer: str | None = None
    ) -> list[ClipInfo]:
        """Clips in the order of their paths: all, or those chosen.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : only clips of this label.

        Raises
        ------
        LibraryError : nothing fits.
        """
        with reading(self._engine, self._where) as connection:
            if selection is None and category is None and performer is None:
                return _contents.list_clips(connection)
            chosen = () if selection is None else selection
            return _contents.list_clips(
                connection, select_ids(connection, self._where, chosen, category, performer)
            )

    def trajectories(self, clip_id: int) -> Trajectories:
        """The canonical joints of a clip, in metres.

        Raises
        ------
        LibraryError : no such clip; LibraryDamagedError: its numbers are damaged.
        """
        from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories

        clips, arrays = schema.clips.c, schema.clip_trajectories.c
        query = sa.select(clips.path, clips.n_frames, clips.frame_rate, arrays.positions)
        query = query.join(schema.clip_trajectories, arrays.clip_id == clips.id).where(clips.id == clip_id)
        with reading(self._engine, self._where) as connection:
            row = connection.execute(query).one_or_none()
        if row is None:
            raise LibraryError(f"{self._where}: no clip {clip_id}; see: dousa list")
        positions = unpack(row.positions, "<f4", (row.n_frames, len(CANONICAL_JOINTS), 3), row.path)
        parents = np.array(CANONICAL_PARENTS)
        return Trajectories(CANONICAL_JOINTS, positions.astype(np.float64), row.frame_rate, parents)

    def remove(
        self, selection: Selection = (), *, category: str | None = None, performer: str | None = None
    ) -> list[str]:
        """Take clips out of the library; their files stay on the disk.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : only clips of this label.

        Returns
        -------
        Paths of the clips that were removed.

        Raises
        ------
        OptionError : nothing is chosen.
        LibraryError : something chosen is not there, or the library cannot be written.
        """
        with writing(self._engine, self._where) as connection:
            ids = select_ids(connection, self._where, selection, category, performer)
            paths = [clip.path for clip in _contents.list_clips(connection, ids)]
            if ids:
                next_revision(connection)
                _contents.delete_clips(connection, ids)
        return paths

    def relabel(
        self,
        selection: Selection = (),
        *,
        category: str | Unchanged | None = UNCHANGED,
        performer: str | Unchanged | None = UNCHANGED,
        where_category: str | None = None,
        where_performer: str | None = None,
    ) -> list[str]:
        """Give clips another category or performer; the forest learns of it in the next training.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : the new labels, None for no label.
        where_category, where_performer : only clips that have this label now.

        Returns
        -------
        Paths of the clips that were chosen.

        Raises
        ------
        OptionError : nothing is chosen, or no new label is given, or an empty one.
        LibraryError : something chosen is not there, or the library cannot be written.
        """
        if category is UNCHANGED and performer is UNCHANGED:
            raise OptionError("expected a new category or performer, got neither")
        if any(isinstance(label, str) and not label.strip() for label in (category, performer)):
            raise OptionError("expected the name of a category or performer, got an empty one")
        with writing(self._engine, self._where) as connection:
            ids = select_ids(connection, self._where, selection, where_category, where_performer)
            if ids:
                next_revision(connection)
                _contents.set_labels(connection, ids, category, performer)
            return [clip.path for clip in _contents.list_clips(connection, ids)]

    def categories(self) -> dict[str, int]:
        """Number of clips of each category, by name."""
        with reading(self._engine, self._where) as connection:
            return _contents.count_by(connection, "category")

    def stats(self) -> LibraryStats:
        """The library in numbers."""
        with reading(self._engine, self._where) as connection:
            return _contents.summarise(connection)


def _as_list(paths: Paths) -> list[str | os.PathLike[str]]:
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)
