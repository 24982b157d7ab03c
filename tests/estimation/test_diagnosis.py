"""Notes on poses against plain masks: overlap, what hides, how far each axis can go."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.slow_search import (
    axes_of,
    covered,
    mismatch,
    moved_along,
    noisy_masks,
    random_body,
    random_pose,
    subtree,
    two_cameras,
)

from dousa.estimation._diagnosis import Diary
from dousa.estimation._diagnosis_kernels import cover_views, measure_widths
from dousa.estimation._types import TrackerSettings
from dousa.estimation._working import Workshop
from dousa.estimation.rasteriser import draw_parts

seeds = st.integers(0, 2**32 - 1)


def make_scene(seed, unseen=False):
    rng = np.random.default_rng(seed)
    body, cameras = random_body(rng), two_cameras()
    pose = random_pose(rng, body)
    masks = noisy_masks(rng, body, pose, cameras)
    if unseen:
        masks[rng.integers(2)] = None
    area = np.mean([mask.sum() for mask in masks if mask is not None])
    return Workshop(body, cameras, TrackerSettings(), 30.0, area), masks, pose


@settings(max_examples=30, deadline=None)
@given(seeds, st.booleans())
def test_overlap_and_what_hides_are_those_of_plain_masks(seed, unseen):
    shop, masks, pose = make_scene(seed, unseen)
    overlap, visible = np.empty(2), np.empty(shop.body.n_parts)
    cover_views(pose, shop.model, shop.views(shop.pack(masks)), shop.make_scratch(), overlap, visible)
    expected = np.zeros(shop.body.n_parts)
    for view, (camera, mask) in enumerate(zip(shop.cameras, masks, strict=True)):
        if mask is None:
            assert np.isnan(overlap[view])
            continue
        parts = draw_parts(shop.body, pose, camera)[0]
        body = parts.any(axis=0)
        assert overlap[view] == pytest.approx((body & mask).sum() / (body | mask).sum(), abs=1e-12)
        own = (parts & (parts.sum(axis=0) == 1)).sum(axis=(1, 2))
        expected = np.maximum(expected, own / np.maximum(parts.sum(axis=(1, 2)), 1))
    np.testing.assert_allclose(visible, expected, atol=1e-12)


def slow_width(shop, masks, pose, part, axis, side):
    """The farthest of dR / 32, dR / 8 and dR / 2 before the image's score has dropped by more than one."""
    below = subtree(shop.body, part)
    others = [q for q in range(shop.body.n_parts) if q not in below]

    def count(at):
        return sum(
            mismatch(
                "masked",
                mask,
                covered(shop.body, pose, camera, others),
                covered(shop.body, at, camera, below),
            )
            for camera, mask in zip(shop.cameras, masks, strict=True)
            if mask is not None
        )

    base, reached = count(pose), 0.0
    for share in (1 / 32, 1 / 8, 1 / 2):
        amount = share * shop.bounds[0][axis]
        if (count(moved_along(pose, axis, side * amount)) - base) * shop.weights[2] > 1.0:
            break
        reached = amount
    return reached


@settings(max_examples=8, deadline=None)
@given(seeds, st.booleans())
def test_widths_are_those_of_plain_masks(seed, unseen):
    shop, masks, pose = make_scene(seed, unseen)
    low, high = np.zeros(shop.n_axes), np.zeros(shop.n_axes)
    measure_widths(
        pose,
        shop.weights,
        shop.bounds,
        shop.model,
        shop.views(shop.pack(masks)),
        shop.make_scratch(),
        low,
        high,
    )
    for part in range(shop.body.n_parts):
        for axis in axes_of(shop.body, part):
            assert low[axis] == pytest.approx(slow_width(shop, masks, pose, part, axis, -1.0), abs=1e-12)
            assert high[axis] == pytest.approx(slow_width(shop, masks, pose, part, axis, 1.0), abs=1e-12)


def test_where_nothing_is_seen_everything_could_lie_elsewhere():
    shop, masks, pose = make_scene(7)
    diary = Diary(shop)
    diary.write(pose, shop.pack(masks))
    diary.write(pose, shop.pack([None, None]))
    overlap, uncertainty, occluded = diary.arrays()
    assert overlap.shape == (2, 2)
    assert uncertainty.shape == (2, shop.body.n_parts + 1)
    assert occluded.shape == (2, shop.body.n_parts)
    assert np.isnan(overlap[1]).all()
    assert occluded[1].all()
    assert (uncertainty[1] >= uncertainty[0]).all()
    assert diary.cover(pose, shop.pack([None, None])) == 0.0
    assert diary.cover(pose, shop.pack(masks)) == pytest.approx(overlap[0].mean())
    np.testing.assert_array_equal(diary.find_lost(overlap, overlap[0].mean()), [False, True])


def test_lost_is_what_covers_less_than_usual():
    diary = Diary(make_scene(0)[0])
    assert diary.is_lost(0.5, 0.9)
    assert not diary.is_lost(0.7, 0.9)
    assert diary.is_lost(0.3, 0.3)  # never believed, whatever is usual
    overlap = np.array([[0.9, np.nan], [0.9, 0.2], [np.nan, np.nan]])
    np.testing.assert_array_equal(diary.find_lost(overlap, 0.9), [False, True, True])


def test_notes_are_taken_up_where_they_were_left():
    shop, masks, pose = make_scene(1)
    frame = shop.pack(masks)
    diary, other = Diary(shop), Diary(shop)
    for _ in range(2):
        diary.write(pose, frame)
    other.load(*diary.arrays())
    other.write(pose, frame)
    diary.write(pose, frame)
    for one, same in zip(diary.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(one, same)
    empty = Diary(shop).arrays()
    assert [len(array) for array in empty] == [0, 0, 0]
