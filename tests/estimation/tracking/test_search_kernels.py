"""The compiled search against eqs. 1 to 3 written out on plain masks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.parts import run_part
from oracles.slow_search import (
    SlowSearch,
    axes_of,
    choose,
    counted_pixels,
    covered,
    moved_along,
    noisy_masks,
    random_body,
    random_pose,
    two_cameras,
)

from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import pack_bits
from dousa.estimation.tracking.search_kernels import count_parts, fill_evidence, move_axis
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import EVIDENCES, PAPER, READINGS, TrackerSettings
from dousa.motion import rotations as rot

seeds = st.integers(0, 2**32 - 1)
choices = st.fixed_dictionaries(
    {
        "reading": st.sampled_from(READINGS),
        "evidence": st.sampled_from(EVIDENCES),
        "candidates": st.sampled_from(("part", "subtree")),
        "thinning": st.sampled_from((1, 2)),
        "inertia": st.sampled_from((1.0, 0.0, 0.3)),
    }
)


def make_scene(seed, unseen=False, **chosen):
    """A body, its silhouettes in a pose, and a pose nearby with its shift from the prediction."""
    rng = np.random.default_rng(seed)
    body, cameras = random_body(rng), two_cameras()
    truth = random_pose(rng, body)
    masks = noisy_masks(rng, body, truth, cameras)
    if unseen:
        masks[rng.integers(2)] = None
    options = TrackerSettings(n_candidates=9, n_candidates_later=5, **chosen)
    area = np.mean([mask.sum() for mask in masks if mask is not None])
    setup = SearchSetup(body, cameras, options, 30.0, area)
    shift = rng.uniform(-0.8, 0.8, setup.n_axes) * setup.bounds[0]
    pose = truth.copy()
    for axis in range(setup.n_axes):
        pose = moved_along(pose, axis, rng.uniform(-1, 1) * setup.bounds[0][axis])
    limits = body.angle_limits
    pose[7:] = np.clip(pose[7:], limits[:, 0], limits[:, 1])
    return rng, setup, masks, pose, shift


def steps_apart(setup, part, factor, half, before, after):
    """Which candidate each axis of a part took."""
    axes = list(axes_of(setup.body, part))
    return (after - before)[axes] * half / (factor * setup.bounds[0][axes])


@settings(max_examples=60, deadline=None)
@given(seeds, choices, st.booleans(), st.sampled_from((1.0, 0.5)))
def test_sweep_takes_the_oracles_candidates(seed, chosen, unseen, factor):
    rng, setup, masks, pose, shift = make_scene(seed, unseen, **chosen)
    part = int(rng.integers(setup.body.n_parts))
    slow_pose, slow_shift = SlowSearch(setup, masks).sweep_part(pose, shift, part, factor, setup.half)
    setup.order = np.array([part])
    found, moved = pose.copy(), shift.copy()
    setup.sweep(found, moved, factor, setup.pack(masks), setup.make_scratch())
    ours = steps_apart(setup, part, factor, setup.half, shift, moved)
    slow = steps_apart(setup, part, factor, setup.half, shift, slow_shift)
    np.testing.assert_allclose(ours, slow, atol=1e-6)
    np.testing.assert_allclose(found, slow_pose, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(seeds, choices)
def test_sweep_goes_from_the_root_to_the_leaves(seed, chosen):
    _, setup, masks, pose, shift = make_scene(seed, **chosen)
    slow = SlowSearch(setup, masks)
    slow_pose, slow_shift = pose, shift
    for part in range(setup.body.n_parts):
        slow_pose, slow_shift = slow.sweep_part(slow_pose, slow_shift, part, 0.5, setup.half_later)
    setup.sweep(pose, shift, 0.5, setup.pack(masks), setup.make_scratch(), setup.half_later)
    np.testing.assert_allclose(shift, slow_shift, atol=1e-9)
    np.testing.assert_allclose(pose, slow_pose, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds, st.booleans())
def test_score_is_the_oracles_up_to_a_constant(seed, unseen):
    rng, setup, masks, pose, shift = make_scene(seed, unseen)
    slow, frame, scratch = SlowSearch(setup, masks), setup.pack(masks), setup.make_scratch()
    other, far = random_pose(rng, setup.body), rng.uniform(-1.9, 1.9, setup.n_axes) * setup.bounds[0]
    ours = setup.score(other, far, frame, scratch) - setup.score(pose, shift, frame, scratch)
    assert ours == pytest.approx(slow.score_pose(other, far) - slow.score_pose(pose, shift), abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds, st.sampled_from(READINGS), st.booleans())
def test_two_images_tell_the_mismatch_of_every_reading(seed, reading, unseen):
    rng, setup, masks, pose, _ = make_scene(seed, unseen)
    body, frame, scratch = setup.body, setup.pack(masks), setup.make_scratch()
    parts = rng.permutation(body.n_parts)[: rng.integers(1, body.n_parts + 1)]
    fixed = [rng.random((camera.height, camera.width)) < 0.3 for camera in setup.cameras]
    images = scratch[2], scratch[3]
    run_part(fill_evidence)(READINGS.index(reading), frame.bits, _pack_all(setup, fixed), *images, scratch[7])
    scratch[5][:], scratch[6][:] = place_parts(body, pose)
    counted = run_part(count_parts)(parts, setup.model, setup.views(frame), *images, scratch, np.inf)
    expected = 0
    for camera, mask, f in zip(setup.cameras, masks, fixed, strict=True):
        if mask is not None:
            x, counts = counted_pixels(reading, mask, f)
            p = covered(body, pose, camera, parts)
            expected += int(((x ^ p) & counts).sum()) - int((x & counts).sum())
    assert counted == expected
    spare = counted + int(rng.integers(-300, 300))  # what is given up is known to be above it
    given_up = run_part(count_parts)(parts, setup.model, setup.views(frame), *images, scratch, spare)
    assert given_up == counted if counted <= spare else spare < given_up <= counted
    assert not scratch[1].any()  # the next call finds it clean


def _pack_all(setup, masks):
    bits = np.zeros((len(masks), setup.height, setup.n_words), np.uint64)
    for view, mask in enumerate(masks):
        packed = pack_bits(mask)
        bits[view, : packed.shape[0], : packed.shape[1]] = packed
    return bits


@settings(max_examples=40, deadline=None)
@given(seeds, st.integers(0, 8), st.floats(-0.3, 0.3))
def test_moving_along_an_axis_is_the_oracles(seed, axis, amount):
    rng = np.random.default_rng(seed)
    pose = np.concatenate((rng.normal(size=3), rot.normalise(rng.normal(size=4)), rng.normal(size=3)))
    expected = moved_along(pose, axis, amount)
    run_part(move_axis)(pose, axis, amount)
    np.testing.assert_allclose(pose, expected, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seeds, choices)
def test_limits_hold_and_nothing_leaves_twice_dr(seed, chosen):
    _, setup, masks, pose, _ = make_scene(seed, **chosen)
    shift = np.zeros(setup.n_axes)
    frame, scratch = setup.pack(masks), setup.make_scratch()
    for _ in range(4):
        setup.sweep(pose, shift, 1.0, frame, scratch)
    limits = setup.body.angle_limits
    assert (pose[7:] >= limits[:, 0]).all()
    assert (pose[7:] <= limits[:, 1]).all()
    assert (np.abs(shift) < 2.0 * setup.bounds[0]).all()


def test_ties_go_to_the_nearer_candidate():
    assert choose({-2: 1.0, -1: 1.0, 1: 1.0, 2: 1.0, 3: 0.5}) == -1
    assert choose({-2: 1.0, 0: 1.0 - 1e-15, 2: 1.0}) == 0


def bead_before_a_ball():
    """A ball with a bead on a stalk that always lies within the ball's outline, seen by one flat camera."""
    body = BodyModel(
        names=("ball", "bead"),
        joints=("ball", "stalk"),
        parents=[-1, 0],
        offsets=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.6]],
        rest=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        n_axes=[0, 1],
        axes=[np.zeros((3, 3)), [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]],
        limits=[np.zeros((3, 2)), [[-2.0, 2.0], [0.0, 0.0], [0.0, 0.0]]],
        spheres=[[0.0, 0.0, 0.0, 0.5], [0.2, 0.0, 0.0, 0.05]],
        sphere_starts=[0, 1, 2],
        tips=(),
        tip_parts=[],
        tip_offsets=np.zeros((0, 3)),
        stature=1.0,
    )
    matrix = [[30.0, 0.0, 20.0], [0.0, 30.0, 20.0], [0.0, 0.0, 1.0]]
    camera = Camera("flat", 40, 40, matrix, np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 3.0], kind="orthographic")
    pose = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1])
    return body, camera, pose


@pytest.mark.parametrize("reading", ["masked", "residual"])
@pytest.mark.parametrize("evidence", EVIDENCES)
@pytest.mark.parametrize("candidates", ["part", "subtree"])
def test_a_hidden_part_goes_where_inertia_has_it(reading, evidence, candidates):
    body, camera, pose = bead_before_a_ball()
    chosen = replace(PAPER, reading=reading, evidence=evidence, candidates=candidates)
    mask = covered(body, pose, camera, [0, 1])
    for inertia, expected in ((1.0, -2), (0.0, 0)):
        setup = SearchSetup(body, [camera], replace(chosen, inertia=inertia), 30.0, mask.sum())
        step = setup.bounds[0][6] / setup.half
        found, shift = pose.copy(), np.zeros(setup.n_axes)
        shift[6] = 2 * step
        setup.order = np.array([1])
        setup.sweep(found, shift, 1.0, setup.pack([mask]), setup.make_scratch())
        assert (found[7] - pose[7]) / step == pytest.approx(expected, abs=1e-6)


def test_a_root_that_fits_stays_although_it_covers_itself():
    body, camera, pose = bead_before_a_ball()
    mask = covered(body, pose, camera, [0])
    setup = SearchSetup(body, [camera], PAPER, 30.0, mask.sum())
    found, shift = pose.copy(), np.zeros(setup.n_axes)
    setup.order = np.array([0])
    setup.sweep(found, shift, 1.0, setup.pack([mask]), setup.make_scratch())
    np.testing.assert_allclose(found, pose, atol=1e-12)


def test_as_printed_a_limb_is_pulled_onto_what_is_placed():
    """The literal reading: only pixels of parts already placed count as silhouette."""
    body, camera, pose = bead_before_a_ball()
    spheres = [body.spheres[0], [0.3, 0.0, 0.0, 0.1]]  # the bead now lies beside the ball
    body = replace(body, offsets=[[0.0, 0.0, 0.0], [0.3, 0.0, 0.6]], spheres=spheres)
    mask = covered(body, pose, camera, [0, 1])
    moved = {}
    for reading in ("literal", "masked"):
        chosen = replace(PAPER, reading=reading, inertia=0.0, max_change=1.5)
        setup = SearchSetup(body, [camera], chosen, 30.0, mask.sum())
        found, shift = pose.copy(), np.zeros(setup.n_axes)
        setup.order = np.array([1])
        setup.sweep(found, shift, 1.0, setup.pack([mask]), setup.make_scratch())
        moved[reading] = abs(shift[6])
    assert moved["masked"] == 0.0
    assert moved["literal"] > 0.5
