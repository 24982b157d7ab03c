"""How each command of the documents is tried: one table. A command that no row fits fails the tests."""

import enum
import functools
import re
import shlex
from dataclasses import dataclass
from typing import Any

from documents.commands import ROOT, Command


class How(enum.Enum):
    """What is done with a command."""

    FOLLOWED = "run as it is written, in the order of the page, on files that dousa makes or on ../shared/data"
    SMALL = "run on a few files of each kind of ../shared/data, once instead of --repeats N, with less of the rest"
    BENCHMARK = "its program is run on as little as its options allow"
    WRITES = "never run, it would write what the package ships: its program must exist and know its options"
    DRY = "not run: make -n says what it would do, and what it names must be there"
    INSTALLED = "not run, it needs the net: what it installs must be this project and its extras"
    SERVED = "not run here: tests/app/studio starts the server; its options must exist"
    ASKED = "run by tests/app/studio/test_studio_serving.py, which asks a running studio"
    MENTIONED = "spoken of in prose without what it needs to run: its name and its options must exist"


@dataclass(frozen=True, slots=True)
class _Rule:
    pattern: str
    how: How


# From above; the first row that fits the whole command counts.
_RULES = (
    _Rule(r"(?:.*\s)?--write(?:[\s=].*)?", How.WRITES),  # before all others: on little data it would ship a bad judge
    _Rule(r"python -m lab\.\S+ \.\.\. .*", How.WRITES),  # what is left out cannot be run: its options are asked for
    _Rule(
        r"make (?:demo|studio|test|test-slow|test-postgres|submission|nightly|types|coverage|wheel|lint|fuzz|bench"
        r"|peers|blender|figures|docs|lock|clean)",
        How.DRY,
    ),
    _Rule(r"pip install .*", How.INSTALLED),
    _Rule(r"python -m lab\.(?:[\w.]+|\w+\.studio_\w+ .*)", How.BENCHMARK),  # those of the studio take an hour
    _Rule(r"python -m lab\.trials\.partial_bodies --library LIB", How.BENCHMARK),  # LIB is a reader's own
    _Rule(r"python -m lab\.[\w.]+ .*", How.SMALL),
    _Rule(r"dousa experiment .*\.\./shared/data/.*", How.SMALL),
    _Rule(r"dousa studio(?: .*)?|dousa demo --studio", How.SERVED),
    # It needs the net; these need what that installs.
    _Rule(r"dousa (?:keypoints|sync|calibrate) ?.*", How.MENTIONED),
    # tests/app/test_projects.py and test_keypoint_sources.py run these on a FOLDER and folders that they make.
    _Rule(r"dousa (?:info|estimate) \.\./shared/data/silhouette_bench|dousa estimate cam01_json .*", How.MENTIONED),
    _Rule(r"curl .*|[A-Z]+=\$\(python3 -c .*\)", How.ASKED),
    _Rule(r"dousa .*(?:--cluster|postgresql\+psycopg:).*", How.MENTIONED),  # tests/workers, tests/library start these
    _Rule(r"dousa .*", How.FOLLOWED),
    _Rule(r"tracker \| dousa label .*", How.FOLLOWED),
    _Rule(r"printf .* > [\w.-]+", How.FOLLOWED),
    _Rule(r"(?:.*\n)?(?:import|from) .*", How.FOLLOWED),  # a piece of Python
)

# Words in capitals that stand for a reader's own.
_PLACEHOLDERS = {
    "FILE": "walk.bvh",
    "DATA": "recordings",
    "RULE": "'name:HDM_(..)_'",
    "FOLDER": "../shared/data/silhouette_bench",
}

# What a command of `How.SMALL` gets besides, by how it begins.
_LESS = {
    "python -m lab.estimation ../shared/data/silhouette_bench --views 1,2,4": "--variant noisy",
    "python -m lab.estimation ../shared/data/silhouette_bench/cmu86": "--frames 40:42 --views 2",
    r"dousa experiment .*": "--trees 10",
    r"python -m lab\.(?:ranking|novelty) .*": "--trees 10",
    "python -m lab.estimation FOLDER": "--variant noisy --views 2",
    "python -m lab.figures.measure_estimation kinect": "--quick --cache kept",
    "python -m lab.figures.measure_estimation retrieval": "--quick --subjects 1,3 --cache kept",
    "python -m lab.figures.measure_estimation video": "--views 1,2",
    "python -m lab.figures.measure_estimation films": "--models full --views 4",
    "python -m lab.figures.measure_estimation doubt": "--views 4 --variants clean",
    "python -m lab.figures.measure_evaluation furi": "--dances 1",
    "python -m lab.figures.measure_chain": "--wrong 1",
    "python -m lab.trials.ranking_weights": "--repeats 1",
    "python -m lab.trials.count_repetitions": "--only synthetic --repeats 1",
    "python -m lab.trials.label_corrections": "--quick",
    "python -m lab.trials.likeness": "--trees 10 --queries 1 --report hdm05",
    "python -m lab.trials.causes": "--only exchanged --places 3 --performers 0",
    "python -m lab.trials.exercise_faults": "--sensors kinect --references 1 --draws 1 --every 10",
    "python -m lab.trials.exercise_measures": "--sensors vicon --references 1 --draws 1 --every 40",
    "python -m lab.trials.count_series": "--folds 0 --only Intelli --quick",
    "python -m lab.trials.label_disturbed": "--only HDM05",
    "python -m lab.trials.confidence": "--only hdm05 --folds 1 --find 2",
    "python -m lab.trials.perhaps": "--only hdm05,utkinect --shares 0.98",
    "python -m lab.trials.label_strangers": "--only hdm05,utkinect --takes 1",
    "python -m lab.trials.segment_confidence": "--only hdm05",
    "python -m lab.benchmarks.find --on-disk": "--minutes 1",
}

# Injecting errors takes long: one category stands for a folder.
_INJECTED = r"python -m lab.errors|python -m lab.figures.measure_evaluation sweep"
_ONE_CATEGORY = {
    "/bandai": "/bandai/walk",
    "/hdm05": "/hdm05/squat1Reps",
    "/utd_mhad/skeleton": "/utd_mhad/skeleton/squat",
}

PROGRAMS = tuple(
    ".".join(path.relative_to(ROOT / "lab").with_suffix("").parts)
    for room in ("benchmarks", "trials", "training", "reliability", "exams")
    for path in sorted((ROOT / "lab" / room).glob("*.py"))
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
)
"""Programs of the lab, as ``python -m lab.NAME`` runs them."""

# The least that each program can do, of those that no page runs.
BENCHMARKS = {
    "benchmarks.__main__": "--only none",  # it runs those below
    "benchmarks.assess": "--minutes 0.2 --rate 30 --repeats 1",
    "reliability.compare_versions": f"--before '{ROOT}' --only features",
    "reliability.version_probe": "--help",  # compare_versions runs it
    "trials.label_review": "--draws 1",
    "trials.irds_grade": "--help",
    "trials.film_cameras": "--help",  # it needs the pose models
    "trials.live_film": "--help",  # likewise
    "benchmarks.keypoints": "--help",  # it needs the pose models
    "trials.made_people": "--help",  # likewise, and a mesh
    "trials.crossings": "--help",  # likewise
    "trials.degrees": "--help",  # likewise
    "training.train_doubt": "--help",  # likewise
    "benchmarks.correlation_matrix": "--frames 200 --repeats 1",
    "training.body_offsets": "--pairs 1",
    "benchmarks.estimate": "--frames 4 --repeats 1",
    "trials.partial_bodies": "--set HDM05 --only legs --seeds 1",
    "trials.noisy_clips": "--set HDM05 --repeats 1 --calibrated 1",
    "trials.few_clips": "../shared/data/bandai --share 0.5",
    "benchmarks.first_run": "--only convert",
    "benchmarks.forest": "--clips 60 --classes 3 --repeats 1",
    "benchmarks.in_turns": f"--before '{ROOT}' --rounds 1 --command 'correlation_matrix --frames 200 --repeats 1'",
    "reliability.file_damage": "--copies 4",
    "reliability.dense_files": "--megabytes 1",
    "reliability.library_flips": "--flips 4",
    "reliability.library_kill": "--kills 2 --only tag",
    "benchmarks.library_add": "../shared/data/bandai/run --jobs 1 --repeats 1 --files 1",
    "benchmarks.ranking": "--queries 1 --repeats 1",
    "benchmarks.reading": "../shared/data --repeats 1",
    "trials.recognition": "--only CMU --repeats 1",
    "trials.foreign_rigs": "--bodies 3",
    "trials.retargeting": "--pairs 2",  # a page only draws
    "reliability.many_writers": "--clips 60 --files 1 --trees 3",
    "trials.subsamples": "--clips 200 --drawn 50 --folds 1",
    "benchmarks.scale": "60 --categories 3",
    # These start a server and ask it, as tests/app/studio does: only their options are read.
    **{name: "--help" for name in PROGRAMS if ".studio_" in name},
    "benchmarks.search": "--clips 60 --categories 3 --repeats 1",
    "benchmarks.label": "--minutes 1 --repeats 1",
    "benchmarks.find": "--minutes 1 --repeats 1",
    "benchmarks.correspondence": "--frames 400 --full 200 --repeats 1",
    "benchmarks.silhouette_candidates": "--candidates 100 --limbs left_forearm --repeats 1",
    "benchmarks.weigh_install": "--help",  # it needs the package index
    # These take minutes to an hour; two of them write what the package ships.
    **dict.fromkeys(("training.calibrate_grade", "exams.evaluation", "exams.film", "training.train_judge"), "--help"),
    **dict.fromkeys(("exams.angles", "exams.retrieval", "exams.sides", "training.calibration_priors"), "--help"),
}


def fill_in(text: str) -> str:
    """The command with files in the place of words in capitals."""
    words = text.split(" ")
    return " ".join(_PLACEHOLDERS.get(word, word) for word in words)


def choose_rule(command: Command) -> How | None:
    """The way a command is tried; None where no row fits."""
    if command.place == "prose" and is_mention(command.text):
        return How.MENTIONED
    text = fill_in(command.text)
    for rule in _RULES:
        if re.fullmatch(rule.pattern, text, re.DOTALL):
            return rule.how
    return None


def is_mention(text: str) -> bool:
    """Whether a command of dousa in running prose lacks what it needs, or leaves something out."""
    if shlex.split(text)[0] != "dousa":
        return False
    words = _split(text)[1]
    return words == ["demo"] or "..." in words or _count_values(words) < _count_needed(words[0])


@functools.cache
def _commands() -> dict[str, Any]:
    from typer.main import get_command

    from dousa.app.cli.main import make_application

    return get_command(make_application()).commands  # type: ignore[attr-defined, no-any-return]


def _parameters(name: str) -> list[Any]:
    assert name in _commands(), f"there is no command 'dousa {name}'"
    return list(_commands()[name].params)


def check_options(text: str) -> None:
    """Fail if a command of dousa has an option that the command line does not know."""
    from dousa.app.cli.usage import ROOT_OPTIONS

    before, (name, *words) = _split(text)
    known = {option for part in _parameters(name) for option in (*part.opts, *part.secondary_opts)}
    assert set(before[::2]) <= set(ROOT_OPTIONS), f"{before} cannot stand before a command"
    for word in words:
        if word.startswith("-") and word not in ("-", "--help"):
            assert word.split("=")[0] in known, f"dousa {name} has no {word}"


def _split(text: str) -> tuple[list[str], list[str]]:
    """The options before the command, each with its value; and the command with its words."""
    _, *words = shlex.split(text)
    start = 0
    while words[start].startswith("-"):
        start += 2
    return words[:start], words[start:]


def _count_needed(name: str) -> int:
    """How many arguments a command cannot do without."""
    return sum(part.param_type_name == "argument" and part.required for part in _parameters(name))


def _count_values(words: list[str]) -> int:
    """How many words of a call are arguments and not options or their values."""
    options = {name: part for part in _parameters(words[0]) for name in part.opts}
    count, skipped = 0, False
    for word in words[1:]:
        if skipped:
            skipped = False
        elif word in options:
            skipped = not options[word].is_flag
        else:
            count += 1
    return count


def make_small(text: str) -> str:
    """A long command as it is tried: the same with one repeat and less of the rest."""
    assert "--write" not in text, f"{text} would change what the package ships: write the option outside of the command"
    small = re.sub(r"--repeats [1-9]\d*", "--repeats 1", fill_in(text))
    if re.match(_INJECTED, text):
        for whole, part in _ONE_CATEGORY.items():
            small = re.sub(rf"{whole}(?= |$)", part, small)
        small = small.replace("/*/", "/squat*/")  # of all categories by a wildcard
    if text.startswith("python -m lab.figures.measure_chain"):  # estimates every skeleton: only those filmed
        small = small.replace("/data/utd_mhad", "/data/filmed/utd_mhad").replace("--people 1,3,5,7", "--people 1")
    added = [more for begin, more in _LESS.items() if re.match(begin, text)]
    assert len(added) <= 1, f"two rows for {text}"
    return " ".join((small if text.startswith(("dousa", "python")) else f"python {small}", *added))
