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

from dousa.estimation.raster.rasteriser import draw_parts
from dousa.estimation.tracking.diagnosis import Diagnosis, cover_views, measure_widths
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings

seeds = st.integers(0, 2**32 - 1)


def make_scene(seed, unseen=False):
    rng = np.random.default_rng(seed)
    body, cameras = random_body(rng), two_cameras()
    pose = random_pose(rng, body)
    masks = noisy_masks(rng, body, pose, cameras)
    if unseen:
        masks[rng.integers(2)] = None
    area = np.mean([mask.sum() for mask in masks if mask is not None])
    return SearchSetup(body, cameras, TrackerSettings(), 30.0, area), masks, pose


@settings(max_examples=30, deadline=None)
@given(seeds, st.booleans())
def test_overlap_and_what_hides_are_those_of_plain_masks(seed, unseen):
    setup, masks, pose = make_scene(seed, unseen)
    overlap, visible = np.empty(2), np.empty(setup.body.n_parts)
    cover_views(pose, setup.model, setup.views(setup.pack(masks)), setup.make_scratch(), overlap, visible)
    expected = np.zeros(setup.body.n_parts)
    for view, (camera, mask) in enumerate(zip(setup.cameras, masks, strict=True)):
        if mask is None:
            assert np.isnan(overlap[view])
            continue
        parts = draw_parts(setup.body, pose, camera)[0]
        body = parts.any(axis=0)
        assert overlap[view] == pytest.approx((body & mask).sum() / (body | mask).sum(), abs=1e-12)
        own = (parts & (parts.sum(axis=0) == 1)).sum(axis=(1, 2))
        expected = np.maximum(expected, own / np.maximum(parts.sum(axis=(1, 2)), 1))
    np.testing.assert_allclose(visible, expected, atol=1e-12)


def slow_width(setup, masks, pose, part, axis, side):
    """The farthest of dR / 32, dR / 8 and dR / 2 before the image's score has dropped by more than one."""
    below = subtree(setup.body, part)
    others = [q for q in range(setup.body.n_parts) if q not in below]

    def count(at):
        return sum(
            mismatch(
                "masked",
                mask,
                covered(setup.body, pose, camera, others),
                covered(setup.body, at, camera, below),
            )
            for camera, mask in zip(setup.cameras, masks, strict=True)
            if mask is not None
        )

    base, reached = count(pose), 0.0
    for share in (1 / 32, 1 / 8, 1 / 2):
        amount = share * setup.bounds[0][axis]
        if (count(moved_along(pose, axis, side * amount)) - base) * setup.weights[2] > 1.0:
            break
        reached = amount
    return reached


@settings(max_examples=8, deadline=None)
@given(seeds, st.booleans())
def test_widths_are_those_of_plain_masks(seed, unseen):
    setup, masks, pose = make_scene(seed, unseen)
    low, high = np.zeros(setup.n_axes), np.zeros(setup.n_axes)
    measure_widths(
        pose,
        setup.weights,
        setup.bounds,
        setup.model,
        setup.views(setup.pack(masks)),
        setup.make_scratch(),
        low,
        high,
    )
    for part in range(setup.body.n_parts):
        for axis in axes_of(setup.body, part):
            assert low[axis] == pytest.approx(slow_width(setup, masks, pose, part, axis, -1.0), abs=1e-12)
            assert high[axis] == pytest.approx(slow_width(setup, masks, pose, part, axis, 1.0), abs=1e-12)


def make_diagnosis(setup):
    return Diagnosis(setup, 300.0, meet=True)


def test_where_nothing_is_seen_everything_could_lie_elsewhere():
    setup, masks, pose = make_scene(7)
    diagnosis = make_diagnosis(setup)
    diagnosis.write(pose, setup.pack(masks))
    diagnosis.write(pose, setup.pack([None, None]))
    overlap, widths, occluded, patches = diagnosis.arrays()
    assert overlap.shape == patches.shape == (2, 2)
    assert widths.shape == (2, setup.body.n_parts + 1)
    assert occluded.shape == (2, setup.body.n_parts)
    assert np.isnan(overlap[1]).all()
    assert occluded[1].all()
    assert (widths[1] >= widths[0]).all()
    assert diagnosis.cover(pose, setup.pack([None, None])) == (0.0, 1.0)
    assert diagnosis.cover(pose, setup.pack(masks)) == pytest.approx((overlap[0].mean(), patches[0, 0]))
    doubt = diagnosis.judge()
    assert doubt.lost[1]
    assert (doubt.errors[1] > doubt.errors[0]).all()


def test_notes_are_taken_up_where_they_were_left():
    setup, masks, pose = make_scene(1)
    frame = setup.pack(masks)
    diagnosis, other = make_diagnosis(setup), make_diagnosis(setup)
    for _ in range(2):
        diagnosis.write(pose, frame)
    other.load(*diagnosis.arrays())
    other.write(pose, frame)
    diagnosis.write(pose, frame)
    for one, same in zip(diagnosis.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(one, same)
    empty = make_diagnosis(setup).arrays()
    assert [len(array) for array in empty] == [0, 0, 0, 0]
