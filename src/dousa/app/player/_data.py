"""What the player is fed of an assessment: both figures, which moments belong together, events and words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dousa.app.player._figures import (
    MILLIMETRES,
    Placed,
    check_max_rate,
    choose_rate,
    encode_array,
    encode_figure,
    encode_match,
    frames_at,
    mean_heading,
)
from dousa.app.player._in_step import find_turn
from dousa.app.player._texts import KIND_LETTERS, PLAYER_TEXTS
from dousa.evaluation._types import Assessment
from dousa.motion.joints import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.joints import JOINT_INDEX as J

__all__ = ["describe_body", "encode_player_data"]


def encode_player_data(
    assessment: Assessment, language: str = "en", max_rate: float = 30.0
) -> dict[str, Any]:
    """An assessment as the player wants it: plain values that JSON can hold.

    Parameters
    ----------
    assessment : any; only its fields are read.
    language : ``"en"`` or ``"ja"``, of buttons and names.
    max_rate : Hz, at most so many frames a second are stored; fewer if the recording has fewer, or if both
        figures together would be more than 13,500 frames (3:45 at 30 Hz).

    Returns
    -------
    ``rate`` Hz; ``reference`` and ``performance`` with ``positions`` (n_frames, 20, 3) int16 mm over the floor and
    about the hips' middle, ``path`` (n_frames, 2) int32 mm of that middle (x, z), both base64, and ``stature`` m;
    ``step`` and ``time``: base64 int32, for each frame of the performance the reference's time in ms that it
    resembles, and that it has if the tempo is kept, the nearest one as -1 - ms where there is none; ``joints``,
    ``parents``, ``segments``, ``events``, ``furi``, ``kinds``, ``texts``. Both figures face +Z on average.

    Raises
    ------
    OptionError : another language, or a rate that is not above 0.
    """
    from dousa.evaluation.words import check_language

    check_language(language)
    check_max_rate(max_rate)
    performance, reference = assessment.performance, assessment.reference
    rate = choose_rate(performance.frame_rate, performance.duration + reference.duration, max_rate)
    frames = frames_at(performance, rate)
    end = (reference.n_frames - 1) / reference.frame_rate
    step = encode_match(assessment.matched_time, frames, end)
    same = encode_match(assessment.same_time, frames, end)
    turn = -mean_heading(performance.positions)
    reference_turn = turn + _relative_heading(assessment)
    start = step[0] if step[0] >= 0 else -1 - step[0]
    first = round(start / MILLIMETRES * reference.frame_rate)
    return {
        "version": 1,
        "language": language,
        "rate": rate,
        "reference": encode_figure(reference, reference.name, rate, Placed(reference_turn, origin=first)),
        "performance": encode_figure(performance, performance.name, rate, Placed(turn)),
        "step": encode_array(step, "<i4"),
        "time": encode_array(same, "<i4"),
        **describe_body(language),
        "events": _describe_events(assessment),
        "furi": _describe_furi(assessment),
        "kinds": _describe_kinds(language),
        "texts": dict(PLAYER_TEXTS[language]),
    }


def _relative_heading(assessment: Assessment) -> float:
    """Angle about +Y, rad, that turns the reference to look where the performance looks; eq. 7 over all frames."""
    for times in (assessment.matched_time, assessment.same_time):
        frames = np.rint(np.asarray(times, dtype=float) * assessment.reference.frame_rate)
        seen = np.isfinite(frames) & (frames >= 0) & (frames < assessment.reference.n_frames)
        if seen.any():
            ours = assessment.performance.segments[seen]
            theirs = assessment.reference.segments[frames[seen].astype(int)]
            turn = find_turn(ours, theirs)
            if turn is not None:
                return turn
    return mean_heading(assessment.performance.positions) - mean_heading(assessment.reference.positions)


def _seconds(value: float) -> float | None:
    return round(float(value), 4) if math.isfinite(value) else None


def describe_body(language: str) -> dict[str, Any]:
    """``joints``, ``parents`` and ``segments`` of the data."""
    from dousa.evaluation.posture import SEGMENT_JOINTS, SEGMENTS
    from dousa.evaluation.words import SEGMENT_WORDS

    return {
        "joints": list(CANONICAL_JOINTS),
        "parents": list(CANONICAL_PARENTS),
        "segments": [
            {"name": name, "label": SEGMENT_WORDS[language][name], "joints": [J[start], J[end]]}
            for name, (start, end) in zip(SEGMENTS, SEGMENT_JOINTS, strict=True)
        ],
    }


def _describe_kinds(language: str) -> dict[str, dict[str, str]]:
    from dousa.evaluation.words import KIND_WORDS

    return {
        kind: {"label": label, "letter": KIND_LETTERS[language][kind]}
        for kind, label in KIND_WORDS[language].items()
    }


def _describe_events(assessment: Assessment) -> list[dict[str, Any]]:
    return [
        {
            "kind": event.kind,
            "start": _seconds(event.start_s),
            "end": _seconds(event.end_s),
            "worst": _seconds(event.worst_s),
            "segments": list(event.segments),
            "says": event.says,
        }
        for event in sorted(assessment.events, key=lambda event: (event.start_s, event.end_s))
        if math.isfinite(event.start_s) and math.isfinite(event.end_s)
    ]


def _describe_furi(assessment: Assessment) -> list[dict[str, Any]]:
    return [
        {"start": _seconds(furi.start_s), "end": _seconds(furi.end_s), "label": furi.label}
        for furi in assessment.furi
        if math.isfinite(furi.start_s) and math.isfinite(furi.end_s)
    ]
