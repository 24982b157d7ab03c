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

from dousa.estimation.body.doubt import SIGNS, WEIGHTS
from dousa.estimation.body.human import make_human
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rasteriser import draw_parts, pack_bits, unpack_bits
from dousa.estimation.raster.rendering import render
from dousa.estimation.tracking.diagnosis import (
    Diagnosis,
    Note,
    erode,
    judge,
    look_at_parts,
    measure_swap,
)
from dousa.estimation.tracking.search_setup import SearchSetup, compare_views, draw_views, measure_rim
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.estimation.tracking.start import exchange_pair, find_pairs

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
    drawn, (visible, outside) = draw_views(setup, pose, frame), look_at_parts(setup, pose, frame, 0)
    overlap = compare_views(drawn, frame.bits)
    expected, wholes, beyond = np.zeros((3, setup.body.n_parts))
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
        wholes += parts.sum(axis=(1, 2))
        beyond += (parts & ~mask).sum(axis=(1, 2))
    np.testing.assert_allclose(visible, expected, atol=1e-12)
    np.testing.assert_allclose(outside, beyond / np.maximum(wholes, 1), atol=1e-12)


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


def find_patches(setup, masks, pose):
    """Share of silhouettes of 300 px that the body leaves uncovered, but for a rim."""
    seen = [view for view, mask in enumerate(masks) if mask is not None]
    bare = [masks[view] & ~draw_parts(setup.body, pose, setup.cameras[view])[0].any(axis=0) for view in seen]
    return sum(erode_slowly(mask, measure_rim(300.0)).sum() for mask in bare) / 300.0 / len(seen)


def make_diagnosis(setup):
    return Diagnosis(setup, 300.0, meet=True)


def test_where_nothing_is_seen_everything_could_lie_elsewhere():
    setup, masks, pose = make_scene(7)
    diagnosis = make_diagnosis(setup)
    diagnosis.write(pose, setup.pack(masks))
    diagnosis.write(pose, setup.pack([None, None]))
    overlap, widths, visible, outside, swap = diagnosis.arrays()
    assert overlap.shape == (2, 2)
    assert widths.shape == swap.shape == (2, setup.body.n_parts + 1)
    assert visible.shape == outside.shape == (2, setup.body.n_parts)
    assert np.isnan(overlap[1]).all()
    assert not visible[1].any()
    assert (widths[1] >= widths[0]).all()
    assert diagnosis.cover(pose, setup.pack([None, None])) == (0.0, 1.0)
    assert diagnosis.cover(pose, setup.pack(masks)) == pytest.approx(
        (overlap[0].mean(), find_patches(setup, masks, pose))
    )
    assert diagnosis.judge(np.stack((pose, pose))).lost[1]


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
    assert [len(array) for array in empty] == [0, 0, 0, 0, 0]


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


def test_an_arm_that_sticks_out_and_a_body_that_is_elsewhere_are_doubted():
    truth = standing_state(BODY)
    masks = [view[0] for view in render(BODY, truth[None], CAMERAS)]
    right, arm, elsewhere = truth[None], truth[None].copy(), truth[None].copy()
    arm[0, 7 + BODY.angle_names.index("left_shoulder.2")] += 1.2
    elsewhere[0, 0] += 0.5
    sure, unsure, lost = (measure(poses[0], masks).judge(poses) for poses in (right, arm, elsewhere))
    hand = BODY.names.index("left_hand")
    assert unsure.errors[0, hand] > 2.0 * sure.errors[0, hand]
    assert not sure.lost[0] and lost.lost[0]
    assert lost.errors.mean() > 2.0 * sure.errors.mean()


def test_legs_that_would_fit_better_exchanged_are_doubted_and_others_are_not():
    pose = standing_state(BODY)
    pose[7 + BODY.angle_names.index("left_hip.1")] += 0.5
    pose[7 + BODY.angle_names.index("right_hip.1")] -= 0.5
    masks = [view[0] for view in render(BODY, pose[None], CAMERAS)]
    setup = SearchSetup(BODY, CAMERAS, TrackerSettings(), 30.0, float(masks[0].sum()))
    frame, feet = setup.pack(masks), [BODY.names.index(f"{side}_foot") for side in ("left", "right")]
    legs = next(pair for pair in find_pairs(BODY) if feet[0] in pair.parts)
    wrong = measure_swap(setup, exchange_pair(BODY, pose, legs), frame)
    assert (wrong[feet] > 0.2).all()
    assert wrong[BODY.names.index("trunk")] < 0.01
    assert (measure_swap(setup, pose, frame) < 0.01).all()


@pytest.mark.parametrize("sign", range(1, 6))
def test_more_of_a_sign_is_never_less_doubt(sign):
    """And frames that nobody is seen in are lost, and spoil no others."""
    setup, poses = make_setup(), np.tile(standing_state(BODY), (12, 1))
    overlap, points, parts = np.full((12, 4), 0.9), np.full((12, 20), 0.01), np.full((12, 15), 0.5)
    overlap[6] = np.nan
    notes = Note(overlap, points, parts, 0.0 * parts, points)
    for meet in (True, False):
        assert min(WEIGHTS["silhouettes", 1 + meet]) >= 0.0 and len(WEIGHTS["silhouettes", 1 + meet]) == len(SIGNS)
        before = judge(setup, poses, notes, meet)
        changed = [values.copy() for values in notes]
        changed[sign - 1] += -0.3 if sign == 3 else 0.0 if sign == 1 else 0.3
        after = judge(setup, poses, Note(*changed), meet)
        assert (after.errors >= before.errors - 1e-12).all()
        assert before.lost[6] and before.lost.sum() in (1, 12)


def test_doubt_of_one_view_is_more():
    setup, poses = make_setup(), np.tile(standing_state(BODY), (12, 1))
    points, parts = np.full((12, 20), 0.01), np.full((12, 15), 0.5)
    notes = Note(np.full((12, 4), 0.9), points, parts, 0.0 * parts, points)
    assert (judge(setup, poses, notes, False).errors > judge(setup, poses, notes, True).errors).all()
