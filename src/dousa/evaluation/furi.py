"""Furi: the figures that a dance is made of, cut from the self-correlation matrix of the reference.

A figure that is danced again is a line beside the diagonal of the matrix; where such lines begin and end the dance
is cut, and figures on one line have one label. What is never danced again is cut where the motion changes and
rests, and only where it would be too long for one eigenspace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation._cuts import choose_cuts, compute_speed, rate_cuts, snap_cuts
from dousa.evaluation._repeats import Coarse, coarsen, find_repeats
from dousa.evaluation._types import PostureSequence
from dousa.evaluation.eigenspace import Eigenspace, fit_eigenspace
from dousa.evaluation.posture import check_segments

__all__ = ["Furi", "find_furi", "fit_furi_eigenspaces", "name_label"]

# Tuned on synthetic dances and on the recordings that are not held out.
_ALIKE = 0.45  # figures are one if they are nearer to each other than this share of the motion within them
_SAME = 0.01  # and so much, of 1 - S, that even two rests are apart
_MOST_LEARNT = 1500  # postures that make an eigenspace where there are more
_LENGTH_SLACK = 1.6  # figures whose lengths differ by a larger factor are two


@dataclass(frozen=True, slots=True)
class Furi:
    """One figure of a dance.

    Parameters
    ----------
    start, end : frames of the reference, the end not included.
    label : equal figures have equal labels.
    """

    start: int
    end: int
    label: str

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.end - self.start


def find_furi(reference: PostureSequence, min_s: float = 1.0, max_s: float = 10.0) -> tuple[Furi, ...]:
    """Cut a dance into its figures.

    Parameters
    ----------
    reference : the dance.
    min_s, max_s : s, shortest and longest figure. A dance shorter than twice `min_s` is one figure.

    Returns
    -------
    Figures in order of time that cover every frame once. Labels are "A", "B", ... in order of appearance.

    Raises
    ------
    InvalidMotionError : no frame.
    OptionError : lengths that cannot be: `min_s` above 0, `max_s` at least twice that.

    Source: Yamane and Shakunaga, section 3.3, who refer to their earlier paper for the method. Here repetitions
    are found by local alignment on S, relative to their surroundings, since a person who stands resembles
    himself all the time; the cuts are the best ones together (dynamic programming), moved to rests nearby.
    """
    if not (min_s > 0 and 2 * min_s <= max_s and np.isfinite(max_s)):
        raise OptionError(f"furi: expected 0 < min_s and 2 min_s <= max_s, got {min_s} s and {max_s} s")
    segments, rate = check_segments(reference.segments, "reference"), reference.frame_rate
    n_frames = len(segments)
    if n_frames == 0:
        raise InvalidMotionError("reference: expected at least one frame, got none")
    if n_frames < 2 * min_s * rate:
        return (Furi(0, n_frames, "A"),)
    coarse = coarsen(segments, rate)
    repeats = find_repeats(coarse, min_s)
    speed = compute_speed(segments, rate)
    cuts = choose_cuts(rate_cuts(coarse, repeats, speed), coarse.rate, min_s, max_s)
    labels = _label(cuts, coarse)
    frames = snap_cuts(cuts, coarse, speed, min_s)
    return tuple(
        Furi(start, end, label) for start, end, label in zip(frames[:-1], frames[1:], labels, strict=True)
    )


def name_label(number: int) -> str:
    """Letters for the number of a figure from 0: A, B, ... Z, AA, AB, ..."""
    letters = ""
    number += 1
    while number:
        number, digit = divmod(number - 1, 26)
        letters = chr(ord("A") + digit) + letters
    return letters


def _label(cuts: Sequence[int], coarse: Coarse) -> list[str]:
    """One label a figure; figures are joined, nearest first, as long as a group's figures are alike on average."""
    from dousa.evaluation._repeat_kernels import compare_stretches

    apart, within = compare_stretches(coarse.similarity, np.array(cuts, np.int64), _LENGTH_SLACK)
    tolerated = _ALIKE * np.minimum(within, within.T) + _SAME
    distance = (apart / tolerated).astype(np.float64)
    np.fill_diagonal(distance, np.inf)
    group = np.arange(len(distance))
    sizes = np.ones(len(distance))
    while len(distance) > 1:
        one, other = divmod(int(distance.argmin()), len(distance))
        if not distance[one, other] < 1.0:
            break
        joint = (sizes[one] * distance[one] + sizes[other] * distance[other]) / (sizes[one] + sizes[other])
        joint[one] = np.inf
        distance[one], distance[:, one] = joint, joint
        distance[other], distance[:, other] = np.inf, np.inf
        sizes[one] += sizes[other]
        group[group == other] = one
    names: dict[int, str] = {}
    return [names.setdefault(int(g), name_label(len(names))) for g in group]


def fit_furi_eigenspaces(
    reference: PostureSequence,
    furi: Sequence[Furi],
    contribution: float = 0.99,
    more: Mapping[str, ArrayLike] | None = None,
    yaw: str = "robust",
) -> dict[str, Eigenspace]:
    """One eigenspace for each label: equal figures share it.

    Parameters
    ----------
    reference : the dance.
    furi : its figures.
    contribution : share of the variance that the axes hold.
    more : postures (N, 9, 3) of further takes by label.
    yaw : ``"robust"`` or ``"plain"``.

    Returns
    -------
    Eigenspaces by label, in order of appearance. Frames in which a segment is not seen are left out, unless all
    frames of the label are like that. Of a label with more than 1,500 frames every second, third ... is taken, so
    that at most 1,500 are: neighbours at a high frame rate say the same.

    Raises
    ------
    InvalidMotionError : a figure outside the reference.
    OptionError : as in `fit_eigenspace`.

    Source: Yamane and Shakunaga, section 3.3.
    """
    whole = np.all(reference.seen, axis=1)
    frames: dict[str, list[NDArray[np.intp]]] = {}
    for figure in furi:
        if not 0 <= figure.start < figure.end <= reference.n_frames:
            raise InvalidMotionError(
                f"furi {figure.label}: expected frames within 0 to {reference.n_frames}, got "
                f"{figure.start} to {figure.end}"
            )
        frames.setdefault(figure.label, []).append(np.arange(figure.start, figure.end))
    spaces = {}
    for label, parts in frames.items():
        chosen = np.concatenate(parts)
        seen = chosen[whole[chosen]]
        postures = reference.segments[seen if len(seen) else chosen]
        if more is not None and label in more:
            postures = np.concatenate([postures, check_segments(more[label], f"more[{label!r}]")])
        step = -(-len(postures) // _MOST_LEARNT)
        spaces[label] = fit_eigenspace(postures[::step], contribution, yaw=yaw)
    return spaces
