"""Sentences about events and lapses."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import OptionError
from dousa.evaluation import ErrorEvent, Lapse
from dousa.evaluation.advice.directions import OPPOSITES
from dousa.evaluation.posture.range_of_motion import ANGLES
from dousa.evaluation.words import (
    _JOINTS,
    _WHOLES,
    KINDS,
    LAPSE_KINDS,
    SEGMENT_NAMES,
    check_language,
    describe_event,
    describe_heading,
    describe_lapse,
    describe_segments,
    format_time,
)
from dousa.messages import LANGUAGES
from dousa.messages.tables import load_table

ARM = ("right_upper_arm", "right_forearm")
ALL = tuple(SEGMENT_NAMES)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0:00.0"), (72, "1:12.0"), (59.96, "1:00.0"), (3599.94, "59:59.9"), (-3.0, "-0:03.0"), (-0.01, "0:00.0"),
        (math.nan, "–"),
    ],
)  # fmt: skip
def test_time(seconds: float, text: str) -> None:
    assert format_time(seconds) == text


@pytest.mark.parametrize(
    ("segments", "english", "japanese"),
    [
        (ARM, "right arm", "右腕"),
        (("right_forearm",), "right forearm", "右前腕"),
        (ALL, "whole body", "全身"),
        ((), "whole body", "全身"),
        ((*ARM, "trunk"), "trunk and right arm", "胴体と右腕"),
        (ALL[1:], "both arms and both legs", "両腕と両脚"),
        (("left_thigh", "right_thigh", "trunk", "left_forearm"), "trunk, left forearm and both thighs", None),
        (("left_upper_arm", "left_forearm", "right_forearm"), "left arm and right forearm", "左腕と右前腕"),
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


def make_event(kind: str, start_s: float, segments: tuple[str, ...], **values: object) -> ErrorEvent:
    numbers = {"lag_ms": None, "shortfall_deg": None, "shortfall_percent": None, "furi": None} | values
    return ErrorEvent(kind, start_s, start_s + 1.0, segments, severity=2.0, worst_s=0.0, reference_s=0.0, **numbers)  # type: ignore[arg-type]


def test_events_say_the_number_that_belongs_to_them() -> None:
    short = make_event("incomplete", 72, ARM, shortfall_deg=24.2, shortfall_percent=38)
    assert str(short.says) == "1:12.0, right arm: 24 deg short, reaches 62 % of the range"
    assert str(short.message) == "right arm: 24 deg short, reaches 62 % of the range"
    late = make_event("shift", 31, ALL, lag_ms=180, furi=2)
    assert str(late.says) == "0:31.0, whole body: 180 ms late (figure 3)"
    assert str(late.says_in_furi) == "whole body: 180 ms late (figure 3)"
    assert str(make_event("shift", 31, ARM, lag_ms=-90).says) == "0:31.0, right arm: 90 ms early"
    partial = make_event("partial", 12, ("left_forearm", "left_upper_arm"))
    assert str(partial.says) == "0:12.0, left arm: a different movement from the reference's"
    assert str(make_event("partial", 12, ARM, shortfall_deg=-21.0).message) == (
        "right arm: goes 21 deg further than the reference"
    )
    assert str(make_event("partial", 12, ARM, deviation_deg=41.0).message).endswith("by up to 41 deg")
    assert str(make_event("global", 40, ALL).says) == "0:40.0, a different figure from the reference's"


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("value", [None, math.nan])
def test_missing_numbers_are_left_out(language: str, kind: str, value: float | None) -> None:
    message = describe_event(kind, ARM, lag_ms=value, shortfall_deg=value, shortfall_percent=value)
    says = message.render(language)
    assert says and "nan" not in says and "None" not in says and "  " not in says


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", list(LAPSE_KINDS))
def test_lapses(language: str, kind: str) -> None:
    says = Lapse(kind, 31.0, 32.2, 30.0, 32.0).says.render(language)
    assert says.startswith("0:31.0")
    assert ("1.2" in says) != ("2.0" in says.removeprefix("0:31.0").replace("0:32.0", ""))
    assert "nan" not in Lapse(kind, math.nan, math.nan, math.nan, math.nan).says.render(language)


def test_headings() -> None:
    assert str(describe_heading(math.radians(25))) == "turned 25 deg to the left"
    assert describe_heading(math.radians(-25)).render("ja") == "右に25度向いています"
    assert str(describe_heading(math.radians(350))) == "turned 10 deg to the right"
    assert str(describe_heading(0.0)) == "faces the same way as the reference"
    assert str(describe_heading(math.nan)) == "heading unknown"


def test_unknown_words_are_refused() -> None:
    with pytest.raises(OptionError, match="expected one of en, ja, got 'fr'"):
        check_language("fr")
    with pytest.raises(OptionError, match="left_ear"):
        describe_segments(("left_ear",))
    with pytest.raises(OptionError, match="kind"):
        describe_event("bad", ARM)
    with pytest.raises(OptionError, match="kind"):
        describe_lapse("bad", 0, 0, 0, 0)


def test_tables_of_names_hold_what_is_named_and_nothing_else() -> None:
    """Their codes are put together from names."""
    parts = {*SEGMENT_NAMES, *_WHOLES, "whole_body", "several"}
    joints = {message.code.removeprefix("advice_parts.") for message in _JOINTS.values()}
    directions = {*OPPOSITES, *OPPOSITES.values(), "upright", "turn_left", "turn_right"}
    expected = {
        "body_segments": parts | {"unknown"},
        "advice_parts": parts | joints,
        "advice_corrections": directions | {"larger", "smaller"},
        "error_kinds": {*KINDS, "unknown"},
        "lapse_kinds": {kind.replace(" ", "_").replace("-", "_") for kind in LAPSE_KINDS},
        "joint_angles": set(ANGLES),
        "offset_ways": {"out", "in", "up", "down", "forward", "back", "left", "right"},
    }
    codes = [code.split(".", 1) for code in load_table("en")]
    assert {group: {name for first, name in codes if first == group} for group in expected} == expected
