"""The generators of errors: what they say about an error is what a ruler finds, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion

from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.composition import compose
from lab.injection.dynamics import RECIPES as DYNAMICS
from lab.injection.dynamics import follow_slowly, follow_spring, follow_weakly, stop_at_limit
from lab.injection.edits import find_heading, measure_angles, measure_segments, put_together, take_apart
from lab.injection.edits import turn as turn_about_vertical
from lab.injection.generators import GENERATORS
from lab.injection.joint_errors import RECIPES as JOINTS
from lab.injection.local_pose import REST, to_local, to_positions
from lab.injection.truth import BODY, LIMB_GROUPS, fit_copy

PARENTS = np.array(CANONICAL_PARENTS[1:])
NEW = ("joints", "dynamics")
ALL_RECIPES = [(name, k) for name, recipes in (("joints", JOINTS), ("dynamics", DYNAMICS)) for k in range(len(recipes))]
RECIPES = {"joints": JOINTS, "dynamics": DYNAMICS}


@pytest.fixture(scope="module")
def motion():
    return make_wandering_motion(12.0, seed=1)


@pytest.fixture(scope="module")
def donor():
    return make_wandering_motion(10.0, seed=2)


def bone_lengths(positions):
    return np.linalg.norm(positions[:, 1:] - positions[:, PARENTS], axis=2)


def make_one(name, number, motion, donors, seeds=range(40)):
    """The first injection of one recipe alone."""
    for seed in seeds:
        found = compose(motion, np.random.default_rng(seed), donors, 1, [RECIPES[name][number]])
        if found is not None:
            return found
    return None


def heading_free(motion):
    """(T, 9, 3)."""
    return turn_about_vertical(measure_segments(motion.positions), -find_heading(motion.positions, motion.frame_rate))


def measure_lag_slowly(clean, wrong, error, rate):
    """Seconds: at each candidate the largest share of moments that agree, by brute force over milliseconds."""
    chosen = [SEGMENTS.index(name) for name in error.segments]
    times = np.arange(len(clean)) / rate
    middle = 0.5 * (error.start_s + error.end_s)
    near = np.flatnonzero(np.abs(times - middle) <= max(0.15, 0.1 * (error.end_s - error.start_s)))
    best = (np.inf, 0.0)
    for lag in np.arange(-0.6, 0.6, 0.005):
        target = np.stack(
            [[np.interp(times[near] - lag, times, clean[:, s, c]) for c in range(3)] for s in chosen], axis=0
        ).transpose(2, 0, 1)
        best = min(best, (float(((target - wrong[near][:, chosen]) ** 2).sum()), float(lag)))
    return best[1]


# Joints


def test_a_pose_taken_into_joints_and_back_is_the_same(motion):
    assert np.allclose(to_positions(to_local(motion.positions)), motion.positions, atol=1e-12)


def test_joints_do_not_depend_on_heading_and_place(motion):
    turned = turn_about_vertical(motion.positions, np.array(1.1)) + np.array([3.0, 0.0, -1.0])
    here, there = to_local(motion.positions), to_local(turned)
    assert np.allclose(here.bones, there.bones, atol=1e-9)
    assert np.allclose(to_local(turned).turned(np.full(motion.n_frames, -1.1)).pelvis @ [1, 0, 0, 0], here.pelvis[:, 0])


def test_the_joints_of_a_mirror_image_are_the_mirrored_joints(motion):
    mirrored, expected = to_local(motion.positions).mirrored(), to_local(mirror_positions(motion.positions))
    assert np.allclose(mirrored.bones, expected.bones, atol=1e-9)
    assert np.allclose(np.abs((mirrored.pelvis * expected.pelvis).sum(axis=1)), 1, atol=1e-9)


def test_a_straight_arm_has_its_forearm_at_the_rest_direction(motion):
    body = take_apart(motion.positions)
    directions = body.directions.copy()
    upper, lower = J["left_elbow"] - 1, J["left_wrist"] - 1
    directions[:, lower] = directions[:, upper]
    straight = to_local(put_together(replace(body, directions=directions)))
    assert np.allclose(straight.bones[:, lower], REST[lower], atol=1e-9)


# Systems, against what theory says of them


@pytest.mark.parametrize("lag", [0.1, 0.3])
def test_a_spring_follows_a_wave_with_the_gain_and_lag_of_its_response(lag):
    rate, hertz = 120.0, 0.5
    times = np.arange(round(10 * rate)) / rate
    followed = follow_spring(np.sin(2 * np.pi * hertz * times)[:, None, None], lag, rate)[:, 0, 0]
    response = 1.0 / (1.0 + 2j * np.pi * hertz * lag / 2.0) ** 2
    settled = times > 4.0
    wave = np.exp(2j * np.pi * hertz * times[settled])
    found = 2j * (followed[settled] * wave.conj()).mean()
    assert found == pytest.approx(response, abs=0.005)


def test_a_limit_of_speed_is_kept_and_reached():
    angle = np.radians(np.concatenate([np.zeros(5), np.full(60, 80.0)]))
    target = np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)[:, None]
    steps = measure_angles(*(follow_slowly(target, np.radians(2.0))[part] for part in (slice(1, None), slice(-1))))
    assert steps.max() == pytest.approx(2.0, abs=1e-6)
    assert np.allclose(follow_slowly(target, np.radians(2.0))[-1], target[-1])


def test_half_the_velocity_is_half_the_way_and_it_drifts_back():
    target = np.concatenate([np.linspace(0, 1, 30), np.ones(600)])[:, None, None]
    assert follow_weakly(target, 0.5, 1e9, 30.0)[29, 0, 0] == pytest.approx(0.5)
    assert follow_weakly(target, 0.5, 1.0, 30.0)[-1, 0, 0] == pytest.approx(1.0, abs=1e-3)


def test_a_joint_goes_no_further_than_its_limit():
    angle = np.radians(np.linspace(0, 90, 91))
    target = np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)[:, None]
    stopped = stop_at_limit(target, target[0], np.radians([40.0]))
    reached = measure_angles(stopped, target[:1])[:, 0]
    assert np.allclose(reached, np.minimum(np.arange(91), 40), atol=1e-6)


def test_lag_gain_and_correlation_of_a_made_up_copy():
    times = np.arange(300) / 30.0

    def swing(when, size):
        angle = size * np.sin(2.3 * when) * np.cos(0.9 * when)
        return np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=1)[:, None]

    frames = np.arange(90.0, 200.0)
    late, _ = fit_copy(swing(times, 0.7), swing(frames / 30.0 - 0.23, 0.7), frames, 30.0)
    assert late.lag_s == pytest.approx(0.23, abs=0.01)
    assert late.gain == pytest.approx(1.0, abs=0.02)
    assert late.is_copy and not late.is_smaller
    _, small = fit_copy(swing(times, 0.7), swing(frames / 30.0, 0.35), frames, 30.0)
    assert small.lag_s == pytest.approx(0.0, abs=0.01)
    assert small.gain == pytest.approx(0.5, abs=0.03)
    assert small.is_smaller and not small.is_copy


# Errors


@pytest.mark.parametrize(("name", "number"), ALL_RECIPES)
def test_an_error_of_every_recipe_is_found_where_its_truth_says(motion, donor, name, number):
    injection = make_one(name, number, motion, [donor])
    assert injection is not None
    (error,) = injection.errors
    recipe = RECIPES[name][number]
    assert (error.kind, error.variant) == (recipe.kind, recipe.variant)
    assert np.allclose(bone_lengths(injection.motion.positions), bone_lengths(motion.positions), atol=1e-9)
    changed = np.abs(injection.motion.positions - motion.positions).max(axis=(1, 2)) > 1e-9
    moments = np.flatnonzero(changed) / motion.frame_rate
    # The fades, not yet visible, reach no more than 0.8 s beyond what can be seen; a shift may wait for movement.
    assert error.start_s >= moments[0] and error.end_s <= moments[-1] + 2 / motion.frame_rate
    assert 0.35 <= error.duration_s <= 4.0
    angles = measure_angles(heading_free(injection.motion), heading_free(motion))
    inside = slice(round(error.start_s * motion.frame_rate), round(error.end_s * motion.frame_rate))
    wrong = [SEGMENTS.index(segment) for segment in error.segments]
    assert angles[inside][:, wrong].max() >= (18.0 if error.kind in ("partial", "global") else 3.0)
    if recipe.whole:
        return
    right = [k for k in range(len(SEGMENTS)) if k not in wrong]
    limb = next(group for group in (*LIMB_GROUPS, BODY) if set(wrong) <= set(group.segments))
    right = [k for k in right if k not in limb.segments]
    assert angles[:, right].max() < 1e-4
    assert "trunk" not in error.segments


@pytest.mark.parametrize("name", NEW)
def test_outside_the_errors_no_direction_changes(motion, donor, name):
    for seed in range(8):
        injection = GENERATORS[name](motion, np.random.default_rng(seed), [donor], 2)
        if injection is None:
            continue
        off = measure_angles(measure_segments(injection.motion.positions), measure_segments(motion.positions))
        times = np.arange(motion.n_frames) / motion.frame_rate
        far = np.ones(motion.n_frames, bool)
        for error in injection.errors:
            far &= (times < error.start_s - 1.5) | (times > error.end_s + 1.5)
        assert off[far].max(initial=0.0) < 1e-6


@pytest.mark.parametrize(("name", "number"), [(name, k) for name, k in ALL_RECIPES if RECIPES[name][k].kind == "shift"])
def test_the_lag_of_a_shift_is_the_one_a_ruler_finds(motion, name, number):
    clean, off = heading_free(motion), []
    for first in (0, 20, 40):
        injection = make_one(name, number, motion, [], range(first, first + 40))
        error = injection.errors[0]
        lag = measure_lag_slowly(clean, heading_free(injection.motion), error, motion.frame_rate)
        assert np.sign(lag) == np.sign(error.lag_ms) == (-1 if "early" in error.variant else 1)
        assert 100 <= abs(error.lag_ms) <= 460
        off.append(abs(1000 * lag - error.lag_ms))
    # The middle of the visible part is not always where the lag is full, and the body carries a late limb along.
    assert np.median(off) <= 25.0


@pytest.mark.parametrize("number", range(4))
def test_a_delayed_joint_is_where_it_was_that_long_ago(motion, number):
    injection = make_one("joints", number, motion, [])
    error, rate = injection.errors[0], motion.frame_rate
    clean, wrong = to_local(motion.positions), to_local(injection.motion.positions)
    bone = J[error.segments[-1].split("_")[0] + ("_elbow" if "arm" in error.segments[-1] else "_knee")] - 1
    frames = np.arange(round(error.start_s * rate), round(error.end_s * rate))
    off = [
        measure_angles(wrong.bones[frames, bone], clean.sampled(frames - lag_s * rate).bones[:, bone])
        for lag_s in (error.lag_ms / 1000.0, 0.9 * error.lag_ms / 1000.0)
    ]
    # Where the delay holds; a tenth of it less fits nowhere for so long.
    assert (off[0] < 0.02).sum() >= 0.2 * rate
    assert (off[1] < 0.02).sum() < 0.1 * rate


@pytest.mark.parametrize("name", NEW)
def test_an_incomplete_motion_lacks_the_range_that_it_is_said_to_lack(motion, name):
    clean = heading_free(motion)
    for number, recipe in enumerate(RECIPES[name]):
        if recipe.kind != "incomplete":
            continue
        injection = make_one(name, number, motion, [])
        error = injection.errors[0]
        inside = slice(round(error.start_s * motion.frame_rate), round(error.end_s * motion.frame_rate))
        wrong = heading_free(injection.motion)
        losses = []
        for segment in map(SEGMENTS.index, error.segments):
            widest = [
                np.degrees(np.arccos(np.clip(d[inside, segment] @ d[inside, segment].T, -1, 1).min()))
                for d in (clean, wrong)
            ]
            losses.append((widest[0] - widest[1], 100 * (1 - widest[1] / widest[0])))
        assert error.shortfall_deg >= 12 and error.shortfall_percent >= 15
        assert max(losses)[0] == pytest.approx(error.shortfall_deg, abs=3.0)


@pytest.mark.parametrize("name", NEW)
def test_errors_overlap_only_where_both_can_be_told(motion, donor, name):
    pairs = set()
    for seed in range(30):
        injection = GENERATORS[name](motion, np.random.default_rng(seed), [donor], 4)
        for k, a in enumerate(injection.errors):
            for b in injection.errors[k + 1 :]:
                if b.start_s >= a.end_s:
                    continue
                whole = [e for e in (a, b) if len(e.segments) == len(SEGMENTS) or "trunk" in e.segments]
                if whole:
                    (body,) = whole
                    other = b if body is a else a
                    assert body.kind == "shift" and other.kind in ("partial", "incomplete")
                    pairs.add("in a late body")
                else:
                    assert not set(a.segments) & set(b.segments)
                    pairs.add("beside")
    assert pairs == {"in a late body", "beside"}


@pytest.mark.parametrize("name", NEW)
def test_a_limb_goes_late_alone_or_with_its_twin(motion, name):
    sets = set()
    for seed in range(30):
        injection = GENERATORS[name](motion, np.random.default_rng(seed), [], 3)
        sets |= {e.segments for e in injection.errors if e.kind == "shift" and len(e.segments) < len(SEGMENTS)}
    names = {tuple(SEGMENTS[s] for s in LIMBS[limb]) for limb in LIMBS}
    assert sets & names
    assert any(len(found) > 2 for found in sets)


@pytest.mark.parametrize("name", GENERATORS)
def test_errors_come_from_the_seed_alone(motion, donor, name):
    first, again, other = (GENERATORS[name](motion, np.random.default_rng(seed), [donor], 2) for seed in (5, 5, 6))
    assert np.array_equal(first.motion.positions, again.motion.positions)
    assert first.errors == again.errors
    assert other is None or not np.array_equal(first.motion.positions, other.motion.positions)


@pytest.mark.parametrize("name", GENERATORS)
def test_the_carrier_is_left_alone_and_the_result_is_as_long(motion, donor, name):
    before = motion.positions.copy()
    injection = GENERATORS[name](motion, np.random.default_rng(3), [donor], 3)
    assert np.array_equal(motion.positions, before)
    assert injection.motion.frame_rate == motion.frame_rate
    assert injection.motion.n_frames == motion.n_frames
    assert not injection.motion.positions.flags.writeable
    starts = [error.start_s for error in injection.errors]
    assert starts == sorted(starts)


@pytest.mark.parametrize("name", GENERATORS)
def test_where_nothing_is_possible_nothing_comes(motion, name):
    rng = np.random.default_rng(0)
    assert GENERATORS[name](replace(motion, positions=motion.positions[:1]), rng, [], 1) is None
    assert GENERATORS[name](replace(motion, positions=motion.positions[:20]), rng, [], 1) is None
    assert GENERATORS[name](motion, rng, [], 0) is None


@pytest.mark.parametrize("name", NEW)
def test_of_one_who_stands_still_nothing_is_late_or_smaller(name):
    still = make_wandering_motion(8.0, reach=0.0)
    for seed in range(10):
        injection = GENERATORS[name](still, np.random.default_rng(seed), [], 3)
        assert injection is None or {error.kind for error in injection.errors} <= {"partial"}


@pytest.mark.parametrize("name", NEW)
@pytest.mark.parametrize("rate", [25.0, 120.0])
def test_short_clips_of_any_rate_will_do(donor, name, rate):
    short = make_wandering_motion(1.6, seed=4, frame_rate=rate)
    found = [GENERATORS[name](short, np.random.default_rng(seed), [donor], 1) for seed in range(12)]
    errors = [error for injection in found if injection for error in injection.errors]
    assert len(errors) >= 6
    assert all(0 <= error.start_s < error.end_s <= 1.6 for error in errors)
    assert max(error.duration_s for error in errors) > 0.6
