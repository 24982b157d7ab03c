"""The standing pose, and inverse kinematics to given places of the joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names, step_poses
from dousa.motion import rotations as rot
from dousa.motion.canonical.joints import CANONICAL_JOINTS


def find_bones(body: BodyModel, rows: IndexArray) -> IndexArray:
    """Return pairs (B, 2) of places in ``rows`` whose direction determines the orientation of a part.

    A part with one point attached takes the vector to it from its joint; one with several takes those from right to
    left, because bodies differ in the joints of pelvis and chest.
    """
    owners = np.concatenate((body.parents, body.tip_parts))
    points = point_names(body)
    place = {int(row): index for index, row in enumerate(rows)}
    pairs: list[tuple[int, int]] = []
    for part in range(body.n_parts):
        hanging = [place[int(row)] for row in np.flatnonzero(owners == part) if int(row) in place]
        if (owners == part).sum() > 1:
            names = {points[int(rows[index])]: index for index in hanging}
            pairs += [
                (names["right_" + name[5:]], index)
                for name, index in names.items()
                if name.startswith("left_") and "right_" + name[5:] in names
            ]
        elif hanging and part in place:
            pairs.append((place[part], hanging[0]))
    return np.array(pairs, np.intp).reshape(-1, 2)


def turn_onto(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) that turns directions (N, 3) best onto others (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def minimise(
    state: Any,
    evaluate: Callable[[Any], tuple[float, Any]],
    linearise: Callable[[Any, Any], Callable[[float], Any]],
    *,
    steps: int,
    settled: float,
    damping: float,
    most_damping: float,
) -> tuple[Any, Any]:
    """Minimise a cost by Levenberg and Marquardt's method; return the state and what `evaluate` found there.

    Parameters
    ----------
    state : to begin with.
    evaluate : a state -> its cost, and what the next step needs of it.
    linearise : a state, and that -> a function that takes a damping to the next state.
    steps : at most.
    settled : the end, once a step gains less than this share of the cost.
    damping, most_damping : at the beginning, and beyond which no step is taken.
    """
    cost, found = evaluate(state)
    for _ in range(steps):
        move = linearise(state, found)
        while damping < most_damping:
            tried = move(damping)
            tried_cost, tried_found = evaluate(tried)
            if tried_cost < cost:
                break
            damping *= 5.0
        else:
            break
        gained = cost - tried_cost
        state, cost, found = tried, tried_cost, tried_found
        damping = max(damping / 8.0, 1e-6)
        if gained <= settled * abs(cost):
            break
    return state, found


def solve_pose(
    body: BodyModel, places: FloatArray, rows: IndexArray, start: FloatArray, *, difference: float = 1e-6
) -> tuple[FloatArray, float]:
    """Return the pose (7 + A,) near ``start`` whose points ``rows`` fit ``places`` (N, 3) best, and its cost.

    Slopes are taken over ``difference`` m or rad.
    """
    compute = _make_residuals(body, places, rows, start)

    def evaluate(pose: FloatArray) -> tuple[float, FloatArray]:
        residuals = compute(pose[None])[0]
        return float(residuals @ residuals), residuals

    def linearise(pose: FloatArray, residuals: FloatArray) -> Callable[[float], FloatArray]:
        steps = np.eye(6 + body.n_angles) * difference
        slope = (compute(step_poses(pose[None].repeat(len(steps), axis=0), steps)) - residuals).T / difference
        square, gradient = slope.T @ slope, slope.T @ residuals
        scale = np.diag(np.diag(square) + 1e-6)

        def move(damping: float) -> FloatArray:
            step = np.linalg.solve(square + damping * scale, -gradient)
            tried: FloatArray = step_poses(pose[None], np.asarray(step[None], np.float64))[0]
            return tried

        return move

    pose, residuals = minimise(
        start.copy(), evaluate, linearise, steps=60, settled=1e-7, damping=1e-3, most_damping=1e6
    )
    return pose, float(residuals @ residuals)


def _make_residuals(
    body: BodyModel,
    places: FloatArray,
    rows: IndexArray,
    start: FloatArray,
    *,
    place: float = 0.5,
    direction: float = 0.3,
    limit: float = 0.5,
    neutral: float = 0.003,
    short: float = 0.02,
) -> Callable[[FloatArray], FloatArray]:
    """Return the function from poses (N, 7 + A) to their residuals (N, R), for least squares.

    A metre off a joint's place costs ``place``. Per metre of stature, a radian off a limb's direction costs
    ``direction``, one beyond a limit ``limit``, and one off the start ``neutral``, for undetermined angles. A bone of
    less than ``short`` statures has no direction.
    """
    bones, stature = find_bones(body, rows), body.stature
    wanted = places[bones[:, 1]] - places[bones[:, 0]]
    lengths = np.linalg.norm(wanted, axis=1)
    long = lengths > short * stature
    bones, wanted = bones[long], wanted[long] / lengths[long, None]
    least, greatest = body.angle_limits.T

    def evaluate(poses: FloatArray) -> FloatArray:
        points = compute_points(body, poses)[:, rows]
        ways = points[:, bones[:, 1]] - points[:, bones[:, 0]]
        ways /= np.linalg.norm(ways, axis=2, keepdims=True) + 1e-12
        angles = poses[:, 7:]
        parts = (
            place * (points - places),
            direction * stature * (ways - wanted),
            limit * stature * (angles - np.clip(angles, least, greatest)),
            neutral * stature * (angles - start[7:]),
        )
        return np.concatenate([part.reshape(len(poses), -1) for part in parts], axis=1)

    return evaluate


def compute_angles(body: BodyModel, part: int, rotation: FloatArray) -> FloatArray:
    """Return joint angles (n,) rad of one part nearest to a rotation in its parent's axes, within the limits.

    Three axes reach every rotation; with fewer the rest is dropped.

    Parameters
    ----------
    body : any tree of parts.
    part : index of a part with n axes.
    rotation : (4,) unit quaternion, the part's axes in its parent's, rest rotation included.
    """
    count, axes = int(body.n_axes[part]), body.axes[part]
    if count == 0:
        return np.zeros(0)
    moved = rot.multiply(rot.conjugate(body.rest[part]), rotation)
    if count == 2:
        frame = np.stack((axes[0], axes[1], rot.cross(axes[0], axes[1])), axis=1)
        angles = rot.to_euler(rot.from_matrix(frame.T @ rot.to_matrix(moved) @ frame), "XY")
    else:
        twist = 2.0 * np.arctan2(moved[1:] @ axes[count - 1], moved[0])
        angles = np.array([(twist + np.pi) % (2.0 * np.pi) - np.pi])
        if count == 3:
            swing = rot.multiply(moved, rot.from_axis_angle(-angles[0] * axes[2]))
            angles = np.concatenate((axes[:2] @ rot.to_axis_angle(swing), angles))
    return np.clip(angles, body.limits[part, :count, 0], body.limits[part, :count, 1])


def standing_state(body: BodyModel, arms_out: float = 0.14) -> FloatArray:
    """Return the upright pose (7 + A,), facing +Z, on the floor y = 0, the root above the origin, within the limits.

    A person (joints ``left_shoulder`` and ``right_shoulder``) has all axes parallel to the world's and the arms
    ``arms_out`` rad off the trunk, as in clothes; other bodies have angles of zero.
    """
    pose = np.zeros(7 + body.n_angles)
    pose[3] = 1.0
    person = {"left_shoulder", "right_shoulder"} <= set(body.joints)
    for part, start in enumerate(body.angle_starts[:-1]):
        count = int(body.n_axes[part])
        if person:
            out = {"left_shoulder": arms_out, "right_shoulder": -arms_out}.get(body.joints[part], 0.0)
            hanging = rot.from_axis_angle(np.array([0.0, 0.0, out]))
            pose[7 + start : 7 + start + count] = compute_angles(body, part, hanging)
        else:
            pose[7 + start : 7 + start + count] = np.clip(0.0, *body.limits[part, :count].T)
    rotations, positions = place_parts(body, pose)
    owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
    centres = positions[owner] + np.einsum("sij,sj->si", rotations[owner], body.spheres[:, :3])
    pose[1] = -(centres[:, 1] - body.spheres[:, 3]).min()
    return pose


def fit_pose(
    body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike], start: ArrayLike | None = None
) -> tuple[FloatArray, float]:
    """Fit the pose (7 + A,) nearest to given places of the joints, within the limits (inverse kinematics).

    Also returns the residual (m), root of the mean squared distance from joint to place. Levenberg-Marquardt over
    places, directions of limbs, and a penalty beyond the limits, the root turned first onto trunk and hips. Directions
    outweigh places, so that another person's bones bend no joint.

    Parameters
    ----------
    body : any tree of parts with named joints and tips.
    positions : (20, 3) m in the order of `CANONICAL_JOINTS`, or name -> (3,) m; NaN where unknown. Other names are
        ignored; the bones may be those of another person.
    start : pose (7 + A,) to begin with and to stay near where undetermined; by default standing.

    Raises
    ------
    BodyModelError : fewer than three joints of the body are given, or all lie in one line or point; a pose or
        positions of another shape.
    """
    places, rows = _match_points(body, positions)
    if start is None:
        starts = _first_guesses(body, places, rows)
    else:
        starts = [np.array(start, np.float64)]
        if starts[0].shape != (7 + body.n_angles,):
            raise BodyModelError("pose.start", expected=7 + body.n_angles, found=str(starts[0].shape))
    pose = min((solve_pose(body, places, rows, first) for first in starts), key=lambda found: found[1])[0]
    pose[7:] = np.clip(pose[7:], *body.angle_limits.T)
    off = compute_points(body, pose)[rows] - places
    return pose, float(np.sqrt((off * off).sum(axis=1).mean()))


def lead_pose(body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike]) -> FloatArray:
    """Return a pose (7 + A,) near to given places of the joints, faster and rougher than `fit_pose`.

    The root is laid onto the trunk and each limb led along its bones, within the limits; arguments and errors are those
    of `fit_pose`.
    """
    pose = _first_guesses(body, *_match_points(body, positions))[0]
    pose[7:] = np.clip(pose[7:], *body.angle_limits.T)
    return pose


def fit_poses(
    body: BodyModel, positions: ArrayLike, names: Sequence[str] = CANONICAL_JOINTS, *, caught: float = 1.5
) -> tuple[FloatArray, FloatArray]:
    """Fit the poses (T, 7 + A) of a whole motion, each frame starting from the one before (inverse kinematics).

    Also returns residuals (T,) m. An undetermined frame keeps the pose of the one before, with a residual of NaN.

    Parameters
    ----------
    body : any tree of parts with named joints and tips.
    positions : (T, K, 3) m, NaN where unknown.
    names : (K,) of the joints.
    caught : times the least residual so far, beyond which a frame is fitted from the standing pose too.

    Raises
    ------
    BodyModelError : no frame determines a pose, or positions of another shape; see `fit_pose`.
    """
    array = np.asarray(positions, np.float64)
    if array.ndim != 3 or array.shape[1:] != (len(names), 3) or not len(array):
        raise BodyModelError("pose.places_over_time", joints=len(names), found=str(array.shape))
    poses = np.zeros((len(array), 7 + body.n_angles))
    residuals = np.full(len(array), np.nan)
    start, first, problem, usual = None, len(array), None, np.inf
    for t, frame in enumerate(array):
        places = dict(zip(names, frame, strict=True))
        try:
            found = fit_pose(body, places, start)
            # Caught in a wrong fold after a jump in time: start again.
            if start is not None and found[1] > caught * usual:
                found = min(found, fit_pose(body, places), key=lambda pair: pair[1])
        except BodyModelError as error:
            problem = error
        else:
            start, residuals[t] = found
            usual, first = min(usual, found[1]), min(first, t)
        if start is not None:
            poses[t] = start
    if start is None:
        assert problem is not None
        raise problem
    poses[:first] = poses[first]
    return poses, residuals


def _match_points(body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike]) -> tuple[FloatArray, IndexArray]:
    """Return known places (N, 3) and their points (N,) of the body."""
    if not isinstance(positions, Mapping):
        array = np.asarray(positions, np.float64)
        if array.shape != (len(CANONICAL_JOINTS), 3):
            raise BodyModelError("pose.places", joints=len(CANONICAL_JOINTS), found=str(array.shape))
        positions = dict(zip(CANONICAL_JOINTS, array, strict=True))
    row_of = {name: row for row, name in reversed(list(enumerate(point_names(body))))}
    found = [(row_of[name], np.asarray(place, np.float64)) for name, place in positions.items() if name in row_of]
    for row, place in found:
        if place.shape != (3,):
            raise BodyModelError("pose.place", joint=point_names(body)[row], found=str(place.shape))
    known = [(row, place) for row, place in found if np.isfinite(place).all()]
    places = np.array([place for _, place in known]).reshape(-1, 3)
    if _are_in_line(body, places):
        raise BodyModelError("pose.few_joints", found=len(known), joints=point_names(body))
    return places, np.array([row for row, _ in known])


def _are_in_line(body: BodyModel, points: FloatArray, *, flat: float = 0.01) -> bool:
    """Return whether points (N, 3) lie within ``flat`` statures of one line, and so determine no turn about it."""
    return len(points) < 3 or bool(np.linalg.svd(points - points.mean(axis=0))[1][1] < flat * body.stature)


def _first_guesses(body: BodyModel, places: FloatArray, rows: IndexArray) -> list[FloatArray]:
    """Return standing with the root moved onto the points, with every limb led along its bone and without."""
    pose = standing_state(body)
    points = compute_points(body, pose)[rows]
    owners = np.concatenate((body.parents, body.tip_parts))[rows]
    # The root and the parts with several children determine the body's front.
    is_core = np.bincount(body.parents[1:], minlength=body.n_parts) > 1
    is_core[0] = True
    core = (rows == 0) | is_core[owners]
    if _are_in_line(body, places[core]):
        core[:] = True
    here, there = points[core].mean(axis=0), places[core].mean(axis=0)
    turned = turn_onto(points[core] - here, places[core] - there)
    pose[3:7] = rot.from_matrix(turned)
    pose[:3] = there + turned @ (pose[:3] - here)
    led = pose.copy()
    lead_limbs(body, led, places, rows)
    return [led, pose]


def lead_limbs(
    body: BodyModel, pose: FloatArray, places: FloatArray, rows: IndexArray, parts: IndexArray | None = None
) -> None:
    """Swing each part, or only ``parts``, with one bone onto its direction from the root outwards, in place."""
    place_of = {int(row): places[index] for index, row in enumerate(rows)}
    owners = np.concatenate((body.parents, body.tip_parts))
    bones = {int(rows[a]): int(rows[b]) for a, b in find_bones(body, rows) if owners[rows[b]] == rows[a]}
    offsets = np.concatenate((body.offsets, body.tip_offsets))
    for part, end in sorted(bones.items()):
        if part == 0 or (parts is not None and part not in parts):
            continue
        rotations, _ = place_parts(body, pose)
        above = rotations[body.parents[part]]
        wanted = above.T @ (place_of[end] - place_of[part])
        local = rot.from_matrix(above.T @ rotations[part])
        led = rot.multiply(rot.between(rot.rotate(local, offsets[end]), wanted), local)
        if body.n_axes[part] == 3 and end in bones:
            beyond = above.T @ (place_of[bones[end]] - place_of[end])
            led = _turn_hinge(body, part, end, led, beyond, offsets[bones[end]])
        first = 7 + body.angle_starts[part]
        pose[first : first + body.n_axes[part]] = compute_angles(body, part, led)


def _turn_hinge(
    body: BodyModel, part: int, child: int, led: FloatArray, beyond: FloatArray, own: FloatArray, straight: float = 0.1
) -> FloatArray:
    """Turn a part about itself so that the hinge below it folds towards the next bone.

    A bend whose sine is less than ``straight`` shows no way in which the hinge folds.
    """
    if body.n_axes[child] != 1:
        return led
    axis = body.axes[part, 2]
    folded = rot.multiply(body.rest[child], rot.from_axis_angle(body.limits[child, 0].mean() * body.axes[child, 0]))
    ways = np.stack((rot.rotate(folded, own), rot.rotate(rot.conjugate(led), beyond)))
    across = ways - (ways @ axis)[:, None] * axis
    if (np.linalg.norm(across, axis=1) < straight * np.linalg.norm(ways, axis=1)).any():
        return led
    twist = np.arctan2(axis @ rot.cross(across[0], across[1]), across[0] @ across[1])
    return rot.multiply(led, rot.from_axis_angle(twist * axis))
