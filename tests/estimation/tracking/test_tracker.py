"""The tracker: silhouettes of a known motion back to the motion, stopped and taken up again; smoothing of poses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import BodyModelError, CalibrationError, OptionError, SilhouetteError
from dousa.estimation.body.body_file import read_body
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rendering import render
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.estimation.tracking.settings import PAPER, TrackerSettings
from dousa.estimation.tracking.start import exchange_pair, find_pairs
from dousa.estimation.tracking.tracker import estimate, smooth_poses
from dousa.motion import rotations as rot

QUICK = TrackerSettings(beam=1, damping=(0.5,), passes=(1.0, 0.4), smoothing=0.0)
SIZE = (128, 96)

ARM = """
stature = 1.2
[[part]]
name = "base"
spheres = [[-0.2, 0, -0.15, 0], [0.2, 0, -0.15, 0], [0.2, 0, 0.15, 0], [-0.2, 0, 0.15, 0], [0, 0.5, 0, 0.08]]
[[part]]
name = "boom"
parent = "base"
offset = [0, 0.5, 0]
axes = [[0, 0, 1], [1, 0, 0]]
limits_degrees = [[-120, 120], [-60, 60]]
spheres = [[0, 0, 0, 0.07], [0, 0.5, 0, 0.05]]
[[part]]
name = "stick"
parent = "boom"
offset = [0, 0.5, 0]
axes = [[0, 0, 1]]
limits_degrees = [[0, 150]]
spheres = [[0, 0, 0, 0.05], [0, 0.4, 0, 0.03]]
[[tip]]
name = "claw"
part = "stick"
offset = [0, 0.4, 0]
"""


def walk(body, n_frames=16):
    """Somebody who walks off to the left while arms and legs swing and the knees bend."""
    poses = np.tile(standing_state(body), (n_frames, 1))
    phase = 2 * np.pi * np.arange(n_frames) / 36.0
    poses[:, 0] += 0.02 * np.arange(n_frames)
    limits = body.angle_limits
    for angle, name in enumerate(body.angle_names):
        side = -1.0 if name.startswith("right") else 1.0
        swing = {"shoulder.1": -0.5, "hip.1": 0.4, "elbow.1": 0.3, "knee.1": 0.3}
        for joint, amount in swing.items():
            if name.endswith(joint):
                poses[:, 7 + angle] += side * amount * np.sin(phase)
    poses[:, 7:] = np.clip(poses[:, 7:], limits[:, 0], limits[:, 1])
    return poses


def errors_mm(body, poses, truth):
    return 1000 * np.linalg.norm(compute_points(body, poses) - compute_points(body, truth), axis=-1)


class Clip:
    """A motion and its silhouettes."""

    def __init__(self, body, poses, n_views=4, size=SIZE, rate=30.0):
        self.body, self.poses, self.rate = body, poses, rate
        self.cameras = make_ring(n_views, size=size)
        self.masks = render(body, poses, self.cameras)

    def silhouettes(self, missing=None):
        return PackedSilhouettes(self.masks, self.rate, missing=missing)

    def track(self, settings=QUICK, start=0, missing=None, **more):
        pose = self.poses[start] if start is not None else None
        options = {"settings": settings, "girths": "keep"} | more
        return estimate(self.silhouettes(missing), self.cameras, self.body, pose, **options)

    def errors(self, found):
        return errors_mm(self.body, found.poses, self.poses)


@pytest.fixture(scope="module")
def walker():
    body = make_human(1.7)
    return Clip(body, walk(body))


def assert_same(one, other):
    for field in ("poses", "iou", "uncertainty", "occluded", "lost"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), err_msg=field)
    assert one.warnings == other.warnings


def test_our_own_body_is_tracked_back_from_nothing_but_silhouettes(walker):
    found = walker.track(TrackerSettings(), start=None)
    n_frames, body = len(walker.poses), walker.body
    assert walker.errors(found).mean() < 25.0
    assert found.poses.shape == walker.poses.shape
    assert found.iou.shape == (n_frames, 4)
    assert found.iou.mean() > 0.85
    assert found.uncertainty.shape == (n_frames, body.n_parts + len(body.tips))
    assert (found.uncertainty >= 0).all()
    assert found.occluded.shape == (n_frames, body.n_parts)
    assert not found.lost.any()
    assert found.warnings == ()
    np.testing.assert_allclose(np.linalg.norm(found.poses[:, 3:7], axis=1), 1.0, atol=1e-9)
    limits = body.angle_limits
    assert (found.poses[:, 7:] >= limits[:, 0] - 1e-9).all()
    assert (found.poses[:, 7:] <= limits[:, 1] + 1e-9).all()


def test_the_number_of_threads_and_the_run_do_not_matter(walker):
    clip = Clip(walker.body, walker.poses[:6], 2)
    one, two, again = (clip.track(TrackerSettings(), n_threads=n) for n in (1, 2, 2))
    assert_same(one, two)
    assert_same(two, again)


def test_views_may_be_missing_now_and_then(walker):
    missing = np.zeros((4, 16), bool)
    missing[0, 3:9] = missing[2, 5:12] = True
    missing[:, 10:12] = True
    found = walker.track(missing=missing)
    np.testing.assert_array_equal(np.isnan(found.iou), missing.T)
    assert walker.errors(found).mean() < 60.0
    assert found.lost[10:12].all()
    assert not found.lost[:10].any()
    assert found.occluded[10:12].all()
    assert (found.uncertainty[10] >= found.uncertainty[9]).all()
    assert any("2 of 16 frames are lost" in str(note) for note in found.warnings)


def test_before_anybody_comes_the_first_pose_is_held(walker):
    clip = Clip(walker.body, walker.poses[:6], 2)
    for masks in clip.masks:
        masks[:3] = False
    found = clip.track(start=3)
    assert len(found.poses) == 6
    np.testing.assert_array_equal(found.poses[:3], found.poses[[3, 3, 3]])
    np.testing.assert_allclose(found.poses[3], clip.poses[3])
    assert found.lost.tolist() == [True] * 3 + [False] * 3
    assert any("frame 3" in str(note) for note in found.warnings)


def test_the_method_as_published_runs(walker):
    clip = Clip(walker.body, walker.poses[:8], 2)
    found = clip.track(PAPER)
    assert np.isfinite(found.poses).all()
    assert clip.errors(found).mean() < 120.0
    steps = np.abs(np.diff(found.poses[:, 7:], axis=0)).max(axis=1)
    assert steps[0] <= np.deg2rad(6.0) + 1e-9  # from rest, dR is the farthest that an angle gets
    again = clip.track(PAPER)
    assert_same(found, again)


def checkpoints_of(clip, **more):
    kept = []
    found = clip.track(on_checkpoint=lambda make: kept.append(make()), **more)
    return found, kept


@pytest.mark.parametrize("wide", [False, True])
def test_an_interrupted_run_ends_as_if_it_had_not_been(walker, wide):
    clip = Clip(walker.body, walk(walker.body, 36), 2, (80, 60))
    settings = replace(QUICK, beam=2, damping=(0.2, 0.9), lag=6) if wide else replace(QUICK, lag=3)
    whole, kept = checkpoints_of(clip, settings=settings)
    assert len(kept) == 1
    assert len(kept[0].poses) == 32 - settings.lag
    assert_same(whole, clip.track(settings, resume=kept[0]))


def test_an_interrupted_run_finds_a_lost_track_at_the_same_frame(walker):
    poses = walk(walker.body, 37)
    poses[29:, 0] += 1.0  # a leap that no inertia allows, shortly before the checkpoint
    clip = Clip(walker.body, poses, 2, (80, 60))
    settings = replace(QUICK, lag=3)
    whole, kept = checkpoints_of(clip, settings=settings)
    assert any("restarted at frame" in str(note) for note in whole.warnings)
    assert clip.errors(whole)[-1].mean() < 150.0
    assert_same(whole, clip.track(settings, resume=kept[0]))


@pytest.mark.parametrize("n_views", [2, 4])
def test_exchanged_legs_are_found_and_mended_from_the_beginning(walker, n_views):
    clip = Clip(walker.body, walk(walker.body, 24), n_views)
    legs = next(
        pair for pair in find_pairs(clip.body) if "left_thigh" in (clip.body.names[part] for part in pair.parts)
    )
    wrong = exchange_pair(clip.body, clip.poses[0], legs)
    found = estimate(clip.silhouettes(), clip.cameras, clip.body, wrong, girths="keep", n_threads=1)
    assert clip.errors(found).mean() < 40.0  # 140 and more where nobody looks again
    assert any("restarted at frame" in str(note) for note in found.warnings)


def test_silhouettes_of_a_stouter_person_fatten_the_body(walker):
    stout = replace(walker.body, spheres=np.array(walker.body.spheres) * (1, 1, 1, 1.3))
    clip = Clip(stout, walker.poses[:3], 3)
    thin = estimate(clip.silhouettes(), clip.cameras, walker.body, clip.poses[0], settings=QUICK, girths="keep")
    fitted = estimate(clip.silhouettes(), clip.cameras, walker.body, clip.poses[0], settings=QUICK)
    assert fitted.body.spheres[:, 3].sum() > 1.1 * walker.body.spheres[:, 3].sum()
    assert thin.body is walker.body
    assert fitted.iou.mean() > thin.iou.mean() + 0.02


def test_large_images_are_searched_small(walker):
    clip = Clip(walker.body, walker.poses[:4], 3, (512, 384))
    found = clip.track(replace(QUICK, height=80))
    assert clip.errors(found).mean() < 40.0
    assert found.iou.mean() > 0.8


def test_a_robot_is_tracked_as_a_person_is(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    body = read_body(path)
    t = np.arange(14)
    poses = np.zeros((14, 7 + body.n_angles))
    poses[:, 3] = 1.0
    poses[:, 0] = 0.01 * t
    poses[:, 7], poses[:, 8], poses[:, 9] = 0.1 + 0.06 * t, -0.2 + 0.04 * t, 0.3 + 0.07 * t
    clip = Clip(body, poses, 3, (256, 192))
    found = clip.track(TrackerSettings())
    assert clip.errors(found).mean() < 25.0
    assert found.motion.skeleton.names == ("base", "boom", "stick", "claw")


def test_a_real_motion_in_another_body_is_followed(shared_data):
    from dousa.estimation.body.posing import fit_pose
    from lab.estimation.clips import first_frame_body, read_clip, take_part
    from lab.estimation.metrics import compare_with_truth

    clip = read_clip(shared_data("silhouette_bench/bd_jog_clean.npz"))
    body = first_frame_body(clip, "start")
    start = fit_pose(body, clip.joints_at(0))[0]
    found = estimate(take_part(clip.silhouettes, range(4), (0, 10)), clip.cameras, body, start)
    points = found.points
    accuracy = compare_with_truth(points.names, points.positions, clip.joints, clip.truth[:10])
    assert accuracy.errors.mean() < 0.045
    assert found.iou.mean() > 0.7
    assert not found.lost.any()


def test_progress_is_told_frame_by_frame(walker):
    clip, told = Clip(walker.body, walker.poses[:5], 2), []
    clip.track(progress=lambda done, total, what: told.append((done, total, str(what))))
    assert told[0][:2] == (0, 5) and "ready" in told[0][2]
    assert told[1:] == [(done, 5, "tracking") for done in range(2, 6)]


def test_one_frame_is_a_motion(walker):
    found = Clip(walker.body, walker.poses[:1], 2).track(TrackerSettings())
    np.testing.assert_allclose(found.poses, walker.poses[:1], atol=1e-12)
    assert found.frames_per_second >= 0.0


@pytest.mark.parametrize(
    ("spoil", "error", "says"),
    [
        (
            lambda a: a.update(cameras=a["cameras"][:1]),
            CalibrationError,
            "one camera for each view, got 1 camera for 2 views",
        ),
        (lambda a: a.update(cameras=make_ring(2, size=(64, 48))), CalibrationError, "got one for 64 x 48"),
        (lambda a: a.update(start=a["start"][:-1]), BodyModelError, "expected a pose of"),
        (lambda a: a.update(start=a["start"] * np.nan), BodyModelError, "finite"),
        (lambda a: a.update(start=np.zeros_like(a["start"])), BodyModelError, "unit quaternion"),
    ],
)
def test_arguments_that_do_not_fit_are_named(walker, spoil, error, says):
    clip = Clip(walker.body, walker.poses[:2], 2)
    arguments = {"cameras": clip.cameras, "start": clip.poses[0]}
    spoil(arguments)
    with pytest.raises(error, match=says):
        estimate(clip.silhouettes(), arguments["cameras"], walker.body, arguments["start"], settings=QUICK)


@pytest.mark.parametrize(("value", "says"), [(False, "every mask is empty"), (True, "is black foreground")])
@pytest.mark.parametrize("start", [0, None])
def test_where_nobody_is_there_is_nothing_to_track(walker, value, says, start):
    clip = Clip(walker.body, walker.poses[:2], 2)
    for masks in clip.masks:
        masks[:] = value
    with pytest.raises(SilhouetteError, match=says):
        clip.track(start=start)


@pytest.mark.parametrize(
    "wrong",
    [
        {"reading": "backwards"}, {"evidence": "hearsay"}, {"candidates": "all"}, {"agility": "lazy"},
        {"n_candidates": 12}, {"n_candidates": 65}, {"n_candidates": 11}, {"max_change": 0.0}, {"root_change": 2.0},
        {"passes": ()}, {"damping": ()}, {"beam": 0}, {"thinning": 3}, {"lag": 0},
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(OptionError):
        replace(TrackerSettings(), **wrong)


def poses_of(values, rate=30.0):
    """(T, 9) poses that turn about the vertical by the first value and bend two joints by the others."""
    values = np.asarray(values, float)
    poses = np.zeros((len(values), 9))
    poses[:, 3:7] = rot.from_axis_angle(values[:, :1] * (0.0, 1.0, 0.0))
    poses[:, 7:] = values[:, 1:]
    return poses


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.5, 20.0))
def test_what_is_still_stays(seed, n_frames, cutoff):
    pose = np.random.default_rng(seed).normal(size=9)
    pose[3:7] /= np.linalg.norm(pose[3:7])
    poses = np.tile(pose, (n_frames, 1))
    np.testing.assert_allclose(smooth_poses(poses, 30.0, cutoff), poses, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_time_backwards_gives_the_same_backwards(seed):
    poses = poses_of(np.random.default_rng(seed).normal(0.0, 0.3, (40, 3)))
    there = smooth_poses(poses, 30.0, 4.0)
    back = smooth_poses(poses[::-1], 30.0, 4.0)[::-1]
    sign = np.sign((there[:, 3:7] * back[:, 3:7]).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(there[:, 3:7], sign * back[:, 3:7], atol=1e-9)
    np.testing.assert_allclose(there[:, 7:], back[:, 7:], atol=1e-9)


def test_a_swing_comes_neither_late_nor_early():
    t = np.arange(300) / 30.0
    swing = np.sin(2 * np.pi * 1.0 * t)
    smooth = smooth_poses(poses_of(np.stack((swing, swing, swing), axis=1)), 30.0, 6.0)[:, 7]
    lags = [float(smooth[20:280] @ swing[20 + lag : 280 + lag]) for lag in range(-5, 6)]
    assert int(np.argmax(lags)) == 5


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_half_of_the_power_is_left_at_the_cut_off(rate):
    t = np.arange(int(20 * rate)) / rate
    swing = np.cos(2 * np.pi * 2.0 * t)
    poses = poses_of(np.stack((0 * t, swing, swing), axis=1))
    smooth = smooth_poses(poses, rate, 2.0)[:, 7]
    inside = slice(len(t) // 4, -len(t) // 4)
    assert (smooth[inside] @ smooth[inside]) / (swing[inside] @ swing[inside]) == pytest.approx(0.5, abs=0.01)


def test_the_sign_of_a_quaternion_says_nothing():
    turning = poses_of(np.linspace(0.0, 6.0, 60)[:, None] * (1.0, 0.0, 0.0))
    flipped = turning.copy()
    flipped[::3, 3:7] *= -1.0
    expected, found = smooth_poses(turning, 30.0, 6.0), smooth_poses(flipped, 30.0, 6.0)
    dots = (expected[:, 3:7] * found[:, 3:7]).sum(axis=1)
    np.testing.assert_allclose(np.abs(dots), 1.0, atol=1e-12)
    assert (found[1:, 3:7] * found[:-1, 3:7]).sum(axis=1).min() > 0.9  # nothing jumps for what is written out
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:7], axis=1), 1.0, atol=1e-12)


def test_nothing_is_smoothed_across_a_break():
    step = np.repeat((0.0, 1.0), 20)
    poses = poses_of(np.stack((0 * step, step, step), axis=1))
    np.testing.assert_allclose(smooth_poses(poses, 30.0, 3.0, breaks=[20]), poses, atol=1e-12)
    assert np.abs(smooth_poses(poses, 30.0, 3.0) - poses).max() > 0.2
    np.testing.assert_allclose(smooth_poses(poses, 30.0, 3.0, breaks=[0, 20, 20, 40, 99]), poses, atol=1e-12)


def test_the_argument_is_left_alone():
    poses = poses_of(np.random.default_rng(0).normal(size=(10, 3)))
    before = poses.copy()
    smooth_poses(poses, 30.0, 2.0)
    np.testing.assert_array_equal(poses, before)
