"""Data of bare motions: one figure, two in step, and the loops of thumbnails."""

import dataclasses
import struct

import numpy as np
import pytest

from app.player_pages import decode, heading_of, positions_of
from dousa.app.player.data import encode_motion, encode_pair, format_player_data
from dousa.app.player.figures import MINIATURE_BYTES, MINIATURE_FRAMES, encode_miniature
from dousa.app.player.in_step import _find_steps
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion import JOINT_INDEX as J
from dousa.motion import canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import draw_performer, make_motion

_HIPS = [J["left_hip"], J["right_hip"]]
_FEET = [J[f"{side}_{end}"] for side in ("left", "right") for end in ("ankle", "toe")]


@dataclasses.dataclass(frozen=True)
class Moved:
    positions: np.ndarray
    frame_rate: float


@pytest.fixture(scope="module")
def dance():
    return canonicalise(make_dance(draw_performer(2)).motion)


@pytest.fixture(scope="module")
def wave():
    return canonicalise(make_motion("wave_right", draw_performer(3)))


def turned(positions, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return positions @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def warped(motion, times):
    """The poses that a motion has at other times, s."""
    frames = np.clip(times * motion.frame_rate, 0, motion.n_frames - 1)
    flat = motion.positions.reshape(motion.n_frames, -1)
    each = np.arange(motion.n_frames)
    return np.stack([np.interp(frames, each, column) for column in flat.T], 1).reshape(-1, 20, 3)


# --- one figure


def test_one_figure_stands_on_the_floor_and_looks_at_the_viewer(wave):
    data = encode_motion(wave, "wave")
    assert data["reference"] is data["step"] is data["time"] is None
    assert (data["events"], data["furi"], data["kinds"], data["assessed"]) == ([], [], {}, False)
    figure = data["performance"]
    positions = positions_of(figure)
    assert figure["name"] == "wave"
    assert positions.shape == (wave.n_frames, 20, 3)
    assert abs(heading_of(positions)) < 0.02
    assert abs(np.percentile(positions[:, _FEET, 1].min(axis=1), 0.5)) < 0.003
    assert np.abs(positions[:, _HIPS][..., [0, 2]].mean(axis=1)).max() < 0.002
    for start, end in (("left_knee", "left_ankle"), ("neck", "head")):
        stored = np.linalg.norm(positions[:, J[end]] - positions[:, J[start]], axis=1)
        true = np.linalg.norm(wave.positions[:, J[end]] - wave.positions[:, J[start]], axis=1)
        assert np.abs(stored - true).max() < 0.003


def test_a_recording_that_grows_neither_turns_nor_jumps(dance):
    first = encode_motion(Moved(dance.positions[:40], 30.0), "live")
    more = encode_motion(Moved(dance.positions[:400], 30.0), "live", like=first)
    assert more["facing"] == first["facing"]
    assert more["floor"] <= first["floor"]
    lift = first["floor"] - more["floor"]
    before, after = positions_of(first["performance"]), positions_of(more["performance"])[:40]
    assert np.abs(after - before - [0, lift, 0]).max() < 0.0021


def test_gaps_are_bridged_and_joints_never_seen_go_to_their_parents(wave):
    positions = wave.positions.copy()
    positions[5:9, J["left_hand"]] = np.nan
    positions[:, J["right_toe"]] = np.nan
    positions[3, J["neck"], 1] = np.inf
    figure = encode_motion(Moved(positions, 30.0))["performance"]
    shown = positions_of(figure)
    assert np.array_equal(shown[:, J["right_toe"]], shown[:, J["right_ankle"]])
    whole = positions_of(encode_motion(wave)["performance"])
    assert np.abs(shown[:, : J["left_hand"]] - whole[:, : J["left_hand"]]).max() < 0.05
    assert 1.2 < figure["stature"] < 2.0


def test_nothing_but_gaps_is_still_a_figure():
    empty = Moved(np.full((4, 20, 3), np.nan), 30.0)
    format_player_data(encode_motion(empty))
    format_player_data(encode_pair(empty, empty))
    assert len(encode_miniature(empty)) == MINIATURE_BYTES


def test_long_recordings_are_thinned_not_cut(dance):
    long = Moved(np.concatenate([dance.positions] * 30), 30.0)
    data = encode_motion(long)
    assert 10 <= data["rate"] < 30
    seconds = (data["performance"]["n_frames"] - 1) / data["rate"]
    assert seconds == pytest.approx((len(long.positions) - 1) / 30, abs=0.2)
    assert len(data["performance"]["positions"]) < 2.5e6


@pytest.mark.parametrize("make", [encode_motion, encode_miniature, lambda motion: encode_pair(motion, motion)])
@pytest.mark.parametrize("shape", [(0, 20, 3), (5, 19, 3), (20, 3)])
def test_other_shapes_are_refused_in_words(make, shape):
    with pytest.raises(InvalidMotionError, match=r"shape \(frames, 20, 3\)"):
        make(Moved(np.zeros(shape), 30.0))


@pytest.mark.parametrize(("options", "says"), [({"language": "xx"}, "en"), ({"max_rate": np.nan}, "above 0")])
def test_wrong_options_are_named(wave, options, says):
    with pytest.raises(OptionError, match=says):
        encode_motion(wave, **options)
    with pytest.raises(OptionError, match=says):
        encode_pair(wave, wave, **options)


# --- two in step


def test_a_known_warp_is_found(dance):
    """The same dance at an uneven tempo, elsewhere and turned: each moment finds its own again."""
    own = Moved(dance.positions[:450], 30.0)
    length = 449 / 30
    clock = np.linspace(0, length, 600)
    truth = clock + 0.6 * np.sin(2 * np.pi * clock / length)  # tempo 0.75 to 1.25
    away = Moved(np.add(turned(warped(dance, truth), 2.1), [3.0, 0.0, -1.0]), 600 / length)
    data = encode_pair(own, away, names=("a", "b"), labels=("query", "match"))
    step = decode(data["step"], "<i4") / 1000
    times = np.arange(len(step)) / data["rate"]
    wanted = np.interp(times, clock, truth)
    moving = np.abs(np.diff(warped(dance, wanted), axis=0)).max(axis=(1, 2)) > 0.01  # who stands has no time
    assert np.median(np.abs(step - wanted)[1:][moving]) < 0.05
    assert np.percentile(np.abs(step - wanted)[1:][moving], 95) < 0.2
    assert abs(heading_of(positions_of(data["reference"])) - heading_of(positions_of(data["performance"]))) < 0.1
    assert (data["texts"]["reference"], data["texts"]["performance"]) == ("query", "match")
    assert (data["reference"]["name"], data["performance"]["name"]) == ("a", "b")


@pytest.mark.parametrize(("a", "b"), [("wave_right", "kick_left"), ("squat", "raise_hands"), ("walk", "walk")])
def test_steps_go_from_start_to_end_at_a_bounded_tempo(a, b):
    reference = canonicalise(make_motion(a, draw_performer(1)))
    performance = canonicalise(make_motion(b, draw_performer(5)))
    step = decode(encode_pair(reference, performance)["step"], "<i4")
    end = (reference.n_frames - 1) / 30 * 1000
    assert step[0] == 0
    assert step[-1] == pytest.approx(end, abs=1)
    fastest = max(3, np.ceil(3 * (reference.n_frames - 1) / (performance.n_frames - 1))) * 1000 / 30
    assert np.all(np.diff(step) >= 0)
    assert np.diff(step).max() <= fastest + 1


def test_the_same_clock_starts_at_once_and_ends_with_the_shorter(wave):
    short = Moved(wave.positions[:20], 30.0)
    same = decode(encode_pair(short, wave)["time"], "<i4")
    assert np.allclose(same[:20], np.arange(20) * 1000 / 30, atol=0.51)
    assert np.all(same[20:] == -1 - round(19000 / 30))


def test_one_frame_against_many(wave):
    still = Moved(wave.positions[:1], 30.0)
    assert np.all(decode(encode_pair(still, wave)["step"], "<i4") == 0)
    assert decode(encode_pair(wave, still)["step"], "<i4").tolist() == [0]
    assert encode_motion(still)["performance"]["n_frames"] == 1


def test_very_long_ones_are_matched_at_a_lower_rate(dance):
    long = Moved(np.concatenate([dance.positions] * 3), 30.0)
    data = encode_pair(long, long)
    step = decode(data["step"], "<i4") / 1000
    assert np.abs(step - np.arange(len(step)) / data["rate"]).max() < 0.2


def _slow_steps(costs):
    """The cheapest path, by trying all of them."""
    n_rows, n_columns = costs.shape
    tempo = (n_columns - 1) / (n_rows - 1)
    most = max(3, int(np.ceil(3 * tempo)))

    def rest(row, column):
        if row == n_rows - 1:
            return (costs[row, column], [column]) if column == n_columns - 1 else (np.inf, [column])
        found = []
        for advance in range(most + 1):
            if column + advance < n_columns:
                price, path = rest(row + 1, column + advance)
                found.append((price + 0.01 * ((advance - tempo) / max(tempo, 1)) ** 2, path))
        price, path = min(found, key=lambda pair: pair[0])
        return price + costs[row, column], [column, *path]

    return rest(0, 0)[1]


@pytest.mark.parametrize("shape", [(2, 2), (5, 5), (4, 7), (7, 4), (6, 1), (2, 6)])
def test_steps_are_the_cheapest_ones(shape):
    for seed in range(5):
        costs = np.random.default_rng(seed).uniform(0, 1, shape)
        assert _find_steps(costs).tolist() == _slow_steps(costs)


# --- miniatures


def read_miniature(data):
    unit, duration, middle, still = struct.unpack_from("<4f", data)
    poses = np.frombuffer(data, np.int8, offset=16).reshape(MINIATURE_FRAMES, 20, 3) * unit
    return np.add(poses, [0, middle, 0]), duration, still, unit


def test_a_miniature_is_the_motion_in_place_and_in_a_three_quarter_view(wave):
    poses, duration, still, unit = read_miniature(encode_miniature(wave))
    assert duration == pytest.approx((wave.n_frames - 1) / 30)
    assert heading_of(poses) == pytest.approx(-0.6, abs=0.05)
    assert abs(poses[:, _FEET, 1].min()) <= unit
    assert np.abs(poses[:, _HIPS][..., [0, 2]].mean(axis=1)).max() <= unit
    assert 0 <= still <= 1
    times = np.linspace(0, duration, MINIATURE_FRAMES)
    truth = warped(wave, times)
    truth = turned(truth, -0.6 - heading_of(truth))
    truth[..., [0, 2]] -= truth[:, _HIPS][..., [0, 2]].mean(axis=1)[:, None]
    truth[..., 1] -= truth[:, _FEET, 1].min()
    assert np.abs(poses - truth).max() <= unit
    away = np.linalg.norm(truth - truth.mean(axis=0), axis=(1, 2))
    assert round(still * (MINIATURE_FRAMES - 1)) == away.argmax()


@pytest.mark.parametrize("n_frames", [1, 2, 23, 24, 25])
def test_every_length_makes_the_same_number_of_bytes(wave, n_frames):
    data = encode_miniature(Moved(wave.positions[:n_frames], 30.0))
    assert len(data) == MINIATURE_BYTES == 1456
    assert read_miniature(data)[1] == pytest.approx((n_frames - 1) / 30)


def test_gaps_do_not_show_in_a_miniature(wave):
    positions = wave.positions.copy()
    positions[4:7, J["right_hand"]] = np.nan
    positions[:, J["left_toe"]] = np.nan
    poses, _, _, unit = read_miniature(encode_miniature(Moved(positions, 30.0)))
    whole, _, _, _ = read_miniature(encode_miniature(wave))
    assert np.allclose(poses[:, J["left_toe"], 0], -128 * unit)  # says that it is not to be drawn
    seen = [joint for joint in range(20) if joint not in (J["left_toe"], J["right_hand"])]
    lift = poses[0, 0, 1] - whole[0, 0, 1]  # a foot that is not seen does not say where the floor is
    assert np.abs(poses[:, seen] - whole[:, seen] - [0, lift, 0]).max() < 0.02 + 2 * unit


def test_a_miniature_does_not_change_the_motion(wave):
    before = wave.positions.copy()
    encode_miniature(Moved(wave.positions[:24].copy(), 30.0))
    encode_miniature(wave)
    encode_motion(wave)
    assert np.array_equal(wave.positions, before)
