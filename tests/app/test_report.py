"""The report: one page that opens offline, in both languages, whatever the assessment holds."""

import base64
import csv
import dataclasses
import io
import json
import math
import re
import zlib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from app.fake_assessment import HOSTILE_WORDS, make_assessment
from app.report_cases import UNUSUAL, PageReader, change, page_data
from dousa.app.drawing.charts import choose_ticks, encode_map, thin_curve, time_ticks
from dousa.app.drawing.markup import element, format_number, trace
from dousa.app.report import page as _fonts
from dousa.app.report.page import build_page, build_parts, write_report
from dousa.errors import OptionError
from dousa.evaluation import advise
from dousa.evaluation.words import SEGMENT_NAMES, name_all
from dousa.messages import Message, load_section

_SHAPES = {"path", "polygon", "circle", "rect", "line"}


@pytest.fixture(scope="module")
def english() -> str:
    return build_page(make_assessment(), "en")


@pytest.fixture(scope="module")
def japanese() -> str:
    return build_page(make_assessment(), "ja")


def test_what_counts_stands_beside_the_figures_of_the_segments() -> None:
    weights = np.array([0.78, 1.16, 1.13, 1.18, 1.14, 0.91, 0.89, 0.92, 0.90])
    assessment = make_assessment()
    residual = np.full_like(assessment.residual, 0.1)
    residual[: len(residual) // 4, 3] = 0.5
    residual[:, 8] = np.nan
    shown = change(assessment, weights=weights, residual=residual, offset_deg=np.arange(9.0))
    parts = build_parts(shown, "en", ("segments", "furi"))
    rows = re.findall(r"<tr><th scope=\"row\">(.*?)</tr>", parts["segments"])
    texts = [re.sub(r"<[^>]+>", "|", row) for row in rows]
    assert [text.split("|")[0] for text in texts] == list(name_all(SEGMENT_NAMES, "en").values())
    assert [re.search(r"× ([\d.]+)", text)[1] for text in texts] == [f"{weight:.2f}" for weight in weights]  # type: ignore[index]
    assert texts[3].endswith("|6°||25 %||17°||3°|")
    assert texts[8].endswith("|–||–||17°||8°|")
    widths = [float(width) for width in re.findall(r"width:([\d.]+)em", parts["segments"])]
    assert widths.index(max(widths)) == 3 and widths[0] / widths[3] == pytest.approx(0.78 / 1.18, abs=0.01)
    (counts,) = re.findall(r'<tr class="counts-row">(.*?)</tr>', parts["furi"])
    assert re.findall(r"× ([\d.]+)", counts) == [f"{weight:.2f}" for weight in weights]


def test_all_alike_is_said() -> None:
    words = load_section("report", "ja")
    shown = build_parts(make_assessment(), "ja", ("segments",))["segments"]
    assert words["segments_alike"] in shown and words["segments_text"] not in shown


def test_contents_in_english(english: str) -> None:
    text = " ".join(PageReader(english).texts)
    said = ("71", "not calibrated", "100 - 10 x 2.9 = 71", "What to work on", "Analysis", "Timeline", "d#", "d*")
    notes = ("one take of the reference: the limits are guessed", "leaves out 1.0 s of the reference")
    assert [words for words in said + notes if words not in text] == []


def test_three_files_are_written(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    path = write_report(make_assessment(), folder)
    assert path == folder / "report.html"
    assert sorted(p.name for p in folder.iterdir()) == ["curves.csv", "events.csv", "report.html"]
    page = path.read_text(encoding="utf-8")
    assert '<html lang="en">' in page and "<title>pupil.bvh against reference.bvh</title>" in page
    again = write_report(make_assessment(), folder, title="Spring & show")
    assert "<h1>Spring &amp; show</h1>" in again.read_text(encoding="utf-8")


def test_the_page_asks_nothing_of_the_network(english: str, japanese: str) -> None:
    for page in (english, japanese):
        asked = page.replace("http://www.w3.org/2000/svg", "")  # the name of a namespace, never loaded
        assert not re.search(r"https?:|//[a-z]+\.[a-z]|url\((?!data:)|@import", asked, re.IGNORECASE)
        for tag, attrs in PageReader(page).elements:
            for name in ("src", "href", "poster", "srcset", "data"):
                value = attrs.get(name)
                if value is not None:
                    assert value.startswith(("data:", "#")) or value in ("curves.csv", "events.csv"), (tag, value)
        assert "default-src 'none'" in page


def test_advice_comes_first_with_its_picture(english: str, japanese: str) -> None:
    assessment = make_assessment()
    said = advise(assessment, "brief")
    for page, language in ((english, "en"), (japanese, "ja")):
        text = " ".join(PageReader(page).texts)
        places = [text.index(one.message.render(language)) for one in said]
        assert places == sorted(places)
        words = load_section("report", language)
        order = [words[f"{name}_title"] for name in ("advice", "player", "events", "timeline", "moments", "analysis")]
        found = [text.index(title) for title in order]
        assert found == sorted(found) and found[0] < places[0] < places[-1] < found[1]
        tips = re.findall(r'<button type="button" class="tip .*?</button>', page)
        assert len(tips) == len(said)
        for tip, one in zip(tips, said, strict=True):
            assert (f'data-event="{one.event}"' in tip) == (one.event is not None)
            assert ("<svg" in tip and "arrow-head" in tip) == bool(one.corrections) or one.event is None


def test_every_text_of_the_report_is_used() -> None:
    folder = resources.files("dousa.app.report")
    sources = "".join(
        file.read_text(encoding="utf-8") for file in folder.iterdir() if file.name.endswith((".py", ".js", ".html"))
    )
    made = tuple("col_ d_ fact_ furi_ kind_short_ letter_ matrix_ read_ seen_from_ view_ row_ segments_".split())
    unused = [
        name
        for name in load_section("report", "en")
        if not name.startswith(made) and not re.search(rf"\b(text_)?{name}\b", sources)
    ]
    assert unused == []


def test_what_the_teacher_says_stands_in_the_page_as_text() -> None:
    assessment = make_assessment()
    page = build_page(assessment, "en", notes="Softer knees\n<script>alert(1)</script>")
    assert 'id="notes"' in page
    assert "Softer knees\n&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert page.index('id="watch"') < page.index('id="notes"') < page.index('id="analysis"')
    assert 'id="notes"' not in build_page(assessment, "en", notes=" \n")


@pytest.mark.parametrize("language", ["en", "ja"])
def test_hostile_words_stay_words(language: str) -> None:
    assessment = make_assessment(words=HOSTILE_WORDS)
    bad = "</script><script>window.hacked=1</script>{{player_data}}"
    sequences = [dataclasses.replace(s, name=bad) for s in (assessment.reference, assessment.performance)]
    furi = tuple(dataclasses.replace(f, label="<i>A\"'") for f in assessment.furi)
    assessment = change(
        assessment,
        reference=sequences[0],
        performance=sequences[1],
        furi=furi,
        warnings=(Message("text.verbatim", text=bad),),
        score_formula=Message("text.verbatim", text=bad),
    )
    page = build_page(assessment, language)
    reader = PageReader(page)
    assert [tag for tag, _ in reader.elements].count("script") == 4
    assert not any("onerror" in attrs for _, attrs in reader.elements)
    assert HOSTILE_WORDS in reader.text
    assert bad in reader.text


def test_file_names_that_are_no_text(tmp_path: Path) -> None:
    assessment = make_assessment()
    odd = dataclasses.replace(assessment.performance, name="caf\udce9.bvh")
    page = write_report(change(assessment, performance=odd), tmp_path).read_bytes().decode("utf-8")
    assert "caf?.bvh" in page


def _embedded_characters(page: str) -> set[str]:
    from fontTools.ttLib import TTFont

    found = re.search(r"url\(data:font/woff;base64,([^)]+)\)", page)
    assert found, "no font in the page"
    with TTFont(io.BytesIO(base64.b64decode(found.group(1)))) as font:
        return {chr(code) for code in font.getBestCmap()}


@pytest.mark.parametrize("language", ["en", "ja"])
def test_every_character_has_a_glyph(language: str) -> None:
    assessment = make_assessment()
    named = dataclasses.replace(assessment.performance, name="牛深ハイヤ節\u3000動作１.bvh")
    page = build_page(change(assessment, performance=named), language)
    reader = PageReader(page)
    shown = set(reader.text) | set(json.dumps(page_data(page), ensure_ascii=False))
    shown |= set(json.dumps(page_data(page, "player-data"), ensure_ascii=False))
    for _, attrs in reader.elements:
        shown |= set("".join(attrs.get(name) or "" for name in ("title", "aria-label", "alt")))
    plain = {chr(code) for code in range(0x100)} | set("–−×†•…“”’‘±°·")  # in the fonts of every system
    assert "節" in shown
    assert shown - plain <= _embedded_characters(page)


def test_an_english_page_carries_no_font(english: str) -> None:
    assert "@font-face" not in english


def test_a_missing_font_is_said_and_nothing_else_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_fonts, "find_font", lambda: None)
    page = build_page(make_assessment(), "ja")
    assert "@font-face" not in page
    assert "pip install &#x27;dousa[pictures]&#x27;" in page


def test_every_picture_has_words_and_a_table(english: str) -> None:
    reader = PageReader(english)
    for tag, attrs in reader.elements:
        if tag == "svg":
            assert attrs.get("aria-label") or attrs.get("aria-hidden") == "true"
        if tag == "img":
            assert attrs.get("alt")
    tables = [attrs for tag, attrs in reader.elements if tag == "table"]
    # Segments, furi, one a figure, one a moment, events, lapses, gaps.
    assert len(tables) == 2 + len(reader.with_class("shape-card")) + len(reader.with_class("moment")) + 3
    captions = [tag for tag, _ in reader.elements if tag == "caption"]
    assert len(captions) == len(tables)


def test_no_number_is_nan(english: str) -> None:
    reader = PageReader(english)
    for tag, attrs in reader.elements:
        if tag in _SHAPES or "style" in attrs:
            assert not re.search(r"\bnan|\binf|None", " ".join(v or "" for v in attrs.values())), (tag, attrs)


@pytest.mark.parametrize("language", ["en", "ja"])
@pytest.mark.parametrize("case", list(UNUSUAL))
def test_unusual_assessments(case: str, language: str, tmp_path: Path) -> None:
    assessment = UNUSUAL[case](make_assessment(seconds=6.0))
    path = write_report(assessment, tmp_path, language=language)
    page = path.read_text(encoding="utf-8")
    test_no_number_is_nan(page)
    page_data(page)
    words = load_section("report", language)
    if case == "nothing found":
        assert words["worst_none"] in page and words["events_none"] in page
    assert (words["no_grade"] in page) == (not math.isfinite(assessment.score))
    if case == "calibrated":
        assert words["calibrated"].format(count=5) in page
        assert words["uncalibrated"] not in " ".join(PageReader(page).texts)


def test_curves_csv_is_whole(tmp_path: Path) -> None:
    assessment = make_assessment(seconds=6.0)
    write_report(assessment, tmp_path)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "curves.csv").read_text(encoding="ascii"))))
    assert len(rows) == assessment.performance.n_frames
    assert (
        list(rows[0])[:11]
        == (
            "time_s reference_s matched_s furi lag_ms facing_deg d_space d_space_limit d_within d_within_limit d_path"
        ).split()
    )
    assert rows[-1]["matched_s"] == "" and rows[0]["furi"] == "1"
    np.testing.assert_allclose([float(row["d_space"]) for row in rows], assessment.d_space, atol=1e-5)
    read = [float(row["right_forearm_deg"]) for row in rows]
    np.testing.assert_allclose(read, np.degrees(assessment.residual[:, 4]), atol=0.01)


def test_events_csv_holds_events_and_lapses(tmp_path: Path) -> None:
    assessment = make_assessment()
    write_report(assessment, tmp_path, language="ja")
    data = (tmp_path / "events.csv").read_bytes()
    assert data.startswith(b"\xef\xbb\xbf")  # spreadsheets guess another encoding without it
    rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"))))
    assert len(rows) == len(assessment.events) + len(assessment.lapses)
    assert {row["kind"] for row in rows} == {"global", "partial", "incomplete", "shift", "skip"}
    assert [row["says"] for row in rows if row["kind"] == "shift"] == [
        event.says.render("ja") for event in assessment.events if event.kind == "shift"
    ]


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    assessment = make_assessment(seconds=4.0)
    file = tmp_path / "file"
    file.write_text("x")
    for folder in (file, file / "below", "bad\0name"):
        with pytest.raises(OptionError, match="report cannot be written"):
            write_report(assessment, folder)
    (tmp_path / "taken" / "report.html").mkdir(parents=True)
    with pytest.raises(OptionError, match="report cannot be written"):
        write_report(assessment, tmp_path / "taken")


def test_another_language_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="expected one of en, ja"):
        write_report(make_assessment(seconds=4.0), tmp_path, language="fr")
    assert not list(tmp_path.iterdir())


def test_long_takes_are_thinned() -> None:
    long = build_page(make_assessment(seconds=120.0, frame_rate=60.0), "en")
    lines = [attrs["d"] or "" for tag, attrs in PageReader(long).elements if tag == "path" and attrs.get("d")]
    assert max(line.count("L") for line in lines) <= 2000
    assert len(page_data(long)["space"]) <= 2000


def test_thinning_keeps_peaks_and_gaps() -> None:
    rng = np.random.default_rng(3)
    times = np.arange(50_000) / 100.0
    values = rng.random(50_000)
    values[12_345], values[40_000] = 9.0, -7.0
    values[20_000:25_000] = np.nan
    x, y = thin_curve(times, values, 1000)
    assert len(x) == len(y) <= 1000 and (np.diff(x) >= 0).all()
    assert np.nanmax(y) == 9.0 and np.nanmin(y) == -7.0
    assert x[np.nanargmax(y)] == pytest.approx(123.45)
    assert np.isnan(y[(x > 201) & (x < 249)]).all()


def test_the_picture_of_a_matrix_is_a_png() -> None:
    values = np.array([[0.0, 1.0, np.nan], [0.5, 2.0, -1.0]])
    data = base64.b64decode(encode_map(values, 0.0, 1.0).removeprefix("data:image/png;base64,"))
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    start = data.index(b"IDAT") + 4
    size = int.from_bytes(data[start - 8 : start - 4], "big")
    lines = np.frombuffer(zlib.decompress(data[start : start + size]), np.uint8).reshape(2, 4)
    assert lines.tolist() == [[0, 0, 254, 255], [0, 127, 254, 0]]


def test_small_parts() -> None:
    assert (
        element("p", {"class": 'a"b', "hidden": True, "x": None}, "<&>")
        == '<p class="a&quot;b" hidden>&lt;&amp;&gt;</p>'
    )
    assert format_number(-0.001) == "0" and format_number(math.nan) == "–" and format_number(12.50) == "12.5"
    assert trace(np.array([0.0, 1.0, np.nan, 2.0]), np.array([0.0, 1.0, 1.0, 3.0])) == "M0 0L1 1M2 3"
    assert choose_ticks(0.0, 1.08, 3) == (0.0, 0.5, 1.0) and choose_ticks(math.nan, 1.0) == ()
    assert time_ticks(0.1)[0] == 0.0 and len(time_ticks(300.0)) <= 12
