"""Experiments with silhouettes: what they feed the tracker, what they make of its answer, and the plain search."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.made_clips import STATURE, make_cameras, make_poses, write_clip

from dousa.errors import BodyModelError, OptionError, SilhouetteError
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.raster.rasteriser import draw_body, pack_bits
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.estimation.tracking.settings import PAPER, READINGS, Estimate, TrackerSettings
from dousa.estimation.tracking.tracker import estimate
from dousa.messages import Message
from dousa.motion import rotations as rot
from lab.estimation.clips import (
    choose_views,
    constant_velocity,
    find_clips,
    frozen_first_pose,
    list_view_choices,
    mark_points,
    read_clip,
    take_part,
)
from lab.estimation.experiment import run_bench
from lab.estimation.readings import (
    CHANGES,
    compute_quantisation_ratio,
    count_mismatch,
    run_reading_table,
    search_plainly,
)
from lab.tasks import run_tasks

BODY = make_human(STATURE)
DEGREES = math.radians(1.0)


class FakeTracker:
    """Answers with fixed poses, or the start held, and remembers what it was asked."""

    def __init__(self, poses=None):
        self.poses = poses
        self.calls = []

    def __call__(self, silhouettes, cameras, body, start=None, *, settings, girths="fit", n_threads=None):
        self.calls.append((silhouettes, cameras, body, start, settings, girths))
        poses = np.tile(start, (silhouettes.n_frames, 1)) if self.poses is None else self.poses
        n_frames, n_views = silhouettes.n_frames, len(cameras)
        hidden = np.zeros((n_frames, body.n_parts), bool)
        hidden[:, list(body.names).index("left_forearm")] = True
        nothing = np.zeros((n_frames, len(point_names(body))))
        iou = np.full((n_frames, n_views), 0.9)
        return Estimate(body, poses, silhouettes.frame_rate, iou, nothing, hidden, hidden[:, 0], ("hm",), 50.0)


def refuse(*_, **__):
    raise BodyModelError("text.verbatim", text="no pose fits")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("clips")
    for name in ("wave_clean", "wave_noisy", "sway_clean"):
        write_clip(place / f"{name}.npz")
    return place


@pytest.fixture(scope="module")
def wave(folder):
    return folder / "wave_clean.npz"


# Clips and views


def test_clips_are_found_by_variant(folder, wave):
    names = [path.name for path in find_clips([folder])]
    assert names == ["sway_clean.npz", "wave_clean.npz", "wave_noisy.npz"]
    assert [path.name for path in find_clips([folder], ["noisy"])] == ["wave_noisy.npz"]
    assert find_clips([wave, folder], ["clean"]) == (wave, folder / "sway_clean.npz")
    clip = read_clip(wave)
    assert (clip.name, clip.variant, clip.stature, len(clip.cameras)) == ("wave", "clean", STATURE, 3)


def test_what_is_no_clip_is_said(folder, tmp_path):
    with pytest.raises(OptionError, match="no such file"):
        find_clips([tmp_path / "nix.npz"])
    with pytest.raises(OptionError, match="found no sequences"):
        find_clips([tmp_path])
    with pytest.raises(OptionError, match="clean, noisy, got 'dirty"):
        find_clips([folder], ["dirty"])
    for lacking, words in (
        ("stature", "stature are not"),
        ("joint_positions", "joint_names and joint_positions"),
    ):
        with pytest.raises(SilhouetteError, match=words):
            read_clip(write_clip(tmp_path / "less.npz", **{lacking: None}))
    with pytest.raises(SilhouetteError, match="expected true joints of 6 frames, got 4"):
        read_clip(write_clip(tmp_path / "short.npz", joint_positions=np.zeros((4, len(point_names(BODY)), 3))))


def test_two_views_are_the_first_and_the_one_most_nearly_square_to_it():
    cameras = make_cameras((0.0, 40.0, 100.0, 170.0, 265.0))
    assert choose_views(cameras, 1) == (0,)
    assert choose_views(cameras, 2) == (0, 4)
    assert choose_views(cameras[:4], 2) == (0, 2)
    assert choose_views(cameras, 5) == (0, 1, 2, 3, 4)
    assert list_view_choices(cameras[:3], 2, "all") == ((0, 1), (0, 2), (1, 2))
    with pytest.raises(OptionError, match="expected 1 to 5, got 6"):
        choose_views(cameras, 6)


def test_a_part_of_silhouettes_is_what_was_there(wave):
    whole = read_clip(wave).silhouettes
    part = take_part(whole, (2, 0), (1, 4))
    assert (part.n_frames, part.names) == (3, (whole.names[2], whole.names[0]))
    for k in range(3):
        for mask, view in zip(part.read(k), (2, 0), strict=True):
            assert (mask == whole.read(k + 1)[view]).all()
    gaps = PackedSilhouettes(np.ones((1, 2, 4, 5), bool), 30.0, missing=[[False, True]])
    assert take_part(gaps, (0,)).read(1) == (None,)
    with pytest.raises(OptionError, match="expected some of 0 to 6"):
        take_part(whole, (0,), (3, 9))


# Baselines


def test_the_first_pose_is_held():
    pose = make_poses(BODY)[0]
    assert (frozen_first_pose(pose, 3) == pose).all()
    with pytest.raises(OptionError, match="one pose and a frame or more"):
        frozen_first_pose(pose, 0)


@given(st.integers(0, 2**32 - 1))
def test_constant_velocity_repeats_the_first_step(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.normal(0.0, 0.3, (2, 12))
    for pose in (one, other):
        pose[3:7] = rot.from_axis_angle(rng.normal(0.0, 0.5, 3))
    poses = constant_velocity(one, other, 4)
    assert poses[0] == pytest.approx(one)
    assert rot.to_matrix(poses[1, 3:7]) == pytest.approx(rot.to_matrix(other[3:7]))
    places = np.delete(poses, slice(3, 7), axis=1)
    assert np.diff(places, 2, axis=0) == pytest.approx(0.0, abs=1e-12)
    matrices = rot.to_matrix(poses[:, 3:7])
    step = matrices[0].T @ matrices[1]
    assert matrices[3] == pytest.approx(matrices[0] @ step @ step @ step)
    limits = np.tile([-0.1, 0.1], (5, 1))
    assert np.abs(constant_velocity(one, other, 9, limits)[:, 7:]).max() <= 0.1


# The bench


def test_a_tracker_that_tells_the_truth_has_no_error(wave):
    tracker = FakeTracker(make_poses(BODY))
    result = run_bench([wave], views=(1, 2), track=tracker)
    assert [row.views for row in result.rows] == [(0,), (0, 2)]
    for row in result.rows:
        ours = row.scores["estimate"]
        assert ours.accuracy.mean_mm == pytest.approx(0.0, abs=1e-6)
        assert ours.image.pixels.shape[0] == len(row.views)
        assert ours.accuracy.mean_mm < row.scores["frozen"].accuracy.mean_mm
        assert not row.is_lost
        assert (row.iou, row.frames_per_second, row.warnings) == (pytest.approx(0.9), 50.0, ("hm",))
    json.dumps(result.to_json())


def test_the_tracker_is_told_the_first_frame_and_the_stature_alone(wave):
    tracker = FakeTracker()
    run_bench([wave], views=(2,), track=tracker, settings=TrackerSettings(damping=(0.25,)))
    silhouettes, cameras, body, start, settings, girths = tracker.calls[0]
    assert (silhouettes.n_views, [camera.name for camera in cameras]) == (2, ["view1", "view3"])
    assert body.stature == STATURE
    assert (settings.damping, girths) == ((0.25,), "fit")
    off = compute_points(body, start) - compute_points(BODY, make_poses(BODY)[0])
    assert np.abs(off).max() < 0.01
    found = FakeTracker(make_poses(BODY))
    assert run_bench([wave], views=(1,), start="auto", track=found).start == "auto"
    assert found.calls[0][3] is None


def test_holding_the_start_is_as_good_as_the_first_pose_held(wave):
    entry = run_bench([wave], views=(3,), track=FakeTracker()).summarise()[0]
    assert entry["estimate"]["mean_mm"] == pytest.approx(entry["frozen"]["mean_mm"])
    assert (entry["n_below_frozen"], entry["n_below_frozen_rooted"], entry["n_clips"]) == (0, 0, 1)
    # This clip moves as constant velocity has it.
    assert entry["constant_velocity"]["mean_mm"] < 0.2 * entry["frozen"]["mean_mm"]
    assert math.isfinite(entry["estimate"]["occluded_mm"])


def test_a_body_may_take_its_bones_from_the_first_frame(tmp_path):
    path = write_clip(tmp_path / "taller_than_told.npz", stature=1.5)
    off = {}
    for source in ("stature", "start"):
        tracker = FakeTracker()
        assert run_bench([path], views=(1,), body=source, track=tracker).body == source
        off[source] = np.abs(tracker.calls[0][2].offsets - BODY.offsets).max()
    assert off["start"] < 0.01
    assert off["stature"] > 0.04


def test_a_clip_that_is_refused_is_lost_and_says_why(wave):
    result = run_bench([wave], views=(1,), track=refuse)
    row = result.rows[0]
    assert (row.is_lost, str(row.problem)) == (True, "no pose fits")
    entry = result.summarise()[0]
    assert (entry["n_lost"], entry["n_below_frozen"]) == (1, 0)
    assert math.isnan(entry["estimate"]["mean_mm"])
    json.dumps(result.to_json())


def test_every_choice_of_views_counts_a_clip_once(folder):
    result = run_bench([folder], views=(1, 2), choice="all", variants=["clean"], track=FakeTracker())
    assert len(result.rows) == 2 * (3 + 3)
    assert [(e["n_views"], e["n_clips"]) for e in result.summarise()] == [(1, 2), (2, 2)]


def test_threads_change_nothing(folder):
    steps = []
    answers = [
        run_bench(
            [folder],
            views=(1,),
            track=FakeTracker(),
            n_jobs=n_jobs,
            progress=lambda *step: steps.append(step),
        )
        for n_jobs in (None, 2)
    ]
    one, two = (json.dumps(answer.to_json()) for answer in answers)
    assert one == two
    assert [step[0] for step in steps] == [0, 1, 2, 3] * 2
    assert (*steps[-1][:2], str(steps[-1][2])) == (3, 3, "wave noisy")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"views": (4,)}, "expected at most 3, got 4"),
        ({"views": (0,)}, "numbers of 1 or more"),
        ({"start": "maybe"}, "start: expected truth or auto"),
        ({"n_jobs": 0}, "other than 0"),
    ],
)
def test_values_out_of_range_are_said(wave, wrong, words):
    with pytest.raises(OptionError, match=words):
        run_bench([wave], track=FakeTracker(), **wrong)


def test_one_task_needs_no_workers():
    def name(task):
        return Message("text.verbatim", text=str(task))

    assert list(run_tasks(str, [1], name, n_jobs=2, progress=None)) == ["1"]
    assert list(run_tasks(str, [], name, n_jobs=2, progress=None)) == []


def test_a_joint_is_hidden_where_the_part_above_it_is():
    parts = np.zeros((1, BODY.n_parts), bool)
    parts[0, [BODY.names.index("left_forearm"), BODY.names.index("left_hand")]] = True
    names = np.array(point_names(BODY))
    assert set(names[mark_points(BODY, parts)[0]]) == {"left_wrist", "left_hand"}


# The paper's experiment


def test_the_table_asks_for_the_papers_settings_and_each_change(wave):
    tracker = FakeTracker()
    settings = replace(PAPER, smoothing=1.0)
    table = run_reading_table(
        wave,
        frames=(1, 5),
        views=(1, 2),
        readings=("masked", "residual"),
        evidences=("log",),
        settings=settings,
        track=tracker,
    )
    assert len(table.rows) == 2 * 2 * 2 * len(CHANGES)
    assert len(table.range_rows) == 2 * 2 * 2 * 2
    assert {call[0].n_frames for call in tracker.calls} == {4}
    asked = [call[4] for call in tracker.calls[: len(CHANGES)]]
    assert [(s.inertia, s.damping, s.passes, s.candidates) for s in asked] == [
        (1, (1,), (1,), "part"),
        (0, (1,), (1,), "part"),
        (1, (0.5,), (1,), "part"),
        (1, (0.5,), (1, 0.5), "part"),
        (1, (0.5,), (1,), "subtree"),
    ]
    assert {call[5] for call in tracker.calls} == {"keep"}
    assert {(s.reading, s.evidence, s.max_change) for s in asked} == {("masked", "log", settings.max_change)}
    row = table.find(source="own body", reading="residual", views=(0, 2), change="W = 1")
    frozen = table.baselines["own body"]["frozen"].accuracy.mean_mm
    assert row.score.accuracy.mean_mm == pytest.approx(frozen)
    answer = json.loads(json.dumps(table.to_json()))
    assert answer["frames"] == [1, 5]
    with pytest.raises(OptionError, match="got 'upside down"):
        run_reading_table(wave, settings=settings, track=tracker, changes=("upside down",))


def test_what_the_model_itself_draws_starts_where_it_is(wave):
    table = run_reading_table(
        wave,
        frames=(0, 2),
        views=(1,),
        readings=("masked",),
        evidences=("log",),
        changes=("paper",),
        sources=("own body",),
        settings=TrackerSettings(max_change=6 * DEGREES),
        track=FakeTracker(),
    )
    assert table.rows[0].score.accuracy.frame_errors[0] == pytest.approx(0.0, abs=2e-3)
    assert [row.told for row in table.range_rows] == ["first frame", "every frame"]
    row = table.range_rows[1]
    errors = [score.accuracy.mean_mm for score in (row.full_range, row.within, row.weighed)]
    assert (row.ratio, row.weighed_ratio) == pytest.approx((errors[0] / errors[1], errors[0] / errors[2]))


def test_the_ratio_is_the_mean_range_by_twice_the_change():
    limits = [math.degrees(high - low) for low, high in BODY.angle_limits]
    assert compute_quantisation_ratio(BODY, 6 * DEGREES) == pytest.approx(sum(limits) / len(limits) / 12.0)
    with pytest.raises(OptionError, match="above 0"):
        compute_quantisation_ratio(BODY, 0.0)


# The plain search


@pytest.mark.parametrize("reading", READINGS)
def test_readings_count_pixels_as_sets_of_pixels_have_it(reading):
    rng = np.random.default_rng(3)
    silhouette, fixed = rng.random((2, 5, 70)) < 0.4
    candidates = rng.random((4, 5, 70)) < 0.3
    counted = count_mismatch(reading, pack_bits(silhouette), pack_bits(fixed), pack_bits(candidates))
    s, f = ({(int(i), int(j)) for i, j in np.argwhere(mask)} for mask in (silhouette, fixed))
    for mask, count in zip(candidates, counted, strict=True):
        p = {(int(i), int(j)) for i, j in np.argwhere(mask)}
        expected = {
            "residual": (s - f) ^ p,
            "masked": (s ^ p) - f,
            "union": (s | f) ^ p,
            "plain": s ^ p,
            "literal": (s & f) ^ p,
        }[reading]
        assert count == len(expected)


def test_the_plain_search_follows_its_own_body():
    poses = make_poses(BODY, n_frames=5, degrees=3.0)
    cameras = make_cameras((0.0, 60.0, 120.0), width=160, height=120)
    masks = PackedSilhouettes([draw_body(BODY, poses, camera) for camera in cameras], 30.0)
    truth = compute_points(BODY, poses)
    errors = {}
    for reach in ("range", "near", "inertia"):
        found = search_plainly(
            masks,
            cameras,
            BODY,
            poses[0],
            reading="masked",
            reach=reach,
            max_change=6 * DEGREES,
            root_change=0.05,
        )
        assert found.shape == poses.shape
        assert np.linalg.norm(found[:, 3:7], axis=1) == pytest.approx(1.0)
        limits = BODY.angle_limits
        assert (found[1:, 7:] >= limits[:, 0] - 1e-6).all()
        assert (found[1:, 7:] <= limits[:, 1] + 1e-6).all()
        errors[reach] = np.linalg.norm(compute_points(BODY, found) - truth, axis=2).mean()
    held = np.linalg.norm(truth - truth[0], axis=2).mean()
    assert errors["inertia"] < min(held, errors["range"])


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("inertia", [0.0, 1.0])
def test_the_tracker_of_the_paper_is_the_plain_search(reading, inertia):
    body = make_human(1.6, "female")  # another one than was drawn, so that nothing fits
    poses = make_poses(BODY, n_frames=6, degrees=5.0)
    cameras = make_cameras((10.0, 95.0), width=160, height=120)
    masks = PackedSilhouettes([draw_body(BODY, poses, camera) for camera in cameras], 30.0)
    settings = replace(PAPER, reading=reading, inertia=inertia)
    found = estimate(masks, cameras, body, poses[0], settings=settings, girths="keep").poses
    plain = search_plainly(
        masks,
        cameras,
        body,
        poses[0],
        reading=reading,
        reach="inertia" if inertia else "near",
        max_change=settings.max_change,
        root_change=settings.root_change * body.stature,
    )
    assert found == pytest.approx(plain, abs=1e-9)


def test_a_plain_search_that_knows_the_frames_before_is_not_led_astray():
    poses = make_poses(BODY, n_frames=6, degrees=3.0)
    cameras = make_cameras((0.0, 90.0), width=160, height=120)
    masks = PackedSilhouettes([draw_body(BODY, poses, camera) for camera in cameras], 30.0)
    wrong = poses[0].copy()
    wrong[7:] = np.clip(wrong[7:] + 0.4, *BODY.angle_limits.T)
    found = search_plainly(
        masks,
        cameras,
        BODY,
        wrong,
        known=poses,
        reading="masked",
        reach="inertia",
        max_change=6 * DEGREES,
        root_change=0.05,
    )
    assert (found[0] == wrong).all()
    assert np.abs(found[1:, 7:] - poses[1:, 7:]).max() < math.radians(10.0)


# Real recordings


def test_the_real_bench_is_read_and_its_baselines_are_scored(shared_data):
    path = shared_data("silhouette_bench/cmu86_walk_clean.npz")
    row = run_bench([path], views=(2,), track=FakeTracker()).rows[0]
    assert row.views == (0, 1)
    assert row.scores["frozen"].accuracy.frame_errors[0] < 0.04  # another body's bones
    assert row.scores["frozen"].accuracy.mean_mm > 500.0  # he walks away
    assert row.is_lost
