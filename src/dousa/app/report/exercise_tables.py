"""The repetitions of an exercise as tables: for the eye, every joint for whoever asks, and as CSV for spreadsheets."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping

from dousa.app.report.curves import build_details, build_table
from dousa.app.report.markup import element, format_grade, format_number
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES, ANGLES, MOVING_DEG
from dousa.evaluation.exercises.repetitions import (
    PAIR_NAMES,
    SHORT,
    AssessedRepetition,
    RepetitionsAssessment,
    choose_angles,
)
from dousa.evaluation.words import format_time


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
    top = "".join(element("th", {"scope": "col"}, text) for text in heads)
    rows = "".join(_row(number, one, angles, words) for number, one in enumerate(done.repetitions, 1))
    inner = element("caption", {"class": "sr"}, words["table_title"])
    inner += element("thead", None, inner=element("tr", None, inner=top)) + element("tbody", None, inner=rows)
    table = element("table", {"class": "repetition-table"}, inner=inner)
    return element("div", {"class": "table-wrap", "tabindex": "0"}, inner=table)


def _row(number: int, one: AssessedRepetition, angles: tuple[str, ...], words: Mapping[str, str]) -> str:
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
    cells = element("th", {"scope": "row"}, str(number)) + "".join(element("td", None, text) for text in texts)
    for name in angles:
        ranged = one.get_range(name)
        text = f"{ranged.range_deg:.0f}°" if math.isfinite(ranged.range_deg) else "–"
        if math.isfinite(ranged.percent):
            text += f" ({ranged.percent:.0f} %)"
        short = found.complete and ranged.percent < SHORT
        cells += element("td", {"class": "short-range" if short else None}, inner=element("span", None, text))
    for value in one.symmetry.values():
        cells += element("td", None, f"{value:+.0f} %" if math.isfinite(value) else "–")
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
    note = element("p", {"class": "note"}, words["joints_note"].format(degrees=format_number(MOVING_DEG, 0)))
    return build_details(words["joints_title"], build_table(heads, rows, words["joints_title"]) + note, len(ANGLES))


def to_repetitions_csv(assessment: RepetitionsAssessment) -> bytes:
    """A row for each repetition, the incomplete ones too: all angles in degrees, nothing where there is no value."""
    pairs = tuple(assessment.repetitions[0].symmetry) if assessment.repetitions else ()
    names = ["number", "complete", "start_s", "end_s", "duration_s", "pause_s", "extent", "tempo", "score"]
    names += [f"{angle}_{what}" for angle in ANGLES for what in ("least_deg", "most_deg", "range_deg", "reference_deg")]
    names += [f"{pair}_symmetry_percent" for pair in pairs]
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
        writer.writerow(row + [_cell(one.symmetry[pair], 1) for pair in pairs])
    return text.getvalue().encode()


def _cell(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
