"""The accents of a dance against the beats of its music: early or late, steady or drifting; as plot and table."""

from __future__ import annotations

import math

import numpy as np

from dousa.app.drawing.charts import Plot, choose_ticks, time_ticks, x_labels
from dousa.app.drawing.markup import element, format_number
from dousa.app.report.curves import build_details, build_table, format_optional
from dousa.evaluation.beats.accents import ACCENTS
from dousa.evaluation.beats.beats import BeatTiming, TimedAccent
from dousa.evaluation.words import format_time
from dousa.messages import load_section

_LEAST_MS = 100.0  # that the plot reaches to either side
_MOST_DOTS = 600


def build_beats(timing: BeatTiming | None, duration: float, language: str) -> str:
    """The whole section; empty without music.

    Parameters
    ----------
    timing : of `dousa.evaluation.assess_timing`.
    duration : s, of the performance.
    language : ``"en"`` or ``"ja"``.
    """
    if timing is None:
        return ""
    words = load_section("report_beats", language)
    said = "".join(element("p", {"class": "beat-says"}, message.render(language)) for message in timing.messages)
    inner = element("h2", None, words["title"]) + said + _facts(timing, words)
    inner += element("div", {"class": "card plot-card"}, inner=_draw(timing, duration, words))
    heads = [words[f"col_{name}"] for name in ("time", "kind", "parts", "beat", "off")]
    table = build_table(heads, [_row(one, words, language) for one in timing.accents], words["table"])
    inner += build_details(words["table"], table, len(timing.accents))
    return element("section", {"id": "beats"}, inner=inner)


def _facts(timing: BeatTiming, words: dict[str, str]) -> str:
    pairs = [
        (words["tempo"], words["per_minute"].format(tempo=format_number(timing.tempo, 0))),
        (words["accents"], words["of"].format(n=len(timing.on_beat), of=len(timing.accents))),
        (words["median"], words["unknown"] if math.isnan(timing.median_ms) else _say_ms(timing.median_ms, words)),
        (words["spread"], words["within"].format(ms=format_number(timing.spread_ms, 0))),
        (words["drift"], _say_drift(timing, words)),
        (words["agreement"], f"{format_number(100.0 * timing.agreement, 0)} %"),
    ]
    items = "".join(
        element("div", None, inner=element("dt", None, name) + element("dd", None, value)) for name, value in pairs
    )
    return element("dl", {"class": "facts beat-facts"}, inner=items)


def _say_ms(value: float, words: dict[str, str]) -> str:
    if abs(value) < 1.0:
        return words["on_time"]
    return words["late" if value > 0 else "early"].format(ms=format_number(abs(value), 0))


def _say_drift(timing: BeatTiming, words: dict[str, str]) -> str:
    drift = timing.drift_ms_per_min
    if not math.isfinite(drift):
        return "–"
    if not timing.drift_distinguishable:
        return words["no_drift"]
    return words["drift_late" if drift > 0 else "drift_early"].format(ms=format_number(abs(drift), 0))


def _draw(timing: BeatTiming, duration: float, words: dict[str, str]) -> str:
    on_beat = timing.on_beat
    times = np.array([one.accent.time_s for one in on_beat])
    off = np.array([one.off_ms for one in on_beat], np.float64)
    reach = max(_LEAST_MS, 1.1 * float(np.abs(off).max(initial=0.0)))
    plot = Plot((0.0, duration), (-reach, reach), words["plot_label"], "beat-plot")
    kinds = {one.accent.kind for one in timing.accents}
    key = [(f"dot {kind}", words[f"kind_{kind}"]) for kind in ACCENTS if kind in kinds]
    plot.level(0.0, "zero")
    if len(on_beat):
        middle = float(np.median(off))
        if timing.drift_distinguishable:
            slope = timing.drift_ms_per_min / 60.0
            ends = np.array([times[0], times[-1]])
            plot.curve(ends, float(np.median(off - slope * times)) + slope * ends, "trend")
            key.append(("trend", words["key_drift"]))
        elif not timing.start_estimated:
            plot.level(middle, "median")
            key.append(("median", words["key_median"]))
    step = -(-len(timing.accents) // _MOST_DOTS)
    for one in timing.accents[::step]:
        late = -reach if one.off_ms is None else one.off_ms
        state = " between" if one.off_ms is None else ""
        plot.dot(one.accent.time_s, late, one.accent.kind + state, _title(one, words))
    if len(on_beat) < len(timing.accents):
        key.append(("dot between", words["between"]))
    plot.cursor()
    ticks = [(value, f"{value:+.0f}" if value else "0") for value in choose_ticks(-reach, reach, 4)]
    return plot.to_markup(ticks, x_labels(time_ticks(duration), duration), name=words["plot_name"], key=key)


def _title(one: TimedAccent, words: dict[str, str]) -> str:
    late = words["between"] if one.off_ms is None else _say_ms(one.off_ms, words)
    return f"{format_time(one.accent.time_s)} {words[f'kind_{one.accent.kind}']}: {late}"


def _row(one: TimedAccent, words: dict[str, str], language: str) -> tuple[str, ...]:
    parts = ("・" if language == "ja" else ", ").join(words[name] for name in one.accent.parts)
    return (
        format_time(one.accent.time_s),
        words[f"kind_{one.accent.kind}"],
        parts,
        format_optional(one.beat, 1),
        words["between"] if one.off_ms is None else f"{one.off_ms:+.0f}",
    )
