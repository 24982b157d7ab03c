"""The table of docs/formats.md: what dousa makes of the files of many producers, one folder each.

    python -m lab.figures.measure_formats ../shared/data/foreign [--files | --hips] [--pictures FOLDER]

Per producer: how many files are read, in which unit and up axis and how each was known, how many hold a whole body, how
many a part of one, how many neither, and what was said about them. ``--files`` prints a row for every file; ``--hips``
how far the hips made from the spines of the pelvis are from the hip joint centres that some files hold, and from the
functional centres about which the markers of the thigh turn. ``--pictures`` draws the first file of every producer,
front and side, to be looked at. Prints Markdown.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import DousaError, JointMappingError
from dousa.formats.registry import SUFFIXES, read_motion
from dousa.motion import CANONICAL_JOINTS, Motion, Trajectories, canonicalise
from dousa.motion.canonical.geometry import hips_from_markers
from dousa.motion.canonical.naming import normalise_names, rank_matches

SIDES = ("left", "right")


@dataclass(frozen=True)
class Reading:
    """What became of one file.

    ``unit``, ``up``: value and how it was known, empty if not read. ``joints``: canonical joints that are there.
    """

    producer: str
    file: str
    format: str = ""
    unit: str = ""
    up: str = ""
    joints: int = 0
    stature: float = 0.0
    table: str = ""
    notes: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """``whole``, ``part``, ``points`` (read, no body known) or ``not read``."""
        if not self.format:
            return "not read"
        return "whole" if self.joints == len(CANONICAL_JOINTS) else "part" if self.joints else "points"


def read(folder: Path, path: Path) -> Reading:
    """Read one file as a new user would."""
    relative = path.relative_to(folder)
    producer, file = relative.parts[0], str(Path(*relative.parts[1:]))
    try:
        motion = read_motion(path)
    except DousaError as error:
        return Reading(producer, file, notes=(str(error.message),))
    origin = motion.provenance
    assert origin is not None
    known = {
        "format": origin.format,
        "unit": f"{origin.unit:.4g} {origin.unit_source}",
        "up": f"{origin.up} {origin.up_source}",
    }
    try:
        body = canonicalise(motion)
    except JointMappingError as error:
        codes = (*(note.code for note in origin.notes), error.problem.code)
        return Reading(producer, file, **known, notes=codes)
    return Reading(
        producer,
        file,
        **known,
        joints=len(CANONICAL_JOINTS) - len(body.absent),
        stature=body.stature,
        table=body.mapping.table,
        notes=tuple(note.code for note in body.warnings),
    )


def _counted(values: Sequence[str]) -> str:
    counts = Counter(value for value in values if value)
    return ", ".join(f"{value} ({n})" if n < len(values) else value for value, n in counts.most_common()) or "-"


def print_producers(readings: Sequence[Reading]) -> None:
    """One row per producer."""
    print("| producer | read | unit (m) | up axis | whole body | part | points | stature (m) | notes |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for producer in sorted({one.producer for one in readings}):
        rows = [one for one in readings if one.producer == producer]
        kinds = Counter(one.kind for one in rows)
        tall = [one.stature for one in rows if one.stature]
        notes = [note.rpartition(".")[2] for one in rows if one.format for note in one.notes]
        cells = (
            producer,
            f"{len(rows) - kinds['not read']} of {len(rows)}",
            _counted([one.unit for one in rows]),
            _counted([one.up for one in rows]),
            *(str(kinds[kind] or "") for kind in ("whole", "part", "points")),
            f"{min(tall):.2f} to {max(tall):.2f}" if tall else "-",
            ", ".join(f"{note} {n}" for note, n in Counter(notes).most_common()),
        )
        print("|", " | ".join(cells), "|")
    total = Counter(one.kind for one in readings)
    print(f"\n{len(readings)} files: " + ", ".join(f"{n} {kind}" for kind, n in total.most_common()))


def print_files(readings: Sequence[Reading]) -> None:
    """One row per file."""
    print("| file | format | unit | up | joints | stature | map | notes |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for one in readings:
        stature = f"{one.stature:.2f}" if one.stature else ""
        cells = (f"{one.producer}/{one.file}", one.format, one.unit, one.up, str(one.joints), stature, one.table)
        print("|", " | ".join(cells), "|", "; ".join(one.notes), "|")


def print_hips(folder: Path, readings: Sequence[Reading]) -> None:
    """Median distance in mm of regressed hips from the centres in the file, by regression."""
    print("| file | Harrington 2007: left, right (mm) | Bell 1989 |")
    print("| --- | --- | --- |")
    for one in readings:
        if not one.format:
            continue
        motion = read_motion(folder / one.producer / one.file)
        matches = () if isinstance(motion, Motion) else rank_matches(motion.names)
        places = next((match.sources for match in matches if match.table == "Markers"), {})
        if isinstance(motion, Motion) or not {"left_hip", "left_asis", "sacrum", "left_knee"} <= set(places):
            continue
        at = {place: motion.positions[:, list(points)].mean(axis=1) for place, points in places.items()}
        knees = 0.5 * (at["left_knee"] + at["right_knee"])
        cells = []
        for metres in (True, False):
            hips = hips_from_markers(at["left_asis"], at["right_asis"], at["sacrum"], knees, metres=metres)
            off = [np.linalg.norm(hips[:, side] - at[f"{name}_hip"], axis=1) for side, name in enumerate(SIDES)]
            cells.append(", ".join(f"{1000 * np.nanmedian(far):.0f}" for far in off))
        print(f"| {one.producer}/{one.file} |", " | ".join(cells), "|")


# Smallest singular value by the greatest: below, a thigh turns about one axis only, as in walking, and nothing tells
# where on the axis the centre is; m between the centre as the pelvis and as the thigh sees it.
_LEAST_TURNING, _MOST_GAP = 0.04, 0.02


def find_functional(pelvis: FloatArray, thigh: FloatArray) -> FloatArray | None:
    """The centre (T, 3) about which two clusters of markers (T, K, 3) turn against each other; None if it is not clear.

    Ehrig, Taylor, Duda, Heller, "A survey of formal methods for determining the centre of rotation of ball joints", J.
    Biomechanics 39 (2006): the point that is fixed in both (SCoRE), in the least-squares sense.
    """
    (turns, places), (thigh_turns, thigh_places) = follow(pelvis), follow(thigh)
    matrix = np.concatenate([turns, -thigh_turns], axis=2).reshape(-1, 6)
    fixed, _, _, sizes = np.linalg.lstsq(matrix, (thigh_places - places).reshape(-1), rcond=None)
    if sizes[-1] < _LEAST_TURNING * sizes[0]:
        return None
    seen = turns @ fixed[:3] + places
    other = thigh_turns @ fixed[3:] + thigh_places
    return 0.5 * (seen + other) if np.linalg.norm(seen - other, axis=1).mean() < _MOST_GAP else None


def follow(cluster: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations (T, 3, 3) and middles (T, 3) of a cluster of markers (T, K, 3), by Kabsch against its first frame."""
    middle = cluster.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(np.einsum("tki,kj->tij", cluster - middle, (cluster - middle)[0]))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt, middle[:, 0]


def print_functional(folder: Path, readings: Sequence[Reading]) -> None:
    """Median distance in mm of the regressed hips from functional centres, where thighs carry markers and move."""
    print("\n| file | from the functional centre: left, right (mm) |\n| --- | --- |")
    for one in readings:
        motion = read_motion(folder / one.producer / one.file) if one.joints else None
        if not isinstance(motion, Trajectories):
            continue
        matches = [match for match in rank_matches(motion.names) if {"left_asis", "sacrum"} <= set(match.sources)]
        if not matches or motion.n_frames < 60:
            continue
        places, keys = matches[0].sources, normalise_names(motion.names)
        pelvis = [index for place in ("left_asis", "right_asis", "sacrum") for index in places[place]]
        cells = []
        for number, side in enumerate(SIDES):
            thigh = [i for i, (s, core) in enumerate(keys) if s == side[0] and core.startswith("th")]
            thigh += [i for i in places.get(f"{side}_knee", ())[:1]]
            whole = ~np.isnan(motion.positions[:, pelvis + thigh]).any(axis=(1, 2))
            seen = motion.positions[whole]
            centre = find_functional(seen[:, pelvis], seen[:, thigh]) if len(thigh) > 2 and whole.sum() > 60 else None
            if centre is None:
                cells.append("-")
                continue
            left, right, sacrum = (seen[:, list(places[place])].mean(axis=1) for place in
                                   ("left_asis", "right_asis", "sacrum"))  # fmt: skip
            hips = hips_from_markers(left, right, sacrum, seen[:, thigh].mean(axis=1), metres=True)
            cells.append(f"{1000 * np.median(np.linalg.norm(hips[:, number] - centre, axis=1)):.0f}")
        if set(cells) != {"-"}:
            print(f"| {one.producer}/{one.file} |", ", ".join(cells), "|")


def draw(folder: Path, readings: Sequence[Reading], pictures: Path) -> None:
    """The first file of every producer that holds a body, and all that are said to be unusual."""
    from dousa.app.pictures.sheets import draw_contact_sheet

    pictures.mkdir(parents=True, exist_ok=True)
    drawn: set[str] = set()
    for one in readings:
        if one.joints and one.producer not in drawn:
            drawn.add(one.producer)
            body = canonicalise(read_motion(folder / one.producer / one.file))
            draw_contact_sheet(body, pictures / f"{one.producer}.png", n_poses=6, title=f"{one.producer}: {one.file}")


def main() -> None:
    """Read the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with one folder per producer")
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--files", action="store_true", help="a row for every file")
    shown.add_argument("--hips", action="store_true", help="regressed hips against the centres of the files")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw one file per producer there")
    given = parser.parse_args()
    paths = sorted(
        path for path in given.folder.glob("*/**/*") if path.is_file() and "LICENSE" not in path.name.upper()
    )
    if not paths:
        raise SystemExit(f"{given.folder}: expected folders of motion files ({', '.join(SUFFIXES)}), found none")
    readings = [read(given.folder, path) for path in paths]
    if given.hips:
        print_hips(given.folder, readings)
        print_functional(given.folder, readings)
    else:
        (print_files if given.files else print_producers)(readings)
    if given.pictures:
        draw(given.folder, readings, given.pictures)


if __name__ == "__main__":
    main()
