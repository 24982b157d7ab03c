"""The side of a library that answers: what is like this, what is this, where is this, what happens here."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from dousa.errors import OptionError
from dousa.library._judging import Unknown
from dousa.library.ingest import ReadOptions

if TYPE_CHECKING:
    from dousa.library._finding import Finding
    from dousa.library._labelling import LearnProgress
    from dousa.library._querying import Querying
    from dousa.library.answers import Classification, SearchResult
    from dousa.library.take_answers import FindResult, LabelledTake
    from dousa.motion import CanonicalMotion, Motion, Trajectories
    from dousa.retrieval.streaming import LiveLabeller

    Query: TypeAlias = int | str | os.PathLike[str] | CanonicalMotion | Motion | Trajectories
    Takes: TypeAlias = Query | Iterable[Query]

__all__ = ["Asking", "JointMap", "Paths", "as_list"]

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
JointMap = Mapping[str, str | Sequence[str]]


class Asking:
    """What the forest of a library is asked."""

    _querying: Querying
    _finding: Finding

    def search(
        self,
        query: Query,
        k: int = 10,
        *,
        ranking: str | None = None,
        same_category: bool = False,
        mirror: bool = False,
        explain: bool = False,
        threshold: float | None = None,
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
    ) -> SearchResult:
        """The clips most like a motion, the most similar first; takes are left out.

        Parameters
        ----------
        query : a motion file, the number of a clip, or a motion.
        k : how many clips at most.
        ranking : what they are ordered by, one of ``dousa.retrieval.RANKINGS``: ``"histogram"`` (eq. 8 of Hamada,
            Kuriyama, Mukai), ``"leaves"``, ``"pose"`` or ``"fused"``, which is also what None stands for.
        same_category : only clips of the category that most trees vote for.
        mirror : search for the mirror image of the query too.
        explain : say why the query is taken for its category, and why each clip is like it.
        threshold : probability of being known from which the query gets a category; None for the forest's own, 0
            for always.
        joint_map, unit, up, skeleton : what the query file does not say.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the query cannot be used.
        LibraryError : no clip of this number, or the library cannot be read.
        OptionError : k below 1, an unknown ranking, a threshold outside 0 to 1.
        """
        from dousa.library._querying import SearchOptions
        from dousa.retrieval.ranking import DEFAULT_RANKING

        if k < 1:
            raise OptionError(f"expected a number of results of 1 or more, got {k}")
        wanted = SearchOptions(
            k, ranking or DEFAULT_RANKING, same_category, mirror, explain, Unknown(threshold)
        )
        return self._querying.search(query, wanted, ReadOptions(joint_map, unit, up, skeleton))

    def classify(
        self,
        paths: Paths,
        *,
        mirror: bool = False,
        explain: bool = False,
        threshold: float | None = None,
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
        mirror : say what the mirror image of each is taken for too.
        explain : say why.
        threshold : as in ``search``.
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
        from dousa.library._querying import ClassifyOptions

        wanted = ClassifyOptions(mirror, explain, Unknown(threshold), n_jobs)
        return self._querying.classify(as_list(paths), wanted, ReadOptions(joint_map, unit, up, skeleton))

    def find(
        self,
        query: Query,
        takes: Takes | None = None,
        k: int = 10,
        *,
        mirror: bool = False,
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
        n_jobs: int | None = None,
    ) -> FindResult:
        """The places in takes that are most like a motion, at half to twice its tempo.

        Parameters
        ----------
        query : a motion file, the number of a clip, or a motion.
        takes : numbers, files and folders, or motions; by default all takes of the library, whose windows are
            kept. Others are described now.
        k : how many places at most.
        mirror : look for the mirror image of the query too.
        joint_map, unit, up, skeleton : what the files do not say.
        n_jobs : files read, and parts described, at a time; as in ``add``.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the query cannot be used; takes that cannot are told in the answer.
        InvalidMotionError : the query is shorter than 0.27 s.
        LibraryError : no clip of this number, no takes, or the library cannot be read.
        OptionError : k below 1.
        """
        if k < 1:
            raise OptionError(f"expected a number of results of 1 or more, got {k}")
        options = ReadOptions(joint_map, unit, up, skeleton)
        chosen = None if takes is None else _as_items(takes)
        return self._finding.find(query, chosen, k, mirror, options, n_jobs)

    def label(
        self,
        take: Query,
        *,
        threshold: float | None = None,
        examples: Iterable[int] = (),
        joint_map: JointMap | None = None,
        unit: float | str | None = None,
        up: str | None = None,
        skeleton: str | os.PathLike[str] | None = None,
        n_jobs: int | None = None,
        progress: LearnProgress | None = None,
    ) -> LabelledTake:
        """What happens in a take, from beginning to end: which category from when to when, and what is unknown.

        The first time after a training, what takes are labelled with is learned from the clips; it is kept in the
        library if that can be written.

        Parameters
        ----------
        take : number, file, or motion.
        threshold : confidence from which a category is said, 0 to 1; None for what was learned.
        examples : numbers of clips that were cut out of takes and named by hand. What a take is labelled with learns
            from each at once, far more than from a clip that is only added.
        joint_map, unit, up, skeleton : what the file does not say.
        n_jobs : parts described at a time, as in ``add``.
        progress : of the learning; called with (steps done, steps, what comes now).

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the take cannot be used.
        LibraryError : no take of this number, or the library cannot be read.
        OptionError : a threshold outside 0 to 1.
        """
        options = ReadOptions(joint_map, unit, up, skeleton)
        return self._finding.label(take, threshold, options, n_jobs, progress, tuple(examples))

    def live(
        self,
        *,
        height: float | None = None,
        threshold: float | None = None,
        n_jobs: int | None = None,
        progress: LearnProgress | None = None,
    ) -> LiveLabeller:
        """What labels a motion while it happens: ``push`` it a frame, and it answers some times a second.

        Parameters
        ----------
        height : m, of the performer; None to estimate it from the first second.
        threshold, n_jobs, progress : as in ``label``.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        OptionError : a height or threshold out of range.
        LibraryError : the library cannot be read.
        """
        return self._finding.live(height, threshold, n_jobs, progress)


def as_list(paths: Paths) -> list[str | os.PathLike[str]]:
    """One path or several, as a list."""
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)


def _as_items(takes: Takes) -> list[Query]:
    from dousa.motion import CanonicalMotion, Motion, Trajectories

    single = (int, str, os.PathLike, CanonicalMotion, Motion, Trajectories)
    return [takes] if isinstance(takes, single) else list(takes)
