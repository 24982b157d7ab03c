"""Body: bones have a length and keep it, limbs hang together, and left and right are named as they are.

A map by names finds a knee wherever it lies and whatever it hangs on. Here geometry and tree are asked whether the
points so named can be those of a body. What fails is said, with joint and frame; positions of a file are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.messages import Message
from dousa.motion.canonical.anthropometry import find_medians, stature_of_parts
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.canonical.mapping import ChosenMap
from dousa.motion.canonical.recipes import Recipe
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
    joints = _list_placed(skeleton)
    if translations[0, joints].any(axis=1).all():  # nearly every file
        return translations, ()
    for some in (frames, slice(None)):
        if len(joints):
            joints = joints[~translations[some][:, joints].any(axis=(0, 2))]
    if not len(joints):
        return translations, ()
    translations = translations if translations.flags.writeable else translations.copy()
    translations[:, joints] = skeleton.offsets[joints]
    return translations, (Message("guard.empty_places", n=len(joints), joint=skeleton.names[joints[0]]),)


@lru_cache(maxsize=64)
def _list_placed(skeleton: Skeleton) -> IndexArray:
    """Joints, without roots, that have an offset."""
    return np.flatnonzero((skeleton.parents >= 0) & skeleton.offsets.any(axis=1))


def check_body(
    names: Sequence[str],
    mapped: ChosenMap | None,
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
    points, recipe = mapped.points, mapped.recipe
    if not (points[:1] > points[:1, :1]).any():  # spares the look at every value
        extent = np.fmax.reduce(points, axis=1) - np.fmin.reduce(points, axis=1)
        if not (extent > 0).any():
            return (Message("guard.no_size"),)
    unknown = _list_unknown(recipe)
    if unknown:
        points = points.copy()
        points[:, unknown] = np.nan

    def name(joint: str) -> str:
        return names[recipe.sources[joint][0]] if joint in recipe.sources else joint

    found = [*_find_crossed(name, points)]
    paths, loose = ((), ()) if parents is None else _follow_limbs(recipe, parents.tobytes())
    if not paths or loose:  # limbs of a tree that hang together are of one side
        found += _find_exchanged(name, points)
    if parents is not None and translations is not None:
        if loose:
            joint, above = loose[0]
            roots = int(np.count_nonzero(parents < 0))
            found.append(Message("guard.loose", n=len(loose), joint=names[joint], parent=names[above], roots=roots))
        found += _find_stretched(names, paths, translations)
    return tuple(found)


@lru_cache(maxsize=64)
def _list_unknown(recipe: Recipe) -> list[int]:
    """Rows of the joints that the file does not have: what others make of them is no evidence."""
    known = {*recipe.sources, *recipe.estimated}
    return [row for joint, row in JOINT_INDEX.items() if joint not in known]


@lru_cache(maxsize=64)
def _follow_limbs(recipe: Recipe, tree: bytes) -> tuple[tuple[int, ...], tuple[tuple[int, int], ...]]:
    """Joints of the long bones, with those between; and the (lower, upper) joints that do not hang on each other."""
    parents = np.frombuffer(tree, np.intp)
    paths: list[int] = []
    loose = []
    for side in _SIDES:
        for upper, lower in _BONES:
            ends = (recipe.sources.get(f"{side}_{upper}", ()), recipe.sources.get(f"{side}_{lower}", ()))
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
    return tuple(paths), tuple(loose)


def _find_stretched(
    names: Sequence[str], joints: tuple[int, ...], translations: FloatArray, most_frames: int = 500
) -> Iterator[Message]:
    """The joint whose bone changes its length most, if it is more than a rig's does.

    ``most_frames`` : looked at, evenly spread, of a long file.
    """
    step = -(-len(translations) // most_frames)
    places = translations[::step, joints]
    if not (places != places[:1]).any():  # most rigs
        return
    bones = np.sqrt(np.einsum("tjk,tjk->jt", places, places))
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.nan_to_num(np.abs(bones / find_medians(bones.T)[:, None] - 1.0), posinf=0.0)
    most = off.max(axis=1, initial=0.0)
    if (most > _STRETCH).any():
        worst = int(most.argmax())
        yield Message(
            "guard.stretched",
            n=int((most > _STRETCH).sum()),
            joint=names[joints[worst]],
            frame=int(off[worst].argmax()) * step + 1,
            share=float(most[worst]),
        )


def _find_crossed(name: Callable[[str], str], points: FloatArray, mostly: float = 0.8) -> Iterator[Message]:
    """Hips and shoulders that point opposite ways: trunks turn by a right angle at most.

    Beyond 120 degrees, of which the cosine is -0.5, in most frames.
    """
    ends = points[:, _WIDTHS]  # (T, hips or shoulders, side, 3)
    across = ends[:, :, 0] - ends[:, :, 1]
    if np.count_nonzero(np.einsum("tk,tk->t", across[:, 0], across[:, 1]) >= 0) > (1 - mostly) * len(across):
        return
    with np.errstate(invalid="ignore", divide="ignore"):
        across /= np.sqrt(np.einsum("tjk,tjk->tj", across, across))[..., None]
    turns = np.einsum("tk,tk->t", across[:, 0], across[:, 1])
    seen = turns[~np.isnan(turns)]
    if len(seen) and (seen < -0.5).mean() >= mostly:
        yield Message("guard.crossed", hip=name("left_hip"), shoulder=name("left_shoulder"))


def _find_exchanged(
    name: Callable[[str], str], points: FloatArray, mostly: float = 0.8, often: float = 0.05
) -> Iterator[Message]:
    """Joints of one side named as the other's: in most frames the bones across are shorter, and nothing else can be.

    Who crosses the limbs makes them shorter too. But then bones keep their length, and do not pass through each other
    ``often``: more than glitches do.
    """
    bones = points[:, _LOWER] - points[:, _UPPER]  # (T, own or across, bone, side, 3)
    lengths = np.sqrt(np.einsum("twbsk,twbsk->wbst", bones, bones))
    seen = ~np.isnan(lengths).any(axis=(0, 2))
    with np.errstate(invalid="ignore"):
        nearer = (lengths[0] > lengths[1]).all(axis=1)
    for bone in np.flatnonzero((seen.sum(axis=1) > 0) & (nearer.sum(axis=1) >= mostly * seen.sum(axis=1))):
        kept = lengths[:, bone][..., seen[bone]]
        change = (kept.std(axis=2) / kept.mean(axis=2)).max(axis=1)
        gaps = _measure_gaps(points[seen[bone]][:, _UPPER[0, bone]], bones[seen[bone], 0, bone])
        through = (gaps < _SOLID * stature_of_parts(points)).mean() >= often
        if through or (change[0] > _STRETCH and change[1] < change[0]):
            upper, lower = _BONES[bone]
            joint, other, top = (name(place) for place in (f"left_{lower}", f"right_{lower}", f"left_{upper}"))
            yield Message("guard.exchanged", joint=joint, other=other, upper=top)
            return


_SOLID = 0.5 * 6.68 / 170.18
"""Share of the stature that the middles of two limbs are apart at least: half the breadth of the ankle, the narrowest
(Ross & Wilson 1974, as in `geometry`); they would touch at twice that."""


def _measure_gaps(starts: FloatArray, bones: FloatArray) -> FloatArray:
    """Distances (T,) of two lines of limited length, (T, 2, 3) each: where they are nearest, or at one of the ends."""
    between = starts[:, 1] - starts[:, 0]
    squares = np.einsum("tsk,tsk->ts", bones, bones)
    along = np.einsum("tsk,tk->ts", bones, between)
    dot = np.einsum("tk,tk->t", bones[:, 0], bones[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        inner = np.nan_to_num((along[:, 0] * squares[:, 1] - along[:, 1] * dot) / (squares.prod(axis=1) - dot**2))
        gaps = []
        for first in (inner, np.zeros(len(dot)), np.ones(len(dot))):
            place = np.clip(first, 0.0, 1.0)
            other = np.clip((place * dot - along[:, 1]) / squares[:, 1], 0.0, 1.0)
            place = np.clip((along[:, 0] + other * dot) / squares[:, 0], 0.0, 1.0)
            gaps.append(between + other[:, None] * bones[:, 1] - place[:, None] * bones[:, 0])
    nearest: FloatArray = np.linalg.norm(gaps, axis=2).min(axis=0)
    return nearest


_WIDTHS = np.array([[JOINT_INDEX[f"{side}_{joint}"] for side in _SIDES] for joint in ("hip", "shoulder")])
# By definition (own or across, bone, side): rows of the canonical joints at both ends of the bones.
_UPPER = np.array([[[JOINT_INDEX[f"{side}_{upper}"] for side in _SIDES] for upper, _ in _BONES]] * 2)
# By the same definition: the lower ends, of which the second are those of the other side.
_LOWER = np.array(
    [[[JOINT_INDEX[f"{side}_{lower}"] for side in sides] for _, lower in _BONES] for sides in (_SIDES, _SIDES[::-1])]
)
