"""Words: every channel can be spoken of, units are those of people, directions are the true ones."""

import re

import numpy as np
import pytest
from oracles.standing import standing

from dousa.motion import JOINT_INDEX
from dousa.retrieval import FEATURE_SETS
from dousa.retrieval.explain.phrases import Fact, say_fact, say_shared_fact
from dousa.retrieval.features.channels import CHANNELS, Channel, compute_channels
from dousa.retrieval.features.feature_sets import DURATION

CHANNELS_OF_ALL = tuple(
    {channel.name: channel for features in FEATURE_SETS.values() for channel in features.channels}.values()
)


def fact(name="right hand above pelvis", unit="body heights", **changed):
    fields = {
        "channel": Channel(name, name, unit), "kind": "mean", "above": True, "start": 0.4, "end": 1.1, "whole": False,
        "value": 0.42, "threshold": 0.31, "others": 50, "away": 45,
    }  # fmt: skip
    return Fact(**(fields | changed))


@pytest.mark.parametrize("channel", [*CHANNELS_OF_ALL, DURATION], ids=lambda channel: channel.name)
def test_every_channel_has_words_of_its_own(channel):
    assert "text.verbatim" in str(say_fact(fact("?", channel.unit)).to_json())
    for kind in ("mean", "spread", "trend"):
        for above in (True, False):
            for value in (0.3, -0.3):
                threshold = value - 0.1 if above else value + 0.1
                said = say_fact(
                    fact(channel.name, channel.unit, kind=kind, above=above, value=value, threshold=threshold)
                )
                assert "text.verbatim" not in str(said.to_json())
                text, japanese = said.render("en"), said.render("ja")
                assert "usual" in text
                assert "ふつうより" in japanese and not re.search("[a-z{}_]", japanese)
                assert "  " not in text
                assert "most others" in text
                assert "radians" not in text


@pytest.mark.parametrize(
    ("changed", "parts"),
    [
        ({}, "is higher than|from 0.4 s to 1.1 s|0.42 body heights above the pelvis (most others: less than 0.31)"),
        ({"threshold": -0.1}, "higher than|(most others: more than 0.10 below it)"),
        ({"above": False, "value": -0.2, "threshold": -0.1, "away": 20}, "lower than|below the pelvis (many others:"),
        ({"above": False, "value": -0.2, "threshold": 0.001, "whole": True, "away": 1},
         "lower than|over the whole motion|(some others: above it)"),
        ({"kind": "spread", "value": 0.2, "threshold": 0.1}, "varies more than|0.20 body heights (most others: less"),
        ({"kind": "trend", "above": False, "value": -0.3, "threshold": 0.1}, "sinks more than|more than 0.10 up)"),
        ({"kind": "trend", "above": False, "value": 0.1, "threshold": 0.3}, "rises less than|(most others: more than"),
        ({"channel": Channel("left elbow left of pelvis", "", "body heights"), "value": -0.1, "threshold": -0.2},
         "farther to the left than|0.10 body heights to the right of the pelvis (most others: more than 0.20)"),
        ({"channel": Channel("distance left hand - head", "", "body heights"), "above": False, "value": 0.2},
         "closer together than|body heights apart (most others: more than"),
        ({"channel": Channel("trunk leaning forward", "", "radians"), "value": np.radians(20), "threshold": -0.0873},
         "leans more forward than|20 degrees forward (most others: more than 5 back)"),
        ({"channel": Channel("right hand heading upwards", "", "share of its speed"), "kind": "spread"},
         "goes upwards and downwards more than|42 % of its speed (most others: less than 31 %)"),
        ({"channel": DURATION, "whole": True, "above": False, "value": 1.24, "threshold": 1.61}, "shorter than|1.2 s"),
        ({"channel": Channel("something new", "", "")}, "something new is larger than|0.42 (most others: less"),
    ],
)  # fmt: skip
def test_sentences(changed, parts):
    said = str(say_fact(fact(**changed)))
    assert all(part in said for part in parts.split("|")), said


def test_numbers_that_would_look_the_same_get_one_more_digit():
    assert "0.314 body heights above the pelvis (most others: less than 0.309)" in str(
        say_fact(fact(value=0.314, threshold=0.309))
    )


def test_few_others_are_not_most():
    assert "most others" in str(say_fact(fact(others=5, away=5)))
    assert "many others" in str(say_fact(fact(others=2, away=2)))


def test_two_clips_in_one_sentence():
    first = fact()
    assert str(say_shared_fact(first, fact(value=0.45, start=0.6, end=1.5))) == (
        "the right hand is higher than usual from 0.4 s to 1.1 s (there from 0.6 s to 1.5 s): on average 0.42 and "
        "0.45 body heights above the pelvis (most others: less than 0.31)"
    )
    assert say_shared_fact(first, fact(value=0.42)) == say_fact(first)
    mixed = str(say_shared_fact(fact(value=0.05, threshold=-0.1), fact(value=-0.02, threshold=-0.1)))
    assert "0.05 body heights above the pelvis and 0.02 body heights below the pelvis" in mixed
    assert "more than 0.10 below it" in mixed


# For a viewer in front the performer's left (+X) is to the right; from the right side forward (+Z) is; from above,
# with forward up on the page, the right (-X) is.
VIEWS = {
    "seen from the front": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "seen from the side": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "seen from above": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_curves_go_the_way_that_a_viewer_sees(view, turn):
    across, up = (np.array(axis) for axis in VIEWS[view])
    angle = turn * 2 * np.pi * np.arange(60)[:, None] / 30  # counterclockwise for the viewer
    motion = np.repeat(standing(), 60, axis=0)
    motion[:, JOINT_INDEX["right_hand"]] += 0.3 * (np.cos(angle) * across + np.sin(angle) * up)
    number = next(k for k, channel in enumerate(CHANNELS) if channel.name == f"right hand curving, {view}")
    value = float(compute_channels(motion, 1.7)[10:50, number].mean())
    text = str(say_fact(fact(f"right hand curving, {view}", "radians a second", value=value, threshold=value - 0.1)))
    assert f"degrees a second {'counterclockwise' if turn > 0 else 'clockwise'}" in text
