"""The report of an exercise: what it says, draws, lists and plays, in both languages, whatever was found."""

import base64
import csv
import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.report_cases import PageReader, page_data
from dousa.app.player.data import encode_repetitions
from dousa.app.report.exercise import build_exercise_page, write_exercise_report
from dousa.errors import OptionError
from dousa.evaluation import RepetitionsAssessment, assess_repetitions
from dousa.messages import Message
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories, mirror_canonical
from dousa.motion.synthetic import draw_performer, make_motion
from lab.trials.exercise_sets import join_repetitions


def make_clips(category: str, n: int) -> list[CanonicalMotion]:
    performer = draw_performer(303)
    takes = [canonicalise(compute_trajectories(make_motion(category, performer, take))) for take in range(14)]
    return [take for take in takes if take.duration * performer.tempo < 2.7][:n]


@pytest.fixture(scope="module")
def kicks() -> tuple[CanonicalMotion, CanonicalMotion]:
    """A kick of the left leg, and four more of which the second is broken off."""
    kick, *clips = make_clips("kick_left", 5)
    return kick, join_repetitions(clips, np.random.default_rng(4), broken_off=[1]).motion


@pytest.fixture(scope="module")
def done(kicks: tuple[CanonicalMotion, CanonicalMotion]) -> RepetitionsAssessment:
    return assess_repetitions(*kicks)


@pytest.mark.parametrize("language", ["en", "ja"])
def test_page_and_table_are_written(
    done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion], tmp_path: Path, language: str
) -> None:
    path = write_exercise_report(done, kicks[1], tmp_path / "new", language=language, name="kicks.trc")
    assert sorted(file.name for file in path.parent.iterdir()) == ["repetitions.csv", "report.html"]
    rows = list(csv.DictReader((path.parent / "repetitions.csv").read_text().splitlines()))
    assert [row["complete"] for row in rows] == ["1", "0", "1", "1"]
    page = path.read_text(encoding="utf-8")
    reader = PageReader(page)
    assert "kicks.trc" in reader.text
    assert "nan" not in re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL)
    assert "{" not in reader.text and "http://" not in reader.text
    # In the list, over the curves and among the pictures each repetition can be pressed.
    pressed = [
        attrs["data-repetition"] for tag, attrs in reader.elements if tag == "button" and "data-repetition" in attrs
    ]
    assert pressed == ["0", "1", "2", "3"] * 3
    assert len(reader.with_class("pose-cell")) == 5
    for tag, attrs in reader.elements:
        if tag == "svg":
            assert attrs.get("aria-label") or attrs.get("aria-hidden") == "true"


def test_what_it_says_is_what_was_measured(
    done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion]
) -> None:
    page = build_exercise_page(done, kicks[1], "en", "kicks.trc")
    reader = PageReader(page)
    scores = [one.score for one in done.complete]
    assert re.findall(r'<span class="number">(.*?)</span>', page)[:2] == ["3", f"{np.median(scores):.0f}"]
    assert f"grade {np.median(scores):.0f} of 100 in the median" in reader.text
    assert "repetition 2: broken off" in reader.text and "and 1 broken off" in reader.text
    rows = re.findall(r"<tr( class=.incomplete-row.)?><th scope=.row.>(\d)</th>(.*?)</tr>", page)[:4]
    assert [bool(incomplete) for incomplete, *_ in rows] == [False, True, False, False]
    for (_, _, cells), one in zip(rows, done.repetitions, strict=True):
        ranged = one.get_range("left_hip_flexion")
        assert f"{ranged.range_deg:.0f}° ({ranged.percent:.0f} %)" in cells
    bars = [attrs["style"] for attrs in reader.with_class("bar-of") if "key-mark" not in (attrs["class"] or "")]
    assert len(bars) >= 3 + 4 + 4  # grades of the complete ones, durations and ranges of all
    heights = [float(re.search(r"height:([\d.]+)%", style or "")[1]) for style in bars[:3]]  # type: ignore[index]
    assert heights == pytest.approx(scores, abs=0.1)


def test_the_player_has_the_reference_beside_each_graded_one(
    done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion]
) -> None:
    import base64

    data = encode_repetitions(done, kicks[1], "kicks.trc")
    spans = [(one["start"], one["end"]) for one in data["furi"]]
    assert spans == [(round(r.repetition.start_s, 4), round(r.repetition.end_s, 4)) for r in done.repetitions]
    assert [one["label"] for one in data["furi"]] == ["1", "2", "3", "4"]
    for name in ("step", "time"):
        values = np.frombuffer(base64.b64decode(data[name]), "<i4")
        times = np.arange(len(values)) / data["rate"]
        for one in done.repetitions:
            inside = (times > one.repetition.start_s) & (times < one.repetition.end_s)
            met = (values[inside] >= 0).mean()
            assert met == 0.0 if not one.repetition.complete else met > 0.6
        assert (values[times < done.repetitions[0].first_s - 0.1] < 0).all()


def test_a_mirrored_performance_is_shown_as_it_was_measured(kicks: tuple[CanonicalMotion, CanonicalMotion]) -> None:
    kick, several = kicks
    mirrored = mirror_canonical(several)
    page = build_exercise_page(assess_repetitions(kick, mirrored, side="mirrored"), mirrored, "en")
    assert "The performance was mirrored" in page and "left hip flexion" in page
    own = build_exercise_page(assess_repetitions(kick, several), several, "en")
    pick = re.compile(r'class="angle angle-1"')
    assert pick.search(page) and pick.search(own)
    curves = [re.search(r'd="([^"]+)" class="angle angle-1"', text)[1] for text in (page, own)]  # type: ignore[index]
    ours, theirs = (np.array(re.findall(r"[\d.]+", curve), float) for curve in curves)
    np.testing.assert_allclose(ours, theirs, atol=1.0)


def test_nothing_graded_and_warnings(
    done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion]
) -> None:
    repetitions = tuple(dataclasses.replace(one, score=math.nan, assessment=None) for one in done.repetitions)
    warning = Message("text.verbatim", text="<b>look</b>")
    bare = dataclasses.replace(done, repetitions=repetitions, warnings=(warning,))
    page = build_exercise_page(bare, kicks[1], "en")
    reader = PageReader(page)
    assert "no repetition could be graded" in reader.text and "too short to be graded" in "".join(reader.texts)
    assert "<b>look</b>" not in page and "&lt;b&gt;look" in page
    assert len(reader.with_class("pose-cell")) == 4  # no reference to show
    assert page_data(page, "player-data")["reference"] is None


def test_hostile_names_stay_names(done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion]) -> None:
    bad = "</script><script>window.hacked=1</script>{{table}}"
    page = build_exercise_page(done, kicks[1], "en", bad)
    PageReader(page)
    assert bad not in page and page.count("<script") == 4
    assert page_data(page, "player-data")["performance"]["name"] == bad


def test_a_folder_that_cannot_be_written(
    done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="cannot be written"):
        write_exercise_report(done, kicks[1], tmp_path / "file")


def test_a_press_plays_a_repetition(
    browser: Any, done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion], tmp_path: Path
) -> None:
    browser.open(write_exercise_report(done, kicks[1], tmp_path, language="ja", name="kicks.trc"), 1280, 900)
    browser.run("document.querySelectorAll('.event[data-repetition]')[2].click()")
    browser.wait(
        "return document.querySelectorAll('.event[data-repetition]')[2].getAttribute('aria-current') === 'true'"
    )
    share = float(browser.run("return document.body.style.getPropertyValue('--now-share')"))
    third = done.repetitions[2].repetition
    assert third.start_s - 0.4 <= share * done.duration_s <= third.end_s + 0.4
    assert browser.messages() == []


def test_sixteen_repetitions_fit_two_sheets(
    browser: Any, done: RepetitionsAssessment, kicks: tuple[CanonicalMotion, CanonicalMotion], tmp_path: Path
) -> None:
    browser.open(write_exercise_report(done, kicks[1], tmp_path, name="kicks.trc"), 1280, 900)
    browser.run(
        "for (const list of document.querySelectorAll('.event-list, .poses')) for (const one of [...list.children])"
        " while (list.children.length < 16) list.append(one.cloneNode(true));"
    )
    sheets = browser.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": True, "preferCSSPageSize": True})
    assert base64.b64decode(sheets["data"]).count(b"/Type /Page\n") == 2
