"""Commands for single files: info, count, convert, plot; plot also draws the map of a library."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app.cli.library import open_to_read
from dousa.app.cli.usage import Json
from dousa.app.output import console, fail, print_json, progress_bar, say, warn
from dousa.app.requests.library import Character
from dousa.app.requests.reading import PartReading, Reading
from dousa.app.targets import ANYTHING, CLIP_MAP, DATABASE_HEAD, check_targets, holds_motion, is_same_file
from dousa.errors import DousaError, OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.drawing.body import Drawable
    from dousa.app.pipelines.projects import Project
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import ClipInfo, ClipMap
    from dousa.motion import Motion, Trajectories
    from dousa.motion.canonical.recipes import JointMap

# As of the registry, which would take a tenth of a second to import; a test holds them equal.
READ_SUFFIXES = (
    ".bvh .amc .c3d .trc .npz .npy .pkl .pk .pickle .joblib .pt .csv .tsv .json .vmd .mot .mvnx .fbx .dae .usd .usda"
    " .usdc .usdz .glb .gltf .vrm .vrma"
)
WRITTEN_SUFFIXES = ".bvh .c3d .trc .opencap.trc .amass.npz .npz .angles.csv .csv .vmd .mot .fbx .glb"


def info(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help=f"Motion files: {READ_SUFFIXES}; or a folder of Pose2Sim, FreeMoCap, OpenCap or EasyMocap, or of "
            "films and their calibration.",
        ),
    ],
    *,
    reading: PartReading,
    json: Json = False,
) -> None:
    """Show what is in a motion file: length, rate, unit, up axis, joints and how they were identified.

    Of the folder of a project: its cameras, calibration, films, keypoints and results, and the command to go on with.

    Example: dousa info walk.bvh take01.amc

    Example: dousa info my_pose2sim_project
    """
    from dousa.app.tables.library import print_info

    options = reading.load()
    answers: list[Project | dict[str, Any]] = []
    failed = 0
    for path in files:
        try:
            answers.append(_find_project(path) or _describe(path, options))
        except DousaError as error:
            failed += 1
            fail(error)
    if json:
        print_json([answer if isinstance(answer, dict) else answer.to_json() for answer in answers])
    else:
        for answer in answers:
            if isinstance(answer, dict):
                print_info(console(), answer)
            else:
                from dousa.app.tables.estimation import print_project

                print_project(console(), answer)
    if failed:
        raise typer.Exit(2)


def _find_project(path: Path) -> Project | None:
    if not path.is_dir():
        return None
    from dousa.app.pipelines.projects import find_project
    from dousa.estimation.keypoints.keypoint_files import holds_keypoints

    if holds_keypoints(path) and not holds_motion(path):
        raise OptionError("project.keypoints", path=path)
    return find_project(path)


def count(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help=f"Motion files: {READ_SUFFIXES}.")],
    *,
    reading: Reading,
    json: Json = False,
) -> None:
    """Count the repetitions of a movement in recordings: how many, when, and how sure that is.

    Neither a library nor a reference is needed: what a recording repeats is counted, two sides in turn one each.

    Example: dousa count squats.bvh

    Example: dousa count session/*.trc --json
    """
    from dousa.app.tables.evaluation import print_count
    from dousa.formats.motion_files import read_canonical
    from dousa.motion import count_repetitions

    options = reading.load()
    answers, failed = [], 0
    with progress_bar() as progress:
        for number, path in enumerate(files):
            progress(number, len(files), Message("text.verbatim", text=path.name))
            try:
                found = count_repetitions(read_canonical(path, options)[0])
            except DousaError as error:
                failed += 1
                fail(error)
                continue
            answers.append((path, found))
    if json:
        print_json([{"path": str(path), **found.to_json()} for path, found in answers])
    else:
        for path, found in answers:
            print_count(console(), path.name, found)
    if failed:
        raise typer.Exit(2)


def _read(path: Path, options: ReadOptions) -> Motion | Trajectories:
    from dousa.formats.registry import read_motion

    return read_motion(
        path, unit=options.unit, up=options.up, skeleton=options.skeleton, frame_rate=options.frame_rate,
        person=options.person, animation=options.animation,
    )  # fmt: skip


def _describe(path: Path, options: ReadOptions) -> dict[str, Any]:
    from dousa.errors import JointMappingError
    from dousa.motion import Motion, canonicalise

    motion = _read(path, options)
    origin = motion.provenance
    if isinstance(motion, Motion):
        names, ends = motion.skeleton.names, list(motion.skeleton.end_sites)
    else:
        names, ends = motion.names, [False] * len(motion.names)
    answer: dict[str, Any] = {
        "path": str(path),
        "format": origin.format if origin else None,
        "holds": "rotations" if isinstance(motion, Motion) else "positions",
        "n_frames": motion.n_frames,
        "frame_rate": motion.frame_rate,
        "duration_s": motion.duration,
        "n_joints": sum(not end for end in ends),
        "unit_m": origin.unit if origin else 1.0,
        "unit_source": origin.unit_source if origin else None,
        "up": origin.up if origin else "y",
        "up_source": origin.up_source if origin else None,
        "joints": [name for name, end in zip(names, ends, strict=True) if not end],
    }
    try:
        canonical = canonicalise(motion, options.joint_map, any_skeleton=options.any_skeleton, markers=options.markers)
    except JointMappingError as error:
        notes = list(map(str, origin.notes)) if origin else []
        return {**answer, "mapping": None, "height_m": None, "warnings": [*notes, str(error.problem)]}
    found = canonical.mapping
    answer["mapping"] = {
        "table": found.table,
        "sides": found.sides,
        "derived": list(found.derived),
        "absent": list(found.absent),
        "sources": {joint: list(sources) for joint, sources in found.sources.items()},
    }
    answer["height_m"] = canonical.height
    answer["stature_m"] = canonical.stature
    answer["height_source"] = canonical.height_source
    answer["warnings"] = list(map(str, canonical.warnings))
    return answer


def _has_positions(motion: Motion | Trajectories) -> bool:
    """Whether any frame has positions: without its root no joint of a skeleton has any."""
    import numpy as np

    from dousa.motion import Motion

    if not isinstance(motion, Motion):
        return bool(np.isfinite(motion.positions).any())
    root = np.concatenate([motion.translations[:, 0], motion.rotations[:, 0]], axis=1)
    return bool(np.isfinite(root).all(axis=1).any())


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Motion file to read.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help=f"File to write: {WRITTEN_SUFFIXES}.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Allow OUT to be IN, or another file that is there.")
    ] = False,
    *,
    character: Character,
    reading: PartReading,
    json: Json = False,
) -> None:
    """Convert a motion file to another format; nothing the target can hold is lost.

    Positions alone (C3D, TRC) become BVH by fitting a skeleton of rigid bones; the mean error is printed. With --onto
    the motion is put onto the skeleton of a character: limb directions are kept, feet stay where they stand.

    Example: dousa convert take.amc take.bvh --frame-rate 30
    """
    from dousa.motion import Motion, resample

    options = reading.load()
    onto, frame_rate = character.onto, character.frame_rate
    if character.keep_reach and onto is None:
        raise OptionError("export.reach_of_nobody")
    if is_same_file(target, source):
        if not overwrite:
            raise OptionError("files_cli.same_file", path=target)
    else:
        check_targets({"OUT": target}, (onto, *reading.files), ANYTHING if overwrite else None)
    motion = _read(source, options)
    for note in motion.provenance.notes if motion.provenance else ():
        warn(note)
    if not _has_positions(motion):
        warn(Message("canonical.never_seen"))
    if frame_rate is not None:
        motion = resample(motion, frame_rate)  # type: ignore[type-var]  # either, not both
    fit_error = None
    answer: dict[str, Any] = {}
    if onto is not None:
        motion, answer = _put_onto(motion, onto, target, options, character.keep_reach)
    if target.suffix.lower() == ".bvh" and not isinstance(motion, Motion):
        motion, fit_error = _fit(motion, options.joint_map)
        warn(Message("files_cli.fitted", path=source, error=1000 * fit_error))
    if target.name.lower().endswith(".amass.npz"):
        motion, answer = _put_onto_smpl(motion, target, options, answer)
    _write(motion, target)
    if json:
        print_json(
            {
                "in": str(source),
                "out": str(target),
                "n_frames": motion.n_frames,
                "frame_rate": motion.frame_rate,
                "fit_error_m": fit_error,
                **answer,
            }
        )
    else:
        say(Message("files_cli.converted", path=target, n=motion.n_frames, rate=motion.frame_rate))


def _write(motion: Motion | Trajectories, target: Path) -> None:
    """Write a motion, and say that a table holds no angles, where people look for some."""
    from dousa.formats.registry import write_motion

    write_motion(motion, target)
    if target.suffix.lower() == ".csv" and not target.name.lower().endswith(".angles.csv"):
        warn(Message("files_cli.places", path=target))


def _put_onto(
    motion: Motion | Trajectories, onto: Path, target: Path, options: ReadOptions, keep_reach: bool
) -> tuple[Motion, dict[str, Any]]:
    import math

    from dousa.formats.registry import read_character
    from dousa.motion import retarget

    made = retarget(motion, read_character(onto), joint_map=options.joint_map, keep_reach=keep_reach)
    known = motion.provenance.notes if motion.provenance else ()
    for warning in made.warnings:
        if warning not in known:
            warn(warning)
    fit = {"onto": str(onto), "skating_m": made.skating, "direction_error_deg": math.degrees(made.direction_error)}
    warn(
        Message(
            "retarget.done",
            path=target,
            n=made.motion.n_frames,
            skating=1000 * made.skating,
            angle=fit["direction_error_deg"],
            worst=made.worst.describe(),
        )
    )
    worst = {"limb": made.worst.limb, "angle_deg": math.degrees(made.worst.angle), "frame": made.worst.frame + 1}
    return made.motion, {**fit, "worst": worst, "scale": made.scale}


def _put_onto_smpl(
    motion: Motion | Trajectories, target: Path, options: ReadOptions, answer: dict[str, Any]
) -> tuple[Motion | Trajectories, dict[str, Any]]:
    """The motion on the mean body of SMPL, and the error where it was on another."""
    import math

    from dousa.formats.smpl import is_smpl, put_onto_smpl
    from dousa.motion import Motion

    if isinstance(motion, Motion) and is_smpl(motion):
        return motion, answer
    made = put_onto_smpl(motion, options.joint_map)
    angle = math.degrees(made.direction_error)
    warn(Message("files_cli.onto_smpl", path=target, angle=angle))
    return made.motion, {**answer, "direction_error_deg": angle}


def _fit(positions: Trajectories, joint_map: JointMap | None) -> tuple[Motion, float]:
    """A motion with rigid bones near the positions, and its mean joint error in m."""
    import numpy as np

    from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories, fit_motion

    canonical = canonicalise(positions, joint_map, any_skeleton=True, whole=True)
    fitted = fit_motion(canonical)
    reached = compute_trajectories(fitted).select(CANONICAL_JOINTS)
    return fitted, float(np.linalg.norm(reached - canonical.positions, axis=-1).mean())


_TABLES, _PICTURES = (".csv",), (".png", ".svg", ".pdf")


def plot(
    file: Annotated[str, typer.Argument(metavar="FILE|LIB", help="Motion file, or a library.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture to write: .png, .svg or .pdf; of a library also .csv."),
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Draw a contact sheet of a motion, or a map of all clips of a library.

    The sheet shows the poses from the front and from the side. On the map clips lie together whose poses are similar,
    whatever they are called; only small distances mean something. In the studio: Library, Map, to choose clips with a
    lasso.

    Example: dousa plot walk.bvh -o walk.png

    Example: dousa plot moves.dousa -o map.png
    """
    if output is None:
        raise OptionError("usage.missing", name="--output")
    if _is_library(file):
        if reading.read:
            raise OptionError("library_map.options")
        _plot_library(file, output)
    else:
        _plot_motion(Path(file), output, reading)


def _is_library(file: str) -> bool:
    """Whether a name is that of a library: a database URL, a file that is one, or a file of this suffix."""
    if "://" in file or file.lower().endswith(".dousa"):
        return True
    try:
        with open(file, "rb") as opened:
            return opened.read(len(DATABASE_HEAD)) == DATABASE_HEAD
    except (OSError, ValueError):
        return False  # the reader of motions says why


def _plot_motion(file: Path, output: Path, reading: Reading) -> None:
    from dousa.app.pictures.sheets import draw_contact_sheet
    from dousa.errors import JointMappingError
    from dousa.motion import canonicalise

    check_targets({"--output": output}, (file, *reading.files))
    options = reading.load()
    motion = _read(file, options)
    for note in motion.provenance.notes if motion.provenance else ():
        warn(Message("text.in_file", path=file, problem=note))
    try:
        drawn: Drawable = canonicalise(
            motion, options.joint_map, any_skeleton=options.any_skeleton, markers=options.markers
        )
    except JointMappingError as error:
        warn(Message("files_cli.drawn_as_points", path=file, problem=error.problem))
        drawn = motion
    draw_contact_sheet(drawn, output, title=file.name)
    say(f"{output}: {file.name}")


def _plot_library(library: str, output: Path) -> None:
    if output.suffix.lower() not in (*_TABLES, *_PICTURES):
        raise OptionError("library_map.suffix", path=output, found=output.suffix)
    check_targets({"--output": output}, (library,), CLIP_MAP)
    with open_to_read(library) as opened:
        with progress_bar() as progress:
            found = opened.map(progress=progress)
        if not len(found.clip_ids):
            raise OptionError("library_map.none", library=library)
        by_number = {clip.id: clip for clip in opened.clips(found.clip_ids.tolist())}
    clips = [by_number[number] for number in found.clip_ids.tolist()]
    rows = [_describe_place(clip, *point) for clip, point in zip(clips, found.points.tolist(), strict=True)]
    _write_map(output, found, rows, clips)
    say(Message("library_map.line", output=output, n=len(rows)))
    if found.left_out:
        say(Message("library_map.left_out", n=len(found.left_out)))


def _describe_place(clip: ClipInfo, x: float, y: float) -> dict[str, Any]:
    labels = {"category": clip.category, "performer": clip.performer}
    return {"clip_id": clip.id, "path": clip.path, **labels, "x": round(x, 4), "y": round(y, 4)}


def _write_map(output: Path, found: ClipMap, rows: list[dict[str, Any]], clips: list[ClipInfo]) -> None:
    if output.suffix.lower() in _PICTURES:
        from dousa.app.pictures.charts import draw_clip_map

        draw_clip_map(found, [clip.category for clip in clips], output)
        return
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(output) as file:
        file.write(text.getvalue().encode("utf-8", "surrogateescape"))
