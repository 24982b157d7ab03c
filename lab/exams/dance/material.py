"""The recordings of the exam."""

from __future__ import annotations

import re
import zlib
from collections import defaultdict
from pathlib import Path

import numpy as np

import dousa
from lab.exams.dance.bodies import Body, medley
from lab.exams.dance.comparing import follow, residuals, to_30


class Material:
    """The recordings that the candidate has not been trained on."""

    def __init__(self, root):
        self.root, self.cache = Path(root), {}
        self.hdm, self.utd, self.bandai = defaultdict(list), defaultdict(list), defaultdict(list)
        for path in sorted(self.root.glob("hdm05/*/HDM_dg_*")):
            self.hdm[path.parent.name].append(path)
        for path in sorted(self.root.glob("utd_mhad/skeleton/**/a*_s7_t*.c3d")):
            self.utd[path.stem[:3]].append(path)
        for path in sorted(self.root.glob("bandai/**/*.bvh")):
            pair = re.sub(r"_\d+$", "", path.stem)
            if zlib.crc32(pair.encode()) % 3 == 0:
                self.bandai[pair].append(path)
        for pair, paths in self.bandai.items():  # aborted takes are no takes
            lengths = [self.body(p).dirs.shape[0] for p in paths]
            middle = np.median(lengths)
            self.bandai[pair] = [p for p, n in zip(paths, lengths, strict=True) if 0.6 < n / middle < 1.6]
        self.alike = {
            "HDM05": {k: self.same_thing(v) for k, v in self.hdm.items() if len(v) >= 6},
            "UTD": {k: self.same_thing(v) for k, v in self.utd.items()},
            "Bandai": {k: self.same_thing(v) for k, v in self.bandai.items() if "hand" in k},
        }
        # Walks and runs may begin on the other foot: no second take of the same dance.
        for name, least in (("HDM05", 6), ("UTD", 4), ("Bandai", 6)):
            self.alike[name] = {k: v for k, v in self.alike[name].items() if len(v) >= least}
        dance = self.body(next(self.root.glob("bandai_dance/*.bvh")))
        dance = dance.cut(round(42 * dance.rate), len(dance))
        self.dance = [dance.cut(round(a * 30), round(b * 30)) for a, b in ((0, 9), (6, 16), (11, 21))]
        cmu = self.body(next(self.root.glob("cmu86/*.amc")))
        self.cmu = [
            cmu.cut(round(a * cmu.rate), round(b * cmu.rate)) for a, b in ((0, 10), (9, 19), (19, 29), (28, 38))
        ]
        legs = [self.utd[a][0] for a in ("a22", "a23", "a24", "a26", "a27")]
        self.donors = {
            "HDM05": [self.body(p[0]) for p in self.hdm.values()] + self.cmu,
            "Bandai": [self.body(p[0]) for p in self.bandai.values()] + self.dance,
            "UTD": [self.body(p[0]) for p in self.utd.values()] + 3 * [self.body(p) for p in legs],
        }
        self.donors |= {"dance": self.donors["Bandai"], "CMU": self.donors["HDM05"]}

    def body(self, path):
        """A recording, read once."""
        if path not in self.cache:
            self.cache[path] = Body.of(dousa.canonicalise(dousa.read_motion(path)))
        return self.cache[path]

    def takes(self, name, rng):
        """Several real takes of one thing by one person, in a random order."""
        table, least = self.alike[name], 4 if name == "UTD" else 6
        chosen = rng.choice(list(table), 1 if name == "Bandai" else min(4, len(table)), replace=False)
        orders = [rng.permutation(len(table[k])) for k in chosen]
        return [medley([self.body(table[k][o[i]]) for k, o in zip(chosen, orders, strict=True)]) for i in range(least)]

    def same_thing(self, paths, limit=15.0):
        """The takes that do what most others do: a take that a person does otherwise is no clean one."""
        bodies = [to_30(self.body(p).motion()) for p in paths]
        apart = np.array(
            [[residuals(x, y, follow(x, y)).mean() if x is not y else np.nan for x in bodies] for y in bodies]
        )
        return [p for p, row in zip(paths, apart, strict=True) if np.nanmedian(row) <= limit]

    def recording(self, name, index, rng):
        """One recording."""
        if name in ("dance", "CMU"):
            windows = self.dance if name == "dance" else self.cmu
            return windows[index % len(windows)]
        if name == "Bandai":
            pair = list(self.bandai)[index % len(self.bandai)]
            return self.body(self.bandai[pair][rng.integers(len(self.bandai[pair]))])
        table = self.hdm if name == "HDM05" else self.utd
        chosen = sorted(rng.choice(list(table), 4, replace=False), key=lambda k: k == "lieDownFloor")
        return medley([self.body(table[k][rng.integers(len(table[k]))]) for k in chosen])
