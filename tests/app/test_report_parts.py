"""The report by parts, for a page that shows it live: the same markup, a style that ends where the report ends."""

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from app.fake_assessment import make_assessment
from dousa.app.report.page import QUICK_PARTS, build_frame, build_page, build_parts, collect_data, write_report
from dousa.app.tables.evaluation import print_assessment, print_progress
from dousa.evaluation import compare_attempts, read_attempt
from dousa.evaluation.grade.score import round_grade
from dousa.messages import Message


@pytest.mark.parametrize("language", ["en", "ja"])
def test_the_page_is_made_of_the_parts(language: str) -> None:
    assessment = make_assessment()
    page, parts = build_page(assessment, language), build_parts(assessment, language)
    frame = build_frame(language)
    assert sorted(re.findall(r'data-part="(\w+)"', frame)) == sorted([*parts, "files", "notes"])
    for name, markup in parts.items():
        if name == "header" and language == "ja":
            continue  # the page may say there that the font is missing
        assert markup in page, name


def test_quick_parts_are_some_of_all() -> None:
    assessment = make_assessment(seconds=6.0)
    quick, whole = build_parts(assessment, "en", QUICK_PARTS), build_parts(assessment, "en")
    assert set(quick) == set(QUICK_PARTS) < set(whole)
    assert all(whole[name] == markup for name, markup in quick.items())


@pytest.mark.parametrize("score", [76.44, 76.45, 76.5, 77.5, 99.96])
def test_one_grade_is_told_alike_everywhere(score: float) -> None:
    whole = f"{round_grade(score):.0f}"
    assessment = replace(make_assessment(seconds=6.0), score=score)
    header = build_parts(assessment, "en", ("header",))["header"]
    assert re.findall('class="number">([^<]*)', header)[0] == whole
    out = Console(file=io.StringIO(), width=200)
    print_assessment(out, assessment)
    attempt = read_attempt(assessment.to_json(), "pupil")
    print_progress(out, compare_attempts([attempt, attempt]))
    said = out.file.getvalue()
    assert f"grade {whole} of 100" in said and f"the grade stayed at {whole}" in said
    assert re.findall(r"^ *pupil +(\d+)", said, re.MULTILINE) == [whole, whole]


def test_another_dance_was_not_performed_in_percent() -> None:
    nothing = {"score": float("nan"), "warnings": (Message("assessment.unlike", mismatch=0.9),)}
    out = Console(file=io.StringIO(), width=200)
    for assessment in (make_assessment(seconds=6.0), replace(make_assessment(seconds=6.0), **nothing)):
        print_assessment(out, assessment)
    assert out.file.getvalue().count("of the reference was performed") == 1


def test_a_report_can_be_bound_anew(browser: Any, tmp_path: Path) -> None:
    browser.open(write_report(make_assessment(), tmp_path), 1280, 900)
    browser.wait("return document.querySelector('#readout b')?.textContent === '0:00.0'")
    browser.run(
        """window.calls = [];
        const player = {time: 0, looped: null, onTime: () => () => calls.push("ended"), seek: (s) => calls.push(s)};
        window.bound = dousa.bindReport(document.body, arguments[0], player);""",
        collect_data(make_assessment(), "en"),
    )
    press = "document.querySelector('#lanes').dispatchEvent(new KeyboardEvent('keydown', {key: 'End', bubbles: true}))"
    browser.run(press)
    assert len(browser.run("return window.calls")) == 1
    shorter = collect_data(make_assessment(seconds=6.0), "en")
    browser.run("window.bound.update(arguments[0])", shorter)
    browser.run(press)
    assert browser.run("return window.calls")[1] == pytest.approx(shorter["duration"])
    browser.run("window.bound.unbind()")
    browser.run(press)
    assert browser.run("return window.calls.slice(2)") == ["ended"]
    assert browser.messages() == []
