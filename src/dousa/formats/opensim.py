"""OpenSim's motions (.mot): joint angles of its whole-body models, by name, and the place of the pelvis.

The same as a plain table is ``.angles.csv``.

The names and their axes are those of the models of Rajagopal et al., Full-body musculoskeletal model for muscle-driven
simulation of human gait, IEEE TBME 2016, which OpenCap uses too; hips, trunk and pelvis turn in the order Z, X, Y of
the ISB (Wu et al., ISB recommendation on definitions of joint coordinate systems, Journal of Biomechanics 2002). X
points forward, Y up, Z to the right; docs/opensim.md has the table. Knees and elbows are hinges: where a body bends
them about another axis, the thigh or the upper arm turns about itself. Toes, subtalar joints and wrists stay at rest.

Places of joints go to OpenCap as ``.opencap.trc``, under the names of its points of films.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import JointMappingError, MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.assembly import settle_motion
from dousa.formats.guard import Clock
from dousa.formats.smpl import mean_body
from dousa.formats.tables.cells import decode, find_rows, list_lines
from dousa.formats.tables.trc import write_trc
from dousa.messages import Message
from dousa.motion import JOINT_INDEX, Motion, Skeleton, Trajectories, canonicalise
from dousa.motion.kinematics import compute_rest_positions
from dousa.motion.rotations import from_axis_angle, from_euler, identity, multiply, rotate, to_euler, unwrap_euler

_PELVIS = np.array([0.056, 0.078, 0.0])
"""m, in OpenSim's axes from the middle of the hips to the pelvis' origin: geometry of the model, Rajagopal 2016."""

# Coordinates of the turns about Z, X, Y of each joint, one by one; * stands for the side. On the left the turns about X
# and Y count the other way, by the definition of the models.
_JOINTS = {
    "pelvis": ("pelvis_tilt", "pelvis_list", "pelvis_rotation"),
    "spine": ("lumbar_extension", "lumbar_bending", "lumbar_rotation"),
    "*hip": ("hip_flexion_", "hip_adduction_", "hip_rotation_"),
    "*knee": ("-knee_angle_", "", ""),
    "*ankle": ("ankle_angle_", "", ""),
    "*shoulder": ("arm_flex_", "arm_add_", "arm_rot_"),
    "*elbow": ("elbow_flex_", "", "pro_sup_"),
}
_STILL = ("subtalar_angle_", "mtp_angle_", "wrist_flex_", "wrist_dev_")
_PLACES = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
_HINGES = (
    ("hip", "knee", "ankle", -1.0),
    ("shoulder", "elbow", "wrist", 1.0),
)  # joints and the sign of flexion, by the definition of ISB


def list_coordinates() -> dict[str, tuple[str, int, float]]:
    """Return of each coordinate, in the order of a file, its joint, its place among Z, X, Y, and its sign."""
    rows = {}
    for joint, names in _JOINTS.items():
        for side, end in (("left_", "l"), ("right_", "r")) if "*" in joint else (("", ""),):
            for place, name in enumerate(names):
                sign = (-1.0 if name.startswith("-") else 1.0) * (-1.0 if end == "l" and place else 1.0)
                if name:
                    rows[name.lstrip("-") + end] = (joint.replace("*", side), place, sign)
    return rows


def body_at_rest() -> Skeleton:
    """Build the mean body of SMPL as the models stand: legs and arms straight down; m, Y up, facing Z."""
    mean = mean_body(22)
    places = dict(zip(mean.names, compute_rest_positions(mean), strict=True))
    middle = (places["left_hip"] + places["right_hip"]) / 2
    rows: list[tuple[str, str, FloatArray]] = [("pelvis", "", np.zeros(3))]

    def add(name: str, above: str, offset: FloatArray) -> None:
        rows.append((name, above, offset))

    add("spine", "pelvis", (places["spine1"] - middle) * (0, 1, 1))
    add("neck", "spine", (places["neck"] - places["spine1"]) * (0, 1, 1))
    add("head", "neck", (places["head"] - places["neck"]) * (0, 1, 1))
    for side in ("left_", "right_"):
        add(f"{side}hip", "pelvis", places[f"{side}hip"] - middle)
        add(f"{side}shoulder", "spine", places[f"{side}shoulder"] - places["spine1"])
        for chain in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
            for above, name in pairwise(chain):
                length = float(np.linalg.norm(places[side + name] - places[side + above]))
                add(side + name, side + above, np.array([0.0, -length, 0.0]))
        add(f"{side}toe", f"{side}ankle", (places[f"{side}foot"] - places[f"{side}ankle"]) * (0, 1, 1))
    names = [name for name, _, _ in rows]
    parents = np.array([names.index(above) if above else -1 for _, above, _ in rows], np.intp)
    ends = np.array([name == "head" or name.endswith(("wrist", "toe")) for name in names])
    return Skeleton(tuple(names), parents, np.array([offset for _, _, offset in rows]), ends)


def _to_opensim(vectors: FloatArray) -> FloatArray:
    """Turn vectors (..., 3) from X left, Y up, Z forward to X forward, Y up, Z right; `_from_opensim` turns back."""
    return vectors[..., [2, 1, 0]] * (1.0, 1.0, -1.0)


def _from_opensim(vectors: FloatArray) -> FloatArray:
    return vectors[..., [2, 1, 0]] * (-1.0, 1.0, 1.0)


def compute_coordinates(motion: Motion) -> dict[str, FloatArray]:
    """Compute the coordinates (T,) of a body in the order of a file: degrees, and metres of the pelvis' place.

    Angles do not jump: they go on over half a turn. Limbs of another body keep their directions (`retarget`).

    Parameters
    ----------
    motion : of any whole body; one with the names and the straight limbs of `body_at_rest`, as `read_mot` and
        `dousa.estimation.estimate` return it, keeps its angles.

    Raises
    ------
    JointMappingError : joints that cannot be mapped.
    """
    body = body_at_rest()
    if (found := _read_straight(motion, body)) is None:
        from dousa.motion import retarget

        still = Motion(body, identity((1, body.n_joints)), body.offsets[None], motion.frame_rate)
        done = retarget(motion, still, plant_feet=False)
        found = np.array(done.motion.rotations), done.motion.translations[:, 0] / done.scale
    rotations, places = found
    for chain in _HINGES:
        for side in ("left_", "right_"):
            _straighten(body, rotations, side, *chain)
    turns = np.concatenate((rotations[..., :1], _to_opensim(rotations[..., 1:])), axis=2)
    angles = {joint: np.degrees(unwrap_euler(to_euler(turns[:, n], "ZXY"))) for n, joint in enumerate(body.names)}
    columns = {name: sign * angles[joint][:, place] for name, (joint, place, sign) in list_coordinates().items()}
    origin = _to_opensim(places) + rotate(turns[:, 0], _PELVIS)
    columns |= dict(zip(_PLACES, origin.T, strict=True))
    return columns | {name + end: np.zeros(len(origin)) for name in _STILL for end in ("r", "l")}


def _read_straight(
    motion: Motion, body: Skeleton, least: float = np.cos(np.radians(0.5))
) -> tuple[FloatArray, FloatArray] | None:
    """Return rotations (T, J, 4) of the body's joints and places (T, 3) m between the hips, where the angles are known.

    They are where the skeleton has the body's joints in the same order of turning, and its limbs hang straight down
    at rest, but for half a degree (``least`` is the cosine).
    """
    skeleton = motion.skeleton
    rows = {name: row for row, name in enumerate(skeleton.names)}
    for row, name in enumerate(body.names):
        above = body.names[body.parents[row]] if row else ""
        if name not in rows or (row and skeleton.names[skeleton.parents[rows[name]]] != above):
            return None
        if name.endswith(("knee", "ankle", "elbow", "wrist")):
            offset = skeleton.offsets[rows[name]]
            if not -offset[1] >= least * np.linalg.norm(offset) > 0:
                return None
    middle = (skeleton.offsets[rows["left_hip"]] + skeleton.offsets[rows["right_hip"]]) / 2
    turns = np.array(motion.rotations[:, [rows[name] for name in body.names]])
    return turns, motion.translations[:, rows["pelvis"]] + rotate(turns[:, 0], middle)


def write_mot(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write the coordinates of a body, see `compute_coordinates`, for OpenSim's models.

    Parameters
    ----------
    motion : of any whole body.
    path : ending in ``.mot``.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, missing rotations, a disk error.
    """
    columns = _compute_for(motion, path)
    rows = np.column_stack((np.arange(motion.n_frames) / motion.frame_rate, *columns.values()))
    if not np.isfinite(rows).all():
        raise MotionWriteError(path, "opensim.gaps")
    head = f"Coordinates\nversion=1\nnRows={len(rows)}\nnColumns={rows.shape[1]}\ninDegrees=yes\n\nendheader\n"
    with atomic_write(path) as file:
        file.write((head + "\t".join(("time", *columns)) + "\n").encode())
        for row in rows.tolist():
            file.write(("\t".join(f"{value:.8f}" for value in row) + "\n").encode())


def _compute_for(motion: Motion, path: str | os.PathLike[str]) -> dict[str, FloatArray]:
    try:
        return compute_coordinates(motion)
    except JointMappingError as error:
        raise MotionWriteError(path, "opensim.other_skeleton", reason=error.problem) from error


def write_angles(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write the coordinates of `write_mot` as a plain table, with ``time_s``; what is missing stays empty.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, a disk error.
    """
    write_angle_table(_compute_for(motion, path), motion.frame_rate, path)


def write_angle_table(columns: Mapping[str, NDArray[Any]], frame_rate: float, path: str | os.PathLike[str]) -> None:
    """Write a row for each frame: its time in s, then the values (T,) of the columns; MotionWriteError for the disk."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", *columns])
    for frame, row in enumerate(zip(*(values.tolist() for values in columns.values()), strict=True)):
        cells = (f"{one:.6f}" if isinstance(one, float) else str(int(one)) for one in (frame / frame_rate, *row))
        writer.writerow("" if cell == "nan" else cell for cell in cells)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


def _straighten(
    body: Skeleton, rotations: FloatArray, side: str, upper: str, hinge: str, end: str, way: float, sure: float = 0.35
) -> None:
    """Turn an upper limb about itself so that its hinge bends about Z; the lower limb stays in its place.

    Parameters
    ----------
    rotations : (T, J, 4), changed in place, in the axes of the body.
    way : of the end in the upper limb's X in OpenSim, when bent: 1 forward, -1 backward.
    sure : sine of the bend from which its plane counts fully: 20 degrees, as a nearly straight limb has none.
    """
    above, joint = body.names.index(side + upper), body.names.index(side + hinge)
    lower = _to_opensim(rotate(rotations[:, joint], body.offsets[body.names.index(side + end)]))
    lower = lower / np.linalg.norm(lower, axis=1, keepdims=True)
    forward, sideways = way * lower[:, 0], way * lower[:, 2]
    forward, sideways = np.where(forward < 0, -forward, forward), np.where(forward < 0, -sideways, sideways)
    twist = -np.arctan2(sideways, forward) * np.clip(np.hypot(forward, sideways) / sure, 0.0, 1.0)
    turn = from_axis_angle(np.stack((0 * twist, twist, 0 * twist), axis=1))
    back = turn * (1.0, -1.0, -1.0, -1.0)
    rotations[:, above] = multiply(rotations[:, above], turn)
    rotations[:, joint] = multiply(back, rotations[:, joint])


_POINTS = {
    "Neck": "neck", "midHip": "pelvis",
    **{side[0].upper() + name: f"{side}_{name.lower()}" for side in ("right", "left") for name in
       ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")},
    "RBigToe": "right_toe", "LBigToe": "left_toe",
}  # fmt: skip
"""Joints by OpenCap's definition of its points."""


def write_opencap(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write the places of the joints of a body as OpenCap names points of films, in m, X forward, Y up, Z right.

    What was not seen is missing; joints that the body does not have are left out.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, a disk error.
    """
    try:
        found = canonicalise(motion)
    except JointMappingError as error:
        raise MotionWriteError(path, "opensim.other_skeleton", reason=error.problem) from error
    names = tuple(name for name, joint in _POINTS.items() if joint not in found.absent)
    rows = [JOINT_INDEX[_POINTS[name]] for name in names]
    places = _to_opensim(found.positions[:, rows])
    if found.missing is not None:
        places[found.missing[:, rows]] = np.nan
    write_trc(Trajectories(names, places, found.frame_rate), path)


def read_mot(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Motion:
    """Read the joint angles of a whole-body model of OpenSim onto the mean body; a note says so.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default metres.
    up : axis that points up; by default Y.

    Raises
    ------
    MotionFileError : missing, damaged, coordinates of no known model.
    """
    text = decode(read_bytes(path))
    lines = list_lines(text, 1000)
    start = next((n for n, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if start is None or start + 1 >= len(lines):
        raise MotionFileError(path, "opensim.no_header")
    head = "\n".join(lines[:start])
    titles = [title.rpartition("/value")[0].rpartition("/")[2] or title for title in lines[start + 1].split()]
    known = list_coordinates()
    if not {"time", "hip_flexion_r", "hip_flexion_l", "knee_angle_r", "knee_angle_l"} <= set(titles):
        raise MotionFileError(path, "opensim.no_coordinates", start + 2)
    rows = re.search(r"nRows\s*=\s*(\d{1,9})\s*$", head, re.IGNORECASE | re.MULTILINE)
    frames = float(rows[1]) if rows else None
    body_rows, cut = find_rows(path, text, start + 2, " ", (len(titles), len(titles)), declared=frames)
    (values,) = body_rows.read(range(len(titles)))
    columns = dict(zip(titles, values.T, strict=True))
    unit_of_angle = 1.0 if re.search(r"inDegrees\s*=\s*no", head, re.IGNORECASE) else np.pi / 180
    body = body_at_rest()
    angles = np.zeros((len(values), body.n_joints, 3))
    for name, (joint, place, sign) in known.items():
        angles[:, body.names.index(joint), place] = sign * unit_of_angle * columns.get(name, np.zeros(len(values)))
    turns = from_euler(angles, "ZXY")
    rotations = np.concatenate((turns[..., :1], _from_opensim(turns[..., 1:])), axis=2)
    origin = np.stack([columns.get(name, np.zeros(len(values))) for name in _PLACES], axis=1)
    translations = np.tile(body.offsets, (len(values), 1, 1))
    translations[:, 0] = _from_opensim(origin - rotate(turns[:, 0], _PELVIS))
    missing = tuple(name for name in (*known, *_PLACES) if name not in columns)
    notes = (*cut, Message("opensim.mean_body"), *((Message("opensim.missing", names=missing),) if missing else ()))
    return settle_motion(
        path, "mot", body, rotations, translations, Clock(None, columns["time"], frames=frames),
        unit=unit, up=up, unit_in_file=1.0, up_in_file="y", notes=notes,
    )  # fmt: skip
