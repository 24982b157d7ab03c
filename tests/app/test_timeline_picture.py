"""The timeline of a take: a valid picture of any number of categories."""

import numpy as np
import pytest

from dousa.app.pictures.canvas import BLUE
from dousa.app.pictures.timeline import draw_timeline
from dousa.errors import MotionWriteError, OptionError
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.takes.label import Segment, Timeline


@pytest.fixture(scope="module")
def walk():
    return make_motion("walk", draw_performer(1))


def segment(start, end, category="wave", confidence=0.8):
    return Segment(start, end, category, confidence)


def timeline(*segments, seconds=0.0):
    return Timeline(segments, max([seconds, *(one.stop for one in segments)]), 0.5)


def take(count, categories, seconds=2.0):
    segments = [
        segment(seconds * k, seconds * (k + 0.9), f"category {k % categories}", 0.3 + 0.7 * (k % 4) / 4)
        for k in range(count)
    ]
    return timeline(*segments, seconds=seconds * count)


def ink(path):
    from matplotlib.image import imread

    image = imread(path)[..., :3]
    assert image.shape[1] == 1430
    return image


def test_bars_lie_at_their_times_and_are_as_high_as_their_confidence(tmp_path):
    draw_timeline(timeline(segment(0, 2, "bow", 1.0), segment(2, 4, "wave", 0.5), seconds=8), tmp_path / "take.png")
    blue = np.abs(ink(tmp_path / "take.png") - np.array([0x9C, 0xC7, 0xE4]) / 255).max(axis=2) < 0.02
    columns = np.flatnonzero(blue.sum(axis=0) > 3)
    left, right = 110 * (0.25 + 2.3), 110 * (13.0 - 0.25 - 0.75)  # the axis from 0 to 8 s
    seconds = 8 * (columns - left) / (right - left)
    assert -0.05 < seconds.min() < 0.05
    assert 3.95 < seconds.max() < 4.05
    heights = [blue[:, int(left + (right - left) * second / 8)].sum() for second in (0.3, 2.3)]
    assert heights[0] == pytest.approx(2 * heights[1], abs=3)


def share_of(image, colour):
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return float((np.abs(image - wanted).max(axis=2) < 0.03).mean())


def test_unknown_is_grey_and_comes_last(tmp_path):
    known = [segment(1, 2, "bow"), segment(3, 4, "wave")]
    draw_timeline(timeline(segment(0, 1, None, 0.9), *known), tmp_path / "take.png")
    bottom = ink(tmp_path / "take.png")[-120:, 300:420]
    assert share_of(bottom, BLUE) == 0.0 < share_of(bottom, "#e4e4e4")


def test_what_is_perhaps_of_a_category_stands_in_its_row_and_looks_another_way(tmp_path):
    doubtful = Segment(1, 2, None, 0.3, guess="bow")
    known = [segment(0, 1, "bow", 0.3), segment(2, 3, "wave", 0.5)]
    draw_timeline(timeline(*known, doubtful), tmp_path / "take.png")
    draw_timeline(timeline(*known, segment(1, 2, "bow", 0.3)), tmp_path / "sure.png")
    image, sure = ink(tmp_path / "take.png"), ink(tmp_path / "sure.png")
    assert image.shape == sure.shape  # no row for what is unknown
    assert 0.0 < share_of(image, "#9cc7e4") < share_of(sure, "#9cc7e4")


@pytest.mark.parametrize("seconds", [0.4, 40_000.0])
def test_any_length_and_hundreds_of_segments(seconds, tmp_path):
    draw_timeline(take(400, 20, seconds / 400), tmp_path / "take.png")
    assert (ink(tmp_path / "take.png").min(axis=2) < 0.9).mean() > 0.01


@pytest.mark.parametrize("segments", [[], [segment(2, 2)]])
def test_nothing_found_and_no_length(tmp_path, segments):
    draw_timeline(timeline(*segments, seconds=3.0), tmp_path / "take.png")
    ink(tmp_path / "take.png")


def test_wrong_suffix_and_folder(tmp_path):
    with pytest.raises(OptionError, match=r"expected a picture \.png"):
        draw_timeline(take(1, 1), tmp_path / "take.gif")
    with pytest.raises(MotionWriteError):
        draw_timeline(take(1, 1), tmp_path / "missing" / "take.png")
