"""Accents are found when they happen: movements whose arrivals are known by construction."""

import numpy as np
import pytest

from dousa.evaluation import find_accents
from evaluation.beats.accented import make_body, move, wave

ARRIVALS = np.cumsum([1.0, 0.6, 0.5, 0.75, 0.9, 0.5, 0.65, 0.7, 0.55, 0.8])
TOLERATED_S = 0.025


def assert_found(accents, expected, kind):
    times = np.array([one.time_s for one in accents])
    assert {one.kind for one in accents} == {kind}
    assert len(times) == len(expected)
    off = np.abs(times - expected)
    assert np.median(off) <= TOLERATED_S
    assert off.max() <= 2 * TOLERATED_S


@pytest.mark.parametrize("rate", [25.0, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("duration", [0.2, 0.3, 0.4])
def test_a_hand_that_stops(rate, duration):
    accents = find_accents(make_body({"left_hand": wave(ARRIVALS, rate, duration=duration)}, rate))
    assert_found(accents, ARRIVALS, "stop")
    assert {one.parts for one in accents} == {("left_hand",)}


def test_a_hand_that_stops_in_a_recording_that_trembles():
    accents = find_accents(make_body({"left_hand": wave(ARRIVALS, 30.0)}, 30.0, noise_m=0.004))
    assert_found([one for one in accents if "left_hand" in one.parts], ARRIVALS, "stop")


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_a_hand_that_turns_back_at_once(rate):
    times = np.arange(round(8 * rate)) / rate
    path = np.zeros((len(times), 3))
    path[:, 1] = 0.3 * np.cos(np.pi * (times - 1.0) / 0.5)
    accents = find_accents(make_body({"left_hand": path}, rate))
    inside = [one for one in accents if 0.4 < one.time_s < 7.6]
    assert_found(inside, np.arange(0.5, 7.6, 0.5), "turn")


def test_a_hand_that_goes_round_a_corner():
    times = np.arange(960) / 120.0
    corners = np.arange(1.0, 8.0, 1.0)
    sides = np.array([(-1, 0, 0), (0, 1, 0), (1, 0, 0), (0, -1, 0)], float)
    path = np.cumsum(0.8 / 120.0 * sides[np.floor(times).astype(int) % 4], axis=0)
    accents = find_accents(make_body({"right_hand": path}, 120.0))
    assert_found(accents, corners, "turn")


def test_an_even_movement_has_no_accent():
    times = np.arange(600) / 60.0
    circle = 0.2 * np.stack([np.cos(5 * times), np.sin(5 * times), 0 * times], axis=1)
    assert find_accents(make_body({"left_hand": circle}, 60.0)) == ()
    assert find_accents(make_body({"left_hand": 0 * circle}, 60.0)) == ()


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_steps(rate):
    times = np.arange(round(9 * rate)) / rate
    landings = np.arange(1.0, 8.0, 0.5)
    paths = {}
    for first, limb in enumerate(("left_foot", "right_foot")):
        mine = landings[first::2]
        # Lifted and put down in an arc: the foot swings forward for 0.3 s, and is in the air as long.
        swing = move(times, [(at, 0.3, (0.0, 0.0, 0.5)) for at in mine])
        u = np.clip((times[:, None] - mine) / 0.3 + 1.0, 0.0, 1.0)
        swing[:, 1] = (0.12 * (4 * u * (1 - u)) ** 2).sum(axis=1)
        paths[limb] = swing
    accents = find_accents(make_body(paths, rate))
    assert_found(accents, landings, "step")
    assert accents[0].parts == ("left_foot",) and accents[1].parts == ("right_foot",)


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_claps(rate):
    claps = np.arange(1.0, 9.0, 1.0)
    times = np.arange(round(9.5 * rate)) / rate
    in_and_out = [(at + part, 0.25, (0.2 * sign, 0.0, 0.0)) for at in claps for part, sign in ((0.0, -1), (0.5, 1))]
    left = move(times, in_and_out)
    accents = find_accents(make_body({"left_hand": left, "right_hand": left * (-1, 1, 1)}, rate))
    assert_found([one for one in accents if one.kind == "clap"], claps, "clap")
    # The hands stop when they meet, and that is the clap; when they are apart, that is a stop of both.
    others = [one for one in accents if one.kind != "clap"]
    assert_found(others, claps + 0.5, "stop")
    assert {one.parts for one in accents} == {("left_hand", "right_hand")}


def test_nothing_is_found_where_the_hand_is_not_seen():
    body = make_body({"left_hand": wave(ARRIVALS, 60.0)}, 60.0, missing=slice(round(2.0 * 60), round(2.3 * 60)))
    times = np.array([one.time_s for one in find_accents(body)])
    assert len(times) == len(ARRIVALS) - 1
    assert np.abs(times - ARRIVALS[2]).min() > 0.2


def test_a_motion_of_two_frames_has_no_accent():
    assert find_accents(make_body({"left_hand": np.zeros((2, 3))}, 30.0)) == ()
