"""The network's own places in space as evidence: what one view knows of depth.

A network's errors add up from bone to bone: who is seen leaning too far has the head too near as well. So it is asked
for the way from joint to joint, in statures, as the network knows the size of nobody. How far off it is across the
view and in depth, and how much nearer it has knees and elbows than they are, was measured on made-up films
(``lab/trials/made_people.py``); such errors last, so that films of some seconds say little more than one picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.cameras.camera import Camera

NETWORK_STATURE = 1.73
"""m, of the person as whom a network sees everybody."""

_ACROSS = (("hip", 0.018, 0.038), ("shoulder", 0.040, 0.060), ("ear", 0.050, 0.060))
"""Point -> the way from its right to its left: statures by which it is off across the view and in depth."""

_BONES: tuple[tuple[str, str, float, float, tuple[float, float, float]], ...] = (
    ("neck", "hips", 0.020, 0.050, (0.0, 0.0, 0.0)),
    ("nose", "neck", 0.022, 0.035, (0.0, 0.027, -0.048)),
    ("elbow", "shoulder", 0.033, 0.053, (0.0, 0.008, -0.027)),
    ("wrist", "elbow", 0.033, 0.059, (0.0, 0.0, 0.0)),
    ("hand", "wrist", 0.016, 0.022, (0.0, -0.014, -0.010)),
    ("knee", "hip", 0.033, 0.057, (0.0, 0.0, -0.030)),
    ("ankle", "knee", 0.032, 0.056, (0.0, 0.0, 0.034)),
    ("heel", "ankle", 0.016, 0.024, (0.0, 0.0, 0.0)),
    ("toe", "ankle", 0.024, 0.047, (0.0, -0.031, -0.020)),
)
"""Point, the one it hangs on, statures by which the way there is off across and in depth, and always (x right, y down,
z away from the camera)."""

_MIDDLES = {"neck": "shoulder", "hips": "hip"}
_SIDES = ("left_", "right_")


@dataclass(frozen=True, slots=True, eq=False)
class Bones:
    """Ways between landmarks that a network knows something of.

    Parameters
    ----------
    ways : (B, L) what is added up of the landmarks' places.
    sigmas : (B, 3) statures, how far each is off along the camera's axes.
    biases : (B, 3) statures, how far each is off always.
    """

    ways: FloatArray
    sigmas: FloatArray
    biases: FloatArray


def list_bones(names: Sequence[str]) -> Bones:
    """The bones that these landmarks have."""
    ways, sigmas, biases = [], [], []

    def add(one: FloatArray | None, other: FloatArray | None, row: tuple[float, float], bias: Sequence[float]) -> None:
        if one is not None and other is not None:
            ways.append(one - other)
            sigmas.append((row[0], row[0], row[1]))
            biases.append(bias)

    for point, across, depth in _ACROSS:
        add(_pick(names, f"left_{point}"), _pick(names, f"right_{point}"), (across, depth), (0.0, 0.0, 0.0))
    for point, parent, across, depth, bias in _BONES:
        for side in _SIDES if point not in ("neck", "nose") else ("",):
            add(_pick(names, side + point), _pick(names, side + parent), (across, depth), bias)
    return Bones(np.reshape(ways, (-1, len(names))), np.reshape(sigmas, (-1, 3)), np.reshape(biases, (-1, 3)))


def _pick(names: Sequence[str], name: str) -> FloatArray | None:
    """(L,) what is added up to get a point; None where the landmarks do not have it."""
    some = [side + _MIDDLES[name] for side in _SIDES] if name in _MIDDLES else [name]
    if not set(some) <= set(names):
        return None
    return np.array([float(own in some) / len(some) for own in names])


def world_terms(
    camera: Camera, world: FloatArray, names: Sequence[str], places: FloatArray, slopes: FloatArray, stature: float
) -> tuple[FloatArray, FloatArray]:
    """Errors in sigmas, and how they change with the pose.

    Parameters
    ----------
    camera : of the view.
    world : (T, L, 3) m, the network's places along the camera's axes; nan where it has none.
    names : (L,) of the landmarks.
    places : (T, L, 3) m, those of the body.
    slopes : (T, L, 3, D) their slopes.
    stature : m, of the body.

    Returns
    -------
    (T, B, 3), nan where the network says nothing, and (T, B, 3, D).
    """
    bones = list_bones(names)
    told = np.einsum("bl,tli->tbi", bones.ways, np.nan_to_num(world))
    known = ~np.einsum("bl,tl->tb", bones.ways != 0, np.isnan(world).any(axis=-1))
    told = told * stature / NETWORK_STATURE - stature * bones.biases
    turned = places @ camera.rotation.T
    sigmas = stature * bones.sigmas
    off = (np.einsum("bl,tli->tbi", bones.ways, turned) - told) / sigmas
    change = np.einsum("bl,ij,tljd->tbid", bones.ways, camera.rotation, slopes, optimize=True) / sigmas[..., None]
    return np.where(known[..., None], off, np.nan), np.asarray(change)
