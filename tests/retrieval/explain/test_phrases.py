"""Words: every channel can be spoken of, units are those of people, directions are the true ones."""

import itertools
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


def test_every_channel_has_words_of_its_own():
    ways = itertools.product([*CHANNELS_OF_ALL, DURATION], ("mean", "spread", "trend"), (True, False), (0.3, -0.3))
    for channel, kind, above, value in ways:
        threshold = value - 0.1 if above else value + 0.1
        said = say_fact(fact(channel.name, channel.unit, kind=kind, above=above, value=value, threshold=threshold))
        text, japanese = said.render("en"), said.render("ja")
        assert "text.verbatim" not in str(said.to_json()), channel.name
        assert "usual" in text and "most others" in text and "  " not in text and "radians" not in text
        assert "ふつうより" in japanese and not re.search("[a-z{}_]", japanese)
    assert "text.verbatim" in str(say_fact(fact("?")).to_json())


def test_numbers_that_would_look_the_same_get_one_more_digit_and_few_others_are_not_most():
    said = str(say_fact(fact(value=0.314, threshold=0.309)))
    assert "0.314 body heights above the pelvis (most others: less than 0.309)" in said
    assert "many others" in str(say_fact(fact(others=2, away=2)))


def test_two_clips_in_one_sentence():
    first = fact()
    assert "0.42 and 0.45 body heights above" in str(say_shared_fact(first, fact(value=0.45, start=0.6, end=1.5)))
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
