"""The section of the report on the beats of the music: what it says, draws and lists, and that it is absent without."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.fake_assessment import make_assessment
from dousa.app.report.page import build_page, write_report
from dousa.app.report.timeline import build_beats
from dousa.evaluation import Accent, BeatTiming, TimedAccent


def make_timing(drift: float = 0.0, *, estimated: bool = False, n: int = 24) -> BeatTiming:
    """An accent each second, 40 ms late and later; every sixth between the beats."""
    accents = []
    for number in range(n):
        late, off = 40.0 + drift * number / 60.0, number % 6 == 5
        kind = ("step", "stop", "clap", "turn")[number % 4]
        accent = Accent(float(number), kind, ("left_hand", "right_hand")[: 1 + (kind == "clap")], 0.8)
        beat = (None, None, None) if off else (2.0 * number + 1.0, number - late / 1000.0, late)
        accents.append(TimedAccent(accent, *beat))
    median = float(np.median([one.off_ms for one in accents if one.off_ms is not None])) if accents else math.nan
    return BeatTiming(
        tuple(accents),
        60,
        120.0,
        0.0,
        estimated,
        0.9,
        1e-6,
        1,
        math.nan if estimated else median,
        3.0,
        drift,
        drift != 0,
    )


def count(pattern: str, markup: str) -> int:
    return len(re.findall(pattern, markup))


def test_without_music_there_is_no_section() -> None:
    assert build_beats(None, 10.0, "en") == ""
    assert 'id="beats"' not in build_page(make_assessment(seconds=6.0), "en")


def test_each_accent_is_drawn_and_listed() -> None:
    markup = build_beats(make_timing(), 24.0, "en")
    assert count(r'class="dot \w+( between)?" style', markup) == 24
    assert count(r'class="dot \w+ between" style', markup) == 4
    assert count(r"<tr><th scope=.row.>", markup) == 24
    assert "40 ms late" in markup and "120 beats a minute" in markup and "20 of 24" in markup
    assert "On the beat: 20 of 24 accents belong to beats of the music" in markup
    assert 'class="level median"' in markup and 'class="trend"' not in markup
    assert "left hand, right hand" in markup


@pytest.mark.parametrize(("drift", "said"), [(90.0, "90 ms later each minute"), (-90.0, "90 ms earlier each minute")])
def test_a_drift_is_a_line(drift: float, said: str) -> None:
    markup = build_beats(make_timing(drift), 24.0, "en")
    assert said in markup
    (data,) = re.findall(r'<path d="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)" class="trend">', markup)
    left, first, right, last = (float(value) for value in data)
    assert left < right
    assert (last < first) == (drift > 0)  # later is further up


def test_late_throughout_cannot_be_told_of_an_estimated_start() -> None:
    markup = build_beats(make_timing(estimated=True), 24.0, "en")
    assert "cannot be told: the start of the music was estimated" in markup
    assert 'class="level median"' not in markup and "nan" not in markup


def test_no_accents_on_the_beat() -> None:
    lost = tuple(TimedAccent(one.accent, None, None, None) for one in make_timing().accents)
    timing = replace(
        make_timing(), accents=lost, median_ms=math.nan, spread_ms=math.nan, drift_ms_per_min=math.nan, p_value=0.8
    )
    markup = build_beats(timing, 24.0, "en")
    assert "nan" not in markup and "0 of 24" in markup


def test_many_accents_are_thinned_in_the_picture() -> None:
    markup = build_beats(make_timing(n=3000), 3000.0, "en")
    assert 300 <= count(r'class="dot \w+( between)?" style', markup) <= 600
    assert count(r"<tr><th scope=.row.>", markup) == 3000


def test_the_page_has_it(tmp_path: Path) -> None:
    page = write_report(make_assessment(), tmp_path, timing=make_timing()).read_text(encoding="utf-8")
    assert page.index("The worst moments") < page.index('<section id="beats">') < page.index('id="analysis"')
