"""Notes on poses against plain masks (overlap, hiding, widths, patches), and how far off a track probably is."""

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

from dousa.estimation.body.human import make_human
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rasteriser import draw_parts, pack_bits, unpack_bits
from dousa.estimation.raster.rendering import render
from dousa.estimation.tracking.diagnosis import (
    Diagnosis,
    ErrorModel,
    PatchMeasure,
    compare_views,
    draw_views,
    erode,
    find_habit,
    find_visible,
)
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
    frame = setup.pack(masks)
    drawn, visible = draw_views(setup, pose, frame), find_visible(setup, pose, frame)
    overlap = compare_views(drawn, frame.bits)
    expected = np.zeros(setup.body.n_parts)
    for view, (camera, mask) in enumerate(zip(setup.cameras, masks, strict=True)):
        if mask is None:
            assert np.isnan(overlap[view])
            continue
        parts = draw_parts(setup.body, pose, camera)[0]
        body = parts.any(axis=0)
        np.testing.assert_array_equal(unpack_bits(drawn[view, : camera.height], camera.width), body)
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
            mismatch("masked", mask, covered(setup.body, pose, camera, others), covered(setup.body, at, camera, below))
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
    low, high = setup.measure_widths(pose, setup.pack(masks), setup.make_scratch()).T
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
    other.load(diagnosis.arrays())
    other.write(pose, frame)
    diagnosis.write(pose, frame)
    for one, same in zip(diagnosis.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(one, same)
    empty = make_diagnosis(setup).arrays()
    assert [len(array) for array in empty] == [0, 0, 0, 0]


BODY = make_human(1.72)
CAMERAS = make_ring(4, size=(160, 120))


def erode_slowly(mask, steps):
    for _ in range(steps):
        padded = np.pad(mask, 1)
        mask = padded[1:-1, 1:-1] & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_erosion_is_that_of_plain_masks(seed, steps):
    rng = np.random.default_rng(seed)
    mask = rng.random((30, 150)) > 0.1
    np.testing.assert_array_equal(unpack_bits(erode(pack_bits(mask), steps), 150), erode_slowly(mask, steps))


def make_setup():
    return SearchSetup(BODY, CAMERAS, TrackerSettings(), 30.0, 1000.0)


def measure(pose, masks):
    setup = make_setup()
    area = float(np.mean([mask.sum() for mask in masks]))
    diagnosis = Diagnosis(setup, area, meet=True)
    diagnosis.write(pose, setup.pack(masks))
    return diagnosis


def test_an_arm_that_is_missed_leaves_patches_and_sticks_out():
    truth = standing_state(BODY)
    masks = [view[0] for view in render(BODY, truth[None], CAMERAS)]
    right = measure(truth, masks)
    assert right.arrays()[3][0] == pytest.approx([0.0, 0.0])
    away = truth.copy()
    away[7 + BODY.angle_names.index("left_shoulder.2")] += 1.2
    wrong = measure(away, masks)
    patches, overhang = wrong.arrays()[3][0]
    assert patches > 0.01
    assert overhang > 0.01
    assert wrong.judge().errors.mean() > 2.0 * right.judge().errors.mean()
    assert not right.judge().lost[0]


def test_a_body_that_is_elsewhere_is_lost():
    truth = standing_state(BODY)
    masks = [view[0] for view in render(BODY, truth[None], CAMERAS)]
    away = truth.copy()
    away[0] += 0.5
    doubt = measure(away, masks).judge()
    assert doubt.lost[0]
    assert doubt.errors.mean() > 0.15


def test_more_patches_are_more_doubt_and_one_view_is_never_sure():
    widths = np.full((5, 20), 0.01)
    patches = np.linspace(0.0, 0.2, 5)[:, None] * np.ones(2)
    patches = np.repeat(patches, 20, axis=0)
    widths = np.repeat(widths, 20, axis=0)
    sure, unsure = (ErrorModel(make_setup(), meet).judge(patches, widths) for meet in (True, False))
    expected = sure.errors.mean(axis=1)
    assert (np.diff(expected) > -1e-12).all()
    assert expected[0] < 0.06
    assert not sure.lost[:10].any()
    assert sure.lost[-10:].all()
    assert (unsure.errors > 3.0 * sure.errors).all()


def test_joints_share_the_error_by_their_widths():
    widths = np.tile([0.0, 0.1, 0.3], (4, 1))
    errors = ErrorModel(make_setup(), meet=True).judge(np.full((4, 2), 0.01), widths).errors
    assert (errors[:, 0] < errors[:, 1]).all()
    assert (errors[:, 1] < errors[:, 2]).all()


def test_frames_that_nobody_is_seen_in_are_lost_and_spoil_no_others():
    patches = np.zeros((12, 2))
    patches[6] = np.nan
    doubt = ErrorModel(make_setup(), meet=True).judge(patches, np.full((12, 3), 0.01))
    assert np.flatnonzero(doubt.lost).tolist() == [6]
    assert (doubt.errors[6] > doubt.errors[5]).all()


def test_nobody_seen_has_no_patches():
    setup = make_setup()
    frame = setup.pack([None] * 4)
    assert np.isnan(PatchMeasure(100.0).measure(np.zeros_like(frame.bits), frame)).all()


def test_what_every_frame_leaves_is_no_error():
    shadow = np.column_stack((np.full(40, 0.04), np.full(40, 0.01)))
    widths = np.full((40, 3), 0.01)
    model = ErrorModel(make_setup(), meet=True)
    assert find_habit(shadow) == pytest.approx(0.7 * 0.04)
    assert find_habit(shadow[:5]) == 0.0
    assert not model.judge(shadow, widths).lost.any()
    assert model.judge(shadow, widths, habit=0.0).lost.all()
    shadow[20:30, 0] += 0.08
    assert model.judge(shadow, widths).lost[21:29].all()
    assert not model.judge(shadow, widths).lost[:15].any()
