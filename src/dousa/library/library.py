"""The motion library: one object for all operations."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeAlias

from dousa.errors import OptionError
from dousa.formats.motion_files import ReadOptions, is_unicode
from dousa.library.changes import LibraryChanges
from dousa.library.label_rules import LabelRule, check_labels, check_text, no_label, parse_label_rule
from dousa.library.results import AddReport, TrainReport
from dousa.library.store.engine import check_jobs, choose_jobs
from dousa.library.store.schema import CLIP, TAKE

if TYPE_CHECKING:
    from dousa.library.add import AddProgress
    from dousa.library.annotations.store import Annotations
    from dousa.library.annotations.tags import SavedSearches
    from dousa.library.care.clip_map import ClipMap
    from dousa.library.care.review import DuplicateGroup, LabelReview
    from dousa.library.results import Classification, FindResult, LabelledTake, SearchResult
    from dousa.library.search.part_forests import PartForests
    from dousa.library.search.search import Searcher
    from dousa.library.search.text import TextMatches, TextResult, TextSearcher
    from dousa.library.store.ingest import Query
    from dousa.library.take_labellers import Labellers
    from dousa.library.takes.takes import Takes
    from dousa.messages import Progress
    from dousa.motion import CanonicalMotion, Motion, Trajectories
    from dousa.retrieval.takes.live import LiveLabeller

Paths: TypeAlias = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
"""One path or several."""


class Library(LibraryChanges):
    """A collection of motion clips that can be trained and searched, made with ``Library.open``.

    Usable in a ``with`` statement, from several threads, and by several programs at once: each sees the writes of the
    others, and writers wait for each other.

    Parameters
    ----------
    database : with the tables of a library.

    >>> library = dousa.Library.open("moves.dousa")
    >>> library.search("wave.bvh").verdict.guess
    'wave_right'
    """

    def add(
        self,
        paths: Paths,
        *,
        kind: Literal["clip", "take"] = "clip",
        category_from: str | None = "folder",
        performer_from: str | None = None,
        labels_from: str | None = None,
        tier: str | None = None,
        options: ReadOptions | None = None,
        n_jobs: int | None = None,
        progress: AddProgress | None = None,
    ) -> AddReport:
        """Add motion files; files that are in the library already stay as they are.

        Written in portions: an interrupted call keeps what it wrote, and can be repeated to go on. In a trained library
        new clips get their histograms at once, and the leaves of the forest learn from labelled ones; its questions
        stay until the next training.

        Parameters
        ----------
        paths : files, and folders that are searched at any depth.
        kind : ``"clip"``, files of one action each; ``"take"``, uncut recordings: they have no category, ``find``
            searches them, and only labelled segments are learned from. A file that is there already keeps its kind.
        category_from, performer_from : rules for the labels, see ``dousa.library.label_rules``.
        labels_from : of takes, their tables of labels: ``"beside"``, ``"folder:DIR"`` or ``"csv:FILE"``, see
            ``dousa.library.annotations.matching``; each segment becomes a clip. Takes that are there already get the
            present labels of their table.
        tier : name of the tier of these tables, None for the first that has labels.
        options : how to read the files; a file read with other options before is read again.
        n_jobs : files read at a time; by default that of ``joblib.parallel_config``, else every core.
        progress : called with (files done, files, path of the last one).

        Returns
        -------
        The files added and not added, with reasons; a file that cannot be used does not stop the others.

        Raises
        ------
        OptionError : an invalid rule or kind; labels of clips, or of no take at all.
        MotionFileError : a table of labels that cannot be read, or has nothing within its take; nothing is added.
        LibraryError : the library cannot be written.

        >>> report = library.add("wave.bvh", category_from=None, n_jobs=1)
        >>> len(report.added), report.skipped
        (1, ())
        """
        from dousa.library.add import Adding

        _check_kind(kind)
        check_jobs(n_jobs)
        if kind == CLIP and (labels_from is not None or tier is not None):
            raise OptionError("annotations.of_clips")
        if tier is not None and labels_from is None:
            raise OptionError("annotations.tier_alone")
        rules = {
            "category": parse_label_rule(category_from if kind == CLIP else None, "category"),
            "performer": parse_label_rule(performer_from, "performer"),
        }
        adding = Adding(self.database, kind, rules, options or ReadOptions(), self._forests, labels_from, tier)
        with self.one_change():
            return adding.run(_as_list(paths), n_jobs, progress)

    def add_motion(
        self,
        motion: Motion | Trajectories | CanonicalMotion,
        name: str,
        category: str | None = None,
        *,
        performer: str | None = None,
        kind: Literal["clip", "take"] = "clip",
        options: ReadOptions | None = None,
        n_jobs: int | None = None,
    ) -> AddReport:
        """Add a motion in memory under a name; a trained forest learns it at once, as from a file.

        It is stored like a file with the same positions. A motion of the same name is replaced, and keeps its labels if
        none are given; one of the same content is not added a second time.

        Parameters
        ----------
        motion : in m, Y up.
        name : takes the place of the path.
        category, performer : its labels, None for none; a take has no category.
        kind : ``"clip"`` or ``"take"``, as in ``add``.
        options : its ``joint_map``, if names and shape are ambiguous.
        n_jobs : windows of takes described at a time, as in ``add``.

        Returns
        -------
        The name as ``added``, ``replaced``, ``unchanged``, or in ``duplicates`` with the name of the same content.

        Raises
        ------
        OptionError : an empty name or label, another kind, a category of a take.
        JointMappingError : joints that cannot be identified.
        InvalidMotionError : positions or a frame rate beyond measure.
        LibraryError : the library cannot be written.

        >>> report = library.add_motion(dousa.read_motion("wave.bvh"), "my wave", "wave_right")
        >>> report.added
        ('my wave',)
        """
        from dousa.library.add import Adding
        from dousa.library.store.ingest import make_record, read_query

        _check_kind(kind)
        check_jobs(n_jobs)
        check_labels(category, performer)
        if kind == TAKE and category is not None:
            raise OptionError("library_add.take_has_no_category", category=category)
        if not name.strip() or not is_unicode(name):
            raise OptionError("library_add.no_name", name=name.encode(errors="backslashreplace").decode())
        check_text(name)
        options = options or ReadOptions()
        record = make_record(read_query(motion, options), name, kind)
        rules: dict[str, LabelRule] = {
            "category": no_label if category is None else lambda root, file: category,
            "performer": no_label if performer is None else lambda root, file: performer,
        }
        adding = Adding(self.database, kind, rules, options, self._forests)
        with self.one_change():
            return adding.run_one(record, n_jobs)

    def train(
        self,
        *,
        feature_set: str | None = None,
        n_trees: int = 100,
        n_trials: int | Literal["all", "sqrt"] | None = None,
        max_entropy: float = 0.0,
        bootstrap: bool = False,
        random_state: int | None = 0,
        n_jobs: int | None = None,
        progress: Progress | None = None,
    ) -> TrainReport:
        """Train a new forest on all labelled clips, and classify every clip and take with it.

        One transaction: if interrupted, the library keeps the forest it had.

        Parameters
        ----------
        feature_set : a name in ``dousa.retrieval.FEATURE_SETS``: ``"paper"`` or ``"extended"``; None for
            ``DEFAULT_FEATURE_SET``.
        n_trees, max_entropy, bootstrap, random_state : as in ``dousa.retrieval.MotionForest``.
        n_trials : likewise.
        n_jobs : trees grown at a time, as in ``add``; the forest does not depend on it.
        progress : called with (steps done, steps, message about the next step).

        Raises
        ------
        TrainingError : fewer than two categories.
        LibraryError : the library cannot be written.
        OptionError : no such features, or a number out of range.

        >>> report = library.train(n_trees=10, n_jobs=1)
        >>> report.n_clips, report.categories
        (12, {'squat': 4, 'walk': 4, 'wave_right': 4})
        """
        from dousa.library.learning.train import train_forest
        from dousa.library.take_labellers import learn_labeller
        from dousa.retrieval import DEFAULT_FEATURE_SET, MotionForest, get_feature_set

        kind = get_feature_set(DEFAULT_FEATURE_SET if feature_set is None else feature_set)
        forest = MotionForest(
            n_trees=n_trees,
            n_trials=n_trials,
            max_entropy=max_entropy,
            bootstrap=bootstrap,
            thresholds=kind.thresholds,
            random_state=random_state,
            n_jobs=choose_jobs(n_jobs),
        )
        stored, report = train_forest(self.database, forest, kind, learn_labeller, n_jobs, progress)
        self._forests.last = stored
        self._parts.prepare(stored, n_jobs, progress)
        return report

    def search(
        self,
        query: Query,
        k: int = 10,
        *,
        ranking: str | None = None,
        same_category: bool = False,
        mirror: bool | None = None,
        explain: bool = False,
        threshold: float | None = None,
        among: Iterable[int] | None = None,
        options: ReadOptions | None = None,
        progress: Progress | None = None,
    ) -> SearchResult:
        """Find the clips most similar to a motion, best first; takes are left out.

        Bodies that lack joints are compared by the joints that both have. For each new set of missing joints a forest
        for the others is learned once, and kept; the one for the joints that most incomplete clips lack is learned in
        the training.

        Parameters
        ----------
        query : a motion file, the number of a clip, or a motion.
        k : how many clips at most.
        ranking : order of the clips, one of ``dousa.retrieval.RANKINGS``: ``"histogram"`` (eq. 8 of Hamada, Kuriyama,
            Mukai), ``"leaves"``, ``"pose"`` or ``"fused"``; None for ``"fused"``.
        same_category : only clips of the category that the query is taken for.
        mirror : search for the mirror image of the query too; None for the mirror image instead, where the guess for it
            is clearly likelier (``notes`` say so), unless the query is a clip of the library.
        explain : give the reasons for the predicted category, and for the similarity of each clip.
        threshold : confidence from which the query gets a category; None for the forest's own, 0 for always.
        among : only clips of these numbers, such as those of ``search_text``; None for all.
        options : how to read the query file.
        progress : called while a forest for a part of the body is learned, with (steps done, steps, message).

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the query cannot be used.
        InvalidMotionError : too little of the body is there.
        LibraryError : no clip of this number, or the library cannot be read.
        OptionError : k below 1, an unknown ranking, a threshold outside 0 to 1.

        >>> found = library.search("wave.bvh", 3)
        >>> [hit.category for hit in found.results]
        ['wave_right', 'wave_right', 'wave_right']
        """
        from dousa.library.search.search import Wanted
        from dousa.retrieval import DEFAULT_RANKING

        _check_k(k)
        chosen = None if among is None else frozenset(among)
        wanted = Wanted(k, ranking or DEFAULT_RANKING, same_category, mirror, explain, threshold, chosen)
        return self._searcher.search(query, wanted, options or ReadOptions(), progress)

    def search_text(
        self,
        text: str,
        k: int | None = 10,
        *,
        category: str | None = None,
        performer: str | None = None,
        kind: Literal["clip", "take"] | None = None,
    ) -> TextResult:
        """Find the clips and takes described by a text, in English or Japanese; no forest is needed.

        Words are matched by meaning with categories, names and what the motions do ("both hands raised above the
        head"): inflections, synonyms and translations of movement words count, and misspelt words are corrected. If
        nothing fits, the result is empty, with the nearest words of the library.

        Parameters
        ----------
        text : such as ``"kicking with the left foot"`` or ``"手を叩く"``.
        k : how many at most; None for all that fit.
        category, performer : only of this label.
        kind : only clips, or only takes.

        Raises
        ------
        OptionError : no text, one of more than 500 characters, or k below 1.
        LibraryError : the library cannot be read.

        >>> found = library.search_text("wave the right hand")
        >>> found.n_found, found.results[0].category
        (4, 'wave_right')
        """
        if k is not None:
            _check_k(k)
        return self._text.search(text, k, category=category, performer=performer, kind=kind)

    def match_text(self, text: str) -> TextMatches:
        """Return only the numbers of all clips and takes that ``search_text`` finds, for very long lists.

        Parameters
        ----------
        text : as in ``search_text``.

        Raises
        ------
        OptionError : no text, or one of more than 500 characters.
        LibraryError : the library cannot be read.

        >>> len(library.match_text("squatting").ids)
        4
        """
        return self._text.match(text)

    def review_labels(self, *, n_jobs: int | None = None, progress: Progress | None = None) -> LabelReview:
        """Find clips whose label is likely wrong because similar clips have another one, the likeliest first.

        Each is judged by trees trained without it. Clips with the tag ``checked`` count as right, and are not listed.
        No forest is needed; nothing is changed.

        Parameters
        ----------
        n_jobs : trees grown at a time, as in ``add``.
        progress : called with (steps done, steps, message about the next step).

        Raises
        ------
        TrainingError : fewer than two categories of three clips.
        LibraryError : the library cannot be read.

        >>> wrong = library.clips(category="squat")[0]
        >>> library.relabel(wrong.id, category="walk")[0] == wrong.path
        True
        >>> doubts = library.review_labels(n_jobs=1).doubts
        >>> [doubt.suggested for doubt in doubts if doubt.clip_id == wrong.id]
        ['squat']
        """
        from dousa.library.care.review import review_labels

        check_jobs(n_jobs)
        return review_labels(self.database, n_jobs, progress)

    def find_near_duplicates(self, *, near: float = 0.01) -> list[DuplicateGroup]:
        """Find groups of nearly equal clips: one recording twice, cleaned, or cut a little differently.

        Parameters
        ----------
        near : largest distance of their joints, body heights.

        Raises
        ------
        OptionError : ``near`` is not above 0 and at most 1.
        LibraryError : the library cannot be read.

        >>> copy = library.add_motion(library.trajectories(1), "the same again")
        >>> [group.clip_ids for group in library.find_near_duplicates()]
        [(1, 13)]
        """
        from dousa.library.care.review import find_near_duplicates

        if not 0 < near <= 1:
            raise OptionError("library_review.near", near=near)
        return find_near_duplicates(self.database, near)

    def map(self, *, progress: Progress | None = None) -> ClipMap:
        """Compute a map of the clips: a plane with clips of similar poses near each other.

        No forest is needed, and labels are not used. The same clips give the same map. Takes are left out.

        Parameters
        ----------
        progress : called with (steps done, steps, message about the next step).

        Raises
        ------
        MissingExtraError : scikit-learn is not installed (``pip install 'dousa[map]'``).
        LibraryError : the library cannot be read.

        >>> library.map().points.shape
        (12, 2)
        """
        from dousa.library.care.clip_map import map_clips

        return map_clips(self.database, progress)

    def classify(
        self,
        paths: Paths,
        *,
        mirror: bool | None = None,
        explain: bool = False,
        threshold: float | None = None,
        options: ReadOptions | None = None,
        n_jobs: int | None = None,
        progress: Progress | None = None,
    ) -> list[Classification]:
        """Predict the categories of motion files, without adding them.

        Parameters
        ----------
        paths : files, and folders that are searched at any depth.
        mirror : classify the mirror image of each too; None for what is likelier, as in ``search``.
        explain : give the reasons.
        threshold : as in ``search``.
        options : how to read the files.
        n_jobs : files read at a time, as in ``add``.
        progress : as in ``search``.

        Returns
        -------
        One result per file; a file that cannot be used has a ``problem`` instead of a category.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        LibraryError : the library cannot be read.

        >>> [answer.verdict.category for answer in library.classify("wave.bvh", n_jobs=1)]
        ['wave_right']
        """
        return self._searcher.classify(
            _as_list(paths),
            mirror=mirror,
            explain=explain,
            threshold=threshold,
            options=options or ReadOptions(),
            n_jobs=n_jobs,
            progress=progress,
        )

    def find(
        self,
        query: Query,
        takes: Query | Iterable[Query] | None = None,
        k: int = 10,
        *,
        mirror: bool = False,
        exact: bool = False,
        options: ReadOptions | None = None,
        n_jobs: int | None = None,
        progress: Progress | None = None,
    ) -> FindResult:
        """Find the places in takes most similar to a motion, at half to twice its tempo.

        Parameters
        ----------
        query : a motion file, the number of a clip, or a motion.
        takes : numbers, files and folders, or motions; by default all takes of the library, whose windows are stored.
            Others are described now.
        k : how many places at most.
        mirror : search for the mirror image of the query too.
        exact : compare every window, also of more takes than fit in memory. Otherwise only the windows of these with
            the nearest sketches are compared.
        options : how to read the files.
        n_jobs : files read, and parts described, at a time; as in ``add``.
        progress : as in ``search``; with many takes also called while their search files are made.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the query cannot be used; such takes are named in the result.
        InvalidMotionError : the query is shorter than 0.27 s.
        LibraryError : no clip of this number, no takes, or the library cannot be read.
        OptionError : k below 1.

        >>> place = library.find("wave.bvh", "take.bvh").results[0]
        >>> segment = library.label("take.bvh").timeline.segments[1]
        >>> place.start < segment.stop and segment.start < place.end
        True
        """
        from dousa.motion import CanonicalMotion, Motion, Trajectories

        _check_k(k)
        single = (int, str, os.PathLike, CanonicalMotion, Motion, Trajectories)
        chosen = [takes] if isinstance(takes, single) else takes if takes is None else list(takes)
        options = options or ReadOptions()
        asked = query, chosen, k
        return self._takes.find(*asked, mirror=mirror, exact=exact, options=options, n_jobs=n_jobs, progress=progress)

    def label(
        self,
        take: Query,
        *,
        threshold: float | None = None,
        examples: Iterable[int] = (),
        options: ReadOptions | None = None,
        n_jobs: int | None = None,
        progress: Progress | None = None,
    ) -> LabelledTake:
        """Label a take from beginning to end: categories with their times, and what is unknown.

        The labeller is learned from the clips the first time after a training, and kept if the library can be written.

        Parameters
        ----------
        take : number, file, or motion.
        threshold : confidence from which a category is given, 0 to 1; None for the learned one.
        examples : numbers of clips cut out of takes and named by hand. The labeller learns from each at once, far more
            than from a clip that is only added.
        options : how to read the file.
        n_jobs : parts described at a time, as in ``add``.
        progress : of the learning; called with (steps done, steps, message about the next step).

        Raises
        ------
        NotTrainedError : there is no forest yet.
        MotionFileError, JointMappingError : the take cannot be used.
        LibraryError : no take of this number, or the library cannot be read.
        OptionError : a threshold outside 0 to 1.

        >>> labelled = library.label("take.bvh", n_jobs=1)
        >>> [segment.category for segment in labelled.timeline.segments]
        ['walk', 'wave_right', 'squat']
        """
        return self._labellers.label(take, threshold, tuple(examples), options or ReadOptions(), n_jobs, progress)

    def live(
        self,
        *,
        height: float | None = None,
        threshold: float | None = None,
        n_jobs: int | None = None,
        progress: Progress | None = None,
    ) -> LiveLabeller:
        """Return a labeller for a motion in progress: ``push`` a frame at a time; it answers several times a second.

        Parameters
        ----------
        height : m, of the performer; None to estimate it from the first second.
        threshold, n_jobs, progress : as in ``label``.

        Raises
        ------
        NotTrainedError : there is no forest yet.
        OptionError : a height or threshold out of range.
        LibraryError : the library cannot be read.

        >>> labeller = library.live(n_jobs=1)
        >>> motion = library.trajectories(1)
        >>> answers = [labeller.push(pose, frame / 30) for frame, pose in enumerate(motion.positions)]
        """
        return self._labellers.live(height, threshold, n_jobs, progress)

    # Made when first needed, as their imports are slow.

    @cached_property
    def _parts(self) -> PartForests:
        from dousa.library.search.part_forests import PartForests

        return PartForests(self.database)

    @cached_property
    def _searcher(self) -> Searcher:
        from dousa.library.search.search import Searcher

        return Searcher(self.database, self._forests, self._parts)

    @cached_property
    def _text(self) -> TextSearcher:
        from dousa.library.search.text import TextSearcher

        return TextSearcher(self.database)

    @cached_property
    def _takes(self) -> Takes:
        from dousa.library.takes.takes import Takes

        return Takes(self.database, self._forests, self._parts)

    @cached_property
    def _labellers(self) -> Labellers:
        from dousa.library.take_labellers import Labellers

        return Labellers(self.database, self._forests, self._takes, self._parts)

    @cached_property
    def annotations(self) -> Annotations:
        """Labels of takes, to read and write.

        >>> library.annotations.read()
        []
        """
        from dousa.library.annotations.store import Annotations

        return Annotations(self.database, self._forests, self.one_change)

    @cached_property
    def searches(self) -> SavedSearches:
        """Saved searches and selections.

        >>> saved = library.searches.save("squats", {"text": "squat"})
        >>> [search.name for search in library.searches.all()]
        ['squats']
        """
        from dousa.library.annotations.tags import SavedSearches

        return SavedSearches(self.database)


def _as_list(paths: Paths) -> list[str | os.PathLike[str]]:
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)


def _check_kind(kind: str) -> None:
    if kind not in (CLIP, TAKE):
        raise OptionError("library_add.unknown_kind", kind=kind)


def _check_k(k: int) -> None:
    if k < 1:
        raise OptionError("library_search.too_few_results", k=k)
