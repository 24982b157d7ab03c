"""The performances of the exam, each beside a clean twin."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from lab.exams.dance.bodies import Body, performer
from lab.exams.dance.placing import Deck, Truth, put_errors, put_two

SETS = ("HDM05", "Bandai", "UTD", "dance", "CMU")
GROUPS = ("synthetic", "real", "made-up", "two at once", "clean", "grade", "irds")


@dataclass
class Case:
    """One performance with its clean twin and the references; ``counts`` says how many of them are shown."""

    group: str
    dataset: str
    references: list[Body]
    clean: Body
    wrong: Body
    truths: list[Truth]
    counts: tuple[int, ...] = (1,)
    twin: bool = True


SIZES = {
    "synthetic": {"HDM05": 10, "Bandai": 16, "UTD": 12, "dance": 6, "CMU": 8},
    "real": {"HDM05": 8, "Bandai": 14, "UTD": 10},
    "made-up": {"HDM05": 6, "Bandai": 6, "UTD": 4, "dance": 8, "CMU": 8},
    "two at once": {"HDM05": 8, "Bandai": 8, "UTD": 6, "dance": 4, "CMU": 6},
    "clean": {"HDM05": 8, "Bandai": 16, "UTD": 8},
}


def make_cases(material, groups, seed):
    """All performances; a group's own seed, so that leaving others out changes nothing."""
    cases = []
    for group in (g for g in GROUPS if g in SIZES and g in groups):
        deck = Deck(np.random.default_rng([seed, zlib.crc32(group.encode())]))
        for name, size in SIZES[group].items():
            for i in range(size):
                rng = np.random.default_rng([seed, zlib.crc32(f"{group}/{name}/{i}".encode())])
                cases.append(make_case(material, group, name, i, rng, deck))
    return cases


def make_case(material, group, name, index, rng, deck):
    """One case of a group."""
    if group in ("real", "clean") or (group == "two at once" and name in ("HDM05", "Bandai", "UTD") and index % 2):
        takes = material.takes(name, rng)
        references, clean = takes[1:], takes[0].turned(rng.uniform(-np.pi, np.pi))
        counts = (3,) if group == "two at once" else tuple(c for c in (1, 3, 5) if c <= len(references))
    else:
        recording = material.recording(name, index, rng)
        several = group == "made-up"
        references = [performer(recording, rng) for _ in range(5)] if several else [recording]
        clean, counts = performer(recording, rng), (1, 5) if several else (1,)
    donors = material.donors[name]
    seconds = len(clean) / clean.rate
    if group == "clean":
        wrong, truths = clean, []
    elif group == "two at once":
        wrong, truths = put_two(clean, rng, donors, index % 5)
    else:
        wrong, truths = put_errors(clean, 1 + (seconds > 5.5) + (seconds > 10.4), rng, deck, donors)
    return Case(group, name, references, clean, wrong, truths, counts, group != "clean")
