"""Reading of a VMD file as a motion of the joints of a body, with the user's model or a mean one.

The bones of a human body are kept, under their Japanese names; bones between them (twist bones, cancelling bones) are
put into their turns. A unit of MMD is taken as 0.08 m, which makes the usual model 1.6 m tall.
"""

from __future__ import annotations

import os
import unicodedata

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.formats.assembly import add_ends, localise, rest_offsets, settle_motion
from dousa.formats.mmd.models import Model, find_model, load_model, template
from dousa.formats.mmd.posing import Poses, find_needed
from dousa.formats.mmd.vmd import VmdFile, load_vmd
from dousa.messages import Message
from dousa.motion import Motion, Skeleton

UNIT = 0.08
"""Metres per unit, by the definition above."""

_TRUNK = ("上半身", "上半身2", "首", "頭", "下半身")
_LIMBS = ("肩", "腕", "ひじ", "手首", "足", "ひざ", "足首", "つま先")
_FINGERS = tuple(f"{finger}{n}" for finger in ("親指", "人指", "中指", "薬指", "小指") for n in "0123")
_KEPT = frozenset((*_TRUNK, *(side + name for side in "左右" for name in (*_LIMBS, *_FINGERS))))


def read_vmd(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
) -> Motion:
    """Read a motion of MikuMikuDance: metres, Y up, facing +Z at rest, 30 Hz.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default 0.08.
    up : axis that points up; by default Y.
    skeleton : the model (.pmx, .pmd); by default the one beside the file, else a mean body, with a note.

    Raises
    ------
    MotionFileError : missing, damaged, keys of a camera or a face only, a model without the bones of a body.
    """
    motion = load_vmd(path)
    chosen = skeleton or find_model(path)
    model = template() if chosen is None else load_model(chosen)
    kept = list_kept(model)
    if not kept:
        raise MotionFileError(chosen or path, "mmd.no_body")
    known = {bone.name for bone in model.bones}
    needed = find_needed(model, kept)
    if not any(model.bones[number].name in motion.bones for number in needed):
        raise MotionFileError(path, "mmd.other_bones", found=tuple(motion.bones)[:5])
    notes = [Message("mmd.mean_body", model=motion.model or "-")] if chosen is None else []
    if chosen is not None:
        notes.append(Message("mmd.model", path=os.path.basename(chosen)))
        lost = tuple(name for name in motion.bones if _plain(name) in _KEPT and name not in known)
        if lost:
            notes.append(Message("mmd.lost_bones", found=lost[:8]))
    return _build(path, motion, model, kept, needed, tuple(notes), unit, up)


def _plain(name: str) -> str:
    """A name with plain digits and letters instead of full-width ones."""
    return unicodedata.normalize("NFKC", name)


def _build(
    path: str | os.PathLike[str],
    motion: VmdFile,
    model: Model,
    kept: list[int],
    needed: set[int],
    notes: tuple[Message, ...],
    unit: float | str | None,
    up: str | None,
) -> Motion:
    if motion.n_frames * len(kept) * 3 > 50_000_000:
        raise MotionFileError(path, "disk.too_large")
    poses = Poses(model, motion, needed)
    skeleton, ends = build_skeleton(model, kept)
    turns = np.stack([poses.turns[number] for number in kept], axis=1)
    places = np.stack([poses.places[number] for number in kept], axis=1)
    rotations, translations = localise(skeleton.parents, turns, places)
    return settle_motion(
        path, "vmd", *add_ends(skeleton, rotations, translations, ends), 30.0,
        unit=unit, up=up, unit_in_file=UNIT, up_in_file="y", notes=notes,
    )  # fmt: skip


def list_kept(model: Model) -> list[int]:
    """List the bones of a body in a model: their root, then themselves; [] if it has none, or a name twice."""
    kept = [number for number in model.order if _plain(model.bones[number].name) in _KEPT]
    root = _find_root(model, kept)
    whole = root is not None and len({model.bones[number].name for number in kept}) == len(kept)
    return [root, *kept] if whole and root is not None else []


def build_skeleton(model: Model, kept: list[int]) -> tuple[Skeleton, list[tuple[int, FloatArray]]]:
    """Build the skeleton of some bones of a model, in its units, and the end of the head, for `add_ends`."""
    bones = model.bones
    joint_of = {number: joint for joint, number in enumerate(kept)}
    parents = []
    for number in kept:
        above = bones[number].parent
        while above >= 0 and above not in joint_of:
            above = bones[above].parent
        parents.append(joint_of[above] if above >= 0 else -1)
    offsets = rest_offsets(parents, np.array([bones[number].place for number in kept]))
    skeleton = Skeleton(tuple(bones[number].name for number in kept), np.array(parents, np.intp), offsets)
    heads = [(joint, bones[number]) for joint, number in enumerate(kept) if bones[number].name == "頭"]
    return skeleton, [(joint, bone.end - bone.place) for joint, bone in heads if bone.end is not None]


def _find_root(model: Model, kept: list[int]) -> int | None:
    """The lowest common ancestor of upper and lower body."""
    lines = []
    for name in ("上半身", "下半身"):
        number = next((n for n in kept if model.bones[n].name == name), None)
        line = []
        while number is not None and number >= 0:
            number = model.bones[number].parent
            line.append(number)
        lines.append(line)
    return next((number for number in lines[0] if number in lines[1] and number >= 0), None)
