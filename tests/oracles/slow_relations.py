"""Relations in words with whole arrays of NumPy, one question after the other.

It says what each question of ``dousa.retrieval.words.relations`` means; that module asks all at once in compiled loops.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from oracles.slow_channels import find_lateral_axis

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions
from dousa.retrieval.features.posed_motion import PosedMotion, place_pelvis
from dousa.retrieval.words.relations import Relation

_SMOOTHED = 5  # frames of the moving average: the joints of a Kinect jump
_SHARE, _LONG_ENOUGH = 0.2, 0.5  # of the motion, or s, from which a pose is worth words
_EVENT = 0.13  # s, of what is over quickly
_STEP = 21  # frames over which the speed of the body is averaged, as it comes and goes with every step
_SPEED_SPAN = 5  # frames over which a speed is taken

_SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class _Posed:
    """A motion as the questions see it, in body heights.

    Parameters
    ----------
    body : (T, 20, 3) left, up and forward of the pelvis.
    heights : (T, 20) above the floor.
    travel : (T, 2) speed of the pelvis to the left and forward, a second.
    turned : (T,) radians that the body has turned to the left since the beginning.
    """

    body: FloatArray
    heights: FloatArray
    travel: FloatArray
    turned: FloatArray

    def at(self, joint: str) -> FloatArray:
        return self.body[:, JOINT_INDEX[joint]]

    def height(self, joint: str) -> FloatArray:
        return self.heights[:, JOINT_INDEX[joint]]


def find_relations(motion: PosedMotion) -> tuple[Relation, ...]:
    """What a motion is in words, in a fixed order; joints that are missing (NaN) give no words."""
    with np.errstate(invalid="ignore", divide="ignore"):
        posed = _pose(motion)
        return tuple(_keep(posed))


def _pose(motion: PosedMotion) -> _Posed:
    positions = place_pelvis(motion.positions, motion.height)  # of a body that lacks it
    points = _smooth(sample_positions(positions, motion.frame_rate)) / motion.height
    pelvis = points[:, JOINT_INDEX["pelvis"]]
    left = _smooth(find_lateral_axis(points - points[:, :1]), 3 * _SMOOTHED)
    left = left / np.maximum(np.hypot(*left.T), 1e-9)[:, None]
    rest = points - pelvis[:, None]
    sideways = rest[..., 0] * left[:, None, 0] + rest[..., 2] * left[:, None, 1]
    forward = -rest[..., 0] * left[:, None, 1] + rest[..., 2] * left[:, None, 0]
    body = np.stack([sideways, rest[..., 1], forward], axis=-1)
    feet = points[:, [JOINT_INDEX[f"{side}_ankle"] for side in _SIDES], 1]
    # Without feet nobody knows where the floor is, and nothing is said about heights over it.
    lowest = np.nanmin(points[..., 1], axis=1) if np.isfinite(feet).any() else feet[:, 0]
    floor = _usual(lowest, 5)
    speed = _smooth(_slope(pelvis[:, ::2]), _STEP)
    travel = np.stack([(speed * left).sum(1), -speed[:, 0] * left[:, 1] + speed[:, 1] * left[:, 0]], axis=-1)
    # Seen from above, a turn to the left takes x towards -z.
    turned = np.unwrap(np.arctan2(-left[:, 1], left[:, 0]))
    return _Posed(body, points[..., 1] - floor, travel, turned - turned[0])


def _smooth(values: FloatArray, width: int = _SMOOTHED) -> FloatArray:
    """Moving average over time; at the ends over the frames that there are."""
    half = min(width // 2, (len(values) - 1) // 2)
    if half < 1:
        return values
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    places = np.arange(len(values))
    first, last = np.maximum(places - half, 0), np.minimum(places + half + 1, len(values))
    shape = (-1,) + (1,) * (values.ndim - 1)
    even: FloatArray = (total[last] - total[first]) / (last - first).reshape(shape)
    return even


def _slope(values: FloatArray) -> FloatArray:
    """Change a second, over a few frames on either side."""
    places = np.arange(len(values))
    first, last = np.maximum(places - _SPEED_SPAN // 2, 0), np.minimum(places + _SPEED_SPAN // 2, len(values) - 1)
    shape = (-1,) + (1,) * (values.ndim - 1)
    slope: FloatArray = (values[last] - values[first]) * CHANNEL_RATE / np.maximum(last - first, 1).reshape(shape)
    return slope


def _keep(posed: _Posed) -> Iterator[Relation]:
    """The relations that hold long enough."""
    least = min(_SHARE * len(posed.body) / CHANNEL_RATE, _LONG_ENOUGH)
    for name, part, holds, is_event in _ask(posed):
        start, end = _longest(holds)
        if holds.any() and (end - start) / CHANNEL_RATE >= (_EVENT if is_event else max(least, _EVENT)) - 1e-9:
            share = round(float(holds.mean()), 4)
            yield Relation(name, part, share, round(start / CHANNEL_RATE, 3), round(end / CHANNEL_RATE, 3))


def _longest(holds: BoolArray) -> tuple[int, int]:
    """First frame, and frame after the last, of the longest stretch in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return 0, 0
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])


_Asked = tuple[str, str, BoolArray, bool]


def _ask(posed: _Posed) -> Iterator[_Asked]:
    yield from _ask_arms(posed)
    yield from _ask_hands(posed)
    yield from _ask_legs(posed)
    yield from _ask_body(posed)


def _pair(name: str, limb: str, limbs: str, holds: list[BoolArray], is_event: bool = False) -> Iterator[_Asked]:
    """A question of the left and of the right: of both where it holds for both."""
    left, right = holds
    both = left & right
    yield name, f"both_{limbs}", both, is_event
    yield name, f"left_{limb}", left & ~both, is_event
    yield name, f"right_{limb}", right & ~both, is_event


def _ask_arms(posed: _Posed) -> Iterator[_Asked]:
    above, level, aside, ahead, bent = [], [], [], [], []
    for side in _SIDES:
        hand, elbow, shoulder = (posed.at(f"{side}_{joint}") for joint in ("hand", "elbow", "shoulder"))
        outward = 1.0 if side == "left" else -1.0
        reach = hand - shoulder
        far = np.linalg.norm(reach, axis=1) > 0.24  # of some 0.3 to 0.4 of an arm that is straight
        above.append(hand[:, 1] > posed.at("head")[:, 1])
        level.append(far & (np.abs(reach[:, 1]) < 0.1))
        aside.append(far & (outward * reach[:, 0] > 0.17) & (reach[:, 1] > -0.2) & (reach[:, 1] < 0.25))
        ahead.append(far & (reach[:, 2] > 0.2) & (np.abs(reach[:, 0]) < reach[:, 2]) & (reach[:, 1] > -0.15))
        bent.append(_angle(shoulder - elbow, posed.at(f"{side}_wrist") - elbow) < np.radians(90.0))
    yield from _pair("above_head", "hand", "hands", above)
    yield from _pair("arm_level", "arm", "arms", level)
    yield from _pair("arm_aside", "arm", "arms", aside)
    yield from _pair("arm_ahead", "arm", "arms", ahead)
    yield from _pair("elbow_bent", "elbow", "elbows", bent)


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    cosine = (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    angle: FloatArray = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle


def _ask_hands(posed: _Posed) -> Iterator[_Asked]:
    left, right = posed.at("left_hand"), posed.at("right_hand")
    near = np.linalg.norm(left - right, axis=1) < 0.1
    below = np.maximum(left[:, 1], right[:, 1]) < posed.at("head")[:, 1]
    yield "hands_together", "", near, False
    meetings = int((np.diff(near.astype(np.int8)) == 1).sum())
    yield "hands_meet", "", near & below if meetings >= 2 else np.zeros_like(near), True
    in_front = (left[:, 2] > 0.03) & (right[:, 2] > 0.03)
    yield "arms_crossed", "", in_front & (left[:, 0] < right[:, 0] - 0.05), False
    names = ("hand_waves", "arm_circles", "hand_thrust", "hand_behind", "hand_low", "hand_at_head")
    asked: dict[str, list[BoolArray]] = {name: [] for name in names}
    for side in _SIDES:
        hand, shoulder = posed.at(f"{side}_hand"), posed.at(f"{side}_shoulder")
        asked["hand_waves"].append(_waves(hand - shoulder))
        asked["arm_circles"].append(_circles(hand - shoulder))
        asked["hand_thrust"].append((_slope(hand - shoulder)[:, 2] > 1.0) & (hand[:, 1] > shoulder[:, 1] - 0.2))
        asked["hand_behind"].append(hand[:, 2] < -0.1)
        asked["hand_low"].append(posed.height(f"{side}_hand") < 0.2)
        asked["hand_at_head"].append(np.linalg.norm(hand - posed.at("head"), axis=1) < 0.13)
    for name, holds in asked.items():
        limb = ("arm", "arms") if name == "arm_circles" else ("hand", "hands")
        yield from _pair(name, *limb, holds, name == "hand_thrust")


def _waves(reach: FloatArray) -> BoolArray:
    """Three or more times from side to side, hand not hanging; reach (T, 3) from the shoulder."""
    raised = reach[:, 1] > -0.12
    nothing = np.zeros(len(reach), np.bool_)
    turns: list[int] = []
    best = 0.0
    sideways = np.where(raised, reach[:, 0], np.nan)
    mark, way = np.nan, 0
    for frame, value in enumerate(sideways):
        if np.isnan(value):
            if len(turns) < 3:
                turns, mark, way = [], np.nan, 0
            continue
        if np.isnan(mark):
            mark = best = value
        best = max(best, value) if way > 0 else min(best, value) if way < 0 else best
        step = value - (best if way else mark)
        if abs(step) > 0.05 and np.sign(step) != way:
            way, best = int(np.sign(step)), value
            turns.append(frame)
    if len(turns) < 4:
        return nothing
    nothing[turns[0] : turns[-1] + 1] = True
    return nothing & raised


def _circles(reach: FloatArray) -> BoolArray:
    """A whole turn of the arm about the shoulder, seen from the side or from the front; reach (T, 3)."""
    holds = np.zeros(len(reach), np.bool_)
    for first, second in ((1, 2), (0, 1)):
        wide = np.hypot(reach[:, first], reach[:, second]) > 0.15
        if wide.mean() < 0.8:
            continue
        angle = np.unwrap(np.arctan2(reach[:, first], reach[:, second]))
        if np.ptp(angle) > np.radians(330.0):
            holds |= wide
    return holds


def _ask_legs(posed: _Posed) -> Iterator[_Asked]:
    raised, lifted, kicked, aside = [], [], [], []
    for side, other in zip(_SIDES, _SIDES[::-1], strict=True):
        foot, knee = posed.at(f"{side}_ankle"), posed.at(f"{side}_knee")
        high = posed.height(f"{side}_ankle") - posed.height(f"{other}_ankle")
        outward = 1.0 if side == "left" else -1.0
        raised.append(high > 0.15)
        lifted.append((knee[:, 1] > -0.12) & (high > 0.08))
        swung = bool(((high > 0.08) & (_slope(foot)[:, 2] > 0.9)).any())
        kicked.append((high > 0.15) & (foot[:, 2] > 0.18) & swung)
        first = foot[: max(len(foot) // 10, 1), 0]
        far = outward * (foot[:, 0] - (np.nanmedian(first) if np.isfinite(first).any() else np.nan))
        aside.append((far > 0.08) & (outward * foot[:, 0] > 0.12))
    yield from _pair("foot_raised", "foot", "feet", raised)
    yield from _pair("knee_raised", "knee", "knees", lifted)
    yield from _pair("kicks_forward", "leg", "legs", kicked, True)
    yield from _pair("steps_aside", "foot", "feet", aside)
    apart = np.abs(posed.at("left_ankle")[:, 0] - posed.at("right_ankle")[:, 0])
    yield "legs_apart", "", apart > 0.3, False


def _ask_body(posed: _Posed) -> Iterator[_Asked]:
    pelvis, head = posed.height("pelvis"), posed.height("head")
    trunk = posed.at("neck")
    upright = trunk[:, 1] / np.linalg.norm(trunk, axis=1)
    lying = head < 0.35
    yield "lying", "", lying, False
    low = (pelvis < max(0.4, 0.8 * np.nan_to_num(pelvis).max())) & ~lying
    yield "body_low", "", low, False
    yield "bent_forward", "", (upright < 0.8) & (trunk[:, 2] > 0) & ~lying, False
    tenth = max(len(pelvis) // 10, 1)
    change = float(np.nanmean(pelvis[-tenth:]) - np.nanmean(pelvis[:tenth])) if np.isfinite(pelvis).any() else 0.0
    moving = np.abs(_slope(pelvis)) > 0.1
    yield "gets_up", "", moving & (change > 0.1), True
    yield "gets_down", "", moving & (change < -0.1), True
    yield from _ask_travel(posed)
    feet = np.minimum(posed.height("left_ankle"), posed.height("right_ankle"))
    lifted = (feet > _usual(feet, 20) + 0.05) & (pelvis > _usual(pelvis, 50) + 0.02)
    yield "in_the_air", "", lifted & ~lying, True


def _usual(values: FloatArray, percent: float) -> float:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else float("nan")


def _ask_travel(posed: _Posed) -> Iterator[_Asked]:
    left, forward = posed.travel.T
    speed = np.hypot(left, forward)
    yield "walks", "", (forward > 0.3) & (speed < 1.2), False
    yield "runs", "", speed > 1.2, False
    yield "walks_back", "", forward < -0.2, False
    yield "goes_left", "", (left > 0.2) & (left > np.abs(forward)), False
    yield "goes_right", "", (left < -0.2) & (-left > np.abs(forward)), False
    turning = _slope(posed.turned)
    yield "turns_left", "", (turning > 0.4) & bool(posed.turned.max() > np.radians(50.0)), False
    yield "turns_right", "", (turning < -0.4) & bool(posed.turned.min() < -np.radians(50.0)), False
    hands = [np.linalg.norm(_slope(posed.at(f"{side}_hand")), axis=1) for side in _SIDES]
    yield "stands_still", "", (speed < 0.05) & (np.maximum(*hands) < 0.1) & (posed.height("pelvis") > 0.42), False
