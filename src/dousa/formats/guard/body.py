"""Body: bones have a length and keep it, limbs hang together, and left and right are named as they are.

A map by names finds a knee wherever it lies and whatever it hangs on. Here geometry and tree are asked whether the
points so named can be those of a body. What fails is said, with joint and frame; positions of a file are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.canonical.reference_frame import MappedBody
from dousa.motion.types import Skeleton

_CHAINS = (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))
_SIDES = ("left", "right")
_BONES = tuple(bone for chain in _CHAINS for bone in pairwise(chain))

_STRETCH = 0.01
"""Share by which a bone of a rig may change its length; measured on the rigs of 22 producers: at most 0.0007."""


def keep_offsets(
    skeleton: Skeleton, translations: FloatArray, frames: IndexArray
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Give joints whose place is zero in every frame their offset: a program wrote the channels and left them empty.

    Parameters
    ----------
    skeleton : offsets in the unit of the translations.
    translations : (T, J, 3) local places; changed in place if they can be written to.
    frames : some frames, looked at first.

    Returns
    -------
    The translations, and a note that names the first of these joints.
    """
    joints = np.flatnonzero((skeleton.parents >= 0) & skeleton.offsets.any(axis=1))
    for some in (frames, slice(None)):
        if len(joints):
            joints = joints[~translations[some][:, joints].any(axis=(0, 2))]
    if not len(joints):
        return translations, ()
    translations = translations if translations.flags.writeable else translations.copy()
    translations[:, joints] = skeleton.offsets[joints]
    return translations, (Message("guard.empty_places", n=len(joints), joint=skeleton.names[joints[0]]),)


def check_body(
    names: Sequence[str],
    mapped: MappedBody | None,
    parents: IndexArray | None = None,
    translations: FloatArray | None = None,
) -> tuple[Message, ...]:
    """Check what was mapped to a body.

    Parameters
    ----------
    names : (K,) of the points of the file.
    mapped : the map and its points in some frames; None if the file holds no body.
    parents : (K,) tree; None if there is none.
    translations : (T, K, 3) local places of the joints of a tree.
    """
    if mapped is None:
        return ()
    extent = np.fmax.reduce(mapped.points, axis=1) - np.fmin.reduce(mapped.points, axis=1)
    if not (extent > 0).any():
        return (Message("guard.no_size"),)
    found = [*_find_crossed(names, mapped), *_find_exchanged(names, mapped)]
    if parents is not None:
        paths, loose = _follow_limbs(mapped.sources, parents)
        if loose:
            joint, above = loose[0]
            found.append(
                Message("guard.loose", n=len(loose), joint=names[joint], parent=names[above], roots=_count(parents))
            )
        if translations is not None:
            found += _find_stretched(names, paths, translations)
    return tuple(found)


def _count(parents: IndexArray) -> int:
    return int(np.count_nonzero(parents < 0))


def _follow_limbs(sources: dict[str, tuple[int, ...]], parents: IndexArray) -> tuple[list[int], list[tuple[int, int]]]:
    """Joints of the long bones, with those between; and the (lower, upper) joints that do not hang on each other."""
    paths: list[int] = []
    loose = []
    for side in _SIDES:
        for upper, lower in _BONES:
            ends = (sources.get(f"{side}_{upper}", ()), sources.get(f"{side}_{lower}", ()))
            if any(len(points) != 1 for points in ends):
                continue
            top, joint = ends[0][0], ends[1][0]
            path = []
            while joint not in (top, -1):
                path.append(joint)
                joint = int(parents[joint])
            if joint == top:
                paths += path
            else:
                loose.append((path[0], top))
    return paths, loose


def _find_stretched(names: Sequence[str], joints: list[int], translations: FloatArray) -> Iterator[Message]:
    """The joint whose bone changes its length most, if it is more than a rig's does."""
    worst, joint, at = _STRETCH, -1, 0
    lengths: list[float] = []
    for one in joints:
        places = translations[:, one]
        if (places == places[0]).all():
            continue
        bone = np.sqrt(np.einsum("tk,tk->t", places, places))
        usual = float(np.nanmedian(bone)) if not np.isnan(bone).all() else 0.0
        if usual > 0:
            off = np.abs(bone / usual - 1.0)
            frame = int(np.nanargmax(off))
            lengths.append(float(off[frame]))
            if off[frame] > worst:
                worst, joint, at = float(off[frame]), one, frame
    if joint >= 0:
        n = sum(length > _STRETCH for length in lengths)
        yield Message("guard.stretched", n=n, joint=names[joint], frame=at + 1, share=worst)


def _find_crossed(names: Sequence[str], mapped: MappedBody, mostly: float = 0.8) -> Iterator[Message]:
    """Hips and shoulders that point opposite ways: trunks turn by a right angle at most."""
    across = [_at(mapped, f"left_{joint}") - _at(mapped, f"right_{joint}") for joint in ("hip", "shoulder")]
    with np.errstate(invalid="ignore", divide="ignore"):
        turns = np.einsum("tk,tk->t", *across) / np.sqrt(np.prod([np.einsum("tk,tk->t", a, a) for a in across], axis=0))
    seen = turns[~np.isnan(turns)]
    if len(seen) and (seen < -0.5).mean() >= mostly:  # the cosine of 120 degrees, beyond what a spine turns
        hip, shoulder = (_name(names, mapped, f"left_{joint}") for joint in ("hip", "shoulder"))
        yield Message("guard.crossed", hip=hip, shoulder=shoulder)


def _find_exchanged(names: Sequence[str], mapped: MappedBody, mostly: float = 0.8) -> Iterator[Message]:
    """Joints of one side named as the other's: the bone across is shorter in most frames, and keeps its length better.

    Who crosses the legs makes it shorter too, but then it changes.
    """
    for upper, lower in _BONES:
        own, across = (
            np.stack([_at(mapped, f"{a}_{upper}") - _at(mapped, f"{b}_{lower}") for a, b in sides])
            for sides in (zip(_SIDES, _SIDES, strict=True), zip(_SIDES, _SIDES[::-1], strict=True))
        )
        lengths = np.sqrt(np.einsum("bstk,bstk->bst", *2 * (np.stack((own, across)),)))
        lengths = lengths[..., ~np.isnan(lengths).any(axis=(0, 1))]
        if lengths.shape[2] < 2 or (lengths[0] > lengths[1]).all(axis=0).mean() < mostly:
            continue
        change = (lengths.std(axis=2) / lengths.mean(axis=2)).max(axis=1)
        if change[1] < change[0]:
            joint, other, top = (
                _name(names, mapped, place) for place in (f"left_{lower}", f"right_{lower}", f"left_{upper}")
            )
            yield Message("guard.exchanged", joint=joint, other=other, upper=top)
            return


def _at(mapped: MappedBody, joint: str) -> FloatArray:
    """Places (T, 3) of a joint of its own; NaN where it was made from others."""
    points = mapped.points[:, JOINT_INDEX[joint]]
    return points if joint in mapped.sources else np.full_like(points, np.nan)


def _name(names: Sequence[str], mapped: MappedBody, joint: str) -> str:
    return names[mapped.sources[joint][0]]
