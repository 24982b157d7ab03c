"""Commands for experiments: experiment, experiment-estimation and demo."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from dousa.app.cli import options as o
from dousa.app.output import ProgressCallback, console, print_json, progress_bar, warn, warn_skipped
from dousa.errors import OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.estimation.tracking.settings import TrackerSettings
    from dousa.experiments.table import Result
    from dousa.formats.motion_files import Skipped
    from dousa.retrieval import LabelledClip


SplitName = Literal["half", "leave-performer-out"]


class SystemName(enum.StrEnum):
    """What is compared: the first four tell categories apart, the last seven rank."""

    FULL_TREE = "full_tree"
    RANDOM_TREE = "random_tree"
    FOREST = "forest"
    MOTION_TEMPLATES = "motion_templates"
    FUSED = "fused"
    HISTOGRAM = "histogram"
    LEAVES = "leaves"
    POSE = "pose"
    EUCLIDEAN = "euclidean"
    DTW = "dtw"


class VariantName(enum.StrEnum):
    """Kinds of sequences, by the ends of their names."""

    CLEAN = "clean"
    NOISY = "noisy"


StartName = Literal["truth", "auto"]

BodyName = Literal["stature", "start"]

ViewChoiceName = Literal["first", "all"]

_SAMPLES = 8


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    app.command(rich_help_panel="Trials")(experiment)
    app.command(rich_help_panel="Trials")(demo)
    app.command("experiment-estimation", rich_help_panel="Estimation")(experiment_estimation)


def experiment(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of motion files.")],
    test: Annotated[
        list[Path] | None,
        typer.Option("--test", help="Train on PATH and test on this folder instead of splitting."),
    ] = None,
    split: Annotated[SplitName | None, typer.Option("--split", help="How PATH is split.", show_default="half")] = None,
    train_share: Annotated[
        float | None,
        typer.Option("--train-share", help="Share of every category to train on, instead of half.", show_default="0.5"),
    ] = None,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Number of repeats, with different seeds.")] = 1,
    ranking: Annotated[
        bool,
        typer.Option("--ranking", help="Evaluate the ranking of retrieved clips instead of their categories."),
    ] = False,
    takes: Annotated[
        bool,
        typer.Option("--takes", help="Evaluate labelling and search of takes concatenated from clips."),
    ] = False,
    unknown: Annotated[
        bool,
        typer.Option("--unknown", help="Evaluate detection of unknown motions and learning of new categories."),
    ] = False,
    features: Annotated[
        o.FeatureSetName | None,
        typer.Option(
            "--features",
            help="paper: the 56 pose features; extended: also speeds, spreads, trends.",
            show_default="paper; extended with --ranking, --takes and --unknown",
        ),
    ] = None,
    system: Annotated[
        list[SystemName] | None,
        typer.Option(
            "--system",
            help="Only this system; can be repeated.",
            show_default="all four; with --ranking the last seven",
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option("--samples", min=1, help="Poses averaged for each of the 10 frames; 1 is plain downsampling."),
    ] = _SAMPLES,
    trees: Annotated[int, typer.Option("--trees", min=1, help="Trees of the forest.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0,
    category_from: o.CategoryFrom = "folder",
    performer_from: o.PerformerFrom = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    jobs: o.Jobs = None,
    figure: Annotated[Path | None, typer.Option("--figure", help="Draw the table: .png, .svg or .pdf.")] = None,
    json: o.Json = False,
) -> None:
    """Measure recognition on held-out clips: single trees, the forest and motion templates.

    The paper's figures 4 and 5 as a table. Without --split half of every category trains and half is tested. With
    --ranking: how good is the order in which clips are found, by our rankings, Euclidean distance, DTW and motion
    templates. With --takes: how well are long takes of people left out labelled and searched. With --unknown: are
    motions of no known category told, and how good are categories that were added later.

    Example: dousa experiment hdm05/ --split leave-performer-out --performer-from 'name:HDM_(..)_'
    """
    from dousa.app.pipelines.experiment_clips import read_labelled_clips, refuse_clips_in_both
    from dousa.app.tables.answers import print_tables
    from dousa.formats.motion_files import ReadOptions

    kind = _choose_kind(ranking=ranking, takes=takes, unknown=unknown)
    _check_split(split, bool(test), performer_from)
    given = {
        "--train-share": train_share is not None,
        "--repeats": repeats != 1,
        "--samples": samples != _SAMPLES,
        "--figure": figure is not None,
        "--split": split is not None,
        "--test": bool(test),
        "--system": bool(system),
    }
    _refuse_ignored(kind, given)
    if figure:
        require("matplotlib", "pictures")
    if train_share is not None and (test or split == "leave-performer-out"):
        raise OptionError("experiments_cli.train_share")
    systems = _choose_systems(system, ranking)
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    with progress_bar() as progress:

        def read(paths: list[Path]) -> tuple[list[LabelledClip], list[Skipped]]:
            return read_labelled_clips(
                paths,
                category_from=category_from,
                performer_from=performer_from,
                options=options,
                n_jobs=jobs,
                progress=progress,
            )

        clips, skipped = read(path)
        tested, more = read(test) if test else (None, [])
        refuse_clips_in_both(clips, tested or [])
        shared: dict[str, Any] = {
            "feature_set": (features or kind.usual_features).value,
            "n_trees": trees,
            "random_state": seed,
            "n_jobs": jobs or -1,
            "progress": progress,
        }
        trial = _Trial(clips, tested, None if test else split or "half", systems, repeats, shared)
        result = trial.run(kind, train_share or 0.5, samples)
    skipped += more
    warn_skipped(skipped)
    answer = {**result.to_json(), "skipped": [item.to_json() for item in skipped]}
    if json:
        print_json(answer)
    else:
        print_tables(console(), result.to_tables())
    if figure:  # last, so that an answer that took long is not lost where the picture cannot be written
        from dousa.app.pictures.sheets import draw_experiment_figure

        draw_experiment_figure(answer, figure)


class _Kind(enum.Enum):
    """What an experiment asks, and the options that have nothing to do with it."""

    RECOGNITION = ("", ())
    RANKING = ("--ranking", ("--train-share", "--repeats", "--samples", "--figure"))
    TAKES = (
        "--takes",
        ("--train-share", "--repeats", "--samples", "--figure", "--split", "--test", "--system"),
    )
    UNKNOWN = ("--unknown", ("--train-share", "--samples", "--figure", "--split", "--test", "--system"))

    @property
    def usual_features(self) -> o.FeatureSetName:
        """What it looks at by default."""
        return o.FeatureSetName.PAPER if self is _Kind.RECOGNITION else o.FeatureSetName.EXTENDED


def _choose_kind(*, ranking: bool, takes: bool, unknown: bool) -> _Kind:
    asked = {_Kind.RANKING: ranking, _Kind.TAKES: takes, _Kind.UNKNOWN: unknown}
    kinds = [kind for kind, wanted in asked.items() if wanted]
    if len(kinds) > 1:
        raise OptionError("experiments_cli.one_kind", found=[kind.value[0] for kind in kinds])
    return kinds[0] if kinds else _Kind.RECOGNITION


def _refuse_ignored(kind: _Kind, given: dict[str, bool]) -> None:
    """Refuse what would be ignored."""
    name, ignored = kind.value
    for option in ignored:
        if given[option]:
            raise OptionError("experiments_cli.not_with", option=option, kind=name)


@dataclass(frozen=True, slots=True)
class _Trial:
    """What all kinds of experiments are asked; ``shared`` are the options that all have."""

    clips: list[LabelledClip]
    tested: list[LabelledClip] | None
    split: str | None
    systems: list[str]
    repeats: int
    shared: dict[str, Any]

    def run(self, kind: _Kind, train_share: float, samples: int) -> Result:
        """Tell categories apart, put clips in order, label takes, or detect what is unknown."""
        from dousa import experiments

        if kind is _Kind.RANKING:
            return experiments.run_ranking_experiment(
                self.clips, test_clips=self.tested, split=self.split, systems=self.systems, **self.shared
            )
        if kind is _Kind.TAKES:
            return experiments.run_takes_experiment(self.clips, **self.shared)
        if kind is _Kind.UNKNOWN:
            return experiments.run_novelty_experiment(self.clips, repeats=self.repeats, **self.shared)
        return experiments.run_experiment(
            self.clips,
            test_clips=self.tested,
            split=self.split,
            train_share=train_share,
            repeats=self.repeats,
            systems=self.systems,
            samples_per_frame=samples,
            **self.shared,
        )


def _choose_systems(asked: list[SystemName] | None, ranking: bool) -> list[str]:
    """The systems asked for, or all that this kind of experiment has."""
    from dousa.experiments.ranking_systems import RANKING_SYSTEMS
    from dousa.experiments.recognition import SYSTEMS

    able = RANKING_SYSTEMS if ranking else SYSTEMS
    names = [str(name) for name in dict.fromkeys(asked or able)]
    wrong = [name for name in names if name not in able]
    if wrong:
        code = "experiments_cli.not_a_ranking" if ranking else "experiments_cli.not_a_classifier"
        raise OptionError(code, expected=able, found=wrong)
    return names


def _check_split(split: SplitName | None, test_given: bool, performer_from: str | None) -> None:
    if test_given and split is not None:
        raise OptionError("experiments_cli.split_and_test")
    if split == "leave-performer-out" and performer_from is None:
        raise OptionError("experiments_cli.no_performers")


def experiment_estimation(
    path: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="Sequences (.npz) with masks, cameras, stature and true joints, or folders of them.",
        ),
    ],
    views: Annotated[
        str, typer.Option("--views", metavar="N,N...", help="Numbers of views to evaluate, each in turn.")
    ] = "1,2,4",
    choice: Annotated[
        ViewChoiceName,
        typer.Option(
            "--choice",
            help="first: one view is the first, two are it and the one most nearly at right angles to it; all: "
            "every choice, averaged.",
        ),
    ] = "first",
    variant: Annotated[
        list[VariantName] | None,
        typer.Option(
            "--variant",
            help="Only files of a folder whose names end in this; can be repeated.",
            show_default="both",
        ),
    ] = None,
    start: Annotated[
        StartName,
        typer.Option("--start", help="truth: the true joints of the first frame are given; auto: the start is found."),
    ] = "truth",
    body: Annotated[
        BodyName,
        typer.Option("--body", help="stature: from tables; start: also the bones that the first frame shows."),
    ] = "stature",
    reading: Annotated[
        list[o.Reading] | None,
        typer.Option("--reading", help="Reading of eq. 2; with --paper several.", show_default="masked"),
    ] = None,
    evidence: Annotated[
        list[o.Evidence] | None,
        typer.Option(
            "--evidence",
            help="How image and inertia are weighted; with --paper several.",
            show_default="log",
        ),
    ] = None,
    paper: Annotated[
        bool,
        typer.Option("--paper", help="The paper's experiment on one PATH: all readings, dR = 6 deg, s = 1 deg."),
    ] = False,
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="FIRST:STOP", help="Frames of --paper, from 0.", show_default="40:76"),
    ] = None,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Measure the accuracy of estimated poses, with static-pose and constant-velocity baselines.

    The tracker is given the first frame's joints and the stature, nothing else.
    Errors in space are in mm: raw, with the hips moved onto the true ones, and
    after the best rotation and translation of each frame (posture).

    Example: dousa experiment-estimation silhouette_bench/ --variant clean

    Example: dousa experiment-estimation silhouette_bench/cmu86_walk_clean.npz --paper
    """
    counts = _parse_views(views)
    if frames is not None and not paper:
        raise OptionError("experiments_cli.frames_without_paper")
    readings, evidences = ([name.value for name in names or ()] for names in (reading, evidence))
    result: Result
    problems: Sequence[Message] = ()
    with progress_bar() as progress:
        if paper:
            _check_paper(path, start, body, choice, variant)
            result = _run_paper(path[0], counts, readings, evidences, frames, jobs, progress)
        else:
            from dousa.experiments import run_bench

            result = bench = run_bench(
                path,
                views=counts,
                choice=choice,
                variants=[name.value for name in variant or VariantName],
                settings=_choose_settings(readings, evidences),
                start=start,
                body=body,
                n_jobs=jobs or -1,
                progress=progress,
            )
            problems = bench.problems
    if json:
        print_json(result)
        return
    from dousa.app.tables.answers import print_tables

    print_tables(console(), result.to_tables())
    for problem in problems:
        warn(problem)


def _parse_views(text: str) -> list[int]:
    try:
        counts = [int(word) for word in text.split(",")]
    except ValueError:
        counts = []
    if not counts or min(counts) < 1:
        raise OptionError("experiments_cli.views", found=text)
    return list(dict.fromkeys(counts))


def _parse_frames(text: str) -> tuple[int, int]:
    first, colon, stop = text.partition(":")
    if not (colon and first.isdecimal() and stop.isdecimal() and int(first) + 1 < int(stop)):
        raise OptionError("experiments_cli.frames", found=text)
    return int(first), int(stop)


def _choose_settings(readings: Sequence[str], evidences: Sequence[str]) -> TrackerSettings:
    from dousa.estimation.tracking.settings import TrackerSettings

    settings = TrackerSettings()
    for name, values in (("reading", readings), ("evidence", evidences)):
        if len(values) > 1:
            raise OptionError("experiments_cli.several_without_paper", option=f"--{name}")
        if values:
            settings = replace(settings, **{name: values[0]})  # type: ignore[arg-type]
    return settings


def _check_paper(
    path: Sequence[Path],
    start: StartName,
    body: BodyName,
    choice: ViewChoiceName,
    variant: Sequence[VariantName] | None,
) -> None:
    if len(path) != 1 or not path[0].is_file():
        raise OptionError("experiments_cli.paper_sequence")
    kept = ("truth", "stature", "first")
    if (start, body, choice) != kept or variant:
        raise OptionError("experiments_cli.paper_options")


def _run_paper(
    path: Path,
    views: Sequence[int],
    readings: Sequence[str],
    evidences: Sequence[str],
    frames: str | None,
    jobs: int | None,
    progress: ProgressCallback,
) -> Result:
    from dousa.estimation.tracking.settings import EVIDENCES, READINGS
    from dousa.experiments.readings import WALKING, run_reading_table

    return run_reading_table(
        path,
        frames=WALKING if frames is None else _parse_frames(frames),
        views=views,
        readings=readings or READINGS,  # type: ignore[arg-type]  # checked by the option
        evidences=evidences or EVIDENCES,  # type: ignore[arg-type]
        n_jobs=jobs or -1,
        progress=progress,
    )


def demo(
    data: Annotated[
        Path | None, typer.Option("--data", help="Do it with the motion files of this folder instead.")
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the motions, the library and the picture.")
    ] = Path("demo-output"),
    category_from: o.CategoryFrom = "folder",
    performer_from: o.PerformerFrom = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Other performers and motions.")] = 0,
    jobs: o.Jobs = None,
    studio: Annotated[
        bool,
        typer.Option(
            "--studio",
            help="Then open the studio on the demo library; at once if the folder has one already.",
        ),
    ] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="With --studio: only print the address.")] = False,
) -> None:
    """Show the main jobs with nothing but the package: make a library of motions, train it, search it and look
    into an uncut take; make a dance and a pupil who gets parts of it wrong, and tell them; see a performer with four
    cameras, estimate the motion from the silhouettes, and find and judge it (the last two not with --data).

    Example: dousa demo --output demo-output

    Example: dousa demo --studio
    """
    from dousa.app.cli.studio import LIBRARY, open_demo_studio
    from dousa.app.demo.demo import run_demo
    from dousa.app.demo.estimation import run_estimation_demo
    from dousa.app.demo.evaluation import run_dance_demo

    for package, extra in (
        ("matplotlib", "pictures"),
        ("cv2", "film"),
        *([("uvicorn", "studio")] if studio else []),
    ):
        require(package, extra)
    if studio and (output / LIBRARY).is_file():
        open_demo_studio(console(), output, opens_browser=not no_browser)
        return
    run_demo(
        console(),
        data,
        output,
        seed=seed,
        n_jobs=jobs,
        category_from=category_from,
        performer_from=performer_from,
    )
    if data is None:
        run_dance_demo(console(), output, seed=seed)
        run_estimation_demo(console(), output, seed=seed)
    if studio:
        open_demo_studio(console(), output, opens_browser=not no_browser)
