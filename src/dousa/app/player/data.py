"""What the player is fed of an assessment or of motions: figures, which moments belong together, events and words; and
its script and style as text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from dousa.app.player.figures import (
    MILLIMETRES,
    Placed,
    Posed,
    check_max_rate,
    choose_rate,
    encode_array,
    encode_figure,
    encode_match,
    find_floor,
    frames_at,
    mean_heading,
    read_figure,
)
from dousa.app.player.in_step import find_turn, put_in_step
from dousa.arrays import FloatArray
from dousa.evaluation.exercises.repetitions import RepetitionsAssessment
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import SEGMENT_JOINTS, SEGMENTS
from dousa.evaluation.words import KINDS, SEGMENT_NAMES, check_language, name_all
from dousa.messages import load_section
from dousa.motion.canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J


def encode_player_data(assessment: Assessment, language: str = "en", max_rate: float = 30.0) -> dict[str, Any]:
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
    _check(language, max_rate)
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
    words = load_section("report", language)
    return {
        **_describe(language, rate, {}),
        "assessed": True,
        "reference": encode_figure(reference, reference.name, rate, Placed(reference_turn, origin=first)),
        "performance": encode_figure(performance, performance.name, rate, Placed(turn)),
        "step": encode_array(step, "<i4"),
        "time": encode_array(same, "<i4"),
        "events": _describe_events(assessment, language),
        "furi": [
            {"start": _seconds(furi.start_s), "end": _seconds(furi.end_s), "label": furi.label}
            for furi in assessment.furi
            if math.isfinite(furi.start_s) and math.isfinite(furi.end_s)
        ],
        "kinds": {
            kind: {"label": label, "letter": words[f"letter_{kind}"]}
            for kind, label in name_all(KINDS, language).items()
        },
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
    return {
        "joints": list(CANONICAL_JOINTS),
        "parents": list(CANONICAL_PARENTS),
        "segments": [
            {"name": name, "label": SEGMENT_NAMES[name].render(language), "joints": [J[start], J[end]]}
            for name, (start, end) in zip(SEGMENTS, SEGMENT_JOINTS, strict=True)
        ],
    }


def _describe_events(assessment: Assessment, language: str) -> list[dict[str, Any]]:
    return [
        {
            "kind": event.kind,
            "start": _seconds(event.start_s),
            "end": _seconds(event.end_s),
            "worst": _seconds(event.worst_s),
            "segments": list(event.segments),
            "says": event.says.render(language),
        }
        for event in sorted(assessment.events, key=lambda event: (event.start_s, event.end_s))
        if math.isfinite(event.start_s) and math.isfinite(event.end_s)
    ]


def encode_motion(
    motion: Posed,
    name: str = "",
    *,
    language: str = "en",
    max_rate: float = 30.0,
    like: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """One figure as the player wants it: plain values that JSON can hold.

    Parameters
    ----------
    motion : canonical joints, such as CanonicalMotion or the Trajectories of a library; gaps are bridged.
    name : shown over the figure.
    language : ``"en"`` or ``"ja"``, of the buttons.
    max_rate : Hz, as of `encode_player_data`.
    like : data that this function made of an earlier state of the same recording, which has grown since: its facing
        is kept, and its floor unless the feet went below it, so that the figure does not turn or jump.

    Returns
    -------
    As `encode_player_data`: the figure is ``performance``; ``reference``, ``step`` and ``time`` are None; no events,
    furi or kinds, and ``assessed`` False. Also ``facing`` (rad, heading that now faces +Z) and ``floor`` (m).

    Raises
    ------
    OptionError : another language, or a rate that is not above 0.
    InvalidMotionError : no frame, or anything but 20 canonical joints.
    """
    _check(language, max_rate)
    figure = read_figure(motion, name)
    facing, floor = mean_heading(figure.positions), find_floor(figure.positions)
    if like is not None:
        facing, floor = float(like["facing"]), min(floor, float(like["floor"]))
    rate = choose_rate(figure.frame_rate, figure.duration, max_rate)
    return {
        **_describe(language, rate, {**load_section("player_single", language), "performance": ""}),
        "reference": None,
        "performance": encode_figure(figure, name, rate, Placed(-facing, floor)),
        "step": None,
        "time": None,
        "facing": facing,
        "floor": floor,
    }


def encode_pair(
    reference: Posed,
    performance: Posed,
    *,
    names: tuple[str, str] = ("", ""),
    labels: tuple[str, str] | None = None,
    language: str = "en",
    max_rate: float = 30.0,
) -> dict[str, Any]:
    """Encode two motions that play in step for the player; neither is judged.

    Parameters
    ----------
    reference, performance : as `motion` of `encode_motion`; times are those of the performance.
    names : of reference and performance, shown over them.
    labels : words for their parts, such as ``("query", "match")``; None for "reference" and "performance".
    language, max_rate : as of `encode_player_data`.

    Returns
    -------
    As `encode_player_data`, without events, furi and kinds, ``assessed`` False. ``step`` goes from the reference's
    first frame to its last at a bounded tempo (see `put_in_step`); ``time`` starts both at once. The performance
    faces +Z on average, the reference is turned to look where the performance looks.

    Raises
    ------
    OptionError, InvalidMotionError : as `encode_motion`.
    """
    _check(language, max_rate)
    theirs, ours = read_figure(reference, names[0]), read_figure(performance, names[1])
    rate = choose_rate(ours.frame_rate, ours.duration + theirs.duration, max_rate)
    times, relative = put_in_step(theirs, ours, rate)
    frames = np.arange(float(len(times)))
    turn = -mean_heading(ours.positions)
    words = load_section("player_pair", language)
    if labels is not None:
        words.update(reference=labels[0], performance=labels[1])
    return {
        **_describe(language, rate, words),
        "reference": encode_figure(theirs, theirs.name, rate, Placed(turn + relative)),
        "performance": encode_figure(ours, ours.name, rate, Placed(turn)),
        "step": _encode_times(times, theirs, frames),
        "time": _encode_times(frames / rate, theirs, frames),
    }


def encode_repetitions(
    done: RepetitionsAssessment, performance: Posed, name: str = "", *, language: str = "en", max_rate: float = 30.0
) -> dict[str, Any]:
    """An exercise as the player wants it: beside each repetition that was graded the reference does one.

    Parameters
    ----------
    done : the repetitions.
    performance : the recording that they are of, mirrored if they were measured so.
    name : shown over the figure.
    language, max_rate : as of `encode_player_data`.

    Returns
    -------
    As `encode_pair`; ``furi`` are the repetitions by number. ``reference`` is None where nothing was graded. ``step``
    shows the reference's matching pose, ``time`` the reference at its own tempo; between repetitions it waits.
    """
    graded = [one for one in done.repetitions if one.assessment is not None]
    spans = [(one.repetition.start_s, one.repetition.end_s) for one in done.repetitions]
    furi = [{"start": _seconds(a), "end": _seconds(b), "label": str(n)} for n, (a, b) in enumerate(spans, 1)]
    ours = read_figure(performance, name)
    if not graded or graded[0].assessment is None:
        return {**encode_motion(ours, name, language=language, max_rate=max_rate), "furi": furi}
    _check(language, max_rate)
    first = graded[0].assessment
    model = first.reference
    rate = choose_rate(ours.frame_rate, ours.duration + model.duration, max_rate)
    matched, same = np.full((2, len(ours.positions)), np.nan)
    for one in graded:
        if one.assessment is not None:
            start = round(one.first_s * ours.frame_rate)
            times = one.assessment.matched_time[: len(matched) - start]
            matched[start : start + len(times)] = times
            own = np.arange(len(times)) / ours.frame_rate
            same[start : start + len(times)] = np.where(own < model.duration, own, np.nan)
    frames = frames_at(ours, rate)
    turn = -mean_heading(first.performance.positions)
    return {
        **_describe(language, rate, load_section("player_pair", language)),
        "reference": encode_figure(model, model.name, rate, Placed(turn + _relative_heading(first))),
        "performance": encode_figure(ours, ours.name, rate, Placed(turn)),
        "step": _encode_times(matched, model, frames),
        "time": _encode_times(same, model, frames),
        "furi": furi,
    }


def _check(language: str, max_rate: float) -> None:
    check_language(language)
    check_max_rate(max_rate)


def _describe(language: str, rate: float, words: Mapping[str, str]) -> dict[str, Any]:
    return {
        "version": 1,
        "language": language,
        "rate": rate,
        "assessed": False,
        **describe_body(language),
        "events": [],
        "furi": [],
        "kinds": {},
        "texts": {**load_section("player", language), **words},
    }


def _encode_times(times: FloatArray, reference: Posed, frames: FloatArray) -> str:
    end = (len(reference.positions) - 1) / reference.frame_rate
    return encode_array(encode_match(times, frames, end), "<i4")


SCRIPT_PARTS: tuple[str, ...] = (
    "theme.js",
    "geometry.js",
    "figure.js",
    "stage.js",
    "controls.js",
    "player.js",
    "clock.js",
    "miniature_figure.js",
    "miniatures.js",
    "api.js",
)
"""In the order in which they use each other."""

# Inside a script element "</script" and "<!--" end or bend the page; U+2028 and U+2029 end lines of old scripts.
_UNSAFE = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}


def read_script_part(name: str) -> str:
    """A file of the player."""
    return (files("dousa.app.player") / name).read_text(encoding="utf-8")


def read_player_script() -> str:
    """The whole script of the player; it makes ``window.dousa`` and no other global name."""
    parts = "\n".join(read_script_part(name) for name in SCRIPT_PARTS)
    return f'(() => {{\n"use strict";\n{parts}\n}})();\n'


def read_player_style() -> str:
    """The style sheet of player and miniatures; elsewhere it sets only variables that say which theme is on."""
    return read_script_part("player.css")


def format_player_data(data: Mapping[str, Any]) -> str:
    """Data as JSON that may stand inside a ``<script type="application/json">`` element, whatever the words are.

    Parameters
    ----------
    data : of `encode_player_data`, or anything that JSON can hold.
    """
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).translate(_UNSAFE)
