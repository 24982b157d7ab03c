"""Shrinking: a whole factor by the size of the person, masks and cameras alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.estimation.body.body import widen
from dousa.estimation.body.human import make_human
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.search_setup import SearchSetup, Shrinker
from dousa.estimation.tracking.settings import TrackerSettings


def area_of(height):
    return 0.22 * height**2


def test_small_people_are_left_alone():
    cameras = make_ring(2, size=(64, 48))
    shrinker = Shrinker(cameras, area_of(40), 260)
    mask = np.random.default_rng(0).random((48, 64)) < 0.5
    assert shrinker.factor == 1
    assert shrinker.cameras == tuple(cameras)
    assert shrinker.area_share == 1.0
    small = shrinker.shrink([mask, None])
    np.testing.assert_array_equal(small[0], mask)
    assert small[1] is None


@pytest.mark.parametrize(("tall", "factor"), [(260, 1), (290, 1), (320, 2), (540, 2), (1040, 4), (1300, 5)])
def test_the_factor_goes_by_the_height_of_the_person(tall, factor):
    assert Shrinker(make_ring(1, size=(1280, 960)), area_of(tall), 260).factor == factor


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_whole_blocks_become_pixels(seed, factor):
    small = np.random.default_rng(seed).random((12, 20)) < 0.5
    large = small.repeat(factor, axis=0).repeat(factor, axis=1)
    cameras = make_ring(1, size=(20 * factor, 12 * factor))
    shrinker = Shrinker(cameras, area_of(100 * factor), 100)
    assert shrinker.factor == factor
    np.testing.assert_array_equal(shrinker.shrink([large])[0], small)
    assert shrinker.area_share == pytest.approx(small.size / large.size)


def test_girths_and_raised_arms_matter_to_the_score_alone():
    body, cameras = make_human(), make_ring(2, size=(160, 120))
    pose = standing_state(body)
    masks = [draw_body(body, pose, camera)[0] for camera in cameras]
    own, stout = (
        SearchSetup(shape, cameras, TrackerSettings(), 30.0, masks[0].sum()) for shape in (body, widen(body, 1.1))
    )
    frame, scratch, still = own.pack(masks), own.make_scratch(), np.zeros(own.n_axes)
    moved = pose + 0.1 * np.eye(len(pose))[0]
    assert own.score(pose, still, frame, scratch) - stout.score(pose, still, frame, scratch) > 2.0
    best, fatter, aside = (
        setup.compare(row, frame, own.find_rims(frame), scratch)
        for setup, row in ((own, pose), (stout, pose), (own, moved))
    )
    assert best - fatter < 0.5
    assert best - aside > 2.0


def test_cameras_shrink_with_their_images():
    camera = make_ring(1, size=(1280, 960))[0]
    body = make_human()
    pose = standing_state(body)
    large = draw_body(body, pose, camera)[0]
    shrinker = Shrinker([camera], large.sum(), 120)
    assert shrinker.factor > 4
    shrunk = shrinker.shrink([large])[0]
    drawn = draw_body(body, pose, shrinker.cameras[0])[0]
    assert shrunk.shape == drawn.shape
    assert (shrunk ^ drawn).sum() < 0.02 * drawn.sum()  # rounding at the outline


def test_full_images_are_no_silhouettes():
    shrinker = Shrinker(make_ring(3, size=(40, 30)), 200.0, 260)
    half = np.zeros((30, 40), bool)
    half[:15] = True
    masks = shrinker.shrink([np.ones((30, 40), bool), half, np.zeros((30, 40), bool)])
    assert masks[0] is None
    np.testing.assert_array_equal(masks[1], half)
    assert not masks[2].any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from((1.0, 90.0)))
def test_packed_frames_unpack(seed, height):
    rng = np.random.default_rng(seed)
    cameras = (*make_ring(2, size=(130, 40)), *make_ring(1, size=(70, 90)))
    shrinker = Shrinker(cameras, area_of(100), 260 if height == 1.0 else 50)
    masks = [rng.random((camera.height, camera.width)) < 0.4 for camera in cameras]
    masks[rng.integers(3)] = None
    small = shrinker.shrink(masks)
    setup = SearchSetup(make_human(), shrinker.cameras, TrackerSettings(), 30.0, 100.0)
    for before, after in zip(small, shrinker.unpack(setup.pack(small)), strict=True):
        if before is None:
            assert after is None
        else:
            np.testing.assert_array_equal(after, before)
