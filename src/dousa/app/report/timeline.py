"""The timeline and the correlation matrix of an assessment, and its accents against the beats of music.

The timeline has furi, errors, distances with their limits, lag and the heat of nine segments on one time axis. Drawings
are stretched to the width at hand; all that is text lies over them and keeps its size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.app.drawing.charts import (
    UNITS,
    Plot,
    choose_ticks,
    encode_map,
    format_clock,
    percent,
    robust_top,
    thin_curve,
    time_ticks,
    viridis_gradient,
    x_labels,
    y_labels,
)
from dousa.app.drawing.markup import Svg, build_terms, draw_mark, element, escape, format_grade, format_number, trace
from dousa.app.report.curves import build_details, build_table, format_optional
from dousa.arrays import FloatArray
from dousa.evaluation.alignment.correspondence import compute_correlation_matrix
from dousa.evaluation.beats.accents import ACCENTS
from dousa.evaluation.beats.beats import BeatTiming, TimedAccent
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.evaluation.words import KINDS, LAPSE_KINDS, SEGMENT_NAMES, format_time, name_all
from dousa.messages import load_section
from dousa.motion.runs import find_runs


def _thin(segments: FloatArray, most: int = 560) -> FloatArray:
    """(N, 9, 3) segments of at most so many frames."""
    step = -(-len(segments) // most)
    return np.ascontiguousarray(segments[step // 2 :: step] if len(segments) > step // 2 else segments)


def draw_matrix(assessment: Assessment, words: Mapping[str, str]) -> str:
    """Performance across, reference up, similarity as colour, with path, straight line and furi cuts."""
    performance, reference = assessment.performance, assessment.reference
    width, height = max(performance.duration, 1e-6), max(reference.duration, 1e-6)
    values = compute_correlation_matrix(_thin(reference.segments), _thin(performance.segments))
    low = min(math.floor(20.0 * float(np.percentile(values, 2.0))) / 20.0, 0.95) if values.size else 0.0
    picture = _show_map(np.asarray(values, float)[::-1], low, 1.0, {"alt": words["matrix_label"]})
    plot = element("div", "matrix-plot", inner=picture + _overlay(assessment, width, height, words))
    up = y_labels(tuple((tick, format_clock(tick)) for tick in time_ticks(height, 8)), 0.0, height)
    ramp = element("div", {"class": "ramp", "style": f"background-image:linear-gradient(0deg,{viridis_gradient()})"})
    ticks = tuple((v, format_number(v)) for v in choose_ticks(low, 1.0, 5))
    bar = element("div", "matrix-bar", inner=ramp + y_labels(ticks, low, 1.0))
    ratio = min(max(height / width, 0.4), 1.6)
    return element(
        "div",
        {"class": "matrix", "style": f"--ratio:{format_number(ratio, 3)}"},
        inner=element("div", "y-title", words["matrix_y"])
        + up
        + plot
        + bar
        + x_labels(time_ticks(width, 8), width)
        + element("div", "x-title", words["matrix_x"])
        + element("div", "bar-title", words["matrix_bar"]),
    )


def _overlay(assessment: Assessment, width: float, height: float, words: Mapping[str, str]) -> str:
    svg = Svg(UNITS, UNITS, words["matrix_lines"], "", stretched=True)
    # Many lines across would hide the picture: then the cuts are marks at its edge.
    reach = UNITS if len(assessment.furi) <= 30 else 0.03 * UNITS
    for furi in assessment.furi:
        for seconds in (furi.reference_start_s, furi.reference_end_s):
            if 0.0 < seconds < height - 1e-6:
                y = UNITS * (1.0 - seconds / height)
                svg.line([(0.0, y), (reach, y)], "cut")
    times = assessment.times
    straight = np.where((assessment.same_time >= 0) & (assessment.same_time <= height), assessment.same_time, np.nan)
    path = assessment.path
    step = max(-(-len(path) // 2000), 1)
    every = max(-(-len(times) // 1000), 1)
    curves = [("straight", (times[::every], straight[::every]))]
    if len(path):
        rate = assessment.frame_rate
        curves.append(("path", (path[::step, 0] / rate, path[::step, 1] / rate)))
    for css_class, (across, up) in curves:
        data = trace(UNITS * across / width, UNITS * (1.0 - up / height))
        if css_class == "path":
            svg.add("path", {"d": data, "class": "path-edge"})
        svg.add("path", {"d": data, "class": css_class})
    cursor = element("i", {"class": "matrix-cursor", "id": "matrix-cursor", "style": f"left:{percent(0, 0, 1)}"})
    return svg.to_markup() + cursor


def _show_map(values: FloatArray, low: float, high: float, attributes: Mapping[str, str]) -> str:
    return element("img", {"src": encode_map(values, low, high), **attributes}).replace("</img>", "")


_WIDTH = 2000.0  # units of the drawings across the whole time
_LANE, _CURVE, _HEAT = 26, 92, 15  # px: one lane of bars, one curve, one segment


@dataclass(frozen=True, slots=True)
class _Row:
    """One row: what stands left of it, and what stands in it.

    Parameters
    ----------
    height : px.
    title : name of the row.
    note : smaller, below the title; may be empty.
    scale : markup of labels at the edge.
    plot : markup of the plot.
    css_class : of the plot.
    """

    height: int
    title: str
    note: str
    scale: str
    plot: str
    css_class: str = ""


def draw_timeline(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """The whole timeline as markup.

    Parameters
    ----------
    assessment : what is shown.
    words : texts of the page.
    language : ``"en"`` or ``"ja"``.
    """
    duration = max(assessment.performance.duration, 1e-6)
    rows = [
        _furi_row(assessment, duration, words),
        *_error_rows(assessment, duration, words, language),
        _distance_row(assessment, duration, words, "d_space"),
        _distance_row(assessment, duration, words, "d_within"),
        _lag_row(assessment, duration, words),
        *_heat_rows(assessment, words, language),
    ]
    ticks = time_ticks(duration)
    side = [_side(row) for row in rows]
    plots = [
        element("div", {"class": f"row {row.css_class}", "style": f"height:{row.height}px"}, inner=row.plot)
        for row in rows
    ]
    marks = "".join(
        element("span", {"style": f"left:{percent(tick, 0, duration)}"}, format_clock(tick)) for tick in ticks
    )
    lines = "".join(element("i", {"style": f"left:{percent(tick, 0, duration)}"}) for tick in ticks)
    inner = (
        element("div", {"class": "grid", "aria-hidden": "true"}, inner=lines)
        + "".join(plots)
        + element("div", {"class": "row clock", "aria-hidden": "true"}, inner=marks)
        + element("div", {"class": "cursor", "id": "cursor"}, inner="<b></b>")
    )
    slider = {
        "class": "lanes-hand", "id": "lanes", "tabindex": "0", "role": "slider", "aria-label": words["timeline_slider"],
        "aria-valuemin": "0", "aria-valuemax": format_number(duration), "aria-valuenow": "0",
        "aria-valuetext": format_time(0.0), "data-duration": format_number(duration, 4),
    }  # fmt: skip
    # Links stand beside the slider, not in it: what is inside one is not reached by those who hear the page.
    lanes = element("div", "lanes", inner=inner + element("div", slider, inner=""))
    scroll = element("div", {"class": "scroll", "id": "scroll"}, inner=lanes)
    return element("div", "timeline", inner=element("div", "names", inner=side) + scroll)


def _side(row: _Row) -> str:
    title = element("b", None, row.title) + (element("small", None, row.note) if row.note else "")
    inner = element("div", "name", inner=title) + row.scale
    return element("div", {"class": f"row-name {row.css_class}", "style": f"height:{row.height}px"}, inner=inner)


def _span(start: float, end: float, duration: float) -> str:
    """CSS place of a span; what is not finite reaches to the edge."""
    left = start if math.isfinite(start) else 0.0
    right = end if math.isfinite(end) else duration
    width = max(min(right, duration) - max(left, 0.0), 0.0)
    return f"left:{percent(left, 0, duration)};width:{percent(width, 0, duration)}"


def _furi_row(assessment: Assessment, duration: float, words: Mapping[str, str]) -> _Row:
    bands = []
    for number, furi in enumerate(assessment.furi):
        if not (math.isfinite(furi.start_s) and math.isfinite(furi.end_s)):
            continue
        tip = words["furi_tip"].format(
            number=number + 1, label=furi.label, start=format_time(furi.start_s), end=format_time(furi.end_s),
            score=format_grade(furi.score),
        )  # fmt: skip
        inner = element("b", None, str(number + 1)) + element("span", None, furi.label)
        style = _span(furi.start_s, furi.end_s, duration)
        tag = {"class": "band", "href": f"#furi-{number + 1}", "style": style, "title": tip}
        bands.append(element("a", tag, inner=inner))
    return _Row(_LANE + 4, words["furi"], "", "", "".join(bands), "bands")


def _assign_lanes(spans: Sequence[tuple[float, float]], narrowest: float) -> tuple[int, ...]:
    """The lowest lane in which each span, as wide as it is drawn, meets no earlier one."""
    free: list[float] = []
    lanes = [0] * len(spans)
    for k in sorted(range(len(spans)), key=lambda k: spans[k][0]):
        start, end = spans[k]
        until = max(end, start + narrowest)
        lane = next((n for n, at in enumerate(free) if at <= start), len(free))
        if lane == len(free):
            free.append(until)
        free[lane] = until
        lanes[k] = lane
    return tuple(lanes)


def _bars(
    items: Sequence[tuple[float, float, str, Mapping[str, object], str]], duration: float, narrowest: float = 0.022
) -> tuple[str, int]:
    """Bars (start, end, title, attributes, markup) packed into lanes; and how many lanes they take.

    Each takes ``narrowest``, a share of the duration, at least; of less its letter could not be read.
    """
    lanes = _assign_lanes([(start, end) for start, end, *_ in items], narrowest * duration)
    out = []
    for (start, end, title, attributes, mark), lane in zip(items, lanes, strict=True):
        style = f"{_span(start, end, duration)};top:{lane * _LANE + 3}px"
        if start > (1.0 - narrowest) * duration:  # the least width would reach beyond the edge
            style = f"right:0;width:{percent(duration - start, 0, duration)};top:{lane * _LANE + 3}px"
        tag = {"type": "button", "style": style, "title": title, "aria-label": title, **attributes}
        out.append(element("button", tag, inner=mark))
    return "".join(out), max(lanes, default=0) + 1


def _error_rows(assessment: Assessment, duration: float, words: Mapping[str, str], language: str) -> list[_Row]:
    """One row for each kind of error, and one for lapses if there are any."""
    rows = []
    for kind, name in name_all(KINDS, language).items():
        items = [
            (
                event.start_s, event.end_s, f"{name} – {event.says.render(language)}",
                {"class": f"bar {kind}", "data-event": str(k), "tabindex": "-1"}, draw_mark(kind, words),
            )
            for k, event in enumerate(assessment.events)
            if event.kind == kind
        ]  # fmt: skip
        bars, count = _bars(items, duration)
        title = words[f"kind_short_{kind}"]
        rows.append(_Row(count * _LANE + 4, title, "", "", bars, f"errors lane-{kind}"))
    lapses = [
        (
            lapse.start_s if math.isfinite(lapse.start_s) else 0.0,
            lapse.end_s if math.isfinite(lapse.end_s) else duration,
            f"{LAPSE_KINDS[lapse.kind].render(language)} – {lapse.says.render(language)}",
            {"class": "bar lapse", "data-lapse": str(k), "tabindex": "-1"}, draw_mark("lapse", words),
        )
        for k, lapse in enumerate(assessment.lapses)
    ]  # fmt: skip
    if lapses:
        bars, count = _bars(lapses, duration)
        rows.append(_Row(count * _LANE + 4, words["lapses"], "", "", bars, "errors lane-lapse"))
    return rows


def _scaled(times: FloatArray, values: FloatArray, duration: float, low: float, high: float) -> str:
    x, y = thin_curve(times, values)
    return trace(_WIDTH * x / duration, 100.0 * (high - y) / (high - low))


def _distance_row(assessment: Assessment, duration: float, words: Mapping[str, str], name: str) -> _Row:
    times = assessment.times
    values, limit = getattr(assessment, name), getattr(assessment, f"{name}_limit")
    top = robust_top(values, limit, least=0.1)
    svg = Svg(_WIDTH, 100.0, words[f"{name}_label"], "curve", stretched=True)
    over = np.where(values > limit, values, np.nan)
    base = np.where(np.isfinite(over), np.minimum(limit, values), np.nan)
    svg.add("path", {"d": _area(times, over, base, duration, top), "class": "over"})
    svg.add("path", {"d": _scaled(times, values, duration, 0.0, top), "class": f"line {name}"})
    svg.add("path", {"d": _scaled(times, limit, duration, 0.0, top), "class": "limit"})
    ticks = tuple((tick, format_number(tick)) for tick in choose_ticks(0.0, top, 3))
    title, note = words[f"{name}_title"], words[f"{name}_note"]
    return _Row(_CURVE, title, note, y_labels(ticks, 0.0, top), svg.to_markup(), "plot")


def _area(times: FloatArray, over: FloatArray, base: FloatArray, duration: float, top: float) -> str:
    parts = []
    for start, end in find_runs(np.isfinite(over)):
        share = max(2, min(end - start, 400))
        picks = np.unique(np.linspace(start, end - 1, share).round().astype(int))
        x = _WIDTH * np.concatenate([times[picks], times[picks][::-1]]) / duration
        y = 100.0 * (1.0 - np.concatenate([over[picks], base[picks][::-1]]) / top)
        if len(picks) > 1:
            parts.append(trace(x, y) + "Z")
    return "".join(parts)


def _lag_row(assessment: Assessment, duration: float, words: Mapping[str, str]) -> _Row:
    lag = 1000.0 * assessment.lag
    known = np.abs(lag[np.isfinite(lag)])
    reach = max(1.15 * float(known.max()) if len(known) else 0.0, 100.0)
    svg = Svg(_WIDTH, 100.0, words["lag_label"], "curve", stretched=True)
    svg.add("path", {"d": f"M0 50L{_WIDTH:.0f} 50", "class": "zero"})
    svg.add("path", {"d": _scaled(assessment.times, lag, duration, -reach, reach), "class": "line lag"})
    ticks = tuple((tick, f"{tick:+.0f}".replace("-", "−") if tick else "0") for tick in choose_ticks(-reach, reach, 4))
    scale = y_labels(ticks, -reach, reach)
    return _Row(_CURVE, words["lag_title"], words["lag_note"], scale, svg.to_markup(), "plot")


def _heat_rows(assessment: Assessment, words: Mapping[str, str], language: str) -> list[_Row]:
    height = _HEAT * len(SEGMENTS)
    residual = _blank_gaps(assessment)
    known = residual[np.isfinite(residual)]
    top = max(float(np.percentile(known, 99.5)) if len(known) else 0.0, math.radians(30.0))
    columns = _pool(residual)
    picture = _show_map(columns.T, 0.0, top, {"alt": words["heat_label"], "class": "heat"})
    names = "".join(
        element("span", {"style": f"height:{_HEAT}px"}, SEGMENT_NAMES[name].render(language)) for name in SEGMENTS
    )
    scale = element("div", "segment-names", inner=names)
    bar = element("span", {"class": "ramp", "style": f"background-image:linear-gradient(90deg,{viridis_gradient()})"})
    patch = element("span", "patch hatched")
    key = f"0° {bar} {np.degrees(top):.0f}° {patch} {escape(words['heat_note'])}"
    head = element("div", "heat-key", inner=key)
    return [
        _Row(_LANE, words["heat_title"], "", "", head, "heat-head"),
        _Row(height, "", "", scale, picture, "heat-row hatched"),
    ]


def _blank_gaps(assessment: Assessment) -> FloatArray:
    """(T, 9) residuals without what was not seen."""
    residual = np.array(assessment.residual, float)
    times = assessment.times
    for start, end, name in assessment.gaps:
        if name in SEGMENTS:
            residual[(times >= start) & (times < end), SEGMENTS.index(name)] = np.nan
    return residual


def _pool(values: FloatArray, columns: int = 1500) -> FloatArray:
    """(N, 9) greatest value of each stretch, at most so many stretches; a stretch unseen for its most part is nan."""
    if len(values) <= columns:
        return values
    size = -(-len(values) // columns)
    n_bins = -(-len(values) // size)
    padded = np.full((n_bins * size, values.shape[1]), np.nan)
    padded[: len(values)] = values
    table = padded.reshape(n_bins, size, -1)
    known = np.isfinite(table)
    greatest = np.where(known, table, -np.inf).max(axis=1)
    pooled: FloatArray = np.where(2 * known.sum(axis=1) >= size, greatest, np.nan)
    return pooled


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
    sentences = "".join(element("p", "beat-says", message.render(language)) for message in timing.messages)
    inner = element("h2", None, words["title"]) + sentences + _list_facts(timing, words)
    inner += element("div", "card plot-card", inner=_draw_beats(timing, duration, words))
    heads = [words[f"col_{name}"] for name in ("time", "kind", "parts", "beat", "off")]
    table = build_table(heads, [_describe_accent(one, words, language) for one in timing.accents], words["table"])
    inner += build_details(words["table"], table, len(timing.accents))
    return element("section", {"id": "beats"}, inner=inner)


def _list_facts(timing: BeatTiming, words: dict[str, str]) -> str:
    pairs = [
        (words["tempo"], words["per_minute"].format(tempo=format_number(timing.tempo, 0))),
        (words["accents"], words["of"].format(n=len(timing.on_beat), of=len(timing.accents))),
        (words["median"], words["unknown"] if math.isnan(timing.median_ms) else _say_ms(timing.median_ms, words)),
        (words["spread"], words["within"].format(ms=format_number(timing.spread_ms, 0))),
        (words["drift"], _say_drift(timing, words)),
        (words["agreement"], f"{format_number(100.0 * timing.agreement, 0)} %"),
    ]
    return build_terms(((escape(name), escape(value)) for name, value in pairs), "facts beat-facts")


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


def _draw_beats(timing: BeatTiming, duration: float, words: dict[str, str]) -> str:
    on_beat = timing.on_beat
    times = np.array([one.accent.time_s for one in on_beat])
    off = np.array([one.off_ms for one in on_beat], np.float64)
    reach = max(100.0, 1.1 * float(np.abs(off).max(initial=0.0)))  # ms to either side
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
    step = -(-len(timing.accents) // 600)  # no more dots than that
    for one in timing.accents[::step]:
        late = -reach if one.off_ms is None else one.off_ms
        state = " between" if one.off_ms is None else ""
        plot.dot(one.accent.time_s, late, one.accent.kind + state, _name_accent(one, words))
    if len(on_beat) < len(timing.accents):
        key.append(("dot between", words["between"]))
    plot.cursor()
    ticks = [(value, f"{value:+.0f}" if value else "0") for value in choose_ticks(-reach, reach, 4)]
    return plot.to_markup(ticks, x_labels(time_ticks(duration), duration), name=words["plot_name"], key=key)


def _name_accent(one: TimedAccent, words: dict[str, str]) -> str:
    late = words["between"] if one.off_ms is None else _say_ms(one.off_ms, words)
    return f"{format_time(one.accent.time_s)} {words[f'kind_{one.accent.kind}']}: {late}"


def _describe_accent(one: TimedAccent, words: dict[str, str], language: str) -> tuple[str, ...]:
    parts = ("・" if language == "ja" else ", ").join(words[name] for name in one.accent.parts)
    return (
        format_time(one.accent.time_s),
        words[f"kind_{one.accent.kind}"],
        parts,
        format_optional(one.beat, 1),
        words["between"] if one.off_ms is None else f"{one.off_ms:+.0f}",
    )
