"""One version of dousa runs one group of probes and writes what it answers; `compare_versions.py` starts it for both.

    PYTHONPATH=CHECKOUT/src python -m lab.reliability.version_probe GROUP --data DATA --work FOLDER --out FILE

Only what every version has is used: the command line, and the names that the packages of methods export.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import dousa
from lab.reliability.probe_record import Record

PERFORMER = r"name:(?:HDM_|_s)([a-z]{2}|\d)_"
SUFFIXES = (".bvh", ".trc", ".c3d", ".npz")
HOMES_OF_ERRORS = ("dousa.experiments", "lab.injection.injection")
LARGEST_BYTES = 1_000_000  # of a foreign file that is read
CATEGORIES = {"hdm05": 11, "bandai": 5, "utd_mhad/skeleton": 8}


class Room:
    """What a group works with.

    Parameters
    ----------
    record : takes the answers.
    data : the recordings.
    work : an empty folder.
    old_library : written by the earlier version.
    """

    def __init__(self, record: Record, data: Path, work: Path, old_library: Path) -> None:
        self.record, self.data, self.work, self.old_library = record, data, work, old_library

    def find(self, pattern: str, count: int) -> list[Path]:
        """Recordings evenly spread over all of a pattern."""
        return _spread(sorted(self.data.glob(pattern)), count)

    def link_clips(self, name: str, categories: dict[str, int], each: int) -> Path:
        """A folder with a folder for each category, of links to recordings.

        Parameters
        ----------
        name : of the folder.
        categories : how many categories of which data set.
        each : clips of a category.
        """
        root = self._make_folder(name)
        for source, count in categories.items():
            folders = [path for path in sorted((self.data / source).iterdir()) if path.is_dir()]
            for folder in _spread(folders, count):
                files = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in (*SUFFIXES, ".amc")]
                (root / folder.name).mkdir(exist_ok=True)
                for file in _spread(files, each):
                    (root / folder.name / file.name).symlink_to(file)
        return root

    def link_clip(self, category: str, file: Path) -> Path:
        """A folder of one clip of a category."""
        root = self._make_folder(f"{category}_{file.stem}")
        (root / category).mkdir()
        (root / category / file.name).symlink_to(file)
        return root

    def _make_folder(self, name: str) -> Path:
        root = self.work / name
        root.mkdir()
        for skeleton in self.data.glob("hdm05/*.asf"):
            (root / skeleton.name).symlink_to(skeleton)
        return root

    def list_queries(self) -> list[Path]:
        """Clips that the libraries do not hold."""
        held = {path.name for path in (self.work / "clips").rglob("*")}
        sources = ("hdm05/*/*.amc", "bandai/r*/*/*.bvh", "utd_mhad/skeleton/*/*_t1.c3d")
        return [path for source in sources for path in self.find(source, 5) if path.name not in held][:9]


def _spread(items: Sequence[Path], count: int) -> list[Path]:
    if len(items) <= count:
        return list(items)
    return [items[round(place)] for place in np.linspace(0, len(items) - 1, count)]


def _read(room: Room, place: str, path: Path) -> Any:
    """The motion of a file with its canonical joints, or the kind of error."""
    try:
        motion = dousa.read_motion(path)
        fields = (
            "names",
            "positions",
            "parents",
            "rest_positions",
            "rotations",
            "translations",
            "frame_rate",
        )
        room.record.put(place, {name: getattr(motion, name) for name in fields if hasattr(motion, name)})
        if isinstance(motion, dousa.Motion):
            room.record.put(f"{place}.skeleton", motion.skeleton)
            room.record.put(f"{place}.moving", dousa.compute_trajectories(motion).positions)
        if origin := motion.provenance:
            wanted = ("format", "unit", "unit_source", "up", "up_source", "values")
            room.record.put(place, {name: getattr(origin, name) for name in wanted})
        room.record.put(f"{place}.canonical", dousa.canonicalise(motion))
    except dousa_error() as error:
        room.record.put(f"{place}.error", type(error).__name__)
        room.record.put(f"{place}.error.says", f"it says: {error}")
        return None
    return motion


def find_name(name: str, *packages: str) -> Any:
    """What a public name stands for; it may have moved from one package to another."""
    for package in packages:
        try:
            return getattr(importlib.import_module(package), name)
        except (ImportError, AttributeError):
            continue
    raise LookupError(f"{name} is in none of {', '.join(packages)}")


def dousa_error() -> type[Exception]:
    """The base of all errors that a person can put right."""
    from dousa.errors import DousaError

    return DousaError


def reading(room: Room) -> None:
    """Every format: positions, rotations, rates, canonical joints, errors; files that are written."""
    samples = {
        "BVH": room.find("bandai/*/*/*.bvh", 6) + room.find("bandai_dance/*", 1),
        "AMC": room.find("hdm05/*/*.amc", 8) + room.find("cmu86/*.amc", 1),
        "C3D": room.find("utd_mhad/skeleton/*/*.c3d", 8),
        "TRC": room.find("irds/*/*/*.trc", 4) + room.find("utkinect/*.trc", 2) + room.find("pose2sim/*.trc", 2),
    }
    for kind, files in samples.items():
        with room.record.probe(f"read {kind}"):
            for path in files:
                _read(room, path.name, path)
    foreign = [path for path in sorted(room.data.glob("foreign/*/*")) if path.stat().st_size <= LARGEST_BYTES]
    for kind in (".bvh", ".c3d", ".trc", ""):
        with room.record.probe(f"read foreign {kind[1:].upper() or 'others'}"):
            for path in foreign:
                suffix = path.suffix.lower()
                if suffix == kind or (not kind and suffix not in (".bvh", ".c3d", ".trc")):
                    _read(room, f"{path.parent.name}/{path.name}", path)
    with room.record.probe("find files"):
        find_motion_files = find_name("find_motion_files", "dousa.library", "dousa.formats")
        room.record.put("files", find_motion_files([room.data / "foreign", room.data / "cmu86"]))
    with room.record.probe("write"):
        _write(room, [files[0] for files in samples.values()] + room.find("foreign/emre_mixed/R*.bvh", 1))
    with room.record.probe("dousa info, convert"):
        first = [files[-1] for files in samples.values()]
        room.record.command("info", "info", *first, "--json")
        for path in first:
            for suffix in SUFFIXES:
                made = room.work / f"{path.stem}_slow{suffix}"
                place = f"convert {path.suffix} {suffix}"
                room.record.command(place, "convert", path, made, "--frame-rate", 20, "--json")
                room.record.file(f"{place}.bytes", made)


def _write(room: Room, files: Iterable[Path]) -> None:
    for path in files:
        motion = dousa.read_motion(path)
        for suffix in SUFFIXES:
            made = room.work / f"{path.stem}{path.suffix[1:].lower()}{suffix}"
            place = f"{path.suffix.lower()} to {suffix}"
            try:
                dousa.write_motion(motion, made)
            except dousa_error() as error:
                room.record.put(f"{place}.error", type(error).__name__)
            room.record.file(place, made)
            if made.exists():
                _read(room, f"{place}, read", made)


def features(room: Room) -> None:
    """Pose features, tracks and forests of both feature sets, from the public names."""
    from dousa import motion, retrieval

    root = room.link_clips("clips", CATEGORIES, 4)
    files = [path for path in sorted(root.rglob("*")) if path.parent != root and not path.is_dir()]
    clips = [dousa.canonicalise(dousa.read_motion(path)) for path in files]
    categories = [path.parent.name for path in files]
    with room.record.probe("motion"):
        for path, clip in list(zip(files, clips, strict=True))[::8]:
            room.record.put(f"{path.name}.resampled", motion.resample(clip.to_trajectories(), 50.0))
            room.record.put(f"{path.name}.mirrored", motion.mirror_canonical(clip))
            room.record.put(f"{path.name}.fitted", motion.fit_motion(clip).rotations)
    for name, kind in retrieval.FEATURE_SETS.items():
        with room.record.probe(f"features, {name}"):
            arrays = np.stack([kind.compute(clip) for clip in clips])
            room.record.put("columns", kind.column_names)
            room.record.put("tests", kind.tests)
            for path, array in zip(files, arrays, strict=True):
                room.record.put(path.name, array)
        with room.record.probe(f"forest, {name}"):
            _grow(room, kind, arrays, categories)
    with room.record.probe("tracks, poses, relations"):
        for path, clip in zip(files, clips, strict=True):
            track = retrieval.compute_track(clip, retrieval.FEATURE_SETS["extended"])
            room.record.put(f"{path.name}.track", [track.times, track.integrals])
            room.record.put(f"{path.name}.poses", retrieval.compute_pose_sequence(clip))
            relations = retrieval.compute_relational_features(clip.positions, clip.frame_rate, clip.height)
            room.record.put(f"{path.name}.relations", relations)


def _grow(room: Room, kind: Any, arrays: np.ndarray, categories: Sequence[str]) -> None:
    from dousa import retrieval

    trains = np.arange(len(arrays)) % 4 != 3
    for bootstrap in (False, True):
        forest = retrieval.MotionForest(
            20,
            thresholds=kind.thresholds,
            bootstrap=bootstrap,
            random_state=5,
            n_jobs=2,
        )
        forest.fit(arrays[trains], np.array(categories)[trains], feature_set=kind)
        place = "bootstrap" if bootstrap else "all"
        room.record.put(f"{place}.bytes", forest.to_bytes())
        room.record.put(f"{place}.leaves", forest.apply(arrays))
        for histogram in ("votes", "leaves"):
            room.record.put(f"{place}.{histogram}", forest.predict_proba(arrays, histogram))
    room.record.put("calibration", retrieval.learn_calibration(
        forest, arrays[trains], np.array(categories)[trains], feature_set=kind
    ).to_bytes())  # fmt: skip


def library(room: Room) -> None:
    """Libraries of both feature sets from the first file to corrections, and all that is asked of them."""
    record, library = room.record, room.work / "moves.dousa"
    clips = room.link_clips("clips", CATEGORIES, 6)
    takes = [*room.find("utkinect/s01_e0*.trc", 1), *room.find("cmu86/*.amc", 1)]
    queries = room.list_queries()
    with record.probe("add"):
        answer = ("--json", "--performer-from", PERFORMER)
        record.command("clips", "add", library, clips, *answer)
        record.command("takes", "add", library, *takes, "--takes", "--json")
        record.command("again", "add", library, clips, *answer)
        record.library("stored", library)
    for features_of in ("paper", "extended"):
        with record.probe(f"train, {features_of}"):
            words = ("train", library, "--features", features_of, "--trees", 40, "--json")
            record.command("answer", *words)
            record.library("stored", library)
        with record.probe(f"search, {features_of}"):
            _search(room, library, queries)
        with record.probe(f"classify, {features_of}"):
            record.command("answer", "classify", library, *queries, "--explain", "--json")
            record.command("mirrored", "classify", library, queries[0], "--mirror", "--threshold", 0.9, "--json")
        with record.probe(f"find and label, {features_of}"):
            _ask_takes(room, library, queries, takes)
    with record.probe("list"):
        _list(room, library)
    with record.probe("grow and correct"):
        _grow_library(room, library, queries)
    with record.probe("find and label after that"):
        _ask_takes(room, library, queries[:1], takes)


def _search(room: Room, library: Path, queries: Sequence[Path]) -> None:
    for rank in ("fused", "histogram", "leaves", "pose"):
        room.record.command(f"{rank} clip", "search", library, 7, "--rank", rank, "--json")
        for query in queries[::3]:
            words = ("search", library, query, "--rank", rank, "--explain", "--json")
            room.record.command(f"{rank} {query.name}", *words)
    query = queries[0]
    room.record.command("mirror", "search", library, query, "--mirror", "--json")
    room.record.command("table", "search", library, query, prose=True)
    room.record.command("no number", "search", library, 99999, "--json", exit_code=2)


def _ask_takes(room: Room, library: Path, queries: Sequence[Path], takes: Sequence[Path]) -> None:
    for query in queries[::4]:
        room.record.command(f"find {query.name}", "find", library, query, "--json")
    room.record.command("find mirrored", "find", library, 3, takes[0], "--mirror", "-k", 3, "--json")
    for take in takes:
        table = room.work / f"{take.stem}.csv"
        room.record.command(f"label {take.name}", "label", library, take, "--csv", table, "--json")
        room.record.file(f"label {take.name}.csv", table)
    room.record.library("labelled", library)
    seen = dousa.canonicalise(dousa.read_motion(takes[0]))
    lines = [
        {
            "time": frame / seen.frame_rate,
            "joints": dict(zip(dousa.CANONICAL_JOINTS, pose.tolist(), strict=True)),
        }
        for frame, pose in enumerate(seen.positions[:150])
    ]
    room.record.command("live", "label", library, "-", "--json", stdin="\n".join(map(json.dumps, lines)))


def _list(room: Room, library: Path) -> None:
    lengths = ("seconds", "take_seconds")
    room.record.command("categories", "list", library, "--json", keep=lengths)
    room.record.command("clips", "list", library, "--clips", "--json", keep=lengths)
    room.record.command("performer", "list", library, "--performer", "bk", "--json", keep=lengths)
    room.record.command("table", "list", library, prose=True)


def _grow_library(room: Room, library: Path, queries: Sequence[Path]) -> None:
    # One file a command: what is added together is learned in portions that end after a second.
    for category, query in zip(("grabHighR", "unheard-of", "unheard-of", "run"), queries, strict=False):
        words = ("add", library, room.link_clip(category, query), "--performer-from", PERFORMER, "--json")
        room.record.command(f"add {query.name}", *words)
        room.record.library(f"add {query.name}", library)
    room.record.command("after", "search", library, queries[5], "--json")
    room.record.command("relabel", "relabel", library, 2, 3, "--category", "other", "--json")
    room.record.command("remove", "remove", library, 9, 10, "--json")
    room.record.command("train", "train", library, "--trees", 25, "--json")
    room.record.library("stored", library)
    _list(room, library)


def old_library(room: Room) -> None:
    """A library that the earlier version wrote: listed, asked, labelled with, grown and trained again."""
    library = room.work / "moves.dousa"
    shutil.copyfile(room.old_library, library)
    queries, takes = room.list_queries(), room.find("utkinect/s02_e0*.trc", 1)
    with room.record.probe("old library: list, search, classify"):
        _list(room, library)
        _search(room, library, queries)
        room.record.command("classify", "classify", library, *queries, "--json")
    with room.record.probe("old library: find and label"):
        _ask_takes(room, library, queries[:1], takes)
    with room.record.probe("old library: add and train"):
        room.record.command("add", "add", library, room.link_clip("walk", queries[-1]), "--json")
        room.record.library("grown", library)
        room.record.command("train", "train", library, "--trees", 20, "--json")
        room.record.library("trained", library)


_HAS_OLD_OPTIONS = importlib.util.find_spec("dousa.app.requests") is None  # before requests were one class a task


def _settings(room: Room, **settings: str) -> tuple[object, ...]:
    """The options, or the file, of settings of the tracker, as the version has them."""
    if _HAS_OLD_OPTIONS:
        return tuple(word for name, value in settings.items() for word in (f"--{name}", value))
    path = room.work / f"{'_'.join(settings)}.toml"
    path.write_text("".join(f"{name} = {value!r}\n" for name, value in settings.items()))
    return "--settings", path


def estimation(room: Room) -> None:
    """Poses from silhouettes with a start that is given and one that is found; silhouettes of a motion."""
    clip, noisy = room.find("silhouette_bench/bk_rotatearms_*.npz", 2)
    start, one_view = room.work / "start.trc", room.work / "one_view.npz"
    with np.load(clip) as file:
        rate, stature = float(file["frame_rate"]), float(file["stature"])
        names, positions = tuple(file["joint_names"].tolist()), file["joint_positions"]
        arrays = {name: file[name] for name in file.files}
    dousa.write_motion(dousa.Trajectories(names, positions, rate), start)
    of_views = ("mask_packed", "camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")
    np.savez(one_view, **{name: array[:1] if name in of_views else array for name, array in arrays.items()})
    films, plates = room.find("pose2sim/videos/*.mp4", 4)[2:], room.find("pose2sim/background/*.png", 4)[2:]
    cameras = room.data / "pose2sim" / "calibration" / "Calib.qca.txt"
    cases: dict[str, tuple[object, ...]] = {
        "estimate, start given": (clip, "--start", f"{start}:0", "--frames", "0:12"),
        "estimate, start found": (noisy, "--stature", stature, "--frames", "0:8"),
        "estimate, as published": (clip, "--start", f"{start}:4", "--frames", "4:9", *_settings(room, method="paper")),
        "estimate, one view": (one_view, "--start", f"{start}:0", *_settings(room, bones="tables"), "--frames", "0:9"),
        "estimate, films": (
            *films, "--cameras", cameras, "--background", *plates, "--stature", 1.75,
            "--start", f"{room.data}/pose2sim/Balancing_for_IK.trc:0", "--frames", "0:3",
        ),
    }  # fmt: skip
    for name, words in cases.items():
        with room.record.probe(name):
            stem = room.work / name.replace(" ", "_").replace(",", "")
            made = {suffix: stem.with_suffix(suffix) for suffix in (".bvh", ".trc", ".csv")}
            outputs = (
                "-o",
                made[".bvh"],
                "--trc" if _HAS_OLD_OPTIONS else "-o",
                made[".trc"],
                "--angles",
                made[".csv"],
                "--json",
            )
            room.record.command("answer", "estimate", *words, *outputs)
            for suffix, path in made.items():
                room.record.file(suffix, path)
    with room.record.probe("render"):
        motion = room.find("bandai/wave-left-hand/*/*.bvh", 1)[0]
        for kind in ("clean", "noisy"):
            made_file = room.work / f"seen_{kind}.npz"
            small = ("--ring", 3, "--size", "160x120", "--frames", "0:20")
            room.record.command(kind, "render", motion, "-o", made_file, *small, "--noise", kind, "--json")
            with np.load(made_file) as file:
                room.record.put(kind, {name: file[name] for name in file.files})


def evaluation(room: Room) -> None:
    """A dance with errors put into it, one exercise by several takes, and the running assessment."""
    from dousa import evaluation

    source = room.find("bandai_dance/*.bvh", 1)[0]
    dance = dousa.canonicalise(dousa.read_motion(source))
    reference, performance = room.work / "reference.npz", room.work / "performance.npz"
    with room.record.probe("errors put into a dance"):
        kinds = ["global", "partial", "incomplete", "shift"]
        inject = find_name("inject_many", *HOMES_OF_ERRORS)
        simulate = find_name("simulate_performer", *HOMES_OF_ERRORS)
        pupil = simulate(inject(dance, kinds, 4).motion, 4)
        room.record.put("pupil", pupil.positions)
        dousa.write_motion(dance.to_trajectories(), reference)
        dousa.write_motion(pupil.to_trajectories(), performance)
    with room.record.probe("evaluate"):
        _evaluate(room, "two dances", [reference], performance)
        _evaluate(room, "mirrored", [reference], performance, "--mirror", "yes", language="ja")
        weights = room.work / "weights.txt"
        weights.write_text("arms = 2\nleft_shank = 0\n")
        _evaluate(room, "free", [reference], performance, "--tempo", "free", "--weights", weights)
        takes = room.find("irds/g2/correct/*.trc", 5)
        _evaluate(room, "several", takes, room.find("irds/g2/incorrect/*.trc", 1)[0])
    with room.record.probe("furi and eigenspaces"):
        postures = evaluation.compute_postures(dance)
        furi = evaluation.find_furi(postures)
        room.record.put("furi", furi)
        room.record.put("text", evaluation.format_furi(furi, dance.frame_rate).encode())
        room.record.put("spaces", evaluation.fit_furi_eigenspaces(postures, furi))
        other = evaluation.compute_postures(pupil)
        room.record.put("segments", postures.segments)
        room.record.put("path", evaluation.find_path(postures.segments, other.segments))
        matrix = evaluation.compute_correlation_matrix(postures.segments[:400], other.segments[:500])
        room.record.put("matrix", matrix)
    with room.record.probe("running assessment"):
        assessor = evaluation.IncrementalAssessor(dance, pupil.frame_rate)
        states = [assessor.push(pose) for pose in pupil.positions[:700]]
        room.record.put("states", states)
        room.record.put("settled", assessor.settled)
        room.record.put("lapses", assessor.lapses)
        room.record.put("finish", assessor.finish())


def _evaluate(
    room: Room, name: str, references: Sequence[Path], performance: Path, *words: object, language: str = "en"
) -> None:
    report = room.work / f"report {name}"
    before = ("--lang", language)  # all versions know it there
    room.record.command(name, *before, "evaluate", *references, "-p", performance, "-o", report, *words, "--json")
    for path in sorted(report.rglob("*")):
        if path.suffix == ".csv":
            room.record.file(f"{name}.{path.name}", path)
        elif path.is_file():
            room.record.put(f"{name}.{path.name}", path.stat().st_size > 0)


def experiments(room: Room) -> None:
    """The smallest runs of all experiments."""
    few = room.link_clips("few", {"hdm05": 4, "utd_mhad/skeleton": 3}, 8)
    out = ("--split", "leave-performer-out", "--performer-from", PERFORMER)
    runs: dict[str, tuple[object, ...]] = {
        "experiment": ("experiment", few, "--trees", 8),
        "experiment, people left out": ("experiment", few, "--trees", 8, *out, "--features", "extended"),
        "experiment --ranking": ("experiment", few, "--ranking", "--trees", 8, *out),
        "experiment --takes": ("experiment", few, "--takes", "--trees", 4, *out[2:]),
        "experiment --unknown": ("experiment", few, "--unknown", "--trees", 8, "--performer-from", PERFORMER),
    }
    bench = room.data / "silhouette_bench" / "bk_rotatearms_clean.npz"
    runs |= {
        "experiment-estimation": ("experiment-estimation", bench, "--views", "2"),
        "experiment-estimation --paper": ("experiment-estimation", bench, "--paper", "--frames", "4:7", "--views", "2"),
        "experiment-errors": ("experiment-errors", room.data / "irds" / "g2" / "correct"),
        "experiment-errors --takes-from": (
            "experiment-errors", room.data / "irds" / "g2", "--repeats", 0, "--takes-from", "folder", "--references", 2,
        ),
    }  # fmt: skip
    for name, words in runs.items():
        with room.record.probe(name):
            room.record.command("answer", *_spell_experiment(words), "--json")


def _spell_experiment(words: tuple[object, ...]) -> tuple[object, ...]:
    """Return an experiment as this version knows it: some have become programs of the lab."""
    if importlib.util.find_spec("dousa.experiments.ranking") is not None:
        return words
    moved = {"experiment-errors": "lab.errors", "experiment-estimation": "lab.estimation"}
    for option, program in (("--ranking", "lab.ranking"), ("--unknown", "lab.novelty")):
        if option in words:
            return program, *(word for word in words[1:] if word != option)
    return moved.get(str(words[0]), words[0]), *words[1:]


GROUPS: dict[str, Callable[[Room], None]] = {
    group.__name__: group for group in (reading, features, library, old_library, estimation, evaluation, experiments)
}


def main() -> None:
    """Run one group."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("group", choices=GROUPS)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--old-library", type=Path, default=Path("none/none"))
    options = parser.parse_args()
    record = Record({"<work>": options.work, "<data>": options.data, "<old>": options.old_library.parent})
    GROUPS[options.group](Room(record, options.data, options.work, options.old_library))
    answer = {"source": str(Path(dousa.__file__).parent), "probes": record.probes}
    options.out.write_text(json.dumps(answer), encoding="utf-8")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
