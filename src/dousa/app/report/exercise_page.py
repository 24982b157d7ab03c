"""The report of an exercise: one page with its repetitions in words, in motion, as pictures and tables; and a CSV."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dousa.app.report.exercise_plots import draw_angles, draw_measures, draw_poses
from dousa.app.report.exercise_tables import build_joints_table, build_repetitions_table, to_repetitions_csv
from dousa.app.report.fonts import embed_font, font_rule
from dousa.app.report.markup import element, escape, format_grade, format_number
from dousa.app.report.page import collect_text, fill_slots, read_file
from dousa.errors import MotionWriteError, OptionError
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES
from dousa.evaluation.exercises.repetitions import (
    AssessedRepetition,
    RepetitionsAssessment,
    choose_angles,
    compute_median,
    describe_exercise,
    describe_trends,
)
from dousa.evaluation.words import check_language, format_time
from dousa.files.disk import atomic_write
from dousa.messages import load_section
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.canonicalise import mirror_canonical

REPETITIONS_NAME, _PAGE_NAME = "repetitions.csv", "report.html"


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
    home = Path(folder)
    contents = {REPETITIONS_NAME: to_repetitions_csv(done), _PAGE_NAME: page.encode("utf-8", "replace")}
    try:
        home.mkdir(parents=True, exist_ok=True)
        for file_name, data in contents.items():
            with atomic_write(home / file_name) as file:
                file.write(data)
    except (OSError, ValueError, MotionWriteError) as error:
        raise OptionError("report_file.unwritable", folder=folder, reason=error) from error
    return home / _PAGE_NAME


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
    from dousa.app.player.data import encode_repetitions, format_player_data, read_player_script, read_player_style

    words = load_section("report_exercise", language)
    title = words["title"].format(name=name or words["unnamed"])
    played = _mirror(done, performance)
    slots = _fill(done, played, title, language)
    player_data = format_player_data(encode_repetitions(done, played, name, language=language))
    font = embed_font(collect_text(*slots.values(), player_data))
    if font.problem:
        problem = load_section("report", language)["font_missing"].format(reason=font.problem)
        slots["header"] = _build_header(done, title, (problem,), words, language)
    frame = {
        "language": language,
        "title": escape(title),
        "font": font_rule(font),
        "report": fill_slots(read_file("exercise.html"), slots),
        "data": format_player_data(_collect(done)),
        "player_data": player_data,
        "player_style": read_player_style(),
        "player_script": read_player_script(),
        "style": "".join(read_file(file) for file in ("colours.css", "page.css", "report.css", "exercise.css")),
        "script": read_file("exercise.js") + read_file("exercise_page.js"),
        "text_made_by": escape(words["made_by"]),
    }
    return fill_slots(read_file("page.html"), frame)


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
    from dousa.app.player.data import encode_repetitions

    words = load_section("report_exercise", language)
    played = _mirror(done, performance)
    slots = _fill(done, played, words["title"].format(name=name or words["unnamed"]), language)
    return {
        "markup": fill_slots(read_file("exercise.html"), slots),
        "data": _collect(done),
        "player": encode_repetitions(done, played, name, language=language),
    }


def _mirror(done: RepetitionsAssessment, performance: CanonicalMotion) -> CanonicalMotion:
    """The performance as it was measured."""
    return mirror_canonical(performance) if done.side == "mirrored" else performance


def _fill(done: RepetitionsAssessment, played: CanonicalMotion, title: str, language: str) -> dict[str, str]:
    """What stands in the slots of exercise.html."""
    words = load_section("report_exercise", language)
    slots = {f"text_{key}": escape(text) for key, text in words.items()}
    return slots | {
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


def _collect(done: RepetitionsAssessment) -> dict[str, Any]:
    """What exercise.js needs: spans to play."""
    spans = [[round(one.repetition.start_s, 3), round(one.repetition.end_s, 3)] for one in done.repetitions]
    return {"duration": round(done.duration_s, 4), "repetitions": spans}


def _build_header(
    done: RepetitionsAssessment, title: str, problems: tuple[str, ...], words: Mapping[str, str], language: str
) -> str:
    head = element("p", {"class": "overline"}, words["overline"]) + element("h1", None, title)
    notes = (*(message.render(language) for message in done.warnings), *problems)
    aside = ""
    if notes:
        items = "".join(element("li", None, text) for text in notes)
        inner = element("h2", None, words["warnings"]) + element("ul", None, inner=items)
        aside = element("aside", {"class": "warnings"}, inner=inner)
    parts = element("div", {"class": "heading"}, inner=head) + _build_figures(done, words) + aside
    return element("header", {"class": "top"}, inner=parts)


def _build_figures(done: RepetitionsAssessment, words: Mapping[str, str]) -> str:
    """How many, how well, how long: the numbers that are looked for first."""
    score = compute_median([one.score for one in done.complete])
    tempo = compute_median([one.tempo for one in done.complete])
    graded = [one.assessment for one in done.complete if one.assessment is not None]
    calibrated = bool(graded) and graded[0].calibrated
    incomplete = len(done.repetitions) - done.count
    figures = [
        (str(done.count), words["figure_count"], words["figure_incomplete"].format(n=incomplete) if incomplete else ""),
        (
            format_grade(score),
            words["figure_grade"],
            words["calibrated" if calibrated else "uncalibrated"].format(n=done.n_references),
        ),
        (
            f"{compute_median([one.repetition.duration_s for one in done.complete]):.1f}",
            words["figure_seconds"],
            words["figure_tempo"].format(tempo=f"{tempo:.2f}", seconds=f"{done.reference_s:.1f}"),
        ),
    ]
    cells = []
    for number, text, note in figures:
        inner = element("span", {"class": "number"}, number) + element("span", {"class": "of"}, text)
        cells.append(element("div", {"class": "figure-cell"}, inner=inner + element("p", {"class": "note"}, note)))
    return element("section", {"class": "card exercise-figures"}, inner="".join(cells))


def _list_sentences(done: RepetitionsAssessment, language: str) -> str:
    trends = describe_trends(done)
    found = trends[0].code != "exercise_table.no_trend"
    items = "".join(element("li", None, message.render(language)) for message in describe_exercise(done))
    items += "".join(
        element("li", {"class": "trend-says" if found else None}, message.render(language)) for message in trends
    )
    return element("ul", {"class": "card says-list"}, inner=items)


def _list_repetitions(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    """A button for each, which plays it."""
    main = max(choose_angles(done), key=lambda name: done.reference_ranges[name])
    items = []
    for number, one in enumerate(done.repetitions):
        when = f"{format_time(one.repetition.start_s)}–{format_time(one.repetition.end_s)}"
        inner = (
            element("span", {"class": "rep-number", "aria-hidden": "true"}, str(number + 1))
            + element("span", {"class": "when"}, when)
            + element("span", {"class": "kind"}, _say_range(one, main, words, language))
            + element("span", {"class": "says"}, _say_grade(one, words))
        )
        tag = {"type": "button", "class": "event repetition", "data-repetition": str(number)}
        items.append(element("li", None, inner=element("button", tag, inner=inner)))
    return element("ol", {"class": "event-list"}, inner="".join(items))


def _say_grade(one: AssessedRepetition, words: Mapping[str, str]) -> str:
    if not one.repetition.complete:
        return words["incomplete"].format(percent=format_number(100.0 * one.repetition.extent, 0))
    if not math.isfinite(one.score):
        return words["not_graded"]
    return words["graded"].format(score=format_grade(one.score))


def _say_range(one: AssessedRepetition, angle: str, words: Mapping[str, str], language: str) -> str:
    ranged = one.get_range(angle)
    return words["item_range"].format(
        angle=ANGLE_NAMES[angle].render(language),
        degrees=format_number(ranged.range_deg, 0),
        seconds=f"{one.repetition.duration_s:.1f}",
    )


def _explain(done: RepetitionsAssessment, words: Mapping[str, str]) -> str:
    names = ("grade", "tempo", "range", "sides", "incomplete", "trend")
    items = "".join(
        element(
            "div",
            None,
            inner=element("dt", None, inner=element("b", None, words[f"read_{name}_term"]))
            + element("dd", None, words[f"read_{name}"]),
        )
        for name in names
    )
    note = words["read_mirrored"] if done.side == "mirrored" else words["read_own_sides"]
    note += " " + words["read_tempo_same" if done.tempo == "same" else "read_tempo_free"]
    return element("dl", {"class": "reading"}, inner=items) + element("p", {"class": "note"}, note)
