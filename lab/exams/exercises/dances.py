"""Rows on dances, gestures, and people who do not move."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation import compute_segments
from dousa.formats.motion_files import read_canonical
from dousa.motion import JOINT_INDEX, CanonicalMotion, mirror_canonical
from lab.exams.exercises.answers import Answer, Asker
from lab.exams.exercises.baselines import find_lags

LAGS_MS = (167, 333, 500)
_ARMS = {
    side: tuple(f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist", "hand")) for side in ("left", "right")
}
_ARM_ROWS = {"left": [1, 2], "right": [3, 4]}
_HOLD_S, _FADE_S, _NEAR_MS, _SAID_MS = 2.5, 0.5, 100.0, 80.0
_EXCHANGED = re.compile(r"exchang|swap|mirror|other (arm|side|leg|hand)|left and right", re.IGNORECASE)


def get_frames(motion: CanonicalMotion) -> FloatArray:
    """(T, 3, 3) axes of the chest: to the left, up along the trunk, forward."""
    at = motion.positions
    across = at[:, JOINT_INDEX["left_shoulder"]] - at[:, JOINT_INDEX["right_shoulder"]]
    up = at[:, JOINT_INDEX["neck"]] - at[:, JOINT_INDEX["pelvis"]]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up -= (up * across).sum(axis=1, keepdims=True) * across
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return np.stack([across, up, np.cross(across, up)], axis=1)


def get_arm(motion: CanonicalMotion, side: str) -> FloatArray:
    """(T, 4, 3) joints of an arm from its shoulder, in the chest's axes."""
    joints = motion.positions[:, [JOINT_INDEX[name] for name in _ARMS[side]]]
    return np.einsum("tij,tkj->tki", get_frames(motion), joints - joints[:, :1])


def put_arm(motion: CanonicalMotion, side: str, arm: FloatArray) -> CanonicalMotion:
    """The motion with another arm at its own shoulder."""
    positions = motion.positions.copy()
    rows = [JOINT_INDEX[name] for name in _ARMS[side]]
    positions[:, rows] = np.einsum("tij,tki->tkj", get_frames(motion), arm) + positions[:, rows[:1]]
    return replace(motion, positions=positions)


def dance_again(motion: CanonicalMotion, seed: int) -> CanonicalMotion:
    """A left-alone second take: every joint wanders by 8 mm in half-second waves, timing by 20 ms, heading turned."""
    random = np.random.default_rng(seed)
    count, rate = motion.n_frames, motion.frame_rate

    def wander(size: float, *shape: int) -> FloatArray:
        knots = np.arange(0, count + rate, rate / 2)
        values = random.normal(0.0, size, (len(knots), *shape)).reshape(len(knots), -1)
        smooth = np.stack([np.interp(np.arange(count), knots, column) for column in values.T], axis=1)
        return smooth.reshape(count, *shape)

    rows = np.clip(np.arange(count) + wander(0.02 * rate), 0, count - 1)
    flat = motion.positions.reshape(count, -1)
    moved = np.stack([np.interp(rows, np.arange(count), column) for column in flat.T], axis=1)
    moved = moved.reshape(count, -1, 3) + wander(0.008, motion.positions.shape[1], 3)
    angle = random.uniform(-math.pi, math.pi)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return replace(motion, positions=moved @ turn)


def delay_arm(motion: CanonicalMotion, side: str, start: float, lag: float) -> CanonicalMotion:
    """One arm exactly ``lag`` seconds late for 2.5 s, coming to it and back within 0.5 s each."""
    arm, rate = get_arm(motion, side), motion.frame_rate
    seconds = np.arange(motion.n_frames) / rate
    fade = max(_FADE_S, 1.2 * lag)
    late = lag * np.interp(seconds, [start - fade, start, start + _HOLD_S, start + _HOLD_S + fade], [0, 1, 1, 0])
    rows = np.arange(len(arm)) - late * rate
    flat = arm.reshape(len(arm), -1)
    moved = np.stack([np.interp(rows, np.arange(len(arm)), column) for column in flat.T], axis=1)
    return put_arm(motion, side, moved.reshape(arm.shape))


def find_places(motion: CanonicalMotion, count: int) -> list[tuple[str, float]]:
    """Sides and starts at which an arm moves most, evenly over the motion, left and right in turns."""
    span = motion.duration / count
    places = []
    for number in range(count):
        side = ("left", "right")[number % 2]
        speed = np.abs(np.diff(compute_segments(motion.positions)[:, _ARM_ROWS[side]], axis=0)).sum(axis=(1, 2))
        starts = np.arange(number * span + 0.8, (number + 1) * span - _HOLD_S - 0.3, 0.2)
        moved = [speed[round(s * motion.frame_rate) : round((s + _HOLD_S) * motion.frame_rate)].sum() for s in starts]
        places.append((side, float(starts[int(np.argmax(moved))])))
    return places


def sit_late(asker: Asker, options) -> dict[str, dict[str, float]]:
    """One late arm in twelve places of a real dance, four in each of three second takes; and those left alone."""
    dance = read_canonical(next(Path(options.data / "bandai_dance").glob("*.bvh")))[0]
    told, other, clean = defaultdict(int), defaultdict(int), defaultdict(int)
    places = find_places(dance, 12)
    for take, lag in enumerate(LAGS_MS):
        again = dance_again(dance, take)
        wrong, mine = again, places[take::3]
        for side, start in mine:
            wrong = delay_arm(wrong, side, start, lag / 1000.0)
        for name, events in _find_shifts(asker, dance, wrong).items():
            right = [_is_told(events, side, start, lag) for side, start in mine]
            told[name] += sum(right)
            other[name] += len(events) - sum(right)
        for name, events in _find_shifts(asker, dance, again).items():
            clean[name] += len(events)
    return {
        "late arm, 12 places: told within 100 ms": dict(told),
        "late arm: other, false events": dict(other),
        "the same takes left alone (3 min): events": dict(clean),
    }


def _find_shifts(asker: Asker, reference: CanonicalMotion, performance: CanonicalMotion) -> dict[str, list[tuple]]:
    """Of dousa and of the plain best lag of each arm: (kind, start, end, segments, lag in ms)."""
    answer = asker.ask([reference], performance)
    ours = [(e.kind, e.start_s, e.end_s, e.segments, e.lag_ms) for e in answer.events]
    plain = []
    for side in ("left", "right"):
        a, b = (get_arm(one, side)[:, 1:3].reshape(one.n_frames, -1) for one in (reference, performance))
        lags = find_lags(a, b, performance.frame_rate)
        edges = np.flatnonzero(np.diff(np.r_[0, np.abs(lags) * 1000.0 >= _SAID_MS, 0]))
        names = (f"{side}_upper_arm", f"{side}_forearm")
        for first, last in edges.reshape(-1, 2):
            if last - first >= 0.5 * performance.frame_rate:
                start, end = first / performance.frame_rate, last / performance.frame_rate
                plain.append(("shift", start, end, names, float(np.median(lags[first:last])) * 1000.0))
    return {"dousa": ours, "best lag": plain}


def _is_told(events: list[tuple], side: str, start: float, lag: float) -> bool:
    """A shift of that arm alone, in that place, by that much."""
    return any(
        kind == "shift"
        and first < start + _HOLD_S
        and last > start
        and value is not None
        and abs(value - lag) <= _NEAR_MS
        and all(name in (f"{side}_upper_arm", f"{side}_forearm") for name in names)
        for kind, first, last, names, value in events
    )


def sit_exchanged(asker: Asker, options) -> dict[str, dict[str, float]]:
    """Left and right arm exchanged for five seconds in four places, and the whole dance mirrored: is it said?"""
    dance = read_canonical(next(Path(options.data / "bandai_dance").glob("*.bvh")))[0]
    said = 0
    flip = np.array([-1.0, 1.0, 1.0])
    for take, place in enumerate((6.0, 20.0, 36.0, 50.0)):
        again = dance_again(dance, 10 + take)
        arms = {side: get_arm(again, side) for side in ("left", "right")}
        seconds = np.arange(again.n_frames) / again.frame_rate
        inside = (seconds >= place) & (seconds < place + 5.0)
        wrong = again
        for side, other in (("left", "right"), ("right", "left")):
            wrong = put_arm(wrong, side, np.where(inside[:, None, None], arms[other] * flip, arms[side]))
        said += any(_EXCHANGED.search(word) for word in asker.ask([dance], wrong).words)
    mirrored = asker.ask([dance], mirror_canonical(dance_again(dance, 20)))
    return {
        "arms exchanged for 5 s, 4 places: said": {"dousa": said},
        "the dance mirrored: said, and graded 80 or above": {
            "dousa": float(any(_EXCHANGED.search(w) for w in mirrored.words) and mirrored.score >= 80.0)
        },
    }


def find_takes(data: Path) -> list[list[Path]]:
    """Groups of six takes of one motion by one person: HDM05's classes and actors, Bandai's pairs."""
    groups = defaultdict(list)
    for file in sorted(data.glob("hdm05/*/*.[aA][mM][cC]")):
        groups[file.parent.name, file.name.split("_")[1]].append(file)
    for file in sorted(data.glob("bandai/*/*/*.bvh")):
        groups[file.parent.parent.name, file.parent.name].append(file)
    return [files[:6] for files in groups.values() if len(files) >= 6]


def sit_false(asker: Asker, options) -> dict[str, dict[str, float]]:
    """Events a minute on clean second takes, with 1, 3 and 5 of the other takes as references."""
    groups = find_takes(options.data)[:: 8 if options.quick else 2]
    rows = {}
    takes = [[read_canonical(file)[0] for file in files] for files in groups]
    for count in (1, 3, 5):
        events: dict[str, int] = defaultdict(int)
        minutes = 0.0
        for group in takes:
            answer = asker.ask(group[1 : 1 + count], group[0])
            events["dousa"] += len(answer.events)
            events["25 deg for 0.3 s"] += count_plain_events(group[1 : 1 + count], group[0])
            minutes += group[0].duration / 60.0
        rows[f"events a minute on {len(groups)} clean second takes ({minutes:.1f} min), {count} references"] = {
            name: value / minutes for name, value in events.items()
        }
    return rows


def count_plain_events(references: list[CanonicalMotion], performance: CanonicalMotion) -> int:
    """Times that a segment is 25 degrees off every reference for 0.3 s, evenly in time."""
    own = compute_segments(performance.positions)
    least = np.full(own.shape[:2], np.inf)
    for reference in references:
        other = compute_segments(reference.positions)
        rows = np.linspace(0, len(other) - 1, len(own)).round().astype(int)
        turned = other[rows]
        plane = ((own[..., 0] + 1j * own[..., 2]) * np.conj(turned[..., 0] + 1j * turned[..., 2])).sum()
        z = (turned[..., 0] + 1j * turned[..., 2]) * plane / max(abs(plane), 1e-9)
        dots = own[..., 0] * z.real + own[..., 2] * z.imag + own[..., 1] * turned[..., 1]
        least = np.minimum(least, np.degrees(np.arccos(np.clip(dots, -1.0, 1.0))))
    count = 0
    for column in (least > 25.0).T:
        edges = np.flatnonzero(np.diff(np.r_[0, column, 0])).reshape(-1, 2)
        count += int((np.diff(edges, axis=1) >= 0.3 * performance.frame_rate).sum())
    return count


def sit_still(asker: Asker, options) -> dict[str, dict[str, float]]:
    """A person who stands, or holds a pose of another exercise, beside 30 motions: no grade, said, no praise."""
    files = sorted(options.data.glob("uiprmd/vicon/m*/correct/*_s04_e03.trc"))
    files += sorted(options.data.glob("utd_mhad/skeleton/*/*_s3_t1.c3d"))[:: 1 if not options.quick else 4]
    files += sorted(options.data.glob("hdm05/*/HDM_bk_*.amc"))[::12]
    motions = [read_canonical(file)[0] for file in files][:30]
    outcomes: dict[str, list[tuple[bool, float]]] = defaultdict(list)
    for number, motion in enumerate(motions):
        other = motions[(number + 11) % len(motions)]
        random = np.random.default_rng(number)
        for name, pose in (("still", motion.positions[0]), ("held pose", other.positions[other.n_frames // 2])):
            count = max(motion.n_frames, round(motion.frame_rate))
            trembling = pose + random.normal(0.0, 0.003, (count, *pose.shape))
            answer = asker.ask(
                [motion],
                replace(
                    motion if name == "still" else other,
                    positions=trembling,
                    frame_rate=motion.frame_rate,
                    missing=None,
                ),
            )
            outcomes[name].append((_is_refused(answer), answer.score))
    rows = {}
    for name, some in outcomes.items():
        rows[f"{name}, {len(some)} motions: no grade, said, no praise"] = {"dousa": float(sum(ok for ok, _ in some))}
        rows[f"{name}: highest grade"] = {"dousa": float(np.nan_to_num(np.nanmax([0.0, *(s for _, s in some)])))}
    return rows


def _is_refused(answer: Answer) -> bool:
    return math.isnan(answer.score) and bool(answer.words) and not answer.praised


def sit_severity(asker: Asker, options) -> dict[str, dict[str, float]]:
    """Squats and arm raises drawn towards their start in five steps: grades that do not rise, of all steps."""
    steps = (0.0, 0.15, 0.3, 0.45, 0.6)
    falls, spans = [], []
    for movement in ("m01", "m07", "m10"):
        for person in ("s01", "s03", "s04"):
            files = sorted(options.data.glob(f"uiprmd/vicon/{movement}/correct/{movement}_{person}_*.trc"))
            references = [read_canonical(file)[0] for file in files[:3]]
            motion = read_canonical(files[4])[0]
            start = motion.positions[:1]
            scores = []
            for step in steps:
                # Positions between two poses are no rigid body: directions keep, lengths are put right by the reader
                drawn = replace(motion, positions=motion.positions + step * (start - motion.positions))
                scores.append(np.nan_to_num(asker.ask(references, drawn).score))
            falls += (np.diff(scores) <= 0.0).tolist()
            spans.append(scores[0] - scores[-1])
    return {
        "a repetition that gets shorter in 5 steps: steps at which the grade does not rise": {
            "dousa": float(np.mean(falls))
        },
        "the same: points lost from first to last, median": {"dousa": float(np.median(spans))},
    }
