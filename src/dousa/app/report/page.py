"""The whole page in one string: markup, style, scripts, data and font."""

from __future__ import annotations

import base64
import html
import io
import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

from dousa.app.drawing.markup import element, escape
from dousa.app.report.curves import build_tables, furi_numbers, to_curves_csv, to_events_csv
from dousa.app.report.sections import (
    build_advice,
    build_events,
    build_facts,
    build_furi,
    build_header,
    build_moments,
    build_reading,
    build_segments,
    make_title,
)
from dousa.app.report.timeline import build_beats, draw_matrix, draw_timeline
from dousa.arrays import FloatArray
from dousa.errors import MotionWriteError, OptionError
from dousa.evaluation.beats.beats import BeatTiming
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.words import SEGMENT_NAMES, check_language, name_all
from dousa.extras import FONT_PACKAGE, find_font
from dousa.files.disk import atomic_write
from dousa.messages import load_section

PARTS: Mapping[str, Callable[[Assessment, Mapping[str, str], str], str]] = MappingProxyType(
    {
        "advice": build_advice,
        "events": build_events,
        "facts": build_facts,
        "segments": build_segments,
        "timeline": draw_timeline,
        "matrix": lambda assessment, words, language: draw_matrix(assessment, words),
        "furi": build_furi,
        "moments": build_moments,
        "reading": build_reading,
        "tables": build_tables,
    }
)
"""What builds each part, besides the header."""

QUICK_PARTS = ("header", "advice", "events", "facts", "segments", "timeline", "tables")
"""Parts that are quick to build, for pages that follow every change."""


def build_parts(assessment: Assessment, language: str, names: Collection[str] | None = None) -> dict[str, str]:
    """Parts of the report by name.

    Parameters
    ----------
    assessment : what they show.
    language : ``"en"`` or ``"ja"``.
    names : which; all if None.
    """
    words = load_section("report", language)
    found = {
        name: build(assessment, words, language) for name, build in PARTS.items() if names is None or name in names
    }
    if names is None or "header" in names:
        title = make_title(assessment, words)
        found["header"] = build_header(assessment, title, _say_warnings(assessment, language), words, language)
    return found


def build_frame(language: str) -> str:
    """The markup around the parts, which are empty: elements with ``data-part``."""
    slots = dict.fromkeys((*PARTS, "header", "files", "beats"), "") | {"notes": '<section data-part="notes"></section>'}
    slots |= {f"text_{name}": escape(text) for name, text in load_section("report", language).items()}
    return fill_slots(read_file("report.html"), slots)


def read_report_script() -> str:
    """The script that makes ``dousa.bindReport`` and ``dousa.bindExercise``; the player's comes before it."""
    return read_file("report.js") + read_file("exercise.js")


def read_report_style() -> str:
    """The style of the report for a page that shows other things as well: it ends at ``.dousa-report``."""
    return (
        f"{read_file('colours.css')}:where(.dousa-report) {{\n{read_file('report.css')}{read_file('exercise.css')}}}\n"
    )


def read_file(name: str) -> str:
    """A file of this package."""
    return resources.files("dousa.app.report").joinpath(name).read_text(encoding="utf-8")


def fill_slots(template: str, slots: Mapping[str, str]) -> str:
    """The template with its slots filled, in one pass: what is filled in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: slots[match.group(1)], template)


def fill_page(
    language: str, title: str, styles: Iterable[str], scripts: Iterable[str], parts: Mapping[str, str]
) -> str:
    """A page that needs no other file: its own style sheets, scripts and parts, and the player's."""
    from dousa.app.player.data import read_player_script, read_player_style

    slots = {
        "language": language,
        "title": escape(title),
        "player_style": read_player_style(),
        "player_script": read_player_script(),
        "style": "".join(read_file(name) for name in ("colours.css", "page.css", *styles)),
        "script": "".join(read_file(name) for name in scripts),
    }
    return fill_slots(read_file("page.html"), {**slots, **parts})


def write_files(folder: str | os.PathLike[str], page: str, tables: Mapping[str, bytes]) -> Path:
    """Write ``report.html`` and tables by their names into a folder that is made if missing; the path of the page.

    Raises
    ------
    OptionError : a folder that cannot be made or written.
    """
    home = Path(folder)
    try:
        home.mkdir(parents=True, exist_ok=True)
        for name, data in {**tables, "report.html": page.encode("utf-8", "replace")}.items():
            with atomic_write(home / name) as file:
                file.write(data)
    except (OSError, ValueError, MotionWriteError) as error:
        raise OptionError("report_file.unwritable", folder=folder, reason=error) from error
    return home / "report.html"


def collect_data(assessment: Assessment, language: str) -> dict[str, Any]:
    """What report.js needs: events to go to, and values to say beside the cursor."""
    words = load_section("report", language)
    step = max(-(-assessment.performance.n_frames // 2000), 1)  # the page can say so many values of each curve
    worst = [_worst_segment(row) for row in assessment.residual[::step]]
    numbers = furi_numbers(assessment)[::step]
    return {
        "duration": assessment.performance.duration,
        "step": step / assessment.frame_rate,
        "events": [_moments(event.start_s, event.end_s, event.worst_s) for event in assessment.events],
        "lapses": [_moments(lapse.start_s, lapse.end_s, lapse.start_s) for lapse in assessment.lapses],
        "space": _round(assessment.d_space[::step], 3),
        "within": _round(assessment.d_within[::step], 3),
        "lag": _round(1000.0 * assessment.lag[::step], 0),
        "matched": _round(assessment.matched_time[::step], 2),
        "furi": [int(number) for number in numbers],
        "worst": [segment for segment, _ in worst],
        "off": [angle for _, angle in worst],
        "segments": list(name_all(SEGMENT_NAMES, language).values()),
        "texts": {name: words[name] for name in ("furi", "lag_title", "now_reference", "now_worst")},
    }


def _moments(start: float, end: float, worst: float) -> list[float]:
    first = start if math.isfinite(start) else 0.0
    last = end if math.isfinite(end) else first
    return [round(v if math.isfinite(v) else first, 3) for v in (first, last, worst)]


def _round(values: FloatArray, decimals: int) -> list[float | int | None]:
    rounded = [round(v, decimals) if math.isfinite(v) else None for v in values.tolist()]
    return [int(v) if v is not None and decimals == 0 else v for v in rounded]


def _worst_segment(row: FloatArray) -> tuple[int | None, int | None]:
    known = [(float(angle), k) for k, angle in enumerate(row) if math.isfinite(angle)]
    if not known:
        return None, None
    angle, k = max(known)
    return k, round(math.degrees(angle))


CURVES_NAME, EVENTS_NAME = "curves.csv", "events.csv"


def _say_warnings(assessment: Assessment, language: str) -> tuple[str, ...]:
    return tuple(message.render(language) for message in assessment.warnings)


def build_page(
    assessment: Assessment,
    language: str,
    title: str | None = None,
    timing: BeatTiming | None = None,
    notes: str = "",
) -> str:
    """The page.

    Parameters
    ----------
    assessment : what it shows.
    language : ``"en"`` or ``"ja"``.
    title : its title; None for who against whom.
    timing : of its accents against the beats of music, if there is any.
    notes : remarks on the performance, in lines.

    Returns
    -------
    HTML that needs no other file.
    """
    from dousa.app.player.data import encode_player_data, format_player_data

    words = load_section("report", language)
    title = title or make_title(assessment, words)
    slots = {name: build(assessment, words, language) for name, build in PARTS.items()}
    slots |= {
        "title": escape(title),
        "files": _files(words),
        "beats": build_beats(timing, assessment.performance.duration, language),
        "notes": _build_notes(notes, words),
        "data": format_player_data(collect_data(assessment, language)),
        "player_data": format_player_data(encode_player_data(assessment, language)),
    }
    slots.update({f"text_{name}": escape(text) for name, text in words.items()})
    warnings = _say_warnings(assessment, language)
    slots["header"] = build_header(assessment, title, warnings, words, language)
    font = embed_font(collect_text(*slots.values()))
    if font.problem:
        warnings = (*warnings, words["font_missing"].format(reason=font.problem))
        slots["header"] = build_header(assessment, title, warnings, words, language)
    slots["font"] = font_rule(font)
    slots["report"] = fill_slots(read_file("report.html"), slots)
    return fill_page(language, title, ("report.css",), ("report.js", "page.js"), slots)


def _build_notes(notes: str, words: Mapping[str, str]) -> str:
    said = notes.strip()
    if not said:
        return ""
    card = element("div", "card", inner=element("p", "notes-said", said))
    return element("section", {"id": "notes"}, inner=element("h2", None, words["notes_title"]) + card)


def collect_text(*markup: str) -> str:
    """Every character that may be shown; tags and codes do no harm."""
    text = "".join(markup)
    text = re.sub(r"\\u([0-9a-fA-F]{4})", lambda match: chr(int(match.group(1), 16)), text)
    text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return "".join(set(html.unescape(text)))


def _files(words: Mapping[str, str]) -> str:
    links = {
        name: element("a", {"href": file}, file) for name, file in (("curves", CURVES_NAME), ("events", EVENTS_NAME))
    }
    return escape(words["tables_text"]).format(**links)


def write_report(
    assessment: Assessment,
    folder: str | os.PathLike[str],
    *,
    language: str = "en",
    title: str | None = None,
    timing: BeatTiming | None = None,
    notes: str = "",
) -> Path:
    """Write ``report.html``, ``curves.csv`` and ``events.csv``.

    Parameters
    ----------
    assessment : what is reported, of one frame or more.
    folder : made if it is missing; files of these names in it are replaced.
    language : ``"en"`` or ``"ja"``, of the page and its sentences.
    title : of the page; None for who against whom.
    timing : accents against the beats of music, of `dousa.evaluation.assess_timing`; None for no section on it.
    notes : remarks on the performance, of a teacher for instance; shown as they are.

    Returns
    -------
    The path of the page. It needs no other file and no network. If the Japanese font is not installed, the
    page says so and uses the fonts of the machine.

    Raises
    ------
    OptionError : a language that there is not, or a folder that cannot be made or written.
    """
    check_language(language)
    page = build_page(assessment, language, title, timing, notes)
    return write_files(
        folder, page, {CURVES_NAME: to_curves_csv(assessment), EVENTS_NAME: to_events_csv(assessment, language)}
    )


# Chinese characters and kana begin here (Unicode standard); fonts of every machine have the signs that come before.
_FIRST_WIDE = 0x2E80


@dataclass(frozen=True, slots=True)
class EmbeddedFont:
    """A font for one page.

    Parameters
    ----------
    data_url : ``data:`` address of a WOFF; empty if there is nothing to embed.
    characters : what it can show.
    problem : why there is none although the page needs one; empty if all is well.
    """

    data_url: str
    characters: frozenset[str]
    problem: str = ""


def embed_font(text: str) -> EmbeddedFont:
    """The font with the Chinese characters, kana and wide signs of a text.

    Parameters
    ----------
    text : everything that the page shows.
    """
    wanted = frozenset(c for c in text if ord(c) >= _FIRST_WIDE and (c.isprintable() or c == "\u3000"))
    if not wanted:
        return EmbeddedFont("", frozenset())
    path = find_font()
    if path is None or find_spec("fontTools") is None:
        return EmbeddedFont("", frozenset(), f"{FONT_PACKAGE}: pip install 'dousa[pictures]'")
    return _cut(str(path), wanted)


@lru_cache(maxsize=4)
def _cut(path: str, wanted: frozenset[str]) -> EmbeddedFont:
    from fontTools import subset
    from fontTools.ttLib import TTFont, TTLibError

    options = subset.Options()
    options.layout_features = []
    options.hinting = False
    options.notdef_outline = True
    options.name_IDs = [0, 1, 2, 13]  # copyright, name, style, licence
    options.flavor = "woff"
    try:
        with TTFont(path, lazy=True) as font:
            for table in ("GSUB", "GPOS", "vhea", "vmtx", "VORG"):
                if table in font:
                    del font[table]
            known = font.getBestCmap()
            present = frozenset(c for c in wanted if ord(c) in known)
            cutter = subset.Subsetter(options)
            cutter.populate(unicodes=[ord(c) for c in present])
            cutter.subset(font)
            buffer = io.BytesIO()
            font.flavor = "woff"
            font.save(buffer, reorderTables=False)
    except (OSError, TTLibError) as error:
        return EmbeddedFont("", frozenset(), f"{path}: {error}")
    return EmbeddedFont("data:font/woff;base64," + base64.b64encode(buffer.getvalue()).decode("ascii"), present)


def font_rule(font: EmbeddedFont) -> str:
    """The style rule that brings the font; it comes first in the list of fonts, but for its own characters only."""
    if not font.data_url:
        return ""
    source = f'url({font.data_url}) format("woff")'
    return f'@font-face{{font-family:"dousa-ja";src:{source};unicode-range:U+{_FIRST_WIDE:X}-3FFFF}}'
