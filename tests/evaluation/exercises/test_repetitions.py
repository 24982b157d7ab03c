"""Finding, counting and assessing repetitions: made-up performers, and real ones where they are at hand."""

import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import (
    ANGLES,
    PAIRED_ANGLES,
    AssessedRepetition,
    Fault,
    RangeOfMotion,
    Repetition,
    RepetitionsAssessment,
    Trend,
    advise,
    assess,
    assess_repetitions,
    compute_joint_angles,
    compute_postures,
    find_repetitions,
)
from dousa.evaluation.errors import causes
from dousa.evaluation.errors.faults import WELL, describe_fault, describe_repetition, find_faults
from dousa.evaluation.exercises.split import find_reference_repetitions
from dousa.evaluation.exercises.summary import (
    choose_angles,
    choose_pair,
    compute_median,
    describe_exercise,
    describe_trends,
)
from dousa.evaluation.exercises.trends import adjust_for_many, estimate_trend
from dousa.evaluation.grade.references import prepare_references
from dousa.evaluation.grade.score import find_well
from dousa.formats.motion_files import ReadOptions, read_canonical
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories, mirror_canonical
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.motion.synthetic.scores import SCORES
from lab.trials.exercise_sets import ExerciseSet, join_repetitions

PERFORMER = draw_performer(302)


def make_clips(category: str, n: int) -> list[CanonicalMotion]:
    """Takes of a single repetition; those of more are left out."""
    takes = (canonicalise(compute_trajectories(make_motion(category, PERFORMER, take))) for take in range(30))
    single = 1.8 * SCORES[category].seconds / PERFORMER.tempo
    return [take for take in takes if take.duration < single][:n]


@pytest.fixture(scope="module")
def squats() -> tuple[CanonicalMotion, ExerciseSet]:
    """A squat, and six more of which one is broken off, with walking before and after."""
    reference, *clips = make_clips("squat", 7)
    walk = canonicalise(compute_trajectories(make_motion("walk", PERFORMER, 0)))
    rng = np.random.default_rng(5)
    return reference, join_repetitions(clips, rng, broken_off=[3], before=walk, after=walk)


def assert_found(found: tuple[Repetition, ...], spans: tuple[tuple[float, float], ...], tolerance_s: float) -> None:
    assert len(found) == len(spans)
    for one, (start, end) in zip(found, spans, strict=True):
        assert one.start_s == pytest.approx(start, abs=tolerance_s)
        assert one.end_s == pytest.approx(end, abs=tolerance_s)


def test_a_reference_finds_each_repetition_and_the_one_broken_off(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    found = find_repetitions(truth.motion, [reference])
    assert_found(found.complete, truth.spans, 0.4)
    (half,) = [one for one in found.repetitions if not one.complete]
    assert half.extent < 0.65
    start, end = truth.broken_off[0]
    assert start - 0.2 < half.start_s < half.end_s < end + 0.2


def test_without_a_reference_the_same_number_is_found(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    found = find_repetitions(squats[1].motion)
    assert found.count == 5


def test_a_reference_of_several_repetitions_serves_as_well(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    several = join_repetitions(make_clips("squat", 4), np.random.default_rng(1)).motion
    assert len(find_reference_repetitions(several)) == 4
    assert find_repetitions(squats[1].motion, [several]).count == 5


def test_the_frame_rate_does_not_matter(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    half_rate = dataclasses.replace(truth.motion, positions=truth.motion.positions[::2], frame_rate=15.0)
    assert_found(find_repetitions(half_rate, [reference]).complete, truth.spans, 0.4)


def test_bounds_are_in_order_and_inside(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    for references in ([], [squats[0]]):
        found = find_repetitions(squats[1].motion, references)
        frames = [
            0,
            *(frame for one in found.repetitions for frame in (one.start, one.end)),
            len(squats[1].motion.positions),
        ]
        assert frames == sorted(frames)


def test_standing_still_has_no_repetition(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, _ = squats
    still = dataclasses.replace(reference, positions=np.repeat(reference.positions[:1], 200, axis=0))
    assert find_repetitions(still).repetitions == ()
    assert find_repetitions(still, [reference]).repetitions == ()
    with pytest.raises(InvalidMotionError) as caught:
        assess_repetitions(reference, still)
    assert caught.value.code == "exercises.no_repetition"
    with pytest.raises(InvalidMotionError) as caught:
        assess_repetitions(still, reference)
    assert caught.value.code == "exercises.still_reference"


def test_one_frame(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    one = dataclasses.replace(squats[0], positions=squats[0].positions[:1])
    assert find_repetitions(one).count == 0
    with pytest.raises(InvalidMotionError) as caught:
        assess_repetitions(squats[0], one)
    assert caught.value.code == "evaluation.short_performance"


def test_nothing_but_gaps_is_refused(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    lost = np.ones(truth.motion.positions.shape[:2], bool)
    with pytest.raises(InvalidMotionError) as caught:
        assess_repetitions(reference, dataclasses.replace(truth.motion, missing=lost))
    assert caught.value.code == "evaluation.unseen_performance"


def test_nan_in_some_frames_is_bridged(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    positions = truth.motion.positions.copy()
    positions[::7, 5] = np.nan
    found = find_repetitions(dataclasses.replace(truth.motion, positions=positions), [reference])
    assert_found(found.complete, truth.spans, 0.4)


def test_a_reference_longer_than_the_performance(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    assert truth.motion.duration > reference.duration
    done = assess_repetitions(truth.motion, reference)
    assert done.count == 1
    assert done.n_references == 5


def test_the_assessment_measures_each_repetition(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    done = assess_repetitions(reference, truth.motion)
    assert done.count == 5
    assert "left_knee_flexion" in done.angles
    assert "left_elbow_flexion" not in done.angles
    for one in done.complete:
        assert 60 < one.score <= 100
        assert one.tempo == pytest.approx(one.repetition.duration_s / done.reference_s)
        assert one.get_range("left_knee_flexion").percent == pytest.approx(100, abs=25)
        assert abs(one.symmetry["knee_flexion"]) < 20
    (half,) = [one for one in done.repetitions if not one.repetition.complete]
    assert math.isnan(half.score)
    assert half.get_range("left_knee_flexion").percent < 60
    pauses = [one.pause_s for one in done.repetitions]
    assert all(pause >= 0 for pause in pauses[:-1])
    assert math.isnan(pauses[-1])


def test_the_grade_is_that_of_assess_with_the_same_options(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    reference, truth = squats
    options = {"tempo": "same", "weights": {"legs": 2.0}}
    done = assess_repetitions(reference, truth.motion, **options)
    assert done.tempo == "same" == done.to_json()["tempo"]
    one = done.complete[0]
    first, last = round(one.first_s * 30), min(one.repetition.end + 8, truth.motion.n_frames)
    cut = dataclasses.replace(truth.motion, positions=truth.motion.positions[first:last])
    (span,) = find_reference_repetitions(reference)
    model = reference.positions[max(span[0] - 8, 0) : span[1] + 8]
    whole = assess(dataclasses.replace(reference, positions=model), cut, **options)
    assert one.assessment is not None
    assert (one.score, one.assessment.to_json()) == (whole.score, whole.to_json())
    assert one.score != assess_repetitions(reference, truth.motion, weights={"legs": 2.0}).complete[0].score


def test_being_slower_costs_points_only_if_asked() -> None:
    squat, *clips = make_clips("squat", 4)
    slow = [dataclasses.replace(clip, frame_rate=clip.frame_rate / 1.6) for clip in clips]
    motion = join_repetitions(slow, np.random.default_rng(3), tempo=(1.0, 1.0)).motion
    free, same = (assess_repetitions(squat, motion, tempo=tempo) for tempo in ("free", "same"))
    assert free.count == same.count == 3
    assert all(one.score > other.score + 0.5 for one, other in zip(free.complete, same.complete, strict=True))


def test_wrong_options_are_told(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    for option in ({"tempo": "slow"}, {"side": "left"}):
        with pytest.raises(OptionError, match=next(iter(option))):
            assess_repetitions(squats[0], squats[1].motion, **option)


def test_json_has_no_nan_and_says_the_same(squats: tuple[CanonicalMotion, ExerciseSet]) -> None:
    done = assess_repetitions(squats[0], squats[1].motion)
    plain = json.loads(json.dumps(done.to_json(), allow_nan=False))
    assert (plain["count"], plain["n_incomplete"]) == (5, 1)
    assert [one["complete"] for one in plain["repetitions"]].count(True) == 5
    assert set(plain["trends"]) >= {"duration_s", "score", "left_knee_flexion", "symmetry_knee_flexion"}
    assert plain["repetitions"][0]["score"] == round(done.repetitions[0].score, 1)


def test_getting_smaller_and_slower_shows_as_a_trend() -> None:
    reference, *clips = make_clips("squat", 4)
    clip = clips[0]
    rng = np.random.default_rng(3)
    tired = []
    for number in range(7):
        depth = 1.0 - 0.045 * number
        start = clip.positions[:1]
        tired.append(
            dataclasses.replace(
                clip,
                positions=start + depth * (clip.positions - start),
                frame_rate=clip.frame_rate * (1.0 - 0.05 * number),
            )
        )
    done = assess_repetitions(reference, join_repetitions(tired, rng, tempo=(1.0, 1.0)).motion)
    assert done.count == 7
    duration, knee = done.trends["duration_s"], done.trends["left_knee_flexion"]
    assert duration.distinguishable
    assert duration.slope > 0
    assert knee.distinguishable
    assert knee.slope < 0


@pytest.mark.parametrize("side", ["mirrored", "auto"])
def test_a_mirror_image_is_found(squats: tuple[CanonicalMotion, ExerciseSet], side: str) -> None:
    kick, *clips = make_clips("kick_left", 5)
    truth = join_repetitions(clips, np.random.default_rng(2))
    done = assess_repetitions(kick, mirror_canonical(truth.motion), side=side)
    assert (done.count, done.side) == (len(truth.spans), "mirrored")
    assert done.complete[0].get_range("left_hip_flexion").range_deg > 40
    assert ("exercises.mirrored" in done.to_json()["warning_codes"]) == (side == "auto")
    assert assess_repetitions(kick, truth.motion, side="auto").side == "same"


def test_what_is_broken_off_alone_is_measured_and_not_graded() -> None:
    reference, *clips = make_clips("squat", 4)
    done = assess_repetitions(reference, join_repetitions(clips, np.random.default_rng(1), broken_off=[0, 1, 2]).motion)
    assert (done.count, len(done.repetitions)) == (0, 3)
    said = [message.render("en") for message in describe_exercise(done)]
    assert said[0] == "no repetition could be graded"
    assert said[1].startswith("repetitions 1 to 3: broken off, reaching ")
    assert "knee" in " ".join(said[2:])
    json.dumps(done.to_json(), allow_nan=False)


@pytest.mark.parametrize("exercise", ["g2", "g4", "g6"])
def test_exercises_of_a_patient(shared_data: Callable[[str], Path], exercise: str) -> None:
    files = sorted(shared_data(f"irds/{exercise}/correct").glob("*.trc"))
    reference, *clips = [read_canonical(str(file), ReadOptions())[0] for file in files]
    truth = join_repetitions(clips[:4], np.random.default_rng(1))
    assert_found(find_repetitions(truth.motion, [reference]).complete, truth.spans, 0.5)
    assert find_repetitions(truth.motion).count == len(truth.spans)


def brute_p_value(values: list[float]) -> float:
    """Share of all orders with a score at least as far from 0."""

    def score(order: tuple[float, ...]) -> int:
        return int(sum(np.sign(b - a) for a, b in itertools.combinations(order, 2)))

    here = abs(score(tuple(values)))
    orders = list(itertools.permutations(values))
    return sum(abs(score(order)) >= here for order in orders) / len(orders)


@given(st.permutations(list(range(6))))
def test_the_exact_test_counts_orders(order: list[int]) -> None:
    assert estimate_trend(order).p_value == pytest.approx(brute_p_value([float(v) for v in order]))


def test_a_steady_rise_of_five_can_be_told_from_chance_and_of_four_it_cannot() -> None:
    five, four = estimate_trend([1.0, 1.2, 1.4, 1.6, 1.8]), estimate_trend([1.0, 1.2, 1.4, 1.6])
    assert five.slope == pytest.approx(0.2)
    assert five.p_value == pytest.approx(2 / math.factorial(5))
    assert five.distinguishable
    assert four.p_value == pytest.approx(2 / math.factorial(4))
    assert not four.distinguishable


def test_a_missing_value_keeps_its_place() -> None:
    found = estimate_trend([1.0, math.nan, 3.0, 4.0])
    assert found.slope == pytest.approx(1.0)
    assert found.n == 3


@pytest.mark.parametrize("values", [[], [3.0], [math.nan, 1.0]])
def test_less_than_two_values_have_no_trend(values: list[float]) -> None:
    found = estimate_trend(values)
    assert math.isnan(found.slope)
    assert not found.distinguishable


def test_chance_alone_is_called_a_trend_no_more_often_than_it_says() -> None:
    rng = np.random.default_rng(4)
    called = [estimate_trend(rng.normal(size=8)).distinguishable for _ in range(600)]
    assert np.mean(called) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 600)


def test_many_measures_of_chance_are_called_a_trend_together_in_one_recording_of_twenty() -> None:
    rng = np.random.default_rng(7)
    called = []
    for _ in range(300):
        trends = {str(measure): estimate_trend(rng.normal(size=8)) for measure in range(12)}
        called.append(any(trend.distinguishable for trend in adjust_for_many(trends).values()))
    assert np.mean(called) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 300)


def test_the_adjustment_by_hand() -> None:
    trends = {name: Trend(1.0, p, 9) for name, p in (("a", 0.01), ("b", 0.04), ("c", 0.03), ("d", math.nan))}
    adjusted = adjust_for_many(trends)
    assert [adjusted[name].adjusted_p for name in "abc"] == pytest.approx([0.03, 0.06, 0.06])
    assert math.isnan(adjusted["d"].adjusted_p)
    assert [adjusted[name].distinguishable for name in "abcd"] == [True, False, False, False]


NAN = float("nan")
KNEES = {"left_knee_flexion": 90.0, "right_knee_flexion": 90.0}
LEFT_KNEE = Fault("left_knee_flexion", "short", "lowest", 1.0, 0.8, 1.2, 60.0, 95.0, 2.0, is_clear=True)
RIGHT_KNEE = dataclasses.replace(LEFT_KNEE, angle="right_knee_flexion", degrees=62.0)
TRUNK = Fault("trunk_forward_lean", "compensation", "there", 1.0, 0.8, 1.2, 30.0, 10.0, 2.5, is_clear=True)
FAINT = dataclasses.replace(TRUNK, degrees=-4.0, expected=3.0, severity=0.7, is_clear=False)


def make_repetition(
    start_s: float,
    score: float,
    ranges: Mapping[str, float] = KNEES,
    *faults: Fault,
    seconds: float = 2.0,
    extent: float = 1.0,
) -> AssessedRepetition:
    frames = round(30 * start_s), round(30 * (start_s + seconds))
    found = Repetition(*frames, start_s, start_s + seconds, extent, extent >= 0.65)
    angles = tuple(RangeOfMotion(name, 0.0, ranges.get(name, 5.0), KNEES.get(name, 5.0)) for name in ANGLES)
    left, right = (ranges.get(f"{side}_knee_flexion", 90.0) for side in ("left", "right"))
    uneven = 200.0 * (left - right) / (left + right)
    return AssessedRepetition(found, seconds / 2.0, score, angles, {"knee_flexion": uneven}, NAN, faults=faults)


def make_exercise(repetitions: Sequence[AssessedRepetition]) -> RepetitionsAssessment:
    expected = {name: KNEES.get(name, 5.0) for name in ANGLES}
    complete = [one for one in repetitions if one.repetition.complete]
    trends = adjust_for_many({"score": estimate_trend([one.score for one in complete])})
    return RepetitionsAssessment(tuple(repetitions), tuple(KNEES), expected, 2.0, 1, trends, 30.0, 60.0)


BENT = "the left knee is bent by 60 deg at the lowest point, in the references by 95 deg"
LEANS = "compensation: the trunk leans forward by 30 deg on the way out, in the references by 10 deg"
BACK = "compensation: the trunk leans back by 4 deg on the way out, in the references by 3 deg the other way"


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ([[], []], []),
        ([[FAINT]], [f"no joint is further off than among people who do it well; furthest off: {BACK}"]),
        ([[LEFT_KNEE]], [f"repetition 1: {BENT}"]),
        ([[LEFT_KNEE]] * 4, [f"every repetition: {BENT}"]),
        ([[LEFT_KNEE]] * 4 + [[], [LEFT_KNEE]], [f"repetitions 1 to 4 and 6: {BENT}"]),
        ([[LEFT_KNEE], [LEFT_KNEE], []], [f"repetitions 1 and 2: {BENT}"]),
        ([[TRUNK, FAINT], [LEFT_KNEE]], [f"repetition 1: {LEANS}", f"repetition 2: {BENT}"]),
        (
            [[LEFT_KNEE, RIGHT_KNEE], [FAINT]],
            ["repetition 1: both knees are bent by 61 deg at the lowest point, in the references by 95 deg"],
        ),
    ],
)
def test_faults_in_words(faults: Sequence[Sequence[Fault]], said: list[str]) -> None:
    done = make_exercise([make_repetition(3 * k, 90, KNEES, *some) for k, some in enumerate(faults)])
    assert [message.render("en") for message in describe_exercise(done)][1:] == said
    poor = make_exercise([make_repetition(3 * k, 59, KNEES, *some) for k, some in enumerate(faults)])
    broken = make_exercise([make_repetition(3 * k, NAN, KNEES, *some, extent=0.5) for k, some in enumerate(faults)])
    codes = [message.code for one in (poor, broken) for message in describe_exercise(one)]
    assert "exercise_summary.as_reference" not in codes
    for message in describe_exercise(done):
        assert not set(message.render("ja")) & set("{}_")


@pytest.mark.parametrize(
    ("repetitions", "said"),
    [
        ([make_repetition(1, 91), make_repetition(4, 89)], ["grade 90 of 100 in the median (89 to 91)"]),
        (
            [make_repetition(start, 80, seconds=3.0) for start in (1, 6)],
            ["grade 80 of 100", "slower than the reference: 3.0 s in the median instead of 2.0 s"],
        ),
        (
            [make_repetition(3 * k, 70 if k == 1 else 90) for k in range(4)],
            ["grade 90 of 100 in the median (70 to 90); the weakest is repetition 2"],
        ),
        (
            [make_repetition(k, 90 if k % 2 else NAN, extent=1.0 if k % 2 else 0.1 * k) for k in range(2, 6)],
            ["grade 90 of 100", "repetitions 1 and 3: broken off, reaching 40 % of the movement at most"],
        ),
        (
            [make_repetition(3 * k, 90, extent=0.67 if k < 4 else 1.0) for k in range(5)],
            ["grade 90 of 100", "repetitions 1 to 4: reaching 67 % of the movement"],
        ),
        (
            [make_repetition(1, 80, KNEES | {"right_knee_flexion": 60.0})] * 2,
            ["grade 80 of 100", "knee flexion: the right goes 67 % as far as the left in the median"],
        ),
    ],
)
def test_the_summary_in_words(repetitions: Sequence[AssessedRepetition], said: list[str]) -> None:
    assert [message.render("en") for message in describe_exercise(make_exercise(repetitions))] == said


def find_own_faults(
    motion: CanonicalMotion, model: CanonicalMotion, n_people: int = 3, grade: float = NAN
) -> tuple[Fault, ...]:
    one, other = (
        describe_repetition(compute_postures(some), compute_joint_angles(some), 0, some.n_frames)
        for some in (motion, model)
    )
    return find_faults(one, [other], n_people, grade=grade)


def test_a_squat_that_is_not_deep_is_short_in_the_knees_and_hips_at_the_lowest_point() -> None:
    model = make_clips("squat", 1)[0]
    start = model.positions[:1]
    shallow = dataclasses.replace(model, positions=start + 0.5 * (model.positions - start))
    faults = find_own_faults(shallow, model)
    knee = next(one for one in faults if one.joint == "right_knee")
    assert (knee.kind, knee.phase, knee.angle) == ("short", "lowest", "right_knee_flexion")
    assert knee.degrees < knee.expected - 20
    assert find_own_faults(shallow, model, 1)[0].severity < faults[0].severity
    assert find_own_faults(model, model) == ()
    assert not any(one.is_clear for one in find_own_faults(shallow, model, grade=80.0))
    assert find_own_faults(shallow, model, 1, grade=60.0)[0].is_clear
    slight = dataclasses.replace(model, positions=start + 0.9 * (model.positions - start))
    said = [find_own_faults(slight, model, people, grade=60.0)[0].is_clear for people in (1, 3)]
    assert said == [False, True]  # beside one reference only what is beyond the tolerance
    # A whole file says the same: the joint, its degrees, the phase.
    little = dataclasses.replace(model, positions=start + 0.4 * (model.positions - start))
    answer = assess([model], little)
    assert answer.score < 75 and answer.events and all(event.fault for event in answer.events)
    for event in answer.events:
        assert event.fault.kind == "short" and event.fault.degrees < event.fault.expected - 20
        assert event.fault.message.render("en") in event.says.render("en")
    assert answer.to_json()["events"][0]["fault"]["phase"] in ("furthest", "lowest")
    first = str(advise(answer)[0].message)
    assert first.startswith("at 0:") and first.endswith(tuple(str(event.fault.message) for event in answer.events))
    assert assess([model], model).events == ()


def test_a_movement_is_done_well_that_is_graded_like_the_references_by_each_other() -> None:
    models = make_clips("squat", 5)

    def find(*shares: float) -> float:
        takes = [
            dataclasses.replace(one, positions=one.positions[:1] * (1.0 - share) + share * one.positions)
            for one, share in zip(models, shares, strict=False)
        ]
        shares_of_segments = np.ones(9)
        references = prepare_references([compute_postures(one) for one in takes], "same", shares_of_segments)
        return find_well(references, shares_of_segments)

    assert find(1.0) == find(1.0, 1.0, 1.0) == find(1.0, 1.0, 1.0, 1.0, 0.3) == WELL
    assert find(1.0, 0.5, 0.25) < WELL


def move_left_arm(model: CanonicalMotion, degrees: np.ndarray) -> CanonicalMotion:
    """The left arm straight, so far from hanging (T,), sideways in the room."""
    moved = model.positions.copy()
    arm, shoulder = [JOINT_INDEX[f"left_{name}"] for name in ("elbow", "wrist", "hand")], [JOINT_INDEX["left_shoulder"]]
    reach = np.linalg.norm(moved[:1, arm] - moved[:1, shoulder], axis=2, keepdims=True)
    angle = np.radians(degrees)[:, None]
    way = np.stack([np.sin(angle), -np.cos(angle), 0.0 * angle], axis=-1)
    moved[:, arm] = moved[:, shoulder] + reach * way
    return dataclasses.replace(model, positions=moved)


def test_an_arm_that_is_still_in_the_references_compensates() -> None:
    model = make_clips("squat", 1)[0]
    still, raised = np.zeros(model.n_frames), 60.0 * np.sin(np.linspace(0.0, np.pi, model.n_frames))
    faults = find_own_faults(move_left_arm(model, raised), move_left_arm(model, still))
    assert {one.joint: one.kind for one in faults} == {"left_shoulder": "compensation"}


def test_how_an_idle_arm_is_held_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    model = make_clips("squat", 1)[0]
    hanging, held = (move_left_arm(model, np.full(model.n_frames, angle)) for angle in (0.0, 80.0))
    assert assess([hanging], held).events == ()
    monkeypatch.setattr(causes, "_is_posture", lambda *_: False)
    assert [event.segments for event in assess([hanging], held).events] == [("left_upper_arm", "left_forearm")]


@pytest.mark.parametrize("angle", [*ANGLES, *(f"both_{name}" for name in PAIRED_ANGLES)])
def test_every_fault_has_words(angle: str) -> None:
    for language, degrees in itertools.product(("en", "ja"), (5.0, -5.0)):
        if degrees > 0 or not angle.endswith(("elbow_flexion", "knee_flexion", "elevation", "trunk_lean")):
            assert "fault" not in describe_fault(angle, "far", "back", degrees, 0.0).render(language)


@pytest.mark.parametrize("falls", [True, False])
def test_the_trend_is_said_if_there_is_one(falls: bool) -> None:
    scores = [95, 93, 91, 86, 84, 82, 77, 72] if falls else [90, 93, 88, 91, 90, 92, 89, 91]
    done = make_exercise([make_repetition(3 * k, score) for k, score in enumerate(scores)])
    assert describe_trends(make_exercise(done.repetitions[:2])) == ()
    (message,) = describe_trends(done)
    assert message.code == ("exercise_table.trend_points" if falls else "exercise_table.no_trend")


def test_what_is_shown_is_what_moves() -> None:
    done = make_exercise([make_repetition(1, 90)])
    assert choose_angles(done) == tuple(KNEES)
    assert choose_pair(done) == "knee_flexion"


def test_the_median_leaves_out_what_is_unknown() -> None:
    assert compute_median([1.0, NAN, 3.0]) == 2.0
    assert compute_median([NAN]) != compute_median([NAN])
