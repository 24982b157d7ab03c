"""From any skeleton or marker set to the 20 canonical joints.

The mapping comes from a joint map if one is given, else from the names, else from the shape of the tree. Joints
that the file lacks are made from their neighbours and reported. Left and right are checked against the body's
front; names are never swapped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dousa.errors import JointMappingError
from dousa.motion._recipe import HAND_REACH, Recipe, named_recipe
from dousa.motion._types import FloatArray, Motion, Trajectories
from dousa.motion.geometry import body_points, chain_height, measure_rest
from dousa.motion.joint_map import JointMap, recipe_from_joint_map
from dousa.motion.joints import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.joints import JOINT_INDEX as J
from dousa.motion.naming import NameMatch
from dousa.motion.sides import compare_sides, compute_forward
from dousa.motion.tree_shape import shape_recipe

__all__ = ["CanonicalMotion", "JointMapping", "canonicalise"]

# m: heights over the joints that no person has, and that nothing has.
_SMALLEST, _TALLEST, _NO_BODY = 0.4, 3.0, 1e9
_MAX_FRAMES = 32  # evenly spread, for the height and the sides
_DEGENERATE = 0.05  # of the forearm or shank: a hand or toe this near to its parent is not one
_TOE_PER_SHANK = 0.35
_TOE_AHEAD, _TOE_DROP = 0.9165, 0.4  # a standing foot slopes: shares of its length ahead and down


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

_MIRRORED = (
    "left and right of the names disagree with the geometry of the body: the coordinates look left-handed, so the "
    "positions were mirrored (depth axis z negated); the names were kept"
)
_UNCLEAR = "the geometry of the body does not tell left from right; the names were trusted"
_BY_SHAPE = (
    "the joints were told by the shape of the tree, and left and right by the front of the body, not by names"
)
_BY_SHAPE_UNCLEAR = _BY_SHAPE + "; which side is left is not clear, a joint map would settle it"
_SKIN_MARKERS = "shoulders, elbows, wrists, knees and ankles are markers on the skin, not joint centres"
_NO_PERSON = "no person is as small or as tall as this; is the unit right (--unit)?"
_MADE_TOES = "there are no toes: they were put in front of the ankles"


@dataclass(frozen=True, slots=True)
class JointMapping:
    """Where the canonical joints of a motion come from.

    Parameters
    ----------
    table : name family such as ``"CMU/HDM05"``, or ``"tree shape"`` or ``"joint map"``.
    sources : canonical joint -> names in the file whose mean it is.
    derived : canonical joints that the file lacks and that were made from others.
    sides : whether left and right of the names are those of the body: ``"agree"``, ``"disagree"`` (then the
        positions were mirrored) or ``"unclear"``.
    """

    table: str
    sources: dict[str, tuple[str, ...]]
    derived: tuple[str, ...]
    sides: str


@dataclass(frozen=True, slots=True, eq=False)
class CanonicalMotion:
    """The 20 canonical joints of a motion over time.

    Parameters
    ----------
    positions : (T, 20, 3) m, world, Y up, right-handed, finite; order of `CANONICAL_JOINTS`.
    frame_rate : Hz.
    height : m, body height over the joints, eq. 1 of Hamada et al.
    height_source : ``"rest pose"`` if an upright one was there, else ``"bone chain"``.
    mapping : where the joints come from.
    warnings : what a person should know, in sentences.
    missing : (T, 20) True where a joint was not seen and its place was filled in; None if all were seen.
    """

    positions: FloatArray
    frame_rate: float
    height: float
    height_source: str
    mapping: JointMapping
    warnings: tuple[str, ...] = ()
    missing: NDArray[np.bool_] | None = None

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.positions)

    @property
    def duration(self) -> float:
        """Seconds from the first pose to the end of the last."""
        return self.n_frames / self.frame_rate

    def to_trajectories(self) -> Trajectories:
        """The same positions as trajectories with canonical names and parents."""
        return Trajectories(CANONICAL_JOINTS, self.positions, self.frame_rate, np.array(CANONICAL_PARENTS))


def canonicalise(motion: Motion | Trajectories, joint_map: JointMap | None = None) -> CanonicalMotion:
    """Map a motion of any skeleton or marker set to the canonical joints.

    Parameters
    ----------
    motion : motion or trajectories in m, Y up.
    joint_map : canonical joint -> name or names in the file, for what names and shape do not tell.

    Returns
    -------
    The canonical motion; gaps (NaN) are filled by interpolation, ends held, and marked in ``missing``.

    Raises
    ------
    JointMappingError : shoulders, elbows, wrists, hips, knees or ankles that cannot be found, or are never seen.
    """
    moving = _trajectories(motion)
    positions = moving.positions
    gaps = bool(np.isnan(positions.sum()))
    never = _never_seen(moving) if gaps else ()
    recipe = _choose_recipe(moving, joint_map, never)
    missing = None
    if gaps:
        missing = _find_missing(recipe, positions)
        positions = _fill(positions)
    points = body_points(recipe, positions)
    return _finish(moving, recipe, points, missing)


def _trajectories(motion: Motion | Trajectories) -> Trajectories:
    if isinstance(motion, Motion):
        from dousa.motion.kinematics import compute_trajectories

        return compute_trajectories(motion)
    return motion


def _never_seen(moving: Trajectories) -> tuple[str, ...]:
    unseen = np.isnan(moving.positions).any(axis=2).all(axis=0)
    return tuple(moving.names[i] for i in np.flatnonzero(unseen))


def _fill(positions: FloatArray) -> FloatArray:
    from dousa.motion.resampling import fill_gaps

    return fill_gaps(positions)


def _find_missing(recipe: Recipe, positions: FloatArray) -> NDArray[np.bool_]:
    """(T, 20) where what a joint is made from is not seen."""
    unseen: NDArray[np.bool_] = np.any(np.isnan(positions), axis=2)
    missing = unseen[:, recipe.gather]
    for row, indices, _ in recipe.blends:
        missing[:, row] = unseen[:, indices].any(axis=1)
    if recipe.pelvis_markers:
        markers = [index for indices in recipe.pelvis_markers for index in indices]
        hips: NDArray[np.bool_] = np.any(unseen[:, markers], axis=1)
        missing[:, [J["pelvis"], J["left_hip"], J["right_hip"]]] |= hips[:, None]
    return missing


def _choose_recipe(moving: Trajectories, joint_map: JointMap | None, never: tuple[str, ...]) -> Recipe:
    """Joint map, else names, else tree shape; points that are never seen do not count."""
    # An unseen point keeps its place but loses its name, so that no rule finds it.
    names = tuple("" if name in never else name for name in moving.names) if never else moving.names
    if joint_map is not None:
        return recipe_from_joint_map(joint_map, names)
    recipe, match = named_recipe(names)
    if recipe is not None:
        return recipe
    if moving.parents is not None and not never:
        recipe = shape_recipe(moving.parents, moving.positions)
        if recipe is not None:
            return recipe
    raise JointMappingError(_problem(match, moving, never), moving.names)


def _problem(match: NameMatch | None, moving: Trajectories, never: tuple[str, ...]) -> str:
    """What is missing and what to do about it."""
    if len(never) == len(moving.names):
        return "no frame tells where any joint is: a value that all of them need is always missing (nan)"
    if match is None or len(match.missing) > 8:
        problem = "the names of the joints are of no known family"
        if moving.parents is None:
            problem += ", and without a skeleton there is no tree whose shape could tell"
        else:
            problem += ", and the shape of the tree is not that of a whole body"
    else:
        problem = f"the names look like {match.table}, but there is no {', '.join(match.missing)}"
    if never:
        problem += f"; never seen in any frame: {', '.join(never)}"
    return problem + "; name the joints in a joint map (--joint-map FILE with lines 'left_elbow = name')"


def _finish(
    moving: Trajectories, recipe: Recipe, points: FloatArray, unseen: NDArray[np.bool_] | None
) -> CanonicalMotion:
    """Tips, height, sides, warnings."""
    sample = _spread(points)
    no_hands, no_toes = _coincident_tips(sample)
    if no_hands:
        _make_hands(points)
    missing = (
        (no_hands, ("left_hand", "right_hand")),
        (no_toes or not recipe.has_toes, ("left_toe", "right_toe")),
    )
    derived = (
        *recipe.derived,
        *(tip for gone, tips in missing if gone for tip in tips if tip not in recipe.derived),
    )
    height, height_source = _measure_height(recipe, sample, moving.rest_positions)
    sides = compare_sides(sample)
    warnings = []
    if not _SMALLEST <= height <= _TALLEST:
        warnings.append(_NO_PERSON)
    if recipe.table == "tree shape":
        warnings.append(_BY_SHAPE_UNCLEAR if sides == "unclear" else _BY_SHAPE)
    elif sides == "unclear":
        warnings.append(_UNCLEAR)
    elif sides == "disagree":
        points[..., 2] *= -1.0
        warnings.append(_MIRRORED)
    if "left_toe" in derived:
        _make_toes(points)
        warnings.append(_MADE_TOES)
    if recipe.pelvis_markers:
        warnings.append(_SKIN_MARKERS)
    sources = {joint: names for joint, names in _named_sources(recipe, moving.names) if joint not in derived}
    mapping = JointMapping(recipe.table, sources, derived, sides)
    points.flags.writeable = False
    return CanonicalMotion(points, moving.frame_rate, height, height_source, mapping, tuple(warnings), unseen)


@lru_cache(maxsize=256)
def _named_sources(recipe: Recipe, names: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple((joint, tuple(names[i] for i in indices)) for joint, indices in recipe.sources.items())


def _spread(points: FloatArray) -> FloatArray:
    if len(points) <= _MAX_FRAMES:
        return points
    return points[np.linspace(0, len(points) - 1, _MAX_FRAMES).round().astype(np.intp)]


def _coincident_tips(sample: FloatArray) -> tuple[bool, bool]:
    """Whether hands, and whether toes, lie on their joints in all frames: end sites of no length."""
    lengths = np.abs(_TIPS_AND_BONES @ sample).sum(axis=2)
    flags = (lengths[:, :4] <= _DEGENERATE * lengths[:, 4:]).all(axis=0)
    return bool(flags[0] or flags[1]), bool(flags[2] or flags[3])


def _make_hands(points: FloatArray) -> None:
    """Put hands beyond the wrists, in line with the forearms."""
    for side in ("left", "right"):
        wrist = points[:, J[f"{side}_wrist"]]
        points[:, J[f"{side}_hand"]] = wrist + HAND_REACH * (wrist - points[:, J[f"{side}_elbow"]])


def _make_toes(points: FloatArray) -> None:
    """Put toes before the ankles: to the front of the body and down along the shank's fall."""
    forward = compute_forward(points)
    forward = _fill(forward[:, None])[:, 0]
    forward[np.isnan(forward).any(axis=1)] = (0.0, 0.0, 1.0)
    for side in ("left", "right"):
        ankle = points[:, J[f"{side}_ankle"]]
        shank = ankle - points[:, J[f"{side}_knee"]]
        squared = (shank * shank).sum(axis=1, keepdims=True) + 1e-300
        ahead = forward - shank * (forward * shank).sum(axis=1, keepdims=True) / squared
        ahead *= np.sqrt(squared) / (np.linalg.norm(ahead, axis=1, keepdims=True) + 1e-12)
        points[:, J[f"{side}_toe"]] = ankle + _TOE_PER_SHANK * (_TOE_AHEAD * ahead + _TOE_DROP * shank)


def _measure_height(recipe: Recipe, sample: FloatArray, rest: FloatArray | None) -> tuple[float, str]:
    chain = chain_height(sample)
    if not chain > 0:
        raise JointMappingError("the body has no height: all its joints coincide")
    if not chain < _NO_BODY:
        raise JointMappingError("its joints lie beyond any measure; is the unit right (--unit)?")
    upright = measure_rest(recipe, rest)
    if upright is not None and upright.fits(chain):
        return upright.height, "rest pose"
    return chain, "bone chain"
