"""The search for the pose in one frame from its silhouettes alone, for the start and after a lost track.

Templates in all headings are laid onto the silhouettes; the best are refined by the tracker's sweeps without inertia,
each limb is tried as in every template, and poses with left and right exchanged are tried as well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray, Mask
from dousa.errors import BodyModelError, SilhouetteError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import lead_limbs, lead_pose, standing_state
from dousa.estimation.silhouettes.cleaning import is_nearly_full
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.estimation.tracking.outlines import (
    Outline,
    guess_place,
    measure_outline,
    move_onto,
    shrink_views,
    turn_about,
)
from dousa.estimation.tracking.search_setup import Frame, SearchSetup, compare_views, draw_views
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.messages import Message, Progress
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion import rotations as rot
from dousa.motion.canonical.joints import JOINT_INDEX, MIRRORED_JOINTS


def is_person(body: BodyModel) -> bool:
    """Return whether joints and tips have the canonical names."""
    return set(CANONICAL_JOINTS) <= set(point_names(body))


def list_templates(body: BodyModel, n_bodies: int = 8) -> FloatArray:
    """Return template poses (N, 7 + A) that face about +Z, cached for the last ``n_bodies`` bodies.

    A person: varied frames of the package's synthetic motions, and standing, arms to the sides, arms up, crouching and
    lying. Another body: at ease, and drawn at random within the limits.
    """
    arrays = (
        *(body.parents, body.offsets, body.rest, body.n_axes, body.axes, body.limits),
        *(body.tip_parts, body.tip_offsets, body.neutral),
    )
    key = (body.names, body.joints, body.tips, *(array.tobytes() for array in arrays))
    if key not in _made:
        if len(_made) >= n_bodies:
            _made.clear()
        poses = _person_poses(body) if is_person(body) else _random_poses(body)
        poses.flags.writeable = False
        _made[key] = poses
    return _made[key]


_made: dict[tuple[object, ...], FloatArray] = {}


def _person_poses(body: BodyModel) -> FloatArray:
    stature, natural = _natural_points()
    poses = [lead_pose(body, body.stature / stature * points) for points in natural]
    standing = standing_state(body)
    poses.append(standing)
    for height in (0.0, 0.9):
        poses.append(lead_pose(body, _raise_arms(body, standing, height)))
    for reach in (0.0, -0.9):
        poses.append(lead_pose(body, _crouch(body, standing, reach)))
    for axis in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        lying = standing.copy()
        lying[3:7] = rot.from_axis_angle(0.5 * np.pi * np.array(axis))
        poses.append(lying)
    return np.array(poses)


def _canonical_points(body: BodyModel, pose: FloatArray) -> FloatArray:
    names = point_names(body)
    return np.asarray(compute_points(body, pose)[[names.index(name) for name in CANONICAL_JOINTS]])


def _raise_arms(body: BodyModel, standing: FloatArray, height: float) -> FloatArray:
    """Return canonical points of standing with both arms stretched to the sides or, with ``height``, up."""
    points = _canonical_points(body, standing)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rows = [JOINT_INDEX[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "hand")]
        way = np.array([sign * np.sqrt(1.0 - height * height), height, 0.0])
        for above, below in pairwise(rows):
            length = np.linalg.norm(points[below] - points[above])
            points[below] = points[above] + max(float(length), 0.05) * way
    return np.asarray(points)


def _crouch(body: BodyModel, standing: FloatArray, reach: float, height: float = 0.14) -> FloatArray:
    """Return canonical points of crouching, knees apart, arms forward and, with ``reach`` < 0, down.

    The hips are ``height`` statures above the ankles.
    """
    points, place = _canonical_points(body, standing), JOINT_INDEX
    down = points[place["left_hip"], 1] - points[place["left_ankle"], 1] - height * body.stature
    legs = {place[side + joint] for side in ("left_", "right_") for joint in ("knee", "ankle", "toe")}
    above = [row for row in range(len(points)) if row not in legs]
    points[above] -= np.array([0.0, down, 0.1 * body.stature])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip, ankle = points[place[f"{side}_hip"]], points[place[f"{side}_ankle"]]
        thigh = 0.245 * body.stature
        points[place[f"{side}_knee"]] = hip + thigh * np.array([0.45 * sign, 0.25, 0.86])
        points[place[f"{side}_ankle"]] = ankle + np.array([0.05 * sign, 0.0, 0.0])
        way = np.array([0.0, reach, np.sqrt(1.0 - reach * reach)])
        rows = [place[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "hand")]
        for upper, lower in pairwise(rows):
            points[lower] = points[upper] + 0.12 * body.stature * way
    return np.asarray(points)


@lru_cache(maxsize=1)
def _natural_points(count: int = 56, rate: float = 3.0) -> tuple[float, FloatArray]:
    """Return stature (m) and canonical points (N, 20, 3) m of a person in everyday poses, at the origin, facing +Z.

    They are the ``count`` most different frames of the synthetic motions, looked at ``rate`` times a second.
    """
    from dousa.motion.synthetic.performers import CATEGORIES, Performer, make_motion

    performer = Performer()
    points = np.concatenate([canonicalise(make_motion(name, performer, 0, rate)).positions for name in CATEGORIES])
    points = np.concatenate((points, points[:, MIRRORED_JOINTS] * (-1.0, 1.0, 1.0)))
    across = points[:, JOINT_INDEX["left_hip"]] - points[:, JOINT_INDEX["right_hip"]]
    yaw = np.arctan2(-across[:, 2], across[:, 0])
    turned = rot.rotate(rot.from_axis_angle(np.stack((0 * yaw, -yaw, 0 * yaw), axis=-1))[:, None], points)
    turned -= turned[:, :1] * (1.0, 0.0, 1.0)
    return performer.stature, np.asarray(turned[_spread_out(turned, count)])


def _spread_out(points: FloatArray, count: int) -> IndexArray:
    """Return indices of frames by farthest-point sampling."""
    flat = points.reshape(len(points), -1)
    chosen = [int(np.argmin(((flat - flat.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = ((flat - flat[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(flat)):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((flat - flat[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)


def _random_poses(body: BodyModel, count: int = 48) -> FloatArray:
    """Draw ``count`` poses within the limits, the first half nearer to ease."""
    rng = np.random.default_rng(0)
    limits = body.angle_limits
    used = np.arange(3) < body.n_axes[:, None]
    poses = np.zeros((count, 7 + body.n_angles))
    poses[:, 3] = 1.0
    ease = np.clip(body.neutral[used], limits[:, 0], limits[:, 1])
    drawn = rng.uniform(limits[:, 0], limits[:, 1], (count, body.n_angles))
    share = np.linspace(0.0, 1.0, count)[:, None]
    poses[:, 7:] = ease + np.minimum(2.0 * share, 1.0) * (drawn - ease)
    return poses


def find_limbs(body: BodyModel) -> list[tuple[IndexArray, IndexArray]]:
    """Return for each unbranched end branch the pose-row indices of its angles, and its parts."""
    parents, starts = body.parents, body.angle_starts
    children = [np.flatnonzero(parents == part) for part in range(body.n_parts)]
    limbs = []
    for part in range(1, body.n_parts):
        if len(children[parents[part]]) < 2:
            continue
        chain, end = [part], part
        while len(children[end]) == 1:
            end = int(children[end][0])
            chain.append(end)
        if len(children[end]) == 0:
            angles = [np.arange(starts[link], starts[link + 1]) for link in chain]
            found = 7 + np.concatenate(angles)
            if len(found):
                limbs.append((found, np.array(chain)))
    return limbs


class LimbPair(NamedTuple):
    """Two limbs that may be taken for each other.

    Parameters
    ----------
    parts : of both.
    points, others : their joints and tips below the first one, and those of the other side.
    """

    parts: IndexArray
    points: IndexArray
    others: IndexArray


def find_pairs(body: BodyModel) -> list[LimbPair]:
    """Return the end branches whose first parts are called left and right of the same name."""
    chains = {body.names[parts[0]]: parts for _, parts in find_limbs(body)}
    pairs = []
    for name, left in chains.items():
        right = chains.get("right_" + name.removeprefix("left_"))
        if name.startswith("left_") and right is not None and len(left) == len(right):
            ends = [np.concatenate((chain[1:], body.n_parts + np.flatnonzero(np.isin(body.tip_parts, chain))))
                    for chain in (left, right)]  # fmt: skip
            parts = np.sort(np.concatenate((left, right)))
            pairs.append(LimbPair(parts, np.concatenate(ends), np.concatenate(ends[::-1])))
    return pairs


def exchange_pair(body: BodyModel, pose: FloatArray, pair: LimbPair) -> FloatArray:
    """Return the pose with each limb's end where that of the other side is, as far as limits allow."""
    points, other = compute_points(body, pose), pose.copy()
    points[pair.points] = points[pair.others]
    lead_limbs(body, other, points, np.arange(len(points)), pair.parts)
    other[7:] = np.clip(other[7:], *body.angle_limits.T)
    return other


def mirror_twins(body: BodyModel, pose: FloatArray, towards: FloatArray) -> list[FloatArray]:
    """Return two poses of a person with nearly the same silhouettes and left and right exchanged.

    The first has the joints in place with left and right names exchanged, so that the body faces the other way; the
    second has them mirrored along ``towards``, the unit vector (3,) of the view, the same to one distant camera.
    """
    points = _canonical_points(body, pose)
    swapped = points[list(MIRRORED_JOINTS)]
    depths = (swapped - points[0]) @ towards
    mirrored = swapped - 2.0 * depths[:, None] * towards
    return [lead_pose(body, _turn_feet(swapped)), lead_pose(body, mirrored)]


def _turn_feet(points: FloatArray) -> FloatArray:
    """Point the toes of a turned body the new way."""
    turned = points.copy()
    for side in ("left", "right"):
        ankle, toe = JOINT_INDEX[f"{side}_ankle"], JOINT_INDEX[f"{side}_toe"]
        turned[toe] = points[ankle] - (points[toe] - points[ankle]) * (1.0, -1.0, 1.0)
    return turned


Scored = tuple[float, FloatArray]


class StartSearch:
    """The search for a body in the silhouettes of one frame.

    Parameters
    ----------
    setup : body and cameras; of the settings, the stiffness counts.
    frame : the silhouettes as the setup packs them.
    outlines : (V,) box and centre of each silhouette, None if no person is seen; none where only near poses are tried.
    n_headings : in which templates are laid onto the silhouettes.
    n_kept : poses kept after the first, the second and every later step.
    apart : statures; poses whose joints are nearer than this in the mean are one.
    pool : threads that try poses side by side; the result does not depend on them.
    """

    def __init__(
        self, setup: SearchSetup, frame: Frame, outlines: Sequence[Outline | None] = (), *, n_headings: int = 16,
        n_kept: tuple[int, int, int] = (20, 8, 4), apart: float = 0.03, pool: Executor | None = None,
    ) -> None:  # fmt: skip
        self.n_headings, self.n_kept, self.apart = n_headings, n_kept, apart
        self.body, self.cameras = setup.body, setup.cameras
        self.frame, self.outlines = frame, outlines
        area = float(np.bitwise_count(frame.bits).sum()) / max(int(frame.seen.sum()), 1)
        usual, given = TrackerSettings(), setup.settings
        stiffness = max(given.stiffness, usual.stiffness)
        own = dataclasses.replace(usual, inertia=0.0, stiffness=stiffness)
        self.setup = SearchSetup(self.body, self.cameras, own, 30.0, area)
        self.map = map if pool is None else pool.map
        if outlines:
            self.rims = self.setup.find_rims(frame)
        self.limbs = find_limbs(self.body)

    def run(self, near: FloatArray | None, tell: Progress) -> list[Scored]:
        """Return a few refined poses, best first; ``near`` adds a pose to the templates."""
        first, second, last = self.n_kept
        what = Message("tracker.first_pose")
        tell(0, 5, what)
        found = self.keep([(self.score(pose), pose) for pose in self._list_candidates(near)], first)
        tell(1, 5, what)
        found = self.keep([self.refine(pose, (1.5, 1.0)) for _, pose in found], second)
        tell(2, 5, what)
        found = self.keep([self.refine(self._exchange_limbs(pose), (1.0, 0.5)) for _, pose in found], last)
        tell(3, 5, what)
        if is_person(self.body):
            twins = [self.refine(twin, (1.5, 1.0, 0.5)) for _, pose in found for twin in self._list_twins(pose)]
            found = self.keep(found + twins, last)
        tell(4, 5, what)
        found = self.keep([self.refine(self._exchange_limbs(pose), (1.0, 0.5)) for _, pose in found], last)
        tell(5, 5, what)
        return found

    def finish(self, found: Sequence[Scored], count: int) -> list[Scored]:
        """Run the last fine sweeps and return the ``count`` best different poses."""
        return self.keep([self.refine(pose, (0.5, 0.25)) for _, pose in found], count)

    def look_again(self, pose: FloatArray, count: int = 3) -> FloatArray:
        """Return the pose with limbs exchanged, or set to one of ``count`` templates each, where that fits better."""

        def try_pair(pair: LimbPair | None) -> Scored:
            other = pose if pair is None else exchange_pair(self.body, pose, pair)
            if pair is not None:
                self.sweep_parts(other, pair.parts, (1.0, 0.5))
            return self.refine(other, (0.5,))

        _, best = max(self.map(try_pair, (None, *find_pairs(self.body))), key=lambda found: found[0])
        return self.refine(self._exchange_limbs(best, count=count), (0.5,))[1]

    def score(self, pose: FloatArray) -> float:
        """Compute the log score, `SearchSetup.compare` where a person is looked for, else with ease and all pixels."""
        if self.outlines:
            return self.setup.compare(pose, self.frame, self.rims, self.setup.own_scratch())
        return self.setup.score(pose, np.zeros(self.setup.n_axes), self.frame, self.setup.own_scratch())

    def refine(self, pose: FloatArray, factors: Sequence[float]) -> Scored:
        """Return score and pose after sweeps of these widths, in dR."""
        pose = pose.copy()
        for factor in factors:
            self._sweep(pose, factor)
            pose[3:7] /= np.linalg.norm(pose[3:7])
        return self.score(pose), pose

    def keep(self, found: Sequence[Scored], count: int) -> list[Scored]:
        """Return the best ``count`` different poses."""
        ordered = sorted(found, key=lambda pair: -pair[0])
        points = compute_points(self.body, np.array([pose for _, pose in ordered]))
        kept: list[int] = []
        for index in range(len(ordered)):
            if len(kept) == count:
                break
            off = np.linalg.norm(points[kept] - points[index], axis=-1).mean(axis=-1)
            if not (off < self.apart * self.body.stature).any():
                kept.append(index)
        return [ordered[index] for index in kept]

    def measure_overlap(self, pose: FloatArray) -> float:
        """Compute the mean intersection over union of the views that see a person."""
        shares = compare_views(draw_views(self.setup, pose, self.frame), self.frame.bits)
        return float(shares[self.frame.seen].mean())

    def _sweep(self, pose: FloatArray, factor: float, order: IndexArray | None = None) -> None:
        shift, scratch = np.zeros(self.setup.n_axes), self.setup.own_scratch()
        self.setup.sweep(pose, shift, factor, self.frame, scratch, order=order)

    def _list_candidates(self, near: FloatArray | None) -> FloatArray:
        """Return templates (N, 7 + A) in all headings, moved onto the silhouettes."""
        place = guess_place(self.cameras, self.outlines, self.body.stature)
        templates = list_templates(self.body)
        templates = templates if near is None else np.concatenate((templates, near[None]))
        turned = [turn_about(templates, 2.0 * np.pi * k / self.n_headings) for k in range(self.n_headings)]
        moved = move_onto(self.body, np.concatenate(turned), place, self.cameras, self.outlines)
        return moved if near is None else np.concatenate((moved, near[None]))

    def sweep_parts(self, pose: FloatArray, parts: IndexArray, widths: Sequence[float]) -> None:
        """Run sweeps of these widths (dR) over some parts, in place."""
        for factor in widths:
            self._sweep(pose, factor, parts)

    def _exchange_limbs(
        self, pose: FloatArray, widths: Sequence[float] = (1.5, 0.75, 0.4), count: int = 5
    ) -> FloatArray:
        """Set each limb to its best template after sweeps of these ``widths`` (dR), where that improves the score."""
        pose, templates = pose.copy(), list_templates(self.body)
        for limb, parts in self.limbs:
            scores = np.empty(len(templates))
            for number, template in enumerate(templates):
                trial = pose.copy()
                trial[limb] = template[limb]
                scores[number] = self.score(trial)
            chosen = _pick_limbs(templates[:, limb], scores, count)
            starts = np.tile(pose, (len(chosen), 1))
            starts[:, limb] = templates[chosen][:, limb]
            tried = self.map(partial(self._refine_limb, parts, widths), starts)
            _, pose = max(((self.score(pose), pose), *tried), key=lambda found: found[0])
        return pose

    def _refine_limb(self, parts: IndexArray, widths: Sequence[float], pose: FloatArray) -> Scored:
        self.sweep_parts(pose, parts, widths)
        return self.score(pose), pose

    def _list_twins(self, pose: FloatArray, level: float = 0.1) -> list[FloatArray]:
        """Return mirror twins; none if the camera is hardly ``level`` and thus cannot distinguish front and back."""
        seen = [camera for camera, found in zip(self.cameras, self.outlines, strict=True) if found]
        towards = seen[0].rotation[2] * (1.0, 0.0, 1.0)
        length = float(np.linalg.norm(towards))
        return mirror_twins(self.body, pose, towards / length) if length > level else []


def _pick_limbs(limbs: FloatArray, scores: FloatArray, count: int, apart: float = 0.35) -> list[int]:
    """Return the numbers of the ``count`` best templates with limbs (N, n) rad that are ``apart`` in some angle."""
    chosen: list[int] = []
    for number in np.argsort(-scores, kind="stable"):
        if len(chosen) == count:
            break
        if not (np.abs(limbs[chosen] - limbs[number]).max(axis=1) < apart).any():
            chosen.append(int(number))
    return chosen


class Start(NamedTuple):
    """A pose found in one frame.

    Parameters
    ----------
    pose : (7 + A,), see `BodyModel`.
    score : log score; comparable only between starts of one call.
    iou : mean intersection over union of body and silhouette over the views that see a person.
    """

    pose: FloatArray
    score: float
    iou: float


def find_start(
    setup: SearchSetup,
    frame: Frame,
    masks: Sequence[Mask | None],
    *,
    n_best: int = 1,
    near: FloatArray | None = None,
    progress: Progress | None = None,
    extent: float = 90.0,
) -> list[Start]:
    """Find the pose in one frame from its silhouettes alone: at most ``n_best`` different ones, best first.

    One view hardly shows distance, the lean of a limb, or in a side view left from right; only feet and knees show
    front from back. The first call compiles the search kernels (cached on disk) and creates the templates.

    Parameters
    ----------
    setup : body, cameras and settings; of the settings only the stiffness counts.
    frame : the silhouettes as the setup packs them.
    masks : (V,) the same as masks; None where a view has no image.
    n_best : number of different poses wanted.
    near : (7 + A,) an earlier pose of the body, one more template.
    progress : called with steps done, steps in all and the current step.
    extent : px, to which the longest side of the silhouettes is shrunk in all but the last step: more is slower.

    Raises
    ------
    SilhouetteError : no person is seen in any view.
    """
    tell = progress or (lambda done, total, what: None)
    outlines = [measure_outline(mask) for mask in masks]
    extents = [found.extent for found in outlines if found is not None]
    if not extents or not frame.seen.any():
        raise SilhouetteError("tracker.nobody")
    cameras, small = shrink_views(setup.cameras, masks, min(1.0, extent / max(extents)))
    rough = SearchSetup(setup.body, cameras, setup.settings, 30.0, 1.0)
    coarse = StartSearch(rough, rough.pack(small), [measure_outline(mask) for mask in small])
    found = coarse.run(near, tell)
    fine = StartSearch(setup, frame, outlines)
    return [Start(pose, score, fine.measure_overlap(pose)) for score, pose in fine.finish(found, n_best)]


def checked_start(body: BodyModel, start: ArrayLike) -> FloatArray:
    """Return the pose (7 + A,) clipped to the body's limits; BodyModelError if it does not fit this body."""
    pose = np.array(start, np.float64)
    if pose.shape != (7 + body.n_angles,) or not np.isfinite(pose).all():
        raise BodyModelError("pose.start", expected=7 + body.n_angles, found=str(pose.shape))
    length = float(np.linalg.norm(pose[3:7]))
    if not 0.99 < length < 1.01:
        raise BodyModelError("pose.quaternion", found=length)
    pose[3:7] /= length
    limits = body.angle_limits
    pose[7:] = np.clip(pose[7:], limits[:, 0], limits[:, 1])
    return pose


def find_first(silhouettes: Silhouettes, most: int = 150) -> tuple[int, tuple[NDArray[np.bool_] | None, ...]]:
    """Return the first frame with a person in as many views as any of the ``most`` first frames, and its masks."""
    best, best_count, best_masks, full = -1, 0, None, 0
    n_frames = min(silhouettes.n_frames, most)
    for frame in range(n_frames):
        masks = silhouettes.read(frame)
        good = [mask is not None and bool(mask.any()) and not is_nearly_full(mask) for mask in masks]
        full += any(mask is not None and is_nearly_full(mask) for mask in masks)
        if sum(good) > best_count:
            kept = tuple(mask if fine else None for mask, fine in zip(masks, good, strict=True))
            best, best_count, best_masks = frame, sum(good), kept
        if best_count and (best_count == len(masks) or frame >= best + 5):
            break
    if best_masks is None:
        raise SilhouetteError("tracker.all_full" if full else "tracker.all_empty", frames=n_frames)
    return best, best_masks
