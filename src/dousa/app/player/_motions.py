"""What the player is fed of bare motions: one figure, or two that play in step without being judged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dousa.app.player._data import describe_body
from dousa.app.player._figures import (
    Figure,
    Placed,
    Posed,
    check_max_rate,
    choose_rate,
    encode_array,
    encode_figure,
    encode_match,
    find_floor,
    mean_heading,
    read_figure,
)
from dousa.app.player._texts import PAIR_TEXTS, PLAYER_TEXTS, SINGLE_TEXTS

__all__ = ["encode_motion", "encode_pair"]


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
        **_describe(language, rate, SINGLE_TEXTS[language]),
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
    """Two motions that play in step, as the player wants them; nobody is judged.

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
    from dousa.app.player._in_step import put_in_step

    _check(language, max_rate)
    theirs, ours = read_figure(reference, names[0]), read_figure(performance, names[1])
    rate = choose_rate(ours.frame_rate, ours.duration + theirs.duration, max_rate)
    times, relative = put_in_step(theirs, ours, rate)
    turn = -mean_heading(ours.positions)
    words = dict(PAIR_TEXTS[language])
    if labels is not None:
        words.update(reference=labels[0], performance=labels[1])
    return {
        **_describe(language, rate, words),
        "reference": encode_figure(theirs, theirs.name, rate, Placed(turn + relative)),
        "performance": encode_figure(ours, ours.name, rate, Placed(turn)),
        "step": _encode_times(times, theirs),
        "time": _encode_times(np.arange(len(times)) / rate, theirs),
    }


def _check(language: str, max_rate: float) -> None:
    from dousa.evaluation.words import check_language

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
        "texts": {**PLAYER_TEXTS[language], **words},
    }


def _encode_times(times: np.ndarray, reference: Figure) -> str:
    end = (reference.n_frames - 1) / reference.frame_rate
    return encode_array(encode_match(times, np.arange(len(times), dtype=float), end), "<i4")
