"""Commands for trials: experiment, demo and warm."""

from __future__ import annotations

import enum
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import console, print_json, progress_bar, say, warn_skipped
from dousa.app.requests.experiments import ExperimentRequest, SystemName
from dousa.app.requests.library import FeatureSet, LabelRules, TakeLabels
from dousa.app.requests.reading import Reading
from dousa.errors import OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.demo import Material
    from dousa.experiments.table import Result
    from dousa.retrieval import LabelledClip


def experiment(
    context: typer.Context,
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of motion files.")],
    *,
    request: ExperimentRequest,
    take_labels: TakeLabels,
    rules: LabelRules,
    reading: Reading,
    json: Json = False,
) -> None:
    """Measure recognition on held-out clips: single trees, the forest and motion templates.

    The paper's figures 4 and 5 as a table. Without --split half of every category trains and half is tested. With
    --takes: how well are long takes of people left out labelled and searched; with --labels these are real takes.

    Example: dousa experiment hdm05/ --split leave-performer-out --performer-from 'name:HDM_(..)_'

    Example: dousa experiment sessions/ --takes --labels beside --performer-from 'name:(s..)_'
    """
    from dousa.app.pipelines.experiment_clips import read_annotated_takes, read_labelled_clips, refuse_clips_in_both
    from dousa.app.tables.library import warn_of_files
    from dousa.app.tables.lines import print_tables

    kind = _choose_kind(request, take_labels)
    _check_options(kind, request, rules)
    files: dict[str, Any] = {"performer_from": rules.performer_from, "options": reading.load()}
    notes: list[tuple[str, Message]] = []
    files["note"] = lambda path, message: notes.append((path, message))
    result: Result
    with progress_bar() as progress:
        shared: dict[str, Any] = {"n_jobs": context.obj or -1, "progress": progress}
        files |= {"n_jobs": context.obj, "progress": progress}
        if kind is _Kind.ANNOTATED:
            from dousa.experiments import run_annotated_takes_experiment

            takes, skipped = read_annotated_takes(path, take_labels.labels or "", take_labels.tier, **files)
            result = run_annotated_takes_experiment(takes, **shared)
        else:
            files["category_from"] = rules.category_from
            clips, skipped = read_labelled_clips(path, **files)
            tested, more = read_labelled_clips(request.test, **files) if request.test else (None, [])
            refuse_clips_in_both(clips, tested or [])
            result = _run_trial(kind, clips, tested, request, shared)
            skipped += more
    warn_skipped(skipped)
    answer = {**result.to_json(), "skipped": [item.to_json() for item in skipped]}
    if notes:
        answer["notes"] = [{"path": path, "note": str(message)} for path, message in notes]
    if json:
        print_json(answer)
    else:
        warn_of_files(notes)
        print_tables(console(), result.to_tables())


class _Kind(enum.Enum):
    """What an experiment asks, and the options that have nothing to do with it."""

    RECOGNITION = ("", ())
    TAKES = ("--takes", ("--repeats", "--split", "--test", "--system"))
    ANNOTATED = ("--takes --labels", ("--repeats", "--test", "--system", "--category-from"))

    @property
    def usual_features(self) -> FeatureSet:
        """What it looks at by default."""
        return "paper" if self is _Kind.RECOGNITION else "extended"


def _choose_kind(request: ExperimentRequest, takes: TakeLabels) -> _Kind:
    if takes != TakeLabels() and not request.takes:
        raise OptionError("annotations.of_clips")
    if takes.tier is not None and takes.labels is None:
        raise OptionError("annotations.tier_alone")
    if takes.labels is not None:
        return _Kind.ANNOTATED
    return _Kind.TAKES if request.takes else _Kind.RECOGNITION


def _check_options(kind: _Kind, request: ExperimentRequest, labels: LabelRules) -> None:
    if request.test and request.split is not None:
        raise OptionError("experiments_cli.split_and_test")
    if request.split == "leave-performer-out" and labels.performer_from is None:
        raise OptionError("experiments_cli.no_performers")
    if kind is _Kind.ANNOTATED and request.split not in (None, "leave-performer-out"):
        raise OptionError("experiments_cli.not_with", option=f"--split {request.split}", kind=kind.value[0])
    if kind is _Kind.ANNOTATED and labels.performer_from is None:
        raise OptionError("experiments_cli.takes_of_nobody")
    given = {
        "--category-from": labels.category_from != "folder",
        "--repeats": request.repeats != 1,
        "--split": request.split is not None,
        "--split SHARE": request.train_share is not None,
        "--test": bool(request.test),
        "--system": bool(request.system),
    }
    name, ignored = kind.value
    for option in ignored:
        if given[option]:
            raise OptionError("experiments_cli.not_with", option=option, kind=name)


def _run_trial(
    kind: _Kind,
    clips: list[LabelledClip],
    tested: list[LabelledClip] | None,
    request: ExperimentRequest,
    shared: dict[str, Any],
) -> Result:
    """Classify clips, or label takes.

    ``shared`` are the arguments that all kinds of experiments have.
    """
    from dousa import experiments

    forest: dict[str, Any] = {"feature_set": request.features or kind.usual_features, "n_trees": request.trees}
    if kind is _Kind.TAKES:
        return experiments.run_takes_experiment(clips, **forest, **shared)
    share = request.train_share
    return experiments.run_experiment(
        clips,
        test_clips=tested,
        split=None if tested else "half" if share is not None else request.split or "half",
        train_share=0.5 if share is None else share,
        repeats=request.repeats,
        systems=[str(name) for name in dict.fromkeys(request.system or SystemName)],
        **forest,
        **shared,
    )


def demo(
    context: typer.Context,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the motions, the library and the pictures.")
    ] = Path("demo-output"),
    studio: Annotated[
        bool,
        typer.Option(
            "--studio",
            help="Then open the studio on the demo library; at once if the folder has one already.",
        ),
    ] = False,
) -> None:
    """Show the main jobs with nothing but the package: the commands are printed, and run on made motions.

    A library of motions is made, trained, searched, and an uncut take labelled; a pupil's dance is evaluated; a kick is
    estimated from the silhouettes of four cameras, searched for, and evaluated.

    Example: dousa demo --output demo-output

    Example: dousa demo --studio
    """
    from dousa.app.cli.studio import open_demo_studio
    from dousa.app.demo import LIBRARY, write_material

    extras = {"matplotlib": "pictures", "cv2": "film", **({"uvicorn": "studio"} if studio else {})}
    for package, extra in extras.items():
        require(package, extra)
    if not (studio and (output / LIBRARY).is_file()):
        with progress_bar() as progress:
            made = write_material(output, progress=progress)
        for truth, command in _list_commands(output, made):
            _run_command(truth, command, context.obj)
    if studio:
        open_demo_studio(console(), output)


def _list_commands(output: Path, made: Material) -> list[tuple[str, tuple[object, ...]]]:
    """The commands of the three jobs, and before each what is true of its material, if anything."""
    from dousa.app.demo import KICK, LIBRARY, PERFORMER_RULE
    from dousa.evaluation.words import KINDS, format_time

    take = made.take
    parts = (f"{format_time(part.start)} {part.category or 'of no category'}" for part in take.truth)
    mistakes = (f"{format_time(one.start_s)}-{format_time(one.end_s)} {KINDS[one.kind]}" for one in made.mistakes)
    library, someone = output / LIBRARY, f"{KICK}, by a performer whom the library does not have"
    estimated, report = output / "estimated.bvh", output / "report_estimated"
    movie, sheet = estimated.with_suffix(".mp4"), estimated.with_suffix(".png")
    stature = f"{made.stature:.2f}"
    return [
        ("1. A library, searched.", ("add", library, made.motions, "--performer-from", PERFORMER_RULE)),
        ("", ("train", library)),
        (f"In truth {someone}:", ("search", library, made.query, "-k", "8", "--picture", output / "search.png")),
        (f"In truth {', '.join(parts)}:", ("add", library, take.path, "--takes")),
        ("", ("label", library, take.path, "--picture", output / "timeline.png")),
        ("", ("find", library, made.motions / KICK / "performer00_1.bvh", "-k", "2")),
        (
            "2. A pupil's dance. In truth wrong: " + ", ".join(mistakes) + ".",
            ("evaluate", made.reference, "--performance", made.pupil, "-o", output / "report"),
        ),
        (
            "3. A performer seen by four cameras, whose bones and girths are 5 to 7 % off the model's.",
            ("estimate", made.seen, "--stature", stature, "-o", estimated, "-o", movie, "-o", sheet),
        ),
        (f"In truth {someone}:", ("search", library, estimated, "-k", "5")),
        (
            "Against a teacher's takes, as it was estimated and as it was:",
            ("evaluate", *made.teacher, "--performance", estimated, "--tempo", "free", "-o", report),
        ),
        ("", ("evaluate", *made.teacher, "--performance", made.performed, "--tempo", "free", "--detail", "brief")),
    ]


def _run_command(truth: str, command: tuple[object, ...], jobs: int | None) -> None:
    from dousa.app.cli.main import make_application

    words = [str(word) for word in command]
    for line in (truth, f"$ dousa {shlex.join(words)}"):
        if line:
            console().print()
            say(line)
    code = make_application(words)([*(("-j", str(jobs)) if jobs else ()), *words], standalone_mode=False)
    if code:  # as after Ctrl-C, which Typer turns into one
        raise typer.Exit(code)


def warm(
    context: typer.Context,
    parts: Annotated[
        list[str] | None,
        typer.Argument(metavar="[PART...]", help="Of library, estimation and evaluation.", show_default="all"),
    ] = None,
) -> None:
    """Compile now what the commands would compile at their first use.

    Small jobs are done with made motions, on all cores; what they compile is kept. It can be interrupted: the rest is
    compiled when it is needed, or when this command is run again.

    Example: dousa warm

    Example: dousa warm library
    """
    from dousa.app.tables.lines import say_line
    from dousa.app.warm import warm as run_jobs

    with progress_bar() as progress:
        found = run_jobs(parts, context.obj, progress)
    for one in found:
        say_line(console(), "warm.ready" if one.problem is None else "warm.not_ready", **one.to_json())
    if any(one.problem for one in found):
        raise typer.Exit(2)
