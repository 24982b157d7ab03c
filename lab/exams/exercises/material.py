"""Repetitions of exercises by real people, and draws of references by others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion

SENSORS = ("kinect", "vicon")
MOVEMENTS = tuple(f"m{n:02d}" for n in range(1, 11))
PEOPLE = ("s01", "s02", "s03", "s04", "s05")
_OTHER_SIDE = {"m02": {"s02"}, "m03": {"s02"}}  # their own notes: they do it with the left

FAULTY = {
    "m01": ("trunk", "thigh", "shank"),
    "m02": ("trunk", "moving thigh", "moving shank"),
    "m03": ("trunk", "thigh", "shank"),
    "m04": ("trunk", "thigh", "shank"),
    "m05": ("trunk", "thigh", "shank"),
    "m06": ("trunk", "moving thigh", "moving shank"),
    "m07": ("trunk", "moving upper_arm", "moving forearm"),
    "m08": ("trunk", "moving upper_arm", "moving forearm"),
    "m09": ("trunk", "moving upper_arm", "moving forearm"),
    "m10": ("trunk", "moving upper_arm", "moving forearm"),
}
"""What is at fault in an incorrect repetition, after the table of Vakanski et al. 2018 as it is remembered, written
before any answer was seen: in every one the trunk does not stay upright or aligned; in squat, lunges and sit to stand
the legs do not go far enough or leave their plane; in hurdle step and leg raise the raised leg; in the four of the
shoulder the moving arm does not go far enough or leaves its plane. Feet, head and hips' rotation are not judged."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """One repetition of an exercise, with what its therapist said of it."""

    exercise: str
    person: str
    correct: bool
    name: str
    motion: CanonicalMotion


def read_uiprmd(data: Path, sensor: str, movement: str, stride: int) -> list[Repetition]:
    """Every ``stride``-th correct and incorrect repetition of the five people."""
    found = []
    for label in ("correct", "incorrect"):
        for person in PEOPLE:
            files = sorted((data / "uiprmd" / sensor / movement / label).glob(f"{movement}_{person}_*.trc"))
            for file in files[::stride]:
                motion = read_canonical(file, whole=False)[0]  # one Vicon repetition lacks a wrist
                found.append(Repetition(movement, person, label == "correct", file.stem, motion))
    return found


def read_irds(data: Path) -> list[Repetition]:
    """All repetitions of person 215."""
    return [
        Repetition(file.parent.parent.name, "215", file.parent.name == "correct", file.stem, read_canonical(file)[0])
        for file in sorted((data / "irds").glob("g*/*/*.trc"))
    ]


def draw_others(repetitions: list[Repetition], person: str, count: int, seed: int) -> list[Repetition]:
    """``count`` correct repetitions by other people, of as many people as there are; one more is one added."""
    random = np.random.default_rng([seed, *person.encode()])
    others = [
        [one for one in repetitions if one.person == other and one.correct] for other in PEOPLE if other != person
    ]
    others = [others[i] for i in random.permutation(len(others)) if others[i]]
    orders = [random.permutation(len(some)) for some in others]
    chosen = []
    for number in range(count):
        some, order = others[number % len(others)], orders[number % len(others)]
        chosen.append(some[order[(number // len(others)) % len(order)]])
    return chosen


def draw_own(repetitions: list[Repetition], person: str, exercise: str, count: int, seed: int) -> list[Repetition]:
    """``count`` correct repetitions by the same person."""
    own = [one for one in repetitions if one.person == person and one.correct and one.exercise == exercise]
    order = np.random.default_rng([seed, 1, *person.encode()]).permutation(len(own))
    return [own[i] for i in order[:count]]


def find_area(correct: list[float], incorrect: list[float]) -> float:
    """AUROC: how often a correct repetition has the larger number; nan without both."""
    good, bad = np.asarray(correct, float), np.asarray(incorrect, float)
    if not len(good) or not len(bad):
        return float("nan")
    return float((good[:, None] > bad).mean() + 0.5 * (good[:, None] == bad).mean())
