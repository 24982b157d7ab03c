"""The whole page in one string: markup, style, scripts, data and font."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping

from dousa.app.report._fonts import embed_font, font_rule
from dousa.app.report._header import build_header, make_title
from dousa.app.report._parts import PARTS, collect_data, fill_slots, read_file
from dousa.app.report._svg import element, escape
from dousa.app.report._texts import TEXTS
from dousa.evaluation._types import Assessment

__all__ = ["CURVES_NAME", "EVENTS_NAME", "build_page"]

CURVES_NAME, EVENTS_NAME = "curves.csv", "events.csv"


def build_page(assessment: Assessment, language: str, title: str | None = None) -> str:
    """The page.

    Parameters
    ----------
    assessment : what it shows.
    language : ``"en"`` or ``"ja"``.
    title : its title; None for who against whom.

    Returns
    -------
    HTML that needs no other file.
    """
    from dousa.app.player import (
        encode_player_data,
        format_player_data,
        read_player_script,
        read_player_style,
    )

    words = TEXTS[language]
    title = title or make_title(assessment, words)
    slots = {name: build(assessment, words, language) for name, build in PARTS.items()}
    slots |= {
        "language": language,
        "title": escape(title),
        "files": _files(words),
        "data": format_player_data(collect_data(assessment, language)),
        "player_data": format_player_data(encode_player_data(assessment, language)),
        "player_style": read_player_style(),
        "player_script": read_player_script(),
        "style": "".join(read_file(name) for name in ("colours.css", "page.css", "report.css")),
        "script": read_file("report.js") + read_file("page.js"),
    }
    slots.update({f"text_{name}": escape(text) for name, text in words.items()})
    shown = _collect_text(
        *slots.values(), build_header(assessment, title, assessment.warnings, words, language)
    )
    font = embed_font(shown)
    warnings = assessment.warnings
    if font.problem:
        warnings = (*warnings, words["font_missing"].format(reason=font.problem))
    slots["header"] = build_header(assessment, title, warnings, words, language)
    slots["font"] = font_rule(font)
    slots["report"] = fill_slots(read_file("report.html"), slots)
    return fill_slots(read_file("page.html"), slots)


def _collect_text(*markup: str) -> str:
    """Every character that may be shown; tags and codes do no harm."""
    text = "".join(markup)
    text = re.sub(r"\\u([0-9a-fA-F]{4})", lambda match: chr(int(match.group(1), 16)), text)
    text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return "".join(set(html.unescape(text)))


def _files(words: Mapping[str, str]) -> str:
    links = {
        name: element("a", {"href": file}, file)
        for name, file in (("curves", CURVES_NAME), ("events", EVENTS_NAME))
    }
    return escape(words["tables_text"]).format(**links)
