"""Assembly of motions and trajectories from the content of files: to metres with Y up, from world to local poses."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypedDict, Unpack

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.formats.guard import (
    Clock,
    check_body,
    find_shift,
    is_flat,
    keep_offsets,
    note_shift,
    settle_clock,
    settle_positions,
    settle_roots,
)
from dousa.messages import Message
from dousa.motion import Motion, Provenance, Skeleton, Trajectories, thin
from dousa.motion.canonical.reference_frame import (
    ReferenceFrame,
    change_arrays,
    infer_reference_frame,
    parse_unit,
    parse_up,
)
from dousa.motion.rotations import conjugate, identity, multiply, rotate
from dousa.motion.types import freeze

LONGEST = 20_000
"""Frames, by definition, that are looked at for the up axis: some minutes, in which a body stands or sits."""


class Claims(TypedDict, total=False):
    """Unit (metres per unit) and up axis of a file, by who says so; None where nobody does.

    Parameters
    ----------
    unit, up : given by the caller.
    unit_in_file, up_in_file : of the file or its format, taken as they are.
    declared_unit, declared_up : of the file, rejected where the body would have an impossible height or clearly stands
        along another axis.
    default_up : usual in the format, ``"y"`` if left out; None where it has none.
    """

    unit: float | str | None
    up: str | None
    unit_in_file: float | None
    up_in_file: str | None
    declared_unit: float | None
    declared_up: str | None
    default_up: str | None


def settle_motion(
    path: str | os.PathLike[str],
    format_name: str,
    skeleton: Skeleton,
    rotations: FloatArray,
    translations: FloatArray,
    clock: Clock | float,
    *,
    rest_in_world: bool = True,
    most_frames: int = 0,
    layout: Any = None,
    values: FloatArray | None = None,
    notes: tuple[Message, ...] = (),
    damaged: str = "markers.damaged",
    **claims: Unpack[Claims],
) -> Motion:
    """Build a motion in metres with Y up from the content of a file, after the checks of `dousa.formats.guard`.

    Parameters
    ----------
    path, format_name : for the provenance and the messages.
    skeleton : offsets in the file's unit and axes.
    rotations : (T, J, 4) local unit quaternions.
    translations : (T, J, 3) local positions in the file's unit and axes, changed in place.
    clock : all that the file says of time; the rate in Hz where it says no more.
    rest_in_world : whether the rest pose stands in the axes of the file; else only the frames show the up axis.
    most_frames : looked at for the up axis where 16 leave a doubt.
    layout, values : of the format and the file, for the provenance.
    notes : for the user, on the reading of the file.
    damaged : code of the message about arrays that make no motion.
    claims : see `Claims`.

    Raises
    ------
    MotionFileError : arrays that make no motion, such as infinite positions.
    """
    from dousa.motion.kinematics import forward_kinematics  # numba

    timeline = settle_clock(path, clock, len(rotations), rotations)
    rotations, translations = timeline.place(rotations), timeline.place(translations)
    values = None if values is None else timeline.place(values)

    def place(frames: IndexArray | slice) -> FloatArray:
        return freeze(forward_kinematics(skeleton.parents, rotations[frames], translations[frames])[0])

    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file may hold 1e300
            rest = _place_rest(skeleton) if rest_in_world else None
            count = min(len(rotations), 16)
            some = np.arange(count) * (len(rotations) - 1) // max(count - 1, 1)
            translations, emptied = keep_offsets(skeleton, translations, some)
            positions = place(some)
            translations, lost = settle_roots(path, skeleton, rotations, translations, positions)
            positions = place(some) if lost else positions
            flat = (Message("guard.flat_body"),) if is_flat(positions) else ()
            roots = np.flatnonzero(skeleton.parents < 0)
            frame, shift, provenance = _find_frame(
                path, format_name, Trajectories(skeleton.names, positions, timeline.rate, skeleton.parents, rest),
                translations[:, roots], (lambda: place(slice(0, most_frames))) if most_frames else None, claims,
                (*timeline.join(notes), *emptied, *lost, *flat), translations,
            )  # fmt: skip
            if shift is not None:
                translations = translations.copy()
                translations[:, roots] -= shift
            settled = change_arrays(skeleton, rotations, translations, frame.unit, frame.rotation)
            read = () if values is None else (settled[0].offsets, *settled[1:])
            provenance = dataclasses.replace(provenance, layout=layout, values=values, read=read)
            return Motion(*settled, timeline.rate, provenance)
    except InvalidMotionError as error:
        raise MotionFileError(path, damaged, reason=error) from error


def _find_frame(
    path: str | os.PathLike[str],
    format_name: str,
    sample: Trajectories,
    placed: FloatArray,
    whole: Callable[[], FloatArray] | None,
    claims: Claims,
    notes: tuple[Message, ...],
    translations: FloatArray | None = None,
) -> tuple[ReferenceFrame, FloatArray | None, Provenance]:
    """Unit and axes, how far to move a body that is far from the origin, and the provenance with all notes.

    Parameters
    ----------
    path, format_name, notes : for the provenance.
    sample : some frames, in the file's unit and axes.
    placed : (T, K, 3) what is in the world of all frames: points, or the roots of a tree.
    whole : returns the positions of all frames that are looked at where the sample leaves a doubt.
    claims : of the file and the caller.
    translations : (T, J, 3) local places of a tree.
    """
    unit, unit_in_file = claims.get("unit"), claims.get("unit_in_file")
    up, up_in_file = claims.get("up"), claims.get("up_in_file")
    known: dict[str, Any] = {
        "unit": unit_in_file if unit is None else parse_unit(unit),
        "up": up_in_file if up is None else parse_up(up),
        "declared_unit": claims.get("declared_unit"),
        "declared_up": claims.get("declared_up"),
        "default_up": claims.get("default_up", "y"),
    }
    frame = infer_reference_frame(sample, whole=whole, **known)
    shift = find_shift(placed, frame.unit)
    moved = None
    if shift is not None:
        near = (lambda: whole() - shift) if whole is not None else None
        frame = infer_reference_frame(sample.replace(positions=sample.positions - shift), whole=near, **known)
        moved, notes = tuple((frame.rotation @ shift * frame.unit).tolist()), (*notes, note_shift(shift))
    doubts = check_body(sample.names, frame.body, sample.parents, translations)
    return (
        frame,
        shift,
        Provenance(
            os.fspath(path),
            format_name,
            frame.unit,
            "declared" if unit is None and unit_in_file is not None else frame.unit_source,
            frame.up,
            "declared" if up is None and up_in_file is not None else frame.up_source,
            notes=(*notes, *doubts, *frame.notes),
            shift=moved,
        ),
    )


@lru_cache(maxsize=64)
def _place_rest(skeleton: Skeleton) -> FloatArray:
    """(J, 3) rest pose, once for all files of a skeleton that a reader has kept."""
    from dousa.motion.kinematics import compute_rest_positions

    return freeze(compute_rest_positions(skeleton))


def settle_world(
    path: str | os.PathLike[str],
    format_name: str,
    names: Sequence[str],
    parent_names: dict[str, str],
    world: FloatArray,
    positions: FloatArray,
    clock: Clock | float,
    *,
    are_local: bool = False,
    **settings: Any,
) -> Motion:
    """Build a motion from poses in the world of joints whose rest pose is unknown: bones have their median offsets.

    Parameters
    ----------
    names, parent_names : (J,) of the joints, and the parent by name as for `order_tree`.
    world : (T, J, 4) unit quaternions; NaN where missing.
    positions : (T, J, 3) in the file's unit and axes; NaN where missing.
    are_local : whether the poses are those in the axes of the parents instead.
    settings : of `settle_motion`.
    """
    order, parents = order_tree(tuple(names), parent_names)
    if not are_local:
        positions, lost = settle_positions(path, names, positions)
        settings["notes"] = (*settings.get("notes", ()), *lost)
    rotations, translations = world[:, order], positions[:, order]
    if not are_local:
        rotations, translations = localise(parents, rotations, translations)
    skeleton = Skeleton(tuple(names[joint] for joint in order), np.array(parents), median_offsets(translations))
    return settle_motion(path, format_name, skeleton, rotations, translations, clock, **settings)


def add_ends(
    skeleton: Skeleton, rotations: FloatArray, translations: FloatArray, ends: Sequence[tuple[int, FloatArray]]
) -> tuple[Skeleton, FloatArray, FloatArray]:
    """Add end sites: (joint, place (3,) in its axes); returns the skeleton and the local poses with them."""
    n_joints, shape = skeleton.n_joints, (len(rotations), len(ends))
    offsets = np.array([place for _, place in ends]).reshape(-1, 3)
    with_ends = Skeleton(
        (*skeleton.names, *(f"{skeleton.names[joint]}_end" for joint, _ in ends)),
        np.array([*skeleton.parents, *(joint for joint, _ in ends)], np.intp),
        np.concatenate((skeleton.offsets, offsets)),
        np.arange(n_joints + len(ends)) >= n_joints,
    )
    rotations = np.concatenate((rotations, identity(shape)), axis=1)
    return with_ends, rotations, np.concatenate((translations, np.tile(offsets, (shape[0], 1, 1))), axis=1)


def rest_offsets(parents: Sequence[int], rest: FloatArray) -> FloatArray:
    """Compute the offsets (J, 3) of joints from their places (J, 3) at rest; those of roots are the places."""
    above = np.array(parents)
    return rest - np.where(above[:, None] >= 0, rest[above], 0.0)


def localise(parents: Any, world: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute local rotations (T, J, 4) and translations (T, J, 3) of joints from poses in the world.

    Parameters
    ----------
    parents : (J,) parent before child, -1 for a root.
    world : (T, J, 4) unit quaternions; NaN where missing.
    positions : (T, J, 3); NaN where missing.
    """
    rotations, translations = np.array(world), np.array(positions)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            back = conjugate(world[:, parent])
            rotations[:, joint] = multiply(back, world[:, joint])
            translations[:, joint] = rotate(back, positions[:, joint] - positions[:, parent])
    return rotations, translations


def median_offsets(translations: FloatArray) -> FloatArray:
    """Compute the offsets (J, 3) of a skeleton as medians of the local positions (T, J, 3), root at 0."""
    counted: BoolArray = np.isfinite(translations.sum(axis=2))
    offsets = np.zeros(translations.shape[1:])
    for joint in range(1, translations.shape[1]):
        seen = translations[counted[:, joint], joint]
        if len(seen):
            offsets[joint] = np.median(seen, axis=0)
    return offsets


def order_tree(names: tuple[str, ...], parent_names: dict[str, str]) -> tuple[list[int], list[int]]:
    """Order the names with parents before children; return their indices and the parent of each in that order.

    Parameters
    ----------
    names : of the joints.
    parent_names : name of the parent by name; a joint without one, or whose parent is not among the names or is its
        own descendant, is a root.
    """
    known = {name: index for index, name in enumerate(names)}
    order: list[int] = []
    place: dict[int, int] = {}
    parents: list[int] = []
    for start in range(len(names)):
        chain = []
        joint: int | None = start
        while joint is not None and joint not in place and joint not in chain:
            chain.append(joint)
            joint = known.get(parent_names.get(names[joint], ""))
        for index in reversed(chain):
            above = known.get(parent_names.get(names[index], ""))
            parents.append(place.get(above, -1) if above is not None else -1)
            place[index] = len(order)
            order.append(index)
    return order, parents


def declared_unit(text: str) -> float | None:
    """Return metres per unit of a named unit, None if it is unknown."""
    try:
        return (
            None if re.fullmatch(r"[-+.\deE]+", text.strip()) else parse_unit(text)
        )  # a number slipped from another column
    except OptionError:
        return None


def settle_trajectories(
    path: str | os.PathLike[str],
    format_name: str,
    names: tuple[str, ...],
    positions: FloatArray,
    clock: Clock | float,
    *,
    keep_values: bool = False,
    notes: tuple[Message, ...] = (),
    **claims: Unpack[Claims],
) -> Trajectories:
    """Build trajectories in metres with Y up from the content of a file, after the checks of `dousa.formats.guard`.

    Parameters
    ----------
    path, format_name : for the provenance and the messages.
    names : (K,) of the points.
    positions : (T, K, 3) in the file's unit and axes, NaN where missing; the caller's no longer.
    clock : all that the file says of time; the rate in Hz where it says no more.
    keep_values : keep the file's own numbers in the provenance.
    notes : for the user, on the reading of the file.
    claims : see `Claims`.

    Raises
    ------
    MotionFileError : no points, no frames, positions that can be none or lie in a picture, an impossible frame rate.
    """
    timeline = settle_clock(path, clock, len(positions), positions)
    positions = timeline.place(positions)
    values = freeze(positions) if keep_values else None
    positions, lost = settle_positions(path, names, positions)
    if is_flat(positions):
        raise MotionFileError(path, "guard.flat")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file may hold 1e300
            some = thin(positions, 10) if len(positions) > 10 else positions
            sample = Trajectories(names, freeze(some), timeline.rate)
            frame, shift, provenance = _find_frame(
                path, format_name, sample, positions, lambda: positions[:LONGEST], claims,
                (*timeline.join(notes), *lost),
            )  # fmt: skip
            placed = frame.place(positions if shift is None else positions - shift)
            provenance = dataclasses.replace(provenance, values=values, read=(placed,) if keep_values else ())
            return Trajectories(names, placed, timeline.rate, provenance=provenance)
    except InvalidMotionError as error:
        raise MotionFileError(path, "markers.damaged", reason=error) from error
