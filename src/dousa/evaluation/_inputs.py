"""What an assessment is given, checked and brought to one rate: motions, weights, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation._types import PostureSequence
from dousa.evaluation.furi import Furi
from dousa.evaluation.posture import SEGMENTS
from dousa.evaluation.weights_file import LEVELS
from dousa.motion import CanonicalMotion
from dousa.motion._types import FloatArray

__all__ = [
    "FEWEST_FRAMES",
    "SHORTEST_S",
    "check_seen",
    "check_takes",
    "pool_takes",
    "scale_furi",
    "spread_weights",
]

SHORTEST_S, FEWEST_FRAMES = 0.5, 3  # of a motion that can be assessed

_LARGEST_WEIGHT = 1e6


def check_takes(
    takes: Sequence[CanonicalMotion], performance: CanonicalMotion, side: str, tempo: str
) -> None:
    """Say what is wrong with motions or options before anything is computed."""
    if not takes:
        raise InvalidMotionError("evaluation: expected at least one reference, got none")
    if side not in ("same", "mirrored"):
        raise OptionError(f"side: expected 'same' or 'mirrored', got {side!r}")
    if tempo not in ("same", "free"):
        raise OptionError(f"tempo: expected 'same' or 'free', got {tempo!r}")
    for what, motion in (*(("reference", take) for take in takes), ("performance", performance)):
        if motion.duration < SHORTEST_S or motion.n_frames < FEWEST_FRAMES:
            raise InvalidMotionError(
                f"{what}: expected a motion of at least {SHORTEST_S} s and {FEWEST_FRAMES} frames, got "
                f"{motion.n_frames} frames at {motion.frame_rate:g} Hz ({motion.duration:.2f} s)"
            )


def check_seen(postures: PostureSequence, what: str) -> None:
    """Say who is not seen."""
    seen_s = postures.seen.any(axis=1).sum() / postures.frame_rate
    if seen_s < SHORTEST_S:
        raise InvalidMotionError(
            f"{what}: expected a body that is seen for at least {SHORTEST_S} s, got {seen_s:.2f} s of "
            f"{postures.duration:.2f} s; the rest is missing (nan)"
        )


def spread_weights(weights: Mapping[str, float] | None) -> FloatArray:
    """(9,) weights; those above 0 have a mean of 1, so that leaving limbs out makes nobody stricter with the rest."""
    given = dict(weights or {})
    known = [name for level in LEVELS for name in level]
    for name, value in given.items():
        if name not in known:
            raise OptionError(f"weights: expected names of {', '.join(known)}, got {name!r}")
        if not isinstance(value, int | float) or not 0.0 <= value <= _LARGEST_WEIGHT:
            raise OptionError(f"weights: {name}: expected a number from 0 to a million, got {value!r}")
    shares = np.ones(len(SEGMENTS))
    for level in LEVELS:  # what is named more exactly counts, in whatever order it comes
        for name in level.keys() & given.keys():
            shares[[SEGMENTS.index(segment) for segment in level[name]]] = given[name]
    if shares.sum() <= 0.0:
        raise OptionError("weights: expected at least one weight above 0")
    return shares / shares[shares > 0.0].mean()


def scale_furi(furi: Sequence[Furi], take: CanonicalMotion, postures: PostureSequence) -> tuple[Furi, ...]:
    """Figures in frames of the resampled reference."""
    ratio = postures.frame_rate / take.frame_rate
    scaled = []
    for one in furi:
        if not 0 <= one.start < one.end <= take.n_frames:
            raise OptionError(
                f"furi: expected frames between 0 and {take.n_frames} of the reference, got {one.start} to {one.end}"
            )
        # However few frames there are, each figure has one.
        start = min(round(one.start * ratio), postures.n_frames - 1)
        end = min(round(one.end * ratio), postures.n_frames)
        scaled.append(Furi(start, max(end, start + 1), one.label))
    return tuple(scaled)


def pool_takes(warped: Sequence[PostureSequence], furi: Sequence[Furi]) -> dict[str, FloatArray]:
    """Postures of the further takes by label."""
    if not warped:
        return {}
    labels = dict.fromkeys(one.label for one in furi)
    return {
        label: np.concatenate(
            [take.segments[one.start : one.end] for take in warped for one in furi if one.label == label]
        )
        for label in labels
    }
