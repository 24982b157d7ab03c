"""Sentences about events and lapses."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import OptionError
from dousa.evaluation.words import (
    KIND_WORDS,
    LANGUAGES,
    LAPSE_WORDS,
    SEGMENT_WORDS,
    check_language,
    describe_event,
    describe_facing,
    describe_lapse,
    describe_segments,
    format_time,
)

ARM = ("right_upper_arm", "right_forearm")
ALL = tuple(SEGMENT_WORDS["en"])


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0:00.0"),
        (72, "1:12.0"),
        (59.96, "1:00.0"),
        (3599.94, "59:59.9"),
        (-3.0, "-0:03.0"),
        (-0.01, "0:00.0"),
        (math.nan, "–"),
    ],
)
def test_time(seconds: float, text: str) -> None:
    assert format_time(seconds) == text


@pytest.mark.parametrize(
    ("segments", "english", "japanese"),
    [
        (ARM, "right arm", "右腕"),
        (("right_forearm",), "right forearm", "右前腕"),
        (ALL, "whole body", "全身"),
        ((), "whole body", "全身"),
        ((*ARM, "trunk"), "trunk and right arm", "胴体・右腕"),
        (ALL[1:], "both arms and both legs", "両腕・両脚"),
        (("left_thigh", "right_thigh", "trunk", "left_forearm"), "trunk, left forearm and both thighs", None),
        (("left_upper_arm", "left_forearm", "right_forearm"), "left arm and right forearm", "左腕・右前腕"),
    ],
)
def test_segments_become_limbs(segments: tuple[str, ...], english: str, japanese: str | None) -> None:
    assert describe_segments(segments) == english
    if japanese:
        assert describe_segments(segments, "ja") == japanese


@given(st.sets(st.sampled_from(ALL)), st.sampled_from(LANGUAGES))
def test_any_segments_have_words_in_any_order(segments: set[str], language: str) -> None:
    words = describe_segments(segments, language)
    assert words and "_" not in words
    assert words == describe_segments(tuple(reversed(sorted(segments))), language)


def test_events_say_the_number_that_belongs_to_them() -> None:
    assert (
        describe_event("incomplete", 72, ARM, shortfall_deg=24.2, shortfall_percent=38)
        == "1:12.0, right arm: 24 deg short, reaches 62 % of the range"
    )
    assert describe_event("shift", 31, ALL, lag_ms=180, furi=2) == "0:31.0, whole body: 180 ms late (furi 3)"
    assert describe_event("shift", 31, ARM, lag_ms=-90) == "0:31.0, right arm: 90 ms early"
    assert (
        describe_event("partial", 12, ("left_forearm", "left_upper_arm"))
        == "0:12.0, left arm: another movement than the reference's"
    )
    assert describe_event("global", 40, ALL) == "0:40.0, the whole figure is another one"


def test_events_in_japanese() -> None:
    ja = describe_event("incomplete", 72, ARM, shortfall_deg=24, shortfall_percent=38, language="ja", furi=0)
    assert ja == "1:12.0 右腕：24度足りません、手本の振れ幅の62 %まで（振り1）"
    assert (
        describe_event("shift", 31, ALL, lag_ms=180, language="ja", furi=2)
        == "0:31.0 全身：180ミリ秒遅れています（振り3）"
    )


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", list(KIND_WORDS["en"]))
@pytest.mark.parametrize("value", [None, math.nan])
def test_missing_numbers_are_left_out(language: str, kind: str, value: float | None) -> None:
    says = describe_event(
        kind, 1.0, ARM, lag_ms=value, shortfall_deg=value, shortfall_percent=value, language=language
    )
    assert "nan" not in says and "None" not in says and "  " not in says


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", list(LAPSE_WORDS["en"]))
def test_lapses(language: str, kind: str) -> None:
    says = describe_lapse(kind, 31.0, 32.2, 30.0, 32.0, language)
    assert says.startswith("0:31.0")
    assert ("1.2" in says) != ("2.0" in says.removeprefix("0:31.0").replace("0:32.0", ""))
    assert "nan" not in describe_lapse(kind, math.nan, math.nan, math.nan, math.nan, language)


def test_facing() -> None:
    assert describe_facing(math.radians(25)) == "turned 25 deg to the left"
    assert describe_facing(math.radians(-25), "ja") == "右に25度向いている"
    assert describe_facing(math.radians(350)) == "turned 10 deg to the right"
    assert describe_facing(0.0) == "faces as the reference does"
    assert describe_facing(math.nan) == "facing unknown"


def test_both_languages_have_the_same_words() -> None:
    for table in (SEGMENT_WORDS, KIND_WORDS, LAPSE_WORDS):
        assert set(table) == set(LANGUAGES)
        assert list(table["en"]) == list(table["ja"])


def test_unknown_words_are_refused() -> None:
    with pytest.raises(OptionError, match="expected one of en, ja, got 'fr'"):
        check_language("fr")
    with pytest.raises(OptionError, match="left_ear"):
        describe_segments(("left_ear",))
    with pytest.raises(OptionError, match="kind"):
        describe_event("bad", 0.0, ARM)
    with pytest.raises(OptionError, match="kind"):
        describe_lapse("bad", 0, 0, 0, 0)
