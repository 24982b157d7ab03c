"""Rotations of SMPL bodies in arrays: which arrays they are, and in which of the usual forms.

A body is found by the roles of names (``pred_rotmat``, ``smpl_poses``, ``pose_world``, ``global_orient`` with
``body_pose``: words of programs are dropped) and by shapes: J joints are 3 J numbers a frame as rotation vectors, 9 J
as matrices, which must be rotations, 6 J as two of their axes (Zhou et al., On the continuity of rotation
representations, 2019): the first two rows, one after the other (PyTorch3D), or the first two columns in turns (SPIN,
VIBE). Known to come so: AMASS, AIST++, Motion-X, EasyMocap, VIBE, WHAM, TRAM, 4DHumans, GVHMR, PromptHMR, HybrIK,
ROMP, SLAHMR.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.motion.rotations import from_axis_angle, from_matrix, identity

JOINTS_OF = {22: "SMPL", 24: "SMPL", 52: "SMPL-H", 55: "SMPL-X"}
"""Model by its number of joints, by the definition of each; 22 are SMPL's without the hands."""

_EASYMOCAP = (78, 87)  # numbers of SMPL-H and SMPL-X with 6 each for the hands, by the definition of EasyMocap
_BODIES = (21, 23)  # without the root, by the definition of SMPL-X and SMPL
_ROLES = {
    "poses": ("poses", "pose", "fullpose", "thetas", "theta", "rotmat", "rotmats"),
    "root": ("rootorient", "globalorient", "rh"),
    "body": ("bodypose", "posebody"),
    "hands": ("posehand", "handpose"),
    "left_hand": ("lefthandpose",),
    "right_hand": ("righthandpose",),
    "places": ("trans", "transl", "translation", "th", "roottrans", "camtrans", "camroot"),
    "betas": ("betas", "shape", "shapes"),
    "scaling": ("scaling",),
    "numbers": ("frameids", "frames", "frame", "frameid"),
}
_WORLD, _CAMERA = re.compile(r"world|global(?!_?orient)|aligned"), re.compile(r"incam|cam|_c$")
_PROGRAMS = re.compile(r"^(?:pred_?|smpl[hx]?_?|params_?)+|_?(?:world|global|w|opt|smooth)$|_", re.IGNORECASE)

Get = Callable[[str], NDArray[Any] | None]


def find_roles(names: Iterable[str]) -> dict[str, str]:
    """Return the array of each role, by the names of some arrays; those in the world before those of a camera."""
    found: dict[str, str] = {}
    for name in sorted(names, key=rank_place):
        found.setdefault(bare_name(name), name)
    roles = {role: next((found[word] for word in words if word in found), None) for role, words in _ROLES.items()}
    return {role: name for role, name in roles.items() if name is not None}


@lru_cache(maxsize=4096)
def bare_name(name: str) -> str:
    """Return a name in lower case, without the words and lines that programs put around it."""
    return _PROGRAMS.sub("", name.lower())


@lru_cache(maxsize=4096)
def rank_place(name: str) -> int:
    """Return 0 for what a name places in the world, 2 in a camera, 1 for names that say neither."""
    return 0 if _WORLD.search(name.lower()) else 2 if _CAMERA.search(name.lower()) else 1


def are_poses(roles: Mapping[str, str]) -> bool:
    """Return whether roles are those of a body."""
    return "poses" in roles or "body" in roles


@dataclass(frozen=True, slots=True, eq=False)
class Rotations:
    """Local rotations (T, J, 4) of a body as unit quaternions; ``found`` : numbers a frame, where they are no body."""

    turns: FloatArray | None
    found: int = 0


def read_rotations(get: Get, roles: Mapping[str, str]) -> Rotations:
    """Read the rotations of a body from the arrays of its roles."""
    parts: dict[str, NDArray[Any]] = {}
    for role in ("poses", "root", "body", "hands", "left_hand", "right_hand"):
        array = get(roles[role]) if role in roles else None
        if array is not None and array.ndim and array.size:
            parts[role] = array
    if "root" in parts and "body" in parts and len(parts["root"]) == len(parts["body"]):
        return _join_parts(parts)
    whole = parts.get("poses", parts.get("body"))
    if whole is None:
        return Rotations(None)
    if whole[0].size in _EASYMOCAP:
        whole = whole.reshape(len(whole), -1)[:, :66]
    turns = as_turns(whole, (*JOINTS_OF, *_BODIES))
    if turns is None:
        return Rotations(None, whole[0].size)
    if turns.shape[1] in _BODIES:
        turns = np.concatenate((identity((len(turns), 1)), turns), axis=1)
    if "root" in parts and (turns[:, 0, 0] == 1).all():  # EasyMocap: the root is beside the poses
        root = as_turns(parts["root"], (1,))
        if root is not None and len(root) == len(turns):
            turns = np.concatenate((root, turns[:, 1:]), axis=1)
    return Rotations(turns)


def _join_parts(parts: Mapping[str, NDArray[Any]]) -> Rotations:
    root, body = as_turns(parts["root"], (1,)), as_turns(parts["body"], _BODIES)
    if root is None or body is None:
        return Rotations(None, parts["root"][0].size + parts["body"][0].size)
    hands = [as_turns(parts[role], (30, 15)) for role in ("hands", "left_hand", "right_hand") if role in parts]
    fingers = [hand for hand in hands if hand is not None and len(hand) == len(body)]
    if body.shape[1] == 21 and sum(hand.shape[1] for hand in fingers) == 30:
        body = np.concatenate((body, *fingers), axis=1)
    return Rotations(np.concatenate((root, body), axis=1))


def as_turns(array: NDArray[Any], joints: Iterable[int]) -> FloatArray | None:
    """Return quaternions (T, J, 4) of an array of rotations of one of these numbers of joints; None if it is none."""
    flat = array.reshape(len(array), -1).astype(np.float64)
    counts = {form * count: (form, count) for form in (3, 9, 6) for count in joints}
    form, count = counts.get(flat.shape[1], (0, 0))
    if array.shape[-2:] == (3, 3) and form != 9:
        return None
    if form == 3:
        return np.asarray(from_axis_angle(flat.reshape(len(flat), count, 3)))
    if form == 9:
        return _from_matrices(flat.reshape(len(flat), count, 3, 3))
    return _from_axes(flat.reshape(len(flat), count, 6)) if form == 6 else None


def _from_matrices(matrices: FloatArray, close: float = 0.05) -> FloatArray | None:
    """Quaternions of matrices; None where one is further than ``close`` from a rotation."""
    squares = np.swapaxes(matrices, -1, -2) @ matrices
    if not np.abs(squares - np.eye(3)).max() < close or not (np.linalg.det(matrices) > 0).all():
        return None
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(from_matrix(left @ right))


def _from_axes(axes: FloatArray) -> FloatArray | None:
    """Quaternions of two axes each; they are rows one after the other, or columns in turns: whichever are unit axes."""
    pairs = {False: (axes[..., :3], axes[..., 3:]), True: (axes[..., ::2], axes[..., 1::2])}
    off = {turns: np.abs((first * second).sum(axis=-1)).mean() for turns, (first, second) in pairs.items()}
    in_turns = bool(off[True] < off[False])
    first, second = pairs[in_turns]
    with np.errstate(invalid="ignore", divide="ignore"):
        first = first / np.linalg.norm(first, axis=-1, keepdims=True)
        second = second - (first * second).sum(axis=-1, keepdims=True) * first
        second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    rows = np.stack((first, second, np.cross(first, second)), axis=-2)
    if not np.isfinite(rows).all():
        return None
    return np.asarray(from_matrix(np.swapaxes(rows, -1, -2) if in_turns else rows))
