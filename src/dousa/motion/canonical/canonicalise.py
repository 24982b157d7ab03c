"""From any skeleton or marker set to the 20 canonical joints.

The mapping comes from a joint map if one is given, else from the names, else from the shape of the tree. Joints
missing in the file are made from their neighbours and reported. Left and right are checked against the body's front;
names are never swapped.

Mirroring reflects in the plane X = 0 of the world and swaps left and right joints: heights, speeds and times stay, and
so do right-handed axes. Mirroring twice gives the same motion, bit for bit.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import InvalidMotionError, JointMappingError
from dousa.messages import Message
from dousa.motion.canonical.anthropometry import stature_of_parts
from dousa.motion.canonical.geometry import STATURE_PER_HEIGHT, body_points, chain_height, find_leaps, measure_rest
from dousa.motion.canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS, MIRRORED_JOINTS, CanonicalPoses
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.mapping import ChosenMap, choose_map, find_clusters, names_of_seen
from dousa.motion.canonical.naming import NameMatch, group_owners, match_names
from dousa.motion.canonical.recipes import HAND_REACH, JointMap, Recipe, recipe_from_joint_map
from dousa.motion.canonical.tree_shape import compare_sides, compute_forward, spread_frames
from dousa.motion.resampling import fill_gaps
from dousa.motion.types import Motion, Trajectories
from dousa.notebooks import plays, short_repr


def _bone(end: str, start: str) -> FloatArray:
    row = np.zeros(len(CANONICAL_JOINTS))
    row[[J[end], J[start]]] = 1.0, -1.0
    return row


_TIPS_AND_BONES = np.stack(
    [
        _bone(f"{side}_{end}", f"{side}_{start}")
        for end, start in (("hand", "wrist"), ("toe", "ankle"), ("wrist", "elbow"), ("ankle", "knee"))
        for side in ("left", "right")
    ]
)


@dataclass(frozen=True, slots=True)
class JointMapping:
    """Where the canonical joints of a motion come from.

    Parameters
    ----------
    table : name family such as ``"CMU/HDM05"``, or ``"tree shape"`` or ``"joint map"``.
    sources : canonical joint -> names in the file whose mean it is.
    derived : canonical joints missing in the file and made from others.
    absent : canonical joints that cannot be found or made: their positions are NaN.
    sides : named and geometrical sides ``"agree"``, ``"disagree"`` (positions were mirrored) or are ``"unclear"``.
    markers : whether points named like joints look like markers on the skin, by the width of the hips alone; None if
        that is not in question.
    """

    table: str
    sources: dict[str, tuple[str, ...]]
    derived: tuple[str, ...]
    sides: str
    absent: tuple[str, ...] = ()
    markers: bool | None = None


@plays
@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class CanonicalMotion(CanonicalPoses):
    """The 20 canonical joints of a motion over time.

    Parameters
    ----------
    positions : (T, 20, 3) m, world, Y up, right-handed, order of `CANONICAL_JOINTS`; finite except ``absent`` joints.
    frame_rate : Hz.
    height : m, body height over the joints, eq. 1 of Hamada et al.; not the stature.
    height_source : ``"rest pose"`` (upright), ``"bone chain"``, or ``"parts"``: long bones of a part of a body.
    mapping : where the joints come from.
    warnings : for the user.
    missing : (T, 20) True where a joint was filled in or is absent; None if all were seen.

    >>> canonical = dousa.canonicalise(dousa.read_motion("wave.bvh"))
    >>> canonical.absent
    ()
    """

    height: float
    height_source: str
    mapping: JointMapping
    warnings: tuple[Message, ...] = ()
    missing: BoolArray | None = None

    @property
    def absent(self) -> tuple[str, ...]:
        """Canonical joints that the file does not have: their positions are NaN."""
        return self.mapping.absent

    @property
    def stature(self) -> float:
        """Estimated stature, m: the crown of the head and the sole of the foot lie beyond the joints."""
        return STATURE_PER_HEIGHT * self.height

    def to_trajectories(self) -> Trajectories:
        """Return the same positions as trajectories with canonical names and parents."""
        return Trajectories(CANONICAL_JOINTS, self.positions, self.frame_rate, np.array(CANONICAL_PARENTS))


def canonicalise(
    motion: Motion | Trajectories,
    joint_map: JointMap | None = None,
    *,
    any_skeleton: bool = False,
    whole: bool = False,
    markers: bool | None = None,
) -> CanonicalMotion:
    """Map a motion of any skeleton or marker set to the canonical joints.

    Gaps (NaN) are filled by interpolation, ends held, and marked in ``missing``.

    Parameters
    ----------
    motion : motion or trajectories in m, Y up.
    joint_map : canonical joint -> name or names in the file, where names and shape are not enough.
    any_skeleton : accept a body that cannot be a person's, such as an animal's or a toy's.
    whole : refuse a part of a body.
    markers : whether points named like joints are markers on the skin; None to decide it by the file.

    Raises
    ------
    JointMappingError : no body and no whole arm or leg is found or seen; or not a person.

    >>> canonical = dousa.canonicalise(dousa.read_motion("wave.bvh"))
    >>> canonical.positions.shape[1] == len(dousa.CANONICAL_JOINTS)
    True
    """
    if isinstance(motion, Motion):
        from dousa.motion.kinematics import compute_trajectories

        motion = compute_trajectories(motion)
    moving, positions = motion, motion.positions
    gaps = bool(np.isnan(positions.sum()))
    never = _never_seen(moving) if gaps else ()
    chosen = _choose_recipe(moving, joint_map, never, markers)
    if not (chosen.is_person or any_skeleton):
        raise JointMappingError("canonical.not_human", moving.names, table=chosen.recipe.table)
    recipe = chosen.recipe
    if whole and recipe.absent:
        raise JointMappingError("canonical.part_refused", moving.names, absent=recipe.absent)
    missing = None
    if gaps:
        missing = _find_missing(recipe, positions)
        positions = fill_gaps(positions)
    points = body_points(recipe, positions, metres=True)
    return _finish(moving, chosen, points, _with_absent(missing, recipe, len(points)))


def require_whole(motion: CanonicalMotion) -> CanonicalMotion:
    """Return the motion; JointMappingError for a part of a body."""
    if motion.absent:
        raise JointMappingError("canonical.part_refused", (), absent=motion.absent)
    return motion


def _with_absent(missing: BoolArray | None, recipe: Recipe, n_frames: int) -> BoolArray | None:
    if not recipe.absent:
        return missing
    marked = np.zeros((n_frames, len(CANONICAL_JOINTS)), bool) if missing is None else missing
    marked[:, [J[joint] for joint in recipe.absent]] = True
    return marked


def _never_seen(moving: Trajectories) -> tuple[int, ...]:
    unseen = np.isnan(moving.positions).any(axis=2).all(axis=0)
    return tuple(int(index) for index in np.flatnonzero(unseen))


def _find_missing(recipe: Recipe, positions: FloatArray) -> BoolArray:
    """(T, 20) where a source of a joint is not seen."""
    unseen: BoolArray = np.any(np.isnan(positions), axis=2)
    missing = unseen[:, recipe.gather]
    for row, indices, _ in recipe.blends:
        missing[:, row] = unseen[:, indices].any(axis=1)
    if recipe.pelvis_markers:
        markers = [index for indices in recipe.pelvis_markers for index in indices]
        hips: BoolArray = np.any(unseen[:, markers], axis=1)
        missing[:, [J["pelvis"], J["left_hip"], J["right_hip"]]] |= hips[:, None]
    return missing


def _choose_recipe(
    moving: Trajectories, joint_map: JointMap | None, never: tuple[int, ...], markers: bool | None
) -> ChosenMap:
    """Choose a joint map, else names, else tree shape, else a part; points that are never seen do not count."""
    names = names_of_seen(moving.names, never)
    if joint_map is not None:
        recipe = recipe_from_joint_map(joint_map, names)
        return ChosenMap(recipe, body_points(recipe, spread_frames(moving.positions)))
    _, *others = _group_people(moving).values() or ((),)  # keep their places but lose their names
    chosen = choose_map(moving, (*never, *chain.from_iterable(others)), markers)
    if chosen is None:
        unseen = tuple(dict.fromkeys(moving.names[index] for index in never))
        raise JointMappingError(_problem(match_names(names), moving, unseen), moving.names)
    return chosen


def _group_people(moving: Trajectories) -> dict[str, tuple[int, ...]]:
    """The points of several people by owner, of points that no reader has taken apart."""
    return group_owners(moving.names) if moving.parents is None else {}


def _problem(match: NameMatch | None, moving: Trajectories, never: tuple[str, ...]) -> Message:
    if set(never) == set(moving.names) and np.isnan(moving.positions).any(axis=2).all():
        return Message("canonical.never_seen")
    if moving.parents is None and (
        clusters := find_clusters(moving.replace(positions=spread_frames(moving.positions)))
    ):
        return Message("canonical.clusters", n=len(clusters), names=clusters)
    unseen = Message("canonical.unseen", names=never) if never else Message("canonical.nothing")
    if match is not None and len(match.missing) <= 8:
        return Message("canonical.missing_joints", table=match.table, missing=match.missing, unseen=unseen)
    tree = Message("canonical.no_tree" if moving.parents is None else "canonical.other_tree")
    return Message("canonical.unknown_names", tree=tree, unseen=unseen)


def _finish(moving: Trajectories, chosen: ChosenMap, points: FloatArray, unseen: BoolArray | None) -> CanonicalMotion:
    recipe, sample = chosen.recipe, spread_frames(points)
    no_hands, no_toes = _coincident_tips(sample)
    if no_hands:
        _make_hands(points)
    missing = (
        (no_hands, ("left_hand", "right_hand")),
        (no_toes or not recipe.has_toes, ("left_toe", "right_toe")),
    )
    derived = (
        *recipe.derived,
        *(
            tip
            for gone, tips in missing
            if gone
            for tip in tips
            if tip not in recipe.derived and tip not in recipe.absent
        ),
    )
    height, height_source = _measure_height(recipe, sample, moving.rest_positions)
    sides = compare_sides(sample)
    warnings = [] if moving.provenance is None else list(moving.provenance.notes)
    if not 0.3 <= height <= 3.0:
        warnings.append(Message("canonical.no_person", height=height))
    if not chosen.is_person:
        warnings.append(Message("canonical.not_a_person", table=recipe.table))
    if people := tuple(_group_people(moving)):
        warnings.append(Message("canonical.several", first=people[0], others=people[1:]))
    if chosen.is_odd:
        warnings.append(Message("canonical.odd_proportions", table=recipe.table))
    if recipe.absent:
        warnings.append(Message("canonical.part", there=_limbs_there(recipe), absent=recipe.absent))
    if recipe.table == "tree shape":
        warnings.append(Message("canonical.by_shape_unclear" if sides == "unclear" else "canonical.by_shape"))
    elif sides == "unclear":
        warnings.append(Message("canonical.sides_unclear"))
    elif sides == "disagree":
        points[..., 2] *= -1.0
        warnings.append(Message("canonical.mirrored"))
    if "left_toe" in derived or "right_toe" in derived:
        _make_toes(points)
        warnings.append(Message("canonical.made_toes"))
    leaps = find_leaps(points, moving.frame_rate)
    if leaps.any():
        frames = np.flatnonzero(leaps.any(axis=1))
        joints = tuple(joint for joint, index in J.items() if leaps[frames[0], index])
        warnings.append(Message("canonical.leaps", n=len(frames), joints=joints, frame=int(frames[0])))
    if recipe.estimated:
        warnings.append(Message("canonical.skin_markers", joints=recipe.estimated))
    sources = {joint: names for joint, names in _named_sources(recipe, moving.names) if joint not in derived}
    mapping = JointMapping(recipe.table, sources, derived, sides, recipe.absent, chosen.markers)
    points.flags.writeable = False
    return CanonicalMotion(points, moving.frame_rate, height, height_source, mapping, tuple(warnings), unseen)


_LIMBS = {
    "trunk": ("pelvis", "neck"),
    **{f"{side}_arm": tuple(f"{side}_{one}" for one in ("shoulder", "elbow", "wrist")) for side in ("left", "right")},
    **{f"{side}_leg": tuple(f"{side}_{one}" for one in ("hip", "knee", "ankle")) for side in ("left", "right")},
}


def _limbs_there(recipe: Recipe) -> tuple[str, ...]:
    """Names of the trunk, arms and legs that are complete."""
    return tuple(limb for limb, joints in _LIMBS.items() if not any(joint in recipe.absent for joint in joints))


@lru_cache(maxsize=256)
def _named_sources(recipe: Recipe, names: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple((joint, tuple(names[i] for i in indices)) for joint, indices in recipe.sources.items())


def _coincident_tips(sample: FloatArray, degenerate: float = 0.05) -> tuple[bool, bool]:
    """Whether hands, and whether toes, lie on their joints in all frames: end sites of no length.

    ``degenerate`` : share of the forearm or shank up to which a hand or toe lies on its joint.
    """
    lengths = np.abs(_TIPS_AND_BONES @ sample).sum(axis=2)
    flags = (lengths[:, :4] <= degenerate * lengths[:, 4:]).all(axis=0)
    return bool(flags[0] or flags[1]), bool(flags[2] or flags[3])


def _make_hands(points: FloatArray) -> None:
    for side in ("left", "right"):
        wrist = points[:, J[f"{side}_wrist"]]
        points[:, J[f"{side}_hand"]] = wrist + HAND_REACH * (wrist - points[:, J[f"{side}_elbow"]])


def _make_toes(
    points: FloatArray, per_shank: float = 0.35, share_ahead: float = 0.9165, share_down: float = 0.4
) -> None:
    """Put toes before the ankles: to the front of the body and down along the shank's fall.

    Parameters
    ----------
    per_shank : length of the foot, ankle to toe, as a share of the shank.
    share_ahead, share_down : a standing foot slopes: shares of its length.
    """
    forward = compute_forward(points)
    if np.isnan(forward).all():
        forward[:] = (0.0, 0.0, 1.0)
    forward = fill_gaps(forward[:, None])[:, 0]
    forward[np.isnan(forward).any(axis=1)] = (0.0, 0.0, 1.0)
    for side in ("left", "right"):
        ankle = points[:, J[f"{side}_ankle"]]
        shank = ankle - points[:, J[f"{side}_knee"]]
        squared = (shank * shank).sum(axis=1, keepdims=True) + 1e-300
        ahead = forward - shank * (forward * shank).sum(axis=1, keepdims=True) / squared
        ahead *= np.sqrt(squared) / (np.linalg.norm(ahead, axis=1, keepdims=True) + 1e-12)
        points[:, J[f"{side}_toe"]] = ankle + per_shank * (share_ahead * ahead + share_down * shank)


def _measure_height(recipe: Recipe, sample: FloatArray, rest: FloatArray | None) -> tuple[float, str]:
    chain = chain_height(sample)
    if recipe.absent:
        part = stature_of_parts(sample) / STATURE_PER_HEIGHT
        if not part > 0:
            raise JointMappingError("canonical.no_height")
        return part, "parts"
    if not chain > 0:
        raise JointMappingError("canonical.no_height")
    if not chain < 1e9:
        raise JointMappingError("canonical.no_measure")
    upright = measure_rest(recipe, rest)
    if upright is not None and upright.fits(chain):
        return upright.height, "rest pose"
    return chain, "bone chain"


_MIRRORED = np.array(MIRRORED_JOINTS)


class _Posed(Protocol):
    """A dataclass with canonical joints over time: a canonical motion, a labelled clip."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def positions(self) -> FloatArray: ...


_Some = TypeVar("_Some", bound=_Posed)


def check_positions(positions: ArrayLike) -> FloatArray:
    """Return canonical positions (T, 20, 3) as numbers; NaN stays.

    Raises
    ------
    InvalidMotionError : no frame, another shape, or infinite positions.
    """
    points = np.asarray(positions, np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(CANONICAL_JOINTS), 3):
        raise InvalidMotionError("postures.motion_shape", shape=points.shape)
    if len(points) == 0:
        raise InvalidMotionError("postures.no_position")
    if np.isinf(points).any():
        raise InvalidMotionError("postures.infinite")
    return points


def mirror_positions(positions: ArrayLike) -> FloatArray:
    """Mirror canonical positions, in a new array.

    Parameters
    ----------
    positions : (..., 20, 3), right-handed, Y up, any unit, order of ``CANONICAL_JOINTS``; NaN stays NaN.

    Raises
    ------
    InvalidMotionError : another shape.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim < 2 or points.shape[-2:] != (len(CANONICAL_JOINTS), 3):
        raise InvalidMotionError("canonical.shape", shape=points.shape)
    mirrored = points[..., _MIRRORED, :]
    # 0 - x and not -x: a joint at 0 must not come back as -0, which is other bytes and another content hash.
    mirrored[..., 0] = 0.0 - mirrored[..., 0]
    return mirrored


def mirror_canonical(motion: _Some) -> _Some:
    """Mirror a motion of canonical joints.

    For a ``CanonicalMotion``, unseen joints and the sources of joints change sides too.

    Parameters
    ----------
    motion : a ``CanonicalMotion``, or another frozen dataclass with ``positions`` (T, 20, 3) m, such as a labelled
        clip; its other fields (frame rate, height, category) are kept.

    Raises
    ------
    InvalidMotionError : positions of another shape.
    """
    positions = mirror_positions(motion.positions)
    positions.flags.writeable = False
    changed: dict[str, Any] = {"positions": positions}
    if isinstance(motion, CanonicalMotion):
        changed["mapping"] = _mirror_mapping(motion.mapping)
        changed["missing"] = None if motion.missing is None else motion.missing[:, _MIRRORED]
    return dataclasses.replace(motion, **changed)


def _mirror_mapping(mapping: JointMapping) -> JointMapping:
    names = {joint: CANONICAL_JOINTS[other] for joint, other in zip(CANONICAL_JOINTS, MIRRORED_JOINTS, strict=True)}
    sources = {joint: mapping.sources[names[joint]] for joint in names if names[joint] in mapping.sources}
    derived, absent = (tuple(names[joint] for joint in some) for some in (mapping.derived, mapping.absent))
    return dataclasses.replace(mapping, sources=sources, derived=derived, absent=absent)
