"""One cause put into a real dance, and what is told of it: one arm exactly late, and left and right exchanged.

python -m lab.trials.causes ../shared/data
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation import advise, assess
from dousa.evaluation.grade.result import Assessment, ErrorEvent
from dousa.formats.motion_files import read_canonical
from dousa.motion import JOINT_INDEX, CanonicalMotion
from lab.injection.performers import vary_performer
from lab.training.judge_material import Recording
from lab.training.judge_recordings import read_recordings
from lab.training.judge_trial import is_left_out, thin

_CHAINS = {"arm": ("shoulder", "elbow", "wrist", "hand"), "leg": ("hip", "knee", "ankle", "toe")}
_LAGS_MS = (167.0, 333.0, 500.0)
_LATE_S, _EXCHANGED_S = 4.0, 5.0
_WITHIN_MS = 100.0
_DANCES = ("bandai_dance/*.bvh", "cmu86/*.amc")
_FLIP = np.array([-1.0, 1.0, 1.0])  # mirror image by definition: x negated


def find_joints(side: str, limb: str) -> list[int]:
    """Joints of a limb, from where it hangs."""
    return [JOINT_INDEX[f"{side}_{name}"] for name in _CHAINS[limb]]


def delay_arm(motion: CanonicalMotion, side: str, start_s: float, end_s: float, lag_s: float) -> CanonicalMotion:
    """An arm that does what it did before at the shoulder of now; a sudden beginning and end."""
    root, *rest = find_joints(side, "arm")
    frames = np.arange(round(start_s * motion.frame_rate), round(end_s * motion.frame_rate))
    before = np.maximum(frames - round(lag_s * motion.frame_rate), 0)
    positions = np.array(motion.positions)
    for joint in rest:
        positions[frames, joint] += (motion.positions[before, joint] - motion.positions[before, root]) - (
            motion.positions[frames, joint] - motion.positions[frames, root]
        )
    return replace(motion, positions=positions)


def exchange(motion: CanonicalMotion, limb: str, start_s: float, end_s: float) -> CanonicalMotion:
    """Left and right limb exchanged, each the mirror image of the other in the plane between the hips."""
    frames = np.arange(round(start_s * motion.frame_rate), round(end_s * motion.frame_rate))
    source = motion.positions[frames]
    across = source[:, JOINT_INDEX["left_hip"]] - source[:, JOINT_INDEX["right_hip"]]
    across[:, 1] = 0.0
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    positions = np.array(motion.positions)
    for side, other in (("left", "right"), ("right", "left")):
        root, *rest = find_joints(side, limb)
        their_root, *theirs = find_joints(other, limb)
        for joint, model in zip(rest, theirs, strict=True):
            away = source[:, model] - source[:, their_root]
            away -= 2.0 * (away * across).sum(axis=1, keepdims=True) * across
            positions[frames, joint] = positions[frames, root] + away
    return replace(motion, positions=positions)


def choose_places(motion: CanonicalMotion, count: int, lasts_s: float) -> FloatArray:
    """Beginnings in s, evenly over the dance."""
    return np.asarray(np.linspace(3.0, motion.duration - lasts_s - 3.0, count))


def overlaps(event: ErrorEvent, start_s: float, end_s: float) -> bool:
    """Whether an event lasts for half of a span, or is half inside it."""
    shared = min(event.end_s, end_s) - max(event.start_s, start_s)
    return shared > 0.5 * min(event.end_s - event.start_s, end_s - start_s)


def count_late(dance: CanonicalMotion, performers: Sequence[int | None], count: int) -> Iterator[tuple[str, int, int]]:
    """(performer, told, other events) of one late arm at a time."""
    for seed in performers:
        told = others = 0
        for place, start in enumerate(choose_places(dance, count, _LATE_S)):
            side, lag = ("left", "right")[place % 2], _LAGS_MS[place % 3]
            performance = delay_arm(dance, side, start, start + _LATE_S, lag / 1000.0)
            answer = assess(dance, perform(performance, seed))
            names = {f"{side}_upper_arm", f"{side}_forearm"}
            right = [
                event
                for event in answer.events
                if event.kind == "shift"
                and set(event.segments) <= names
                and event.lag_ms is not None
                and abs(event.lag_ms - lag) <= _WITHIN_MS
                and overlaps(event, start, start + _LATE_S)
            ]
            told += bool(right)
            others += len(answer.events) - bool(right)
            print(f"  {start:5.1f} s {side} {lag:.0f} ms: " + "; ".join(say(event) for event in answer.events))
        yield "the same" if seed is None else f"performer {seed}", told, others


def say(event: ErrorEvent) -> str:
    """An event in short."""
    return f"{event.start_s:.1f}-{event.end_s:.1f} {event.message.render('en')}"


def perform(motion: CanonicalMotion, seed: int | None) -> CanonicalMotion:
    """The same by another person, or the very same."""
    return motion if seed is None else vary_performer(motion, seed)


def is_exchange(answer: Assessment, start_s: float, end_s: float) -> bool:
    """Whether it is said that the sides were exchanged."""
    return any(
        getattr(event, "cause", None) == "exchanged" and overlaps(event, start_s, end_s) for event in answer.events
    )


def count_exchanged(
    dance: CanonicalMotion, performers: Sequence[int | None], count: int
) -> Iterator[tuple[str, int, int]]:
    """(performer, told, other events) of arms exchanged at one place at a time."""
    for seed in performers:
        told = others = 0
        for start in choose_places(dance, count, _EXCHANGED_S):
            performance = exchange(dance, "arm", start, start + _EXCHANGED_S)
            answer = assess(dance, perform(performance, seed))
            right = is_exchange(answer, start, start + _EXCHANGED_S)
            told += right
            others += len(answer.events) - right
            print(f"  {start:5.1f} s: " + "; ".join(say(event) for event in answer.events))
            print("         " + "; ".join(advice.message.render("en") for advice in advise(answer)))
        yield "the same" if seed is None else f"performer {seed}", told, others


def count_false(recordings: Sequence[Recording], most: int) -> Iterator[tuple[str, int, int, float]]:
    """(set, references, events, minutes) of takes of the same motion by the same person."""
    takes: dict[tuple[str, str, str], list[CanonicalMotion]] = defaultdict(list)
    for one in recordings:
        takes[one.set_name, one.person, one.motion_name].append(one.motion)
    found: dict[tuple[str, int], tuple[int, float]] = {}
    for (name, person, motion), several in takes.items():
        for count in (1, 3, 5):
            for place in range(min(most, len(several))):
                references = [*several[:place], *several[place + 1 :]][:count]
                if len(references) < count:
                    continue
                events = assess(references, several[place]).events
                before = found.get((name, count), (0, 0.0))
                found[name, count] = before[0] + len(events), before[1] + several[place].duration / 60.0
                if events:
                    print(f"  {name} {person} {motion} {count}: " + "; ".join(say(event) for event in events))
    for (name, count), (events, minutes) in sorted(found.items()):
        yield name, count, events, minutes


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--performers", type=int, default=1, help="made-up performers besides the dancer")
    parser.add_argument("--places", type=int, default=12)
    parser.add_argument("--only", choices=("late", "exchanged", "false"))
    parser.add_argument("--takes", type=int, default=2, help="of each motion that are judged by the others")
    parser.add_argument("--chosen", action="store_true", help="clean takes of the people that choices are made on")
    options = parser.parse_args()
    if options.only in (None, "false"):
        recordings = read_recordings(options.data, exam=not options.chosen)
        recordings = [thin(one) for one in recordings if not options.chosen or is_left_out(one)]
        for name, count, events, minutes in count_false(recordings, options.takes):
            print(
                f"{name}, {count} references: {events} events in {minutes:.1f} minutes, {events / minutes:.2f} a minute"
            )
    performers = [None, *range(options.performers)]
    for pattern in () if options.only == "false" else _DANCES:
        for path in sorted(options.data.glob(pattern)):
            motion = read_canonical(path)[0]
            step = max(1, round(motion.frame_rate / 30.0))
            dance = replace(
                motion, positions=motion.positions[::step], frame_rate=motion.frame_rate / step, missing=None
            )
            print(f"{path.name}: {dance.duration:.0f} s")
            trials = (("late", count_late, options.places), ("exchanged", count_exchanged, options.places // 3))
            for what, count, places in trials:
                for name, told, others in count(dance, performers, places) if options.only in (None, what) else ():
                    print(f"{name}, {what}: told {told} of {places}, other events {others}")


if __name__ == "__main__":
    main()
