"""Furi: the figures that a dance is made of, cut from the self-correlation matrix of the reference.

A figure that is danced again is a line beside the diagonal of the matrix; where such lines begin and end the dance
is cut, and figures on one line have one label. What is never danced again is cut where the motion changes and
rests, and only where it would be too long for one eigenspace.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.evaluation.alignment.dynamic_programming import compare_stretches
from dousa.evaluation.figures.cuts import (
    Coarse,
    choose_cuts,
    coarsen,
    compute_speed,
    find_repeats,
    rate_cuts,
    snap_cuts,
)
from dousa.evaluation.figures.eigenspace import Eigenspace, fit_eigenspace
from dousa.evaluation.posture.posture import PostureSequence, check_segments
from dousa.files.disk import read_small_text
from dousa.motion import CanonicalMotion


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
        raise OptionError("furi.lengths", min_s=min_s, max_s=max_s)
    segments, rate = check_segments(reference.segments, "reference"), reference.frame_rate
    n_frames = len(segments)
    if n_frames == 0:
        raise InvalidMotionError("postures.no_frame", what="reference")
    if n_frames < 2 * min_s * rate:
        return (Furi(0, n_frames, "A"),)
    coarse = coarsen(segments, rate)
    repeats = find_repeats(coarse, min_s)
    speed = compute_speed(segments, rate)
    cuts = choose_cuts(rate_cuts(coarse, repeats, speed), coarse.rate, min_s, max_s)
    labels = _label(cuts, coarse)
    frames = snap_cuts(cuts, coarse, speed, min_s)
    return tuple(Furi(start, end, label) for start, end, label in zip(frames[:-1], frames[1:], labels, strict=True))


def name_label(number: int) -> str:
    """Name the number of a figure from 0 by letters: A, B, ... Z, AA, AB, ..."""
    letters = ""
    number += 1
    while number:
        number, digit = divmod(number - 1, 26)
        letters = chr(ord("A") + digit) + letters
    return letters


def _label(
    cuts: Sequence[int], coarse: Coarse, *, nearer_than: float = 0.45, length_slack: float = 1.6, same: float = 0.01
) -> list[str]:
    """One label a figure; figures are joined, nearest first, as long as a group's figures are similar on average."""
    # same: 1 - S that even two rests are apart; tuned on synthetic dances and on recordings that are not held out
    # nearer_than: figures are one if they are nearer to each other than this share of the motion within them;
    # length_slack: figures whose lengths differ by a larger factor are two
    apart, within = compare_stretches(coarse.similarity, np.array(cuts, np.int64), length_slack)
    tolerated = nearer_than * np.minimum(within, within.T) + same
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
    *,
    most_learnt: int = 1500,
) -> dict[str, Eigenspace]:
    """Fit one eigenspace for each label: equal figures share it.

    Parameters
    ----------
    reference : the dance.
    furi : its figures.
    contribution : share of the variance that the axes hold.
    more : postures (N, 9, 3) of further takes by label.
    yaw : ``"robust"`` or ``"plain"``.
    most_learnt : largest number of postures that an eigenspace is made from.

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
                "furi.outside",
                label=figure.label,
                n_frames=reference.n_frames,
                start=figure.start,
                end=figure.end,
            )
        frames.setdefault(figure.label, []).append(np.arange(figure.start, figure.end))
    spaces = {}
    for label, parts in frames.items():
        chosen = np.concatenate(parts)
        seen = chosen[whole[chosen]]
        postures = reference.segments[seen if len(seen) else chosen]
        if more is not None and label in more:
            postures = np.concatenate([postures, check_segments(more[label], f"more[{label!r}]")])
        step = -(-len(postures) // most_learnt)
        spaces[label] = fit_eigenspace(postures[::step], contribution, yaw=yaw)
    return spaces


_LONGEST_LABEL = 100  # letters, see docs/evaluation.md
_VALUE = r"[^\s,;\-–—−~〜～]+"
_LINE = re.compile(rf"({_VALUE})\s*[\s,;\-–—−~〜～]\s*({_VALUE})(?:[\s,;]+(.*))?", re.DOTALL)
_HEADING = re.compile(r"(start|begin|from|開始)\w*[\s,;]+(end|stop|to|終了)\w*([\s,;].*)?", re.IGNORECASE)
_FRAME = re.compile(r"\d{1,20}", re.ASCII)
_SECONDS = re.compile(r"(\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})s(?:ec)?", re.ASCII | re.IGNORECASE)
_CLOCK = re.compile(r"(?:(\d{1,4}):)?(\d{1,6}):(\d{1,2}(?:\.\d{0,9})?)", re.ASCII)


def read_furi(path: str | os.PathLike[str], frame_rate: float, n_frames: int) -> tuple[Furi, ...]:
    """Read where the figures of a dance begin and end.

    Parameters
    ----------
    path : text as the module's docstring says.
    frame_rate : Hz, of the reference.
    n_frames : of the reference.

    Returns
    -------
    Figures in order of time; `uncovered` tells what lies between them.

    Raises
    ------
    MotionFileError : the file cannot be read or has no figure; a line that is none; a figure that ends before it
        begins, lies outside the reference, or overlaps another.
    """
    found: list[tuple[int, int, str, int]] = []
    for number, line in enumerate(read_small_text(path).splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content or (not found and _HEADING.fullmatch(content)):
            continue
        try:
            found.append((*_parse_line(content, frame_rate, n_frames), number))
        except OptionError as error:
            raise MotionFileError(path, error.message, line=number) from None
    if not found:
        raise MotionFileError(path, "furi_file.no_line")
    found.sort()
    for (_, end, _, one), (start, _, _, other) in pairwise(found):
        if start < end:
            raise MotionFileError(path, "furi_file.overlap", line=max(one, other), other=min(one, other))
    return _name(found)


def _parse_line(content: str, frame_rate: float, n_frames: int, *, slack_s: float = 0.1) -> tuple[int, int, str]:
    """Start, end (not included) and label; an OptionError says what is wrong."""
    # slack_s: people round: the last figure may end so much after the dance
    match = _LINE.fullmatch(content)
    if match is None:
        raise OptionError("furi_file.form", found=_quote(content))
    first, last, label = match[1], match[2], _clean(match[3] or "")
    if len(label) > _LONGEST_LABEL:
        raise OptionError("furi_file.long_label", most=_LONGEST_LABEL, length=len(label), label=_quote(label))
    if _FRAME.fullmatch(first) and _FRAME.fullmatch(last):
        start, end = int(first) - 1, int(last)
        if start < 0 or end > n_frames:
            raise OptionError("furi_file.frames", n_frames=n_frames, first=first, last=last)
    else:
        times = [text for text in (first, last) if not _FRAME.fullmatch(text)]
        seconds = [_parse_time(text) for text in times]
        if len(times) == 1:
            raise OptionError("furi_file.mixed", first=first, last=last)
        if seconds[1] > n_frames / frame_rate + slack_s:
            raise OptionError("furi_file.late", end_s=n_frames / frame_rate, last=last)
        start, end = (min(round(s * frame_rate), n_frames) for s in seconds)
    if start >= end:
        raise OptionError("furi_file.order", first=first, last=last)
    return start, end, label


def _parse_time(text: str) -> float:
    """Seconds."""
    if match := _SECONDS.fullmatch(text):
        return float(match[1])
    if match := _CLOCK.fullmatch(text):
        return 3600.0 * int(match[1] or 0) + 60.0 * int(match[2]) + float(match[3])
    if re.fullmatch(r"\d*\.\d*", text):
        raise OptionError("furi_file.bare_seconds", found=_quote(text))
    raise OptionError("furi_file.time", found=_quote(text))


def _clean(label: str) -> str:
    return " ".join(label.split()).strip("\"' ")


def _quote(text: str, *, shown: int = 40) -> str:
    return repr(text if len(text) <= shown else text[:shown] + "...")


def _name(found: Sequence[tuple[int, int, str, int]]) -> tuple[Furi, ...]:
    """Figures without a label get one that no other has."""
    given = {label for _, _, label, _ in found}
    names = (name for number in range(2 * len(found)) if (name := name_label(number)) not in given)
    return tuple(Furi(start, end, label or next(names)) for start, end, label, _ in found)


def format_furi(furi: Sequence[Furi], frame_rate: float) -> str:
    """Write the text of a furi file, of which `read_furi` reads the same.

    Parameters
    ----------
    furi : figures.
    frame_rate : Hz, for the times in the comments.

    Raises
    ------
    OptionError : a label that a furi file cannot hold: empty, with ``#``, with spaces, commas or quotes around it,
        longer than 100 letters.
    """
    lines = [f"# start-end label, frames from 1, last one included, {frame_rate:g} frames/s"]
    for figure in furi:
        if not can_hold(figure.label):
            raise OptionError("furi_file.label", label=figure.label[:40])
        times = f"{_clock(figure.start / frame_rate)} to {_clock(figure.end / frame_rate)}"
        lines.append(f"{figure.start + 1}-{figure.end} {figure.label}  # {times}")
    return "\n".join(lines) + "\n"


def can_hold(label: str) -> bool:
    """Whether a furi file can hold a label."""
    match = _LINE.fullmatch(f"1-2 {label}")
    plain = label.isprintable() and "#" not in label
    whole = match is not None and match[3] == label == _clean(label)
    return plain and whole and 0 < len(label) <= _LONGEST_LABEL


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(1000 * seconds), 60_000)
    return f"{minutes}:{rest / 1000:06.3f}"


def uncovered(furi: Sequence[Furi], n_frames: int) -> tuple[tuple[int, int], ...]:
    """List the (start, end) frames, half-open, of a reference of n frames that belong to none of the figures."""
    places = [0, *(frame for figure in furi for frame in (figure.start, figure.end)), n_frames]
    return tuple((a, b) for a, b in zip(places[::2], places[1::2], strict=True) if a < b)


def scale_furi(furi: Sequence[Furi], take: CanonicalMotion, postures: PostureSequence) -> tuple[Furi, ...]:
    """Convert figures to frames of the resampled reference."""
    ratio = postures.frame_rate / take.frame_rate
    scaled = []
    for one in furi:
        if not 0 <= one.start < one.end <= take.n_frames:
            raise OptionError("evaluation.furi_outside", n_frames=take.n_frames, start=one.start, end=one.end)
        # However few frames there are, each figure has one.
        start = min(round(one.start * ratio), postures.n_frames - 1)
        end = min(round(one.end * ratio), postures.n_frames)
        scaled.append(Furi(start, max(end, start + 1), one.label))
    return tuple(scaled)


def pool_takes(warped: Sequence[PostureSequence], furi: Sequence[Furi]) -> dict[str, FloatArray]:
    """Collect the postures of the further takes by label."""
    if not warped:
        return {}
    labels = dict.fromkeys(one.label for one in furi)
    return {
        label: np.concatenate(
            [take.segments[one.start : one.end] for take in warped for one in furi if one.label == label]
        )
        for label in labels
    }
