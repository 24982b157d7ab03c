"""Generators of errors that differ in construction, by name.

A judge that was trained on one way to make errors knows that way; the numbers that count are those for a generator
that it never saw. ``"windows"`` edits directions in the world and bends time; ``"joints"`` works on the rotations of
joints; ``"dynamics"`` has limbs follow their targets badly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dousa.motion.canonical.canonicalise import CanonicalMotion
from lab.injection.composition import compose
from lab.injection.dynamics import RECIPES as DYNAMICS
from lab.injection.injection import KINDS, Injection, inject, inject_many
from lab.injection.joint_errors import RECIPES as JOINTS

Generator = Callable[[CanonicalMotion, np.random.Generator, Sequence[CanonicalMotion], int], Injection | None]
"""(carrier, rng, donors, wanted number of errors) -> the wrong motion and its truth, or None if nothing is possible.

The motion has the carrier's frames and frame rate; the truth is measured against the carrier, or, of a limb that is
wrong in a body that is late, against the late carrier. Fewer errors than wanted come where more find no place.
"""

_GAP_S = 0.5


def _generate_windows(
    motion: CanonicalMotion, rng: np.random.Generator, donors: Sequence[CanonicalMotion], wanted: int
) -> Injection | None:
    kinds = [str(kind) for kind in rng.choice(KINDS, size=wanted)]
    if wanted == 1:
        return inject(motion, kinds[0], rng, donors=donors)
    return inject_many(motion, kinds, rng, donors=donors, gap_s=_GAP_S) if kinds else None


def _generate_joints(
    motion: CanonicalMotion, rng: np.random.Generator, donors: Sequence[CanonicalMotion], wanted: int
) -> Injection | None:
    return compose(motion, rng, donors, wanted, JOINTS)


def _generate_dynamics(
    motion: CanonicalMotion, rng: np.random.Generator, donors: Sequence[CanonicalMotion], wanted: int
) -> Injection | None:
    return compose(motion, rng, donors, wanted, DYNAMICS)


GENERATORS: dict[str, Generator] = {
    "windows": _generate_windows,
    "joints": _generate_joints,
    "dynamics": _generate_dynamics,
}
