"""The report of an exercise: one page with its repetitions in words, in motion, as pictures and tables; and a CSV."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.drawing.body import Placement, compute_heading, draw_body, measure_body, place, turn
from dousa.app.drawing.charts import Plot, build_key, choose_ticks, number_labels, time_ticks, x_labels
from dousa.app.drawing.markup import (
    Svg,
    build_cells,
    build_heads,
    build_list,
    build_terms,
    build_warnings,
    element,
    escape,
    format_grade,
    format_number,
    frame_table,
)
from dousa.app.report.curves import build_details, build_table
from dousa.app.report.page import collect_text, embed_font, fill_page, fill_slots, font_rule, read_file, write_files
from dousa.arrays import FloatArray
from dousa.evaluation.exercises.repetitions import AssessedRepetition, RepetitionsAssessment
from dousa.evaluation.exercises.summary import (
    PAIR_NAMES,
    SHORT,
    choose_angles,
    choose_pair,
    compute_median,
    describe_exercise,
    describe_trends,
    describe_worst,
)
from dousa.evaluation.posture.range_of_motion import ANGLE_NAMES, ANGLES, MOVING_DEG, compute_joint_angles
from dousa.evaluation.words import check_language, format_time
from dousa.messages import load_section
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.canonicalise import mirror_canonical
from dousa.motion.canonical.joints import JOINT_INDEX as J

REPETITIONS_NAME = "repetitions.csv"


def write_exercise_report(
    done: RepetitionsAssessment,
    performance: CanonicalMotion,
    folder: str | os.PathLike[str],
    *,
    language: str = "en",
    name: str = "",
) -> Path:
    """Write ``report.html`` and ``repetitions.csv``.

    Parameters
    ----------
    done : of `dousa.evaluation.assess_repetitions`.
    performance : the motion that was assessed, as it was recorded.
    folder : made if it is missing; files of these names in it are replaced.
    language : ``"en"`` or ``"ja"``, of the page.
    name : of the performance, in the title.

    Returns
    -------
    The path of the page; it needs no other file and no network.

    Raises
    ------
    OptionError : a language that there is not, or a folder that cannot be made or written.
    """
    check_language(language)
    page = build_exercise_page(done, performance, language, name)
    return write_files(folder, page, {REPETITIONS_NAME: to_repetitions_csv(done)})


def build_exercise_page(
    done: RepetitionsAssessment, performance: CanonicalMotion, language: str, name: str = ""
) -> str:
    """The page.

    Parameters
    ----------
    done, performance : as of `write_exercise_report`.
    language : ``"en"`` or ``"ja"``.
    name : of the performance, in the title.

    Returns
    -------
    HTML that needs no other file.
    """
    from dousa.app.player.data import format_player_data

    words = load_section("report_exercise", language)
    title, slots, player = _fill(done, performance, language, name)
    player_data = format_player_data(player)
    font = embed_font(collect_text(*slots.values(), player_data))
    if font.problem:
        problem = load_section("report", language)["font_missing"].format(reason=font.problem)
        slots["header"] = _build_header(done, title, (problem,), words, language)
    parts = {
        "font": font_rule(font),
        "report": fill_slots(read_file("exercise.html"), slots),
        "data": format_player_data(_collect(done)),
        "player_data": player_data,
        "text_made_by": escape(words["made_by"]),
    }
    styles, scripts = ("report.css", "exercise.css"), ("exercise.js", "page.js")
    return fill_page(language, title, styles, scripts, parts)


def build_exercise(
    done: RepetitionsAssessment, performance: CanonicalMotion, language: str, name: str = ""
) -> dict[str, Any]:
    """The report for a page that shows other things as well.

    Parameters
    ----------
    done, performance, language, name : as of `build_exercise_page`.

    Returns
    -------
    ``markup`` of the report; ``data`` for ``dousa.bindExercise``; ``player`` for ``dousa.createPlayer``.
    """
    _, slots, player = _fill(done, performance, language, name)
    return {"markup": fill_slots(read_file("exercise.html"), slots), "data": _collect(done), "player": player}


def _fill(
    done: RepetitionsAssessment, performance: CanonicalMotion, language: str, name: str
) -> tuple[str, dict[str, str], dict[str, Any]]:
    """The title, the slots of exercise.html, and what the player needs."""
    from dousa.app.player.data import encode_repetitions

    words = load_section("report_exercise", language)
    title = words["title"].format(name=name or words["unnamed"])
    played = mirror_canonical(performance) if done.side == "mirrored" else performance  # as it was measured
    slots = {f"text_{key}": escape(text) for key, text in words.items()}
    slots |= {
        "summary": _list_sentences(done, language),
        "list": _list_repetitions(done, words, language),
        "angles": draw_angles(done, played, words, language),
        "measures": draw_measures(done, words, language),
        "poses": draw_poses(done, played, words, language),
        "table": build_repetitions_table(done, words, language),
        "joints": build_joints_table(done, words, language),
        "reading": _explain(done, words),
        "files": escape(words["files"]).format(csv=element("a", {"href": REPETITIONS_NAME}, REPETITIONS_NAME)),
        "header": _build_header(done, title, (), words, language),
    }
    return title, slots, encode_repetitions(done, played, name, language=language)


def _collect(done: RepetitionsAssessment) -> dict[str, Any]:
    spans = [[round(one.repetition.start_s, 3), round(one.repetition.end_s, 3)] for one in done.repetitions]
    return {"duration": round(done.duration_s, 4), "repetitions": spans}


def _build_header(
    done: RepetitionsAssessment, title: str, problems: tuple[str, ...], words: Mapping[str, str], language: str
) -> str:
    head = element("p", "overline", words["overline"]) + element("h1", None, title)
    notes = (*(message.render(language) for message in done.warnings), *problems)
    parts = element("div", "heading", inner=head) + _build_figures(done, words)
    return element("header", "top", inner=parts + build_warnings(words["warnings"], notes))


def _build_figures(done: RepetitionsAssessment, words: Mapping[str, str]) -> str:
    """How many, how well, how long: the numbers that are looked for first."""
    score = compute_median([one.score for one in done.complete])
    tempo = compute_median([one.tempo for one in done.complete])
    graded = [one.assessment for one in done.complete if one.assessment is not None]
    calibrated = bool(graded) and graded[0].calibrated
    incomplete = len(done.repetitions) - done.count
    figures = [
        (str(done.count), words["figure_count"], words["figure_incomplete"].format(n=incomplete) if incomplete else "")
    ]
    if graded:
        note = words["calibrated" if calibrated else "uncalibrated"].format(n=done.n_references)
        figures.append((format_grade(score), words["figure_grade"], note))
    if done.complete:
        seconds = format_number(compute_median([one.repetition.duration_s for one in done.complete]), 1)
        note = words["figure_tempo"].format(tempo=format_number(tempo, 2), seconds=f"{done.reference_s:.1f}")
        figures.append((seconds, words["figure_seconds"], note))
    cells = []
    for number, text, note in figures:
        inner = element("span", "number", number) + element("span", "of", text)
        cells.append(element("div", "figure-cell", inner=inner + element("p", "note", note)))
    return element("section", "card exercise-figures", inner=cells)


def _list_sentences(done: RepetitionsAssessment, language: str) -> str:
    items = [element("li", None, message.render(language)) for message in describe_exercise(done)]
    for trend in describe_trends(done):
        css = None if trend.code == "exercise_table.no_trend" else "trend-says"
        items.append(element("li", {"class": css}, trend.render(language)))
    return element("ul", "card says-list", inner=items)


def _list_repetitions(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    main = max(choose_angles(done), key=lambda name: done.reference_ranges[name])
    items = []
    for number, one in enumerate(done.repetitions):
        when = f"{format_time(one.repetition.start_s)}–{format_time(one.repetition.end_s)}"
        inner = (
            element("span", {"class": "rep-number", "aria-hidden": "true"}, str(number + 1))
            + element("span", "when", when)
            + element("span", "kind", _say_range(one, main, words, language))
            + element("span", "says", _say_grade(one, words))
        )
        tag = {"type": "button", "class": "event repetition", "data-repetition": str(number)}
        items.append(element("button", tag, inner=inner))
    return build_list(items, "event-list", "ol")


def _say_grade(one: AssessedRepetition, words: Mapping[str, str]) -> str:
    if not one.repetition.complete:
        return words["incomplete"].format(percent=format_number(100.0 * one.repetition.extent, 0))
    if not math.isfinite(one.score):
        return words["not_graded"]
    return words["graded"].format(score=format_grade(one.score))


def _say_range(one: AssessedRepetition, angle: str, words: Mapping[str, str], language: str) -> str:
    if one.faults and one.faults[0].is_clear:
        return one.faults[0].message.render(language)
    ranged = one.get_range(angle)
    return words["item_range"].format(
        angle=ANGLE_NAMES[angle].render(language),
        degrees=format_number(ranged.range_deg, 0),
        seconds=f"{one.repetition.duration_s:.1f}",
    )


def _explain(done: RepetitionsAssessment, words: Mapping[str, str]) -> str:
    names = ("grade", "tempo", "range", "sides", "worst", "incomplete", "trend")
    pairs = ((element("b", None, words[f"read_{name}_term"]), escape(words[f"read_{name}"])) for name in names)
    note = words["read_mirrored"] if done.side == "mirrored" else words["read_own_sides"]
    note += " " + words["read_tempo_same" if done.tempo == "same" else "read_tempo_free"]
    return build_terms(pairs, "reading") + element("p", "note", note)


def build_repetitions_table(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    """A row for each repetition: when, how long, grade, the joints that move most, both sides.

    Parameters
    ----------
    done : the repetitions.
    words : texts of the page.
    language : of the names of joints.
    """
    angles = choose_angles(done)
    pairs = tuple(done.repetitions[0].symmetry) if done.repetitions else ()
    heads = [words[f"col_{name}"] for name in ("number", "time", "duration", "tempo", "pause", "grade")]
    heads += [
        words["col_range"].format(
            angle=ANGLE_NAMES[name].render(language), degrees=format_number(done.reference_ranges[name], 0)
        )
        for name in angles
    ]
    heads += [words["col_sides"].format(angle=PAIR_NAMES[name].render(language)) for name in pairs]
    heads.append(words["col_worst"])
    rows = (_row(number, one, angles, words, language) for number, one in enumerate(done.repetitions, 1))
    return frame_table(words["table_title"], [build_heads(heads)], rows, "repetition-table")


def _row(number: int, one: AssessedRepetition, angles: tuple[str, ...], words: Mapping[str, str], language: str) -> str:
    found = one.repetition
    grade = format_grade(one.score)
    if not found.complete:
        grade = words["incomplete"].format(percent=format_number(100.0 * found.extent, 0))
    texts = [
        f"{format_time(found.start_s)}–{format_time(found.end_s)}",
        f"{found.duration_s:.2f}",
        f"× {one.tempo:.2f}" if math.isfinite(one.tempo) else "–",
        f"{one.pause_s:.1f}" if math.isfinite(one.pause_s) else "–",
        grade,
    ]
    cells = element("th", {"scope": "row"}, str(number)) + build_cells(texts)
    for name in angles:
        ranged = one.get_range(name)
        text = f"{ranged.range_deg:.0f}°" if math.isfinite(ranged.range_deg) else "–"
        if math.isfinite(ranged.percent):
            text += f" ({ranged.percent:.0f} %)"
        short = found.complete and ranged.percent < SHORT
        cells += element("td", {"class": "short-range" if short else None}, inner=element("span", None, text))
    for value in one.symmetry.values():
        cells += element("td", None, f"{value:+.0f} %" if math.isfinite(value) else "–")
    cells += element("td", None, describe_worst(one).render(language))
    return element("tr", {"class": None if found.complete else "incomplete-row"}, inner=cells)


def build_joints_table(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    """Every joint angle in every repetition, opened when asked for: its range, and from where to where."""
    heads = [words["col_joint"], words["reference"]]
    heads += [str(number) for number in range(1, len(done.repetitions) + 1)]
    rows = []
    for name in ANGLES:
        reference = done.reference_ranges[name]
        cells = [ANGLE_NAMES[name].render(language), f"{format_number(reference, 0)}°"]
        for one in done.repetitions:
            ranged = one.get_range(name)
            if math.isfinite(ranged.range_deg):
                cells.append(f"{ranged.range_deg:.0f}° ({ranged.least_deg:.0f} – {ranged.most_deg:.0f})")
            else:
                cells.append("–")
        rows.append(cells)
    note = element("p", "note", words["joints_note"].format(degrees=format_number(MOVING_DEG, 0)))
    return build_details(words["joints_title"], build_table(heads, rows, words["joints_title"]) + note, len(ANGLES))


def to_repetitions_csv(assessment: RepetitionsAssessment) -> bytes:
    """A row for each repetition, the incomplete ones too: all angles in degrees, nothing where there is no value."""
    pairs = tuple(assessment.repetitions[0].symmetry) if assessment.repetitions else ()
    names = ["number", "complete", "start_s", "end_s", "duration_s", "pause_s", "extent", "tempo", "score"]
    names += [f"{angle}_{what}" for angle in ANGLES for what in ("least_deg", "most_deg", "range_deg", "reference_deg")]
    names += [f"{pair}_symmetry_percent" for pair in pairs]
    names += ["worst_angle", "worst_kind", "worst_s", "worst_deg", "worst_expected_deg", "worst_severity"]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for number, one in enumerate(assessment.repetitions, 1):
        found = one.repetition
        row: list[object] = [number, int(found.complete)]
        row += [_cell(value, 3) for value in (found.start_s, found.end_s, found.duration_s, one.pause_s, found.extent)]
        row += [_cell(one.tempo, 3), _cell(one.score, 1)]
        for ranged in one.ranges:
            values = (ranged.least_deg, ranged.most_deg, ranged.range_deg, ranged.reference_deg)
            row += [_cell(value, 1) for value in values]
        row += [_cell(one.symmetry[pair], 1) for pair in pairs]
        for worst in one.faults[:1]:
            row += [worst.angle, worst.kind, _cell(worst.time_s, 3), _cell(worst.degrees, 1)]
            row += [_cell(worst.expected, 1), _cell(worst.severity, 2)]
        writer.writerow(row + [""] * (len(names) - len(row)))
    return text.getvalue().encode()


def _cell(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


_CELL = (150.0, 190.0)  # units of a drawing of a pose


def draw_angles(
    done: RepetitionsAssessment, performance: CanonicalMotion, words: Mapping[str, str], language: str
) -> str:
    """The joint angles that move most, over time, with the repetitions as bands to press.

    Parameters
    ----------
    done : the repetitions.
    performance : as it was measured: mirrored if they were.
    words : texts of the page.
    language : of the names of joints.
    """
    names = choose_angles(done)
    curves = compute_joint_angles(performance)
    step = max(-(-performance.n_frames // 3000), 1)  # no more points than that
    times = np.arange(performance.n_frames)[::step] / performance.frame_rate
    shown = {name: curves[name][::step] for name in names}
    known = np.concatenate([values[np.isfinite(values)] for values in shown.values()])
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    low, high = min(low - 3.0, 0.0), high + 0.12 * (high - low) + 3.0
    plot = Plot((0.0, max(done.duration_s, 1e-6)), (low, high), words["angles_label"], "angle-plot")
    for number, one in enumerate(done.repetitions, 1):
        found = one.repetition
        css = "repetition" if found.complete else "repetition incomplete"
        plot.span(found.start_s, found.end_s, css, str(number), data_repetition=str(number - 1))
    key = []
    for number, name in enumerate(names, 1):
        plot.curve(times, shown[name], f"angle angle-{number}")
        key.append((f"angle-{number}", ANGLE_NAMES[name].render(language)))
    plot.cursor()
    ticks = [(value, f"{value:.0f}°") for value in choose_ticks(low, high, 5)]
    labels = x_labels(time_ticks(done.duration_s), max(done.duration_s, 1e-6))
    return plot.to_markup(ticks, labels, key=key)


def draw_measures(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    """Grade, duration, ranges and sides from repetition to repetition, a column each; the reference as a line."""
    ones = done.repetitions
    plots = [
        _columns(done, [one.score for one in ones], words["grade"], "", digits=0, top=100.0, trend="score"),
        _columns(
            done,
            [one.repetition.duration_s for one in ones],
            words["duration"],
            " s",
            digits=1,
            reference=done.reference_s,
            trend="duration_s",
        ),
    ]
    for name in choose_angles(done):
        values = [one.get_range(name).range_deg for one in ones]
        title = words["range_of"].format(angle=ANGLE_NAMES[name].render(language))
        reference = done.reference_ranges[name]
        plots.append(_columns(done, values, title, "°", digits=0, reference=reference, trend=name))
    pair = choose_pair(done)
    if pair is not None:
        title = words["sides_of"].format(angle=PAIR_NAMES[pair].render(language))
        plots.append(_columns(done, [one.symmetry[pair] for one in ones], title, " %", digits=0, both=True))
    key = [("bar-of", words["key_complete"]), ("bar-of incomplete", words["key_incomplete"])]
    key += [("reference", words["reference"]), ("trend", words["key_trend"])]
    return element("div", "measures", inner=plots) + build_key(key)


def _columns(
    done: RepetitionsAssessment,
    values: Sequence[float],
    title: str,
    unit: str,
    *,
    digits: int,
    reference: float = math.nan,
    top: float = 0.0,
    trend: str = "",
    both: bool = False,
) -> str:
    known = [abs(value) for value in (*values, reference) if math.isfinite(value)]
    high = top or 1.25 * max([*known, 20.0 if both else 1e-6])
    low = -high if both else 0.0
    count = len(values)
    plot = Plot((0.5, count + 0.5), (low, high), title, "columns")
    if both:
        plot.level(0.0, "zero")
    plot.level(reference, "reference")
    for number, (value, one) in enumerate(zip(values, done.repetitions, strict=True), 1):
        css = "" if one.repetition.complete else "incomplete"
        text = f"{value:+.{digits}f}" if both else format_number(value, digits)
        plot.bar(number - 0.36, number + 0.36, value, css, text if count <= 24 else "")
    _add_trend(plot, done, values, trend)
    ticks = [(value, f"{format_number(value, 1)}{unit}") for value in choose_ticks(low, high, 3)]
    labels = number_labels([str(number) for number in range(1, count + 1)], 12)
    return element("div", "card measure", inner=plot.to_markup(ticks, labels, name=title))


def _add_trend(plot: Plot, done: RepetitionsAssessment, values: Sequence[float], name: str) -> None:
    """Add the line of a significant trend, through the middle of the complete repetitions."""
    found = done.trends.get(name)
    if found is None or not found.distinguishable:
        return
    complete = [
        (number, value)
        for number, (value, one) in enumerate(zip(values, done.repetitions, strict=True), 1)
        if one.repetition.complete and math.isfinite(value)
    ]
    order = np.arange(len(complete), dtype=np.float64)
    middle = compute_median([value - found.slope * place for place, (_, value) in enumerate(complete)])
    plot.curve(np.array([number for number, _ in complete], np.float64), middle + found.slope * order, "trend")


def draw_poses(
    done: RepetitionsAssessment, performance: CanonicalMotion, words: Mapping[str, str], language: str, most: int = 24
) -> str:
    """The pose in which each repetition goes furthest, beside the reference's; seen from where it shows most.

    Parameters
    ----------
    done, performance : as of `draw_angles`.
    words : texts of the page.
    language : of the names of joints.
    most : repetitions that are drawn.
    """
    name = max(choose_angles(done), key=lambda angle: done.reference_ranges[angle])
    angle = compute_joint_angles(performance)[name]
    cells: list[tuple[FloatArray, str, str, str | None]] = []
    graded = next((one.assessment for one in done.repetitions if one.assessment is not None), None)
    ways: list[tuple[FloatArray, FloatArray]] = []
    if graded is not None:
        model = replace(
            performance,
            positions=np.asarray(graded.reference.positions, np.float64),
            frame_rate=graded.reference.frame_rate,
            missing=None,
        )
        theirs = compute_joint_angles(model)[name]
        first, pose = _find_furthest(model, theirs, 0, model.n_frames)
        ways.append((_face(model, first), _face(model, pose)))
        text = words["pose"].format(name=words["reference"], degrees=format_number(float(theirs[pose]), 0))
        cells.append((ways[0][1], text, "reference", None))
    for number, one in enumerate(done.repetitions[:most], 1):
        found = one.repetition
        first, pose = _find_furthest(performance, angle, found.start, found.end)
        ways.append((_face(performance, first), _face(performance, pose)))
        text = words["pose"].format(name=_name(number, one, words), degrees=format_number(float(angle[pose]), 0))
        cells.append((ways[-1][1], text, "performance" if found.complete else "performance faint", str(number - 1)))
    azimuth = math.radians(_choose_view(ways))
    turned = [turn(pose, azimuth) for pose, *_ in cells]
    common = place(turned, *_CELL, 10.0)
    figures = [
        _draw_cell(pose, text, css, repetition, common)
        for pose, (_, text, css, repetition) in zip(turned, cells, strict=True)
    ]
    lead = words["poses_text"].format(angle=ANGLE_NAMES[name].render(language))
    return element("p", "lead", lead) + element("div", "poses", inner=figures)


def _name(number: int, one: AssessedRepetition, words: Mapping[str, str]) -> str:
    return words["number_at"].format(number=number, time=format_time(one.repetition.start_s))


def _find_furthest(motion: CanonicalMotion, angle: FloatArray, start: int, end: int) -> tuple[int, int]:
    """Frames at which a repetition begins, and at which an angle is furthest from what it is then."""
    last = min(end, motion.n_frames)
    begin = min(start, last - 1)
    away = np.abs(angle[begin:last] - angle[begin])
    return begin, begin + (int(np.nanargmax(away)) if np.isfinite(away).any() else 0)


def _face(motion: CanonicalMotion, frame: int) -> FloatArray:
    """One pose (20, 3) over its own pelvis, in body lengths, facing the viewer, its lower foot on the floor."""
    pose = np.asarray(motion.positions[frame], np.float64) / measure_body(np.asarray(motion.positions, np.float64))
    pose = pose - pose[J["pelvis"]] * [1.0, 0.0, 1.0]
    return turn(pose - [0.0, float(np.nanmin(pose[:, 1])), 0.0], -compute_heading(pose))


def _choose_view(
    ways: Sequence[tuple[FloatArray, FloatArray]], views: Sequence[float] = (0.0, 45.0, -45.0, 90.0, -90.0)
) -> float:
    """Degrees towards the performer's right from which the way to the furthest pose is longest in the picture."""
    shown = []
    for view in views:
        gaps = [turn(pose - first, math.radians(view))[:, :2] for first, pose in ways]
        shown.append(float(np.nansum([np.linalg.norm(gap, axis=1).sum() for gap in gaps])))
    shown[0] *= 1.1  # the front wins ties
    return views[int(np.argmax(shown))]


def _draw_cell(pose: FloatArray, text: str, css: str, repetition: str | None, common: Placement) -> str:
    svg = Svg(*_CELL, text, "figure pose")
    svg.line([(6.0, common.bottom), (_CELL[0] - 6.0, common.bottom)], "floor")
    draw_body(svg, pose, common, css)
    caption = element("span", "caption-text", text)
    if repetition is None:
        return element("div", "pose-cell", inner=svg.to_markup() + caption)
    tag = {"type": "button", "class": "pose-cell", "data-repetition": repetition}
    return element("button", tag, inner=svg.to_markup() + caption)
