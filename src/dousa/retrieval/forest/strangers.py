"""Motions of no category that a library knows: gestures drawn at random (``motion.synthetic.gestures``), described.

The people and the categories of a library show how its own motions differ. How else a body can move they do not show,
least of all where there are few categories, which may be far from each other and yet all look alike beside a gesture
that nobody taught. So every library is told of the same made-up gestures: some stand in the space of the poses as what
a motion may be nearer to than to its category (``pose_space``), and the others are asked while it is learned what a
confidence means (``calibration``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import canonicalise, mirror_canonical
from dousa.motion.synthetic.gestures import make_gesture
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.partial_bodies import hide_joints
from dousa.retrieval.features.posed_motion import PosedMotion

_BESIDE, _ASKED = 80, 40  # gestures; each is there with its mirror image


@dataclass(frozen=True, slots=True, eq=False)
class Strangers:
    """Features of made-up gestures.

    Parameters
    ----------
    beside : (M, T, F) those that stand in spaces of poses.
    asked : (K, T, F) others, that are asked about.
    """

    beside: FloatArray
    asked: FloatArray


def describe_strangers(feature_set: FeatureSet | None) -> Strangers | None:
    """Made-up gestures as a feature set describes them; None for one without banks: the paper knows no strangers."""
    return None if feature_set is None or not feature_set.has_banks else _describe(feature_set)


@lru_cache(maxsize=4)
def _describe(kind: FeatureSet) -> Strangers:
    features = np.stack([kind.compute(kind.complete(hide_joints(one, kind.hidden))) for one in _make_gestures()])
    features.flags.writeable = False
    return Strangers(features[: 2 * _BESIDE], features[2 * _BESIDE :])


@lru_cache(maxsize=1)
def _make_gestures() -> Sequence[PosedMotion]:
    motions = [canonicalise(make_gesture(seed)) for seed in range(_BESIDE + _ASKED)]
    return [side for motion in motions for side in (motion, mirror_canonical(motion))]
