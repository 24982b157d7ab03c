"""What the shape of a body tells: its height, which way is up, which side is left.

Everything works on canonical points (T, 20, 3) in the order of `CANONICAL_JOINTS`, in any unit; NaN where a
joint was not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe, named_recipe
from dousa.motion.canonical.tree_shape import shape_recipe
from dousa.motion.types import Trajectories

_AXES = ("x", "y", "z")

# The bone chain of the paper's body height: from head to toe, both legs counted half; then pelvis to the
# middle of the hips.
_LEG = (("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"))
_CHAIN = (
    ("head", "neck"),
    ("neck", "spine"),
    ("spine", "pelvis"),
    *((f"{side}_{upper}", f"{side}_{lower}") for upper, lower in _LEG for side in ("left", "right")),
)
_BONES = np.zeros((len(_CHAIN) + 1, len(J)))

for _bone, (_a, _b) in enumerate(_CHAIN):
    _BONES[_bone, [J[_a], J[_b]]] = 1.0, -1.0

_BONES[-1, [J["pelvis"], J["left_hip"], J["right_hip"]]] = 1.0, -0.5, -0.5

# A standing body is shorter than its bones end to end: the spine is curved, the legs are apart. Measured on the
# upright rest poses of HDM05: 0.957 to 0.976.
_POSTURE = 0.967

# A standing foot slopes: the ankle is higher than the toe joint by this share of their distance.
_FOOT_SLOPE = 0.4
_SHARE = _POSTURE * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 0.5 * _FOOT_SLOPE, 0.5 * _FOOT_SLOPE, 1.0])
_STATURE_PER_HEIGHT = 1.1  # the crown of the head and the sole of the foot lie beyond the joints
_MAX_REST_MISMATCH = 0.1  # a rest pose whose bones are longer or shorter than the moving ones is not believed
_UPRIGHT = 0.9  # cosine; a rest pose with trunk and legs this well along an axis is upright

_ALIGNED = 0.8  # cosine between body axis and a coordinate axis
_NEARLY_ALL = 0.9  # of the frames
_FLOOR = 0.15  # of the body height: how near to zero the floor must be
_JUMP = 0.5  # of the body height: how high above it the feet may fly
_CENTRED = 0.02  # of the body height: a pelvis that stays this near to zero was put there
_FLAT = 0.4  # of the body height: a body that lies is no thicker
_BELOW = 0.03  # of the body height: nothing of it is deeper below the floor


def find_recipe(names: tuple[str, ...], parents: ArrayLike | None, positions: FloatArray) -> Recipe | None:
    """The canonical mapping by names, then by the shape of the tree; None if neither knows."""
    recipe, _ = named_recipe(names)
    if recipe is None and parents is not None:
        recipe = shape_recipe(parents, positions)
    return recipe


def chain_height(points: FloatArray) -> float:
    """Height of the body along its bones, median over frames: head-neck-spine-pelvis-hip-knee-ankle-toe.

    Parameters
    ----------
    points : (T, 20, 3) canonical points, any unit.

    Returns
    -------
    Height in that unit, as eq. 1 would measure it on the upright body; NaN if a joint is missing in all
    frames.
    """
    bones = _BONES @ points
    return _median(np.sqrt(np.einsum("tjk,tjk->tj", bones, bones)) @ _SHARE)


def _median(values: FloatArray) -> float:
    middle = float(np.median(values))
    if not np.isnan(middle):
        return middle
    seen = values[~np.isnan(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


@dataclass(frozen=True, slots=True)
class RestPose:
    """What an upright rest pose tells.

    Parameters
    ----------
    height : eq. 1 of Hamada et al.: max(Y) - min(Y) over the joints, Y being the axis the body stands along.
    axis : that axis, 0 to 2.
    chain : `chain_height` of the rest pose.
    """

    height: float
    axis: int
    chain: float

    def fits(self, chain: float) -> bool:
        """Whether the moving body has these bones: files may replace the offsets frame by frame."""
        return abs(self.chain - chain) <= _MAX_REST_MISMATCH * chain


def measure_rest(recipe: Recipe, rest_positions: FloatArray | None) -> RestPose | None:
    """Measure a rest pose, once per skeleton.

    Parameters
    ----------
    recipe : canonical mapping of the skeleton.
    rest_positions : (J, 3) rest pose in any unit and axes, None if unknown.

    Returns
    -------
    None unless the pose is upright: trunk and both legs along one axis.
    """
    return None if rest_positions is None else _measure_rest(recipe, rest_positions.tobytes())


@lru_cache(maxsize=256)
def _measure_rest(recipe: Recipe, rest_bytes: bytes) -> RestPose | None:
    rest = body_points(recipe, np.frombuffer(rest_bytes).reshape(1, -1, 3))
    pose = rest[0]
    trunk = pose[J["neck"]] - pose[J["pelvis"]]
    legs = [pose[J[f"{side}_hip"]] - pose[J[f"{side}_ankle"]] for side in ("left", "right")]
    limbs = np.stack([trunk, *legs])
    axis = int(np.argmax(np.abs(trunk)))
    along = limbs[:, axis] * np.sign(trunk[axis])
    if not (along > _UPRIGHT * np.sqrt((limbs * limbs).sum(axis=1))).all():
        return None
    return RestPose(float(np.ptp(pose[:, axis])), axis, chain_height(rest))


def estimate_stature(sample: Trajectories, points: FloatArray | None) -> float:
    """Rough stature of the person in the unit of the sample, NaN if nothing tells it.

    Parameters
    ----------
    sample : some frames.
    points : their canonical points; None if the joints could not be told apart: then the extent of all points
        has to do.
    """
    if points is not None:
        height = chain_height(points)
        if height > 0:
            return _STATURE_PER_HEIGHT * height
    seen = sample.positions[~np.isnan(sample.positions).any(axis=(1, 2))]
    return float(np.median(np.ptp(seen, axis=1).max(axis=1))) if len(seen) else float("nan")


def body_points(recipe: Recipe, positions: FloatArray) -> FloatArray:
    """Canonical points (T, 20, 3) in the unit of the positions, hips made from pelvis markers where need be."""
    points = recipe.apply(positions)
    if recipe.pelvis_markers:
        left, right, sacrum = (positions[:, list(indices)].mean(axis=1) for indices in recipe.pelvis_markers)
        knees = 0.5 * (points[:, J["left_knee"]] + points[:, J["right_knee"]])
        hips = hips_from_markers(left, right, sacrum, knees)
        points[:, [J["left_hip"], J["right_hip"]]] = hips
        points[:, J["pelvis"]] = hips.mean(axis=1)
    return points


def hips_from_markers(
    left_asis: FloatArray, right_asis: FloatArray, sacrum: FloatArray, knees: FloatArray
) -> FloatArray:
    """Hip joint centres (T, 2, 3), left and right, from markers on the pelvis.

    Bell, Brand, Pedersen, "Prediction of hip joint centre location from external landmarks", Human Movement
    Science 8 (1989): from the middle of the front spines (ASIS) 36 % of their distance to the side, 19 % back and
    30 % down, in the plane that the sacrum (or the middle of the PSIS) spans with them.

    Parameters
    ----------
    left_asis, right_asis, sacrum : (T, 3), any unit.
    knees : (T, 3) middle of the knees; tells which side of the plane is down, whatever the handedness.
    """
    middle = 0.5 * (left_asis + right_asis)
    lateral = left_asis - right_asis
    width = np.linalg.norm(lateral, axis=-1, keepdims=True)
    lateral = lateral / width
    back = sacrum - middle
    back = back - (back * lateral).sum(axis=-1, keepdims=True) * lateral
    back = back / np.linalg.norm(back, axis=-1, keepdims=True)
    down = np.cross(back, lateral)
    if np.nansum((knees - middle) * down) < 0:
        down = -down
    base = middle + width * (0.19 * back + 0.30 * down)
    return np.stack((base + 0.36 * width * lateral, base - 0.36 * width * lateral), axis=-2)


def find_upright_axis(
    sample: Trajectories, points: FloatArray | None, rest: RestPose | None, default_up: str | None
) -> str:
    """The axis that points up: the format's habit unless the body says otherwise in nearly all frames.

    A person may lie down, so a body along another axis is not enough unless the skeleton's rest pose stands along
    that axis too: the feet must also stay on a floor at zero along the new axis.

    Parameters
    ----------
    sample : some frames in the file's axes.
    points : their canonical points, None if the joints could not be told apart.
    rest : the upright rest pose if there is one.
    default_up : the habit; None lets the body decide between y and z (y if it does not).
    """
    prior = default_up or "y"
    if points is None:
        return _up_without_joints(sample) if default_up is None else prior
    body = points[:, J["head"]] - 0.5 * (points[:, J["left_ankle"]] + points[:, J["right_ankle"]])
    body = body[~np.isnan(body[:, 0] + body[:, 1] + body[:, 2])]
    if not len(body):
        return prior
    cosines = body / np.sqrt((body * body).sum(axis=1, keepdims=True) + 1e-300)
    column, sign = _AXES.index(prior[-1]), -1.0 if prior.startswith("-") else 1.0
    aligned = np.abs(cosines) > _ALIGNED
    if np.count_nonzero(aligned[:, column] & (sign * cosines[:, column] > 0)) > (1 - _NEARLY_ALL) * len(body):
        return prior
    name = _common_axis(cosines)
    if default_up is None:
        if name is not None:
            return _floor_axis(points, name) or name
        return "z" if abs(cosines[:, 2].mean()) > abs(cosines[:, 1].mean()) else "y"
    return prior if name is None or _lies_down(sample, points, rest, prior, name) else name


def _common_axis(cosines: FloatArray) -> str | None:
    """The axis that bodies of these direction cosines stand along in nearly all frames."""
    mean = cosines.mean(axis=0)
    column = int(np.argmax(np.abs(mean)))
    sign = np.sign(mean[column])
    if np.mean(sign * cosines[:, column] > _ALIGNED) < _NEARLY_ALL:
        return None
    return ("-" if sign < 0 else "") + _AXES[column]


def _lies_down(sample: Trajectories, points: FloatArray, rest: RestPose | None, prior: str, name: str) -> bool:
    """Whether a body along an unusual axis may rather be a person who lies: no sign of a floor below the feet."""
    height = chain_height(points)
    stands = _AXES[rest.axis] if rest is not None and rest.fits(height) else None
    # A rest pose that stands along this axis is sign enough, but for x, which is nobody's up axis: rest poses along it
    # (LAFAN1, Bandai-Namco) are a habit of drawing bones. Points without a skeleton may be in a camera's axes, y down.
    if stands == name[-1] != prior[-1] and name[-1] != "x":
        return False
    centred = np.abs(points[:, J["pelvis"]]).max() < _CENTRED * height
    if sample.rest_positions is None and (centred or name[-1] == prior[-1]):
        return False
    return not _has_floor(points, name, height)


def _has_floor(points: FloatArray, name: str, height: float) -> bool:
    """Whether the body stays on a floor at zero along an axis; NaN is no evidence."""
    along = points[..., _AXES.index(name[-1])] * (-1.0 if name.startswith("-") else 1.0)
    lowest = along.min(axis=1)
    return bool(abs(lowest.min()) < _FLOOR * height and lowest.max() < _JUMP * height)


def _floor_axis(points: FloatArray, name: str) -> str | None:
    """The axis, z or y, across whose floor a body along another axis lies flat; None if it rather stands."""
    height = chain_height(points)
    for axis in ("z", "y"):
        if axis == name[-1] or _has_floor(points, name, height) or not _has_floor(points, axis, height):
            continue
        along = points[..., _AXES.index(axis)]
        if along.min() > -_BELOW * height and np.ptp(along, axis=1).max() < _FLAT * height:
            return axis
    return None


def _up_without_joints(sample: Trajectories) -> str:
    """y or z, whichever the cloud of points is more extended along."""
    seen = sample.positions[~np.isnan(sample.positions).any(axis=(1, 2))]
    if not len(seen):
        return "y"
    extent = np.median(np.ptp(seen, axis=1), axis=0)
    return "z" if extent[2] > extent[1] else "y"
