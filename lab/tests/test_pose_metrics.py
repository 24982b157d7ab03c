"""Accuracy: perfect, empty, known and random estimates, against a plain transcription."""

from __future__ import annotations

import json
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import plain_accuracy

from dousa.errors import OptionError
from dousa.estimation.cameras.camera import Camera
from dousa.motion import rotations as rot
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from lab.estimation.metrics import (
    ANGLES,
    SEGMENTS,
    compare_in_images,
    compare_with_truth,
    compute_iou,
    list_stretches,
)

NAMES = CANONICAL_JOINTS
FEW = tuple(name for name in NAMES if name not in ("spine", "left_hand", "right_hand"))


def draw_points(seed=0, n_frames=7, names=NAMES):
    return np.random.default_rng(seed).normal(0.0, 0.5, (n_frames, len(names), 3))


def make_camera(kind="pinhole", depth=4.0):
    focal = 300.0 if kind == "pinhole" else 80.0
    matrix = [[focal, 0.0, 160.0], [0.0, focal, 120.0], [0.0, 0.0, 1.0]]
    return Camera("view", 320, 240, matrix, np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, depth], kind=kind)


def test_a_perfect_estimate_has_no_error():
    points = draw_points()
    answer = compare_with_truth(NAMES, points, NAMES, points, occluded=np.zeros(points.shape[:2]))
    zero = ("mean_mm", "root_mm", "rigid_mm", "segment_deg", "angle_deg", "jitter", "loss_rate", "visible_mm")
    assert [getattr(answer, name) for name in zero] == pytest.approx([0.0] * len(zero), abs=1e-9)
    assert answer.compute_pck(0.05) == answer.share_compared == 1.0
    assert not answer.is_lost
    assert math.isnan(answer.recovery_s)
    assert math.isnan(answer.occluded_mm)


@pytest.mark.parametrize("n_frames", [0, 3])
def test_nothing_to_compare_is_nan_and_never_zero(n_frames):
    points = np.full((n_frames, len(NAMES), 3), np.nan)
    answer = compare_with_truth(NAMES, np.zeros_like(points), NAMES, points)
    numbers = answer.to_json()
    for name in (
        "mean_mm",
        "root_mm",
        "rigid_mm",
        "segment_deg",
        "angle_deg",
        "pck_50",
        "loss_rate",
        "recovery_s",
    ):
        assert math.isnan(numbers[name]), name
    assert not answer.is_lost


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.booleans())
def test_agrees_with_the_plain_transcription(seed, n_frames, gaps):
    rng = np.random.default_rng(seed)
    truth = rng.normal(0.0, 0.5, (n_frames, len(FEW), 3))
    names = tuple(rng.permutation(NAMES))
    estimated = rng.normal(0.0, 0.5, (n_frames, len(names), 3))
    shared = [names.index(name) for name in FEW]
    size = rng.choice([0.02, 0.08, 0.15], (n_frames, 1, 1))
    estimated[:, shared] = truth + rng.normal(0.0, 1.0, truth.shape) * size
    if gaps:
        estimated[rng.random(estimated.shape[:2]) < 0.1] = np.nan
        truth[rng.random(truth.shape[:2]) < 0.1] = np.nan
    answer = compare_with_truth(names, estimated, FEW, truth, frame_rate=25.0)
    plain = plain_accuracy.score(names, estimated, FEW, truth, 25.0, 0.15, SEGMENTS, ANGLES)
    got = {
        "mean": answer.mean_mm / 1e3,
        "root": answer.root_mm / 1e3,
        "rigid": answer.rigid_mm / 1e3,
        "segment": np.deg2rad(answer.segment_deg),
        "angle": np.deg2rad(answer.angle_deg),
        "jitter": answer.jitter,
        "pck_50": answer.compute_pck(0.05),
        "loss_rate": answer.loss_rate,
        "recovery": answer.recovery_s,
    }
    if not gaps:
        assert got == pytest.approx(plain, nan_ok=True, abs=1e-6)
    else:  # the plain one counts frames without anything seen as not lost, too
        del got["loss_rate"], plain["loss_rate"]
        assert got == pytest.approx(plain, nan_ok=True, abs=1e-6)
    assert answer.joints == tuple(name for name in NAMES if name in FEW)


@given(st.integers(0, 2**32 - 1))
def test_moving_and_turning_the_whole_body_is_seen_by_the_raw_error_alone(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, 0.5, (4, len(NAMES), 3))
    turn = rot.to_matrix(rot.from_axis_angle(rng.normal(0.0, 1.0, 3)))
    moved = compare_with_truth(NAMES, points + np.array([0.3, 0.0, 0.4]), NAMES, points)
    assert moved.mean_mm == pytest.approx(500.0)
    assert [moved.root_mm, moved.segment_deg, moved.rigid_mm] == pytest.approx([0.0] * 3, abs=1e-6)
    turned = compare_with_truth(NAMES, points @ turn.T + 1.0, NAMES, points)
    assert [turned.rigid_mm, turned.angle_deg] == pytest.approx([0.0] * 2, abs=1e-6)


def test_a_mirror_image_is_not_aligned_away():
    points = draw_points()
    assert compare_with_truth(NAMES, points * [-1.0, 1.0, 1.0], NAMES, points).rigid_mm > 10.0


def test_a_bent_knee_costs_its_angle():
    straight = {"left_hip": (0, 1, 0), "left_knee": (0, 0.5, 0), "left_ankle": (0, 0, 0)}
    bent = straight | {"left_ankle": (0, 0.5 - 0.5 * math.cos(math.radians(20)), -0.5 * math.sin(math.radians(20)))}
    one, other = (np.array([list(pose.values())], float) for pose in (bent, straight))
    answer = compare_with_truth(tuple(bent), one, tuple(straight), other)
    assert answer.angles == ("left_knee",)
    assert answer.angle_deg == pytest.approx(20.0)
    assert answer.segments == ("left_thigh", "left_shank")
    assert answer.segment_deg == pytest.approx(10.0)
    assert math.isnan(answer.root_mm)  # neither both hips nor a pelvis


def test_lost_frames_and_coming_back():
    truth = np.zeros((12, len(NAMES), 3))
    off = np.array([0, 0, 1, 1, 1, 0, 0, 1, 0, 0, 1, 1]) * 0.2
    answer = compare_with_truth(NAMES, truth + off[:, None, None] * [1.0, 0.0, 0.0], NAMES, truth, frame_rate=10.0)
    assert list_stretches(answer.lost) == [(2, 5), (7, 8), (10, 12)]
    assert answer.loss_rate == 0.5
    assert answer.recovery_s == pytest.approx(0.2)
    assert answer.is_lost  # it never came back from the last stretch


def test_hidden_joints_are_told_apart():
    truth = np.zeros((3, len(NAMES), 3))
    flags = np.zeros(truth.shape[:2], bool)
    flags[:, 4:8] = True
    off = np.where(flags, 0.1, 0.01)[..., None] * np.array([0.0, 1.0, 0.0])
    answer = compare_with_truth(NAMES, truth + off, NAMES, truth, occluded=flags)
    assert (answer.visible_mm, answer.occluded_mm) == pytest.approx((10.0, 100.0))
    assert answer.compute_pck(0.05) == pytest.approx(0.8)


def test_an_estimate_with_gaps_says_how_much_was_compared():
    truth = draw_points()
    estimated = truth.copy()
    estimated[:, :5] = np.nan
    answer = compare_with_truth(NAMES, estimated, NAMES, truth)
    assert answer.share_compared == 0.75
    assert answer.mean_mm == 0.0


def test_bodies_that_are_no_people_are_matched_by_name():
    truth = draw_points(names=("base", "arm", "claw"))
    answer = compare_with_truth(("claw", "base"), truth[:, [2, 0]], ("base", "arm", "claw"), truth)
    assert answer.joints == ("base", "claw")
    assert answer.mean_mm == 0.0


def test_an_accuracy_survives_the_way_to_another_process():
    points = draw_points()
    answer = compare_with_truth(NAMES, points + 0.01, NAMES, points)
    again = pickle.loads(pickle.dumps(answer))
    assert json.dumps(again.to_json()) == json.dumps(answer.to_json())


@pytest.mark.parametrize(
    ("names", "points", "others", "truth", "words"),
    [
        (("a",), np.zeros((2, 1, 3)), ("b",), np.zeros((2, 1, 3)), "no joint in common"),
        (("a",), np.zeros((2, 1, 3)), ("a",), np.zeros((3, 1, 3)), "as many frames"),
        (("a",), np.zeros((2, 2, 3)), ("a",), np.zeros((2, 1, 3)), "estimate: expected points"),
        (("a", "a"), np.zeros((2, 2, 3)), ("a",), np.zeros((2, 1, 3)), "every name once"),
    ],
)
def test_what_does_not_fit_is_said(names, points, others, truth, words):
    with pytest.raises(OptionError, match=words):
        compare_with_truth(names, points, others, truth)
    with pytest.raises(OptionError, match=r"flags|frames|joint|points|name"):
        compare_with_truth(names, points, others, truth, occluded=np.zeros((9, 9)))


def test_errors_in_the_image_scale_with_the_distance():
    truth = np.zeros((2, 1, 3))
    off = truth + np.array([0.1, 0.0, 0.0])
    near, far = (
        compare_in_images(("pelvis",), off, ("pelvis",), truth, [make_camera(depth=depth)], 1.5) for depth in (3.0, 6.0)
    )
    assert (near.mean_px, far.mean_px) == pytest.approx((10.0, 5.0))
    assert near.mean_percent == pytest.approx(100.0 * 0.1 / 1.5) == far.mean_percent
    flat = compare_in_images(("pelvis",), off, ("pelvis",), truth, [make_camera("orthographic")], 1.5)
    assert (flat.mean_px, flat.mean_percent) == pytest.approx((8.0, 100.0 * 0.1 / 1.5))


def test_what_is_behind_a_camera_is_not_counted():
    truth = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]])
    views = [make_camera(depth=4.0), make_camera(depth=40.0)]
    answer = compare_in_images(("neck", "head"), truth + 0.1, ("neck", "head"), truth, views, 1.7)
    assert np.isnan(answer.pixels[0, 0]).tolist() == [False, True]
    assert np.isfinite(answer.view_px).all()
    with pytest.raises(OptionError, match="a camera or more"):
        compare_in_images(("neck",), truth[:, :1], ("neck",), truth[:, :1], [], 1.7)


def test_overlap_of_masks():
    one = np.zeros((3, 4, 5), bool)
    other = one.copy()
    one[0, :2], other[0, 1:3] = True, True
    one[1] = True
    assert compute_iou(one, other).tolist() == pytest.approx([1 / 3, 0.0, math.nan], nan_ok=True)
    assert compute_iou(one[0], one[0]) == 1.0
    with pytest.raises(OptionError, match="one shape"):
        compute_iou(one, one[:, :2])
