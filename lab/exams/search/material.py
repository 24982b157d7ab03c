"""The recordings of the exam, what means the same in them, and how they are made worse."""

from __future__ import annotations

import csv
import functools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dousa

JOINTS = dousa.CANONICAL_JOINTS
J = {name: i for i, name in enumerate(JOINTS)}
STYLES_LEARNED = ("elderly", "feminine", "normal", "masculine")  # of Bandai, whose people are not told


@dataclass(frozen=True)
class Clip:
    """One thing that somebody does, in a file. ``person``: subject or actor; of Bandai the style stands for it."""

    dataset: str
    path: Path
    category: str
    person: str

    @property
    def key(self):
        """Its category, and of which set."""
        return f"{self.dataset}:{self.category}"


@dataclass(frozen=True)
class Points:
    """``positions`` (T, 20, 3) m, Y up, NaN where missing; ``rate`` Hz."""

    positions: np.ndarray
    rate: float

    def __len__(self):
        return len(self.positions)

    @property
    def seconds(self):
        """How long it lasts."""
        return len(self) / self.rate

    def cut(self, start, stop):
        """The part between two times in s."""
        return Points(self.positions[round(start * self.rate) : max(round(stop * self.rate), 1)], self.rate)

    def at_rate(self, rate, tempo=1.0):
        """At another frame rate, ``tempo`` times as fast."""
        times = np.arange(0, len(self) - 1 + 1e-9, tempo * self.rate / rate)
        low = np.minimum(times.astype(int), len(self) - 2)
        share = (times - low)[:, None, None]
        return Points((1 - share) * self.positions[low] + share * self.positions[low + 1], rate)

    def write(self, path):
        """As a file that dousa reads."""
        path.parent.mkdir(parents=True, exist_ok=True)
        dousa.write_motion(dousa.Trajectories(JOINTS, self.positions, self.rate), path)
        return path

    def without(self, *words):
        """Without the joints whose names hold these words."""
        kept = [i for i, name in enumerate(JOINTS) if not any(w in name for w in words)]
        return [JOINTS[i] for i in kept], self.positions[:, kept]


@functools.cache
def load(path):
    """The canonical joints of a file."""
    motion = dousa.canonicalise(dousa.read_motion(path))
    return Points(np.asarray(motion.positions), motion.frame_rate)


def read_sets(root):
    """All clips of HDM05, UTD-MHAD and Bandai (five of each pair of content and style), in a fixed order."""
    root, sets = Path(root), {}
    hdm = sorted(root.glob("hdm05/*/HDM_*.[aA][mM][cC]"))
    sets["hdm05"] = [Clip("hdm05", p, p.parent.name, p.name[4:6]) for p in hdm]
    utd = sorted(root.glob("utd_mhad/skeleton/*/a*.c3d"))
    sets["utd"] = [Clip("utd", p, p.parent.name, re.search(r"_s(\d)", p.name)[1]) for p in utd]
    bandai = [p for pair in sorted(root.glob("bandai/*/*")) for p in sorted(pair.glob("*.bvh"))[::2]]
    sets["bandai"] = [Clip("bandai", p, p.parent.parent.name, p.parent.name) for p in bandai]
    return sets


def hold_out(clips, *people):
    """(those of all others, those of these people)."""
    return [c for c in clips if c.person not in people], [c for c in clips if c.person in people]


def thin(clips, number):
    """So many of each category, evenly over its clips."""
    table = {}
    for clip in clips:
        table.setdefault(clip.category, []).append(clip)
    return [
        row[i] for row in table.values() for i in np.unique(np.linspace(0, len(row) - 1, number).round().astype(int))
    ]


def read_takes(root):
    """UTKinect: {path: [(start, end, category), ...]}."""
    takes = {}
    for path in sorted(Path(root).glob("utkinect/*.trc")):
        with open(path.with_suffix(".labels.csv"), newline="", encoding="utf-8") as file:
            takes[path] = [(float(r["start_s"]), float(r["end_s"]), r["category"]) for r in csv.DictReader(file)]
    return takes


def cut_segments(takes, folder, longest=20.0):
    """The labelled segments of takes as clips; one of UTKinect is no action but 35 s of everything."""
    clips = []
    for path, truth in takes.items():
        for i, (start, end, category) in enumerate(truth):
            if end - start <= longest:
                part = load(path).cut(start, end).write(folder / f"{path.stem}_{i}_{category}.npz")
                clips.append(Clip("utkinect", part, category, path.stem[:3]))
    return clips


def disturb(points, rng, rate=15.0, noise=0.03, missing=0.05):
    """As a bad sensor sees it: slow, noise of ``noise`` m along each axis, joints lost for 1 to 8 frames each time."""
    slow = points.at_rate(rate) if points.rate > rate else points
    positions = slow.positions + rng.normal(0, noise, slow.positions.shape)
    n_frames, n_joints = positions.shape[:2]
    lost, wanted = np.zeros((n_frames, n_joints), bool), missing * n_frames * n_joints
    while lost.sum() < wanted:
        start = rng.integers(n_frames)
        lost[start : start + rng.integers(1, 9), rng.integers(n_joints)] = True
    positions[lost] = np.nan
    return Points(positions, slow.rate)


SAME = [
    ("hdm05:squat1Reps", "utd:squat"),
    ("hdm05:jogLeftCircle4StepsRstart", "utd:jog", "bandai:run"),
    ("hdm05:throwBasketball", "utd:basketball_shoot"),
    ("utd:walk", "bandai:walk", "utkinect:walk"),
    ("utd:wave", "bandai:wave-right-hand"),
    ("bandai:wave-both-hands", "utkinect:waveHands"),
    ("utd:clap", "utkinect:clapHands"),
    ("utd:stand_to_sit", "utkinect:sitDown"),
    ("utd:sit_to_stand", "utkinect:standUp"),
    ("utd:throw", "utkinect:throw"),
    ("utd:push", "utkinect:push"),
]
# Whether these mean the same is a matter of opinion: they count neither for nor against.
UNCLEAR = [
    ("hdm05:grabHighR", "bandai:raise-up-right-hand", "bandai:wave-right-hand", "utd:wave", "utd:catch"),
    ("hdm05:depositFloorR", "utd:pickup_throw", "utkinect:pickUp"),
    ("hdm05:sneak2StepsLStart", "utd:walk", "bandai:walk", "utkinect:walk", "utkinect:carry"),
    ("bandai:walk-turn-left", "bandai:walk-turn-right", "utd:walk", "utkinect:walk", "utkinect:carry"),
    ("utkinect:carry", "utd:walk", "bandai:walk"),
    ("hdm05:throwBasketball", "utkinect:throw", "utd:throw", "utkinect:push"),
    ("hdm05:jogLeftCircle4StepsRstart", "utd:walk", "bandai:walk-turn-left"),
    ("bandai:raise-up-both-hands", "bandai:wave-both-hands", "utkinect:waveHands"),
]


def mean_same(a, b):
    """Whether two keys mean the same: True, False, or None where nobody can say."""
    if a == b or any(a in group and b in group for group in SAME):
        return True
    if a.split(":")[0] != b.split(":")[0] and any(a in group and b in group for group in UNCLEAR):
        return None
    return False


def relate(key, name, keys):
    """Whether a category called ``name``, learned from sets with these ``keys``, means the same as ``key``."""
    told = [mean_same(key, k) for k in keys if k.split(":")[1] == name]
    return True if True in told else None if None in told else False
