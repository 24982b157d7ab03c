"""What every row of the exam is given, and what it answers."""

from __future__ import annotations

import functools
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.exams.search.baseline import Nearest
from lab.exams.search.material import load, read_sets, read_takes


@dataclass(frozen=True)
class Line:
    """A line of the table; NaN: has no such number."""

    what: str
    dousa: float
    baseline: float = float("nan")
    target: str = ""
    note: str = ""


@dataclass(frozen=True)
class Context:
    """The recordings, the seed, and a folder for libraries and made files."""

    root: Path
    seed: int
    folder: Path

    @functools.cached_property
    def sets(self):
        """All clips, by set."""
        return read_sets(self.root)

    @functools.cached_property
    def takes(self):
        """The takes of UTKinect with their labels."""
        return read_takes(self.root)

    def rng(self, *words):
        """Numbers that depend on these words and the seed alone."""
        return np.random.default_rng([self.seed, zlib.crc32("/".join(map(str, words)).encode())])

    def nearest(self, clips):
        """The baseline, learned from these clips."""
        return Nearest([(load(c.path), c.category, f"{c.dataset}_{c.person}") for c in clips])

    def write(self, points, *words):
        """A made motion as a file."""
        return points.write(self.folder / ("_".join(map(str, words)) + ".npz"))
