"""The learned judge: what it sees, boosted trees, errors decoded from their probabilities, and sizes of errors."""

import itertools

import numpy as np
import pytest
from oracles.wrong_dances import (
    ARM,
    EVEN,
    TOLERANCE,
    be_late,
    compare_dances,
    first_frames,
    gather_dances,
    get_dance,
    shrink_arm,
    thin,
    turn_limb,
)

from dousa.evaluation.alignment.dynamic_programming import follow_classes
from dousa.evaluation.errors.descriptors import (
    LIMB_OF,
    N_LIMBS,
    Descriptors,
    describe_moments,
    join_descriptors,
)
from dousa.evaluation.errors.deviations import Deviations, compute_deviations
from dousa.evaluation.errors.evidence import gather_evidence
from dousa.evaluation.errors.findings import Finding, measure_suspects
from dousa.evaluation.errors.judge import BODY_CLASSES, LIMB_CLASSES, BoostedTrees, Decoding, Suspect, decode
from dousa.evaluation.posture.posture import LIMBS
from dousa.motion import CanonicalMotion


def test_exported_trees_answer_as_scikit_learn_does() -> None:
    ensemble = pytest.importorskip("sklearn.ensemble")
    from lab.training.judge_trees import export_trees

    rng = np.random.default_rng(0)
    features = rng.standard_normal((600, 6)).astype(np.float32)
    classes = (features[:, 0] * features[:, 1] > 0).astype(int) + 2 * (features[:, 2] > 0.5)
    model = ensemble.HistGradientBoostingClassifier(max_iter=12, max_leaf_nodes=8).fit(features, classes)
    trees = export_trees(model)
    assert np.exp(trees.predict_log_proba(features)) == pytest.approx(model.predict_proba(features), abs=1e-5)
    again = BoostedTrees.from_arrays(trees.to_arrays("a"), "a")
    assert (again.predict_log_proba(features) == trees.predict_log_proba(features)).all()


def test_a_stump_by_hand() -> None:
    """One round, two classes, one question each: x <= 1 speaks for the first class."""
    trees = BoostedTrees(
        feature=np.zeros(6, np.uint16),
        threshold=np.array([1.0, 2.0, 0.0, 1.0, 0.0, 2.0], np.float32),
        left=np.array([1, -1, -1, 4, -1, -1], np.int32),
        right=np.array([2, -1, -1, 5, -1, -1], np.int32),
        roots=np.array([[0, 3]], np.int32),
        start=np.array([0.5, 0.0]),
    )
    logits = np.array([[2.5, 0.0], [0.5, 2.0]])
    expected = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    assert trees.predict_log_proba([[1.0], [1.1]]) == pytest.approx(expected)


RATE = 15.0
PLAIN = Decoding(change=2.0, shortest_s=0.25, surest=0.0)


def make_logs(
    limbs: dict[tuple[int, str], tuple[int, int]], body: dict[str, tuple[int, int]], n: int = 60, sure: float = 0.9
) -> tuple[np.ndarray, np.ndarray]:
    """Log probabilities where classes are sure in spans of moments and nothing is wrong elsewhere."""
    by_limb, whole = np.full((n, 5, 4), 0.02), np.full((n, 4), 0.02)
    by_limb[:, :, 0], whole[:, 0] = sure, sure
    for (limb, name), (start, end) in limbs.items():
        by_limb[start:end, limb] = 0.02
        by_limb[start:end, limb, LIMB_CLASSES.index(name)] = sure
    for name, (start, end) in body.items():
        whole[start:end] = 0.02
        whole[start:end, BODY_CLASSES.index(name)] = sure
    return np.log(by_limb), np.log(whole)


def test_an_error_has_its_span_and_limb() -> None:
    (found,) = decode(*make_logs({(1, "partial"): (10, 30)}, {}), RATE, PLAIN)
    assert (found.kind, found.start, found.end, found.limbs) == ("partial", 10, 30, (1,))
    assert found.segments == (1, 2)


def test_limbs_that_err_alike_together_are_one_error() -> None:
    logs = make_logs({(1, "shift"): (10, 30), (2, "shift"): (12, 31), (3, "partial"): (12, 31)}, {})
    both, leg = sorted(decode(*logs, RATE, PLAIN), key=lambda one: one.limbs)
    assert (both.kind, both.limbs, both.start, both.end) == ("shift", (1, 2), 10, 31)
    assert (leg.kind, leg.limbs) == ("partial", (3,))


def test_the_body_explains_limbs_but_not_another_class() -> None:
    logs = make_logs({(1, "shift"): (10, 30), (2, "partial"): (10, 30)}, {"shift": (8, 32)})
    body, limb = decode(*logs, RATE, PLAIN)
    assert (body.kind, body.limbs) == ("shift", (0, 1, 2, 3, 4))
    assert (limb.kind, limb.limbs) == ("partial", (2,))
    (only,) = decode(*make_logs({(2, "partial"): (10, 30)}, {"global": (8, 32)}), RATE, PLAIN)
    assert only.kind == "global"


def test_a_flicker_is_bridged_and_a_short_error_is_none() -> None:
    limbs, body = make_logs({(1, "partial"): (10, 30)}, {})
    limbs[20, 1] = np.log([0.6, 0.1, 0.1, 0.2])
    (found,) = decode(limbs, body, RATE, PLAIN)
    assert (found.start, found.end) == (10, 30)
    assert decode(*make_logs({(1, "partial"): (10, 13)}, {}), RATE, PLAIN) == []


@pytest.mark.parametrize(("short", "likelier"), [(0.55, "incomplete"), (0.35, "partial")])
def test_a_limb_is_short_or_elsewhere_over_its_whole_stretch(short: float, likelier: str) -> None:
    limbs, body = make_logs({(1, "partial"): (10, 30)}, {})
    limbs[10:30:2, 1] = np.log([0.02, 0.02, 0.62, 0.34])
    limbs[11:30:2, 1] = np.log([0.02, 0.02, short, 0.96 - short])
    limbs[29, 1] = np.log([0.02, 0.02, 0.1, 0.86])
    (found,) = decode(limbs, body, RATE, PLAIN)
    assert (found.kind, found.start, found.end) == (likelier, 10, 30)


def worth(course: tuple[int, ...], scores: np.ndarray, change: float) -> float:
    changes = sum(a != b for a, b in itertools.pairwise(course))
    return float(sum(scores[t, c] for t, c in enumerate(course))) - change * changes


def test_the_course_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        scores, change = rng.standard_normal((6, 3)), float(rng.uniform(0.2, 2.0))
        best = max(worth(course, scores, change) for course in itertools.product(range(3), repeat=6))
        found = tuple(int(c) for c in follow_classes(scores, change))
        assert worth(found, scores, change) == pytest.approx(best)


MOTION = get_dance()
ALL, LEFT_ARM = (0, 1, 2, 3, 4), (1,)


def measure(performance: CanonicalMotion, kind: str, start_s: float, end_s: float, limbs: tuple[int, ...]) -> Finding:
    frames = np.arange(0, performance.n_frames, 2)
    suspect = Suspect(kind, round(15 * start_s), round(15 * end_s), limbs, 1.0)
    (found,) = measure_suspects(gather_dances(performance, MOTION), [suspect], frames)
    # A shift begins and ends where it is seen to, later and earlier than where it was suspected.
    most = 9 if kind == "shift" else 2
    assert -2 <= found.start - 30 * start_s <= most and -most <= found.end - 30 * end_s <= 2
    return found


@pytest.mark.parametrize("lag_s", [-0.4, -0.2, 0.12, 0.3, 0.5])
def test_a_shift_has_its_lag(lag_s: float) -> None:
    found = measure(be_late(MOTION, lag_s, 5.0, 9.0), "shift", 5.0, 9.0, ALL)
    assert found.lag_s == pytest.approx(lag_s, abs=0.025)
    assert found.segments == tuple(range(9)) and found.shortfall is None


@pytest.mark.parametrize("gain", [0.4, 0.7])
def test_an_arm_that_is_short_lacks_range(gain: float) -> None:
    found = measure(shrink_arm(MOTION, "left", gain, 5.0, 8.0), "incomplete", 5.0, 8.0, LEFT_ARM)
    assert found.segments == LIMBS["left_arm"] and found.lag_s is None
    assert found.shortfall is not None and found.shortfall_share is not None
    assert found.shortfall_share == pytest.approx(1.0 - gain, abs=0.2)
    assert 5 * 30 - 2 <= found.worst <= 8 * 30 + 2


def test_of_a_wrong_limb_the_segments_that_are_wrong_are_named() -> None:
    found = measure(turn_limb(MOTION, [f"left_{j}" for j in ARM], 60.0, 5.0, 8.0), "partial", 5.0, 8.0, LEFT_ARM)
    assert set(found.segments) <= {1, 2} and found.segments
    assert found.severity > 2.0


def test_what_nobody_saw_is_no_error() -> None:
    theirs = thin(MOTION)
    outside = compute_deviations(theirs, theirs, np.arange(float(theirs.n_frames)) + 1e4, EVEN)
    evidence = gather_evidence(outside, TOLERANCE, 0.07, EVEN)
    suspects = [Suspect("partial", 10, 30, LEFT_ARM, 1.0)]
    assert measure_suspects(evidence, suspects, np.arange(0, theirs.n_frames, 2)) == []
    assert measure_suspects(evidence, suspects, np.arange(0)) == []


FEATURES = 25  # of a limb in one window
OWN, BEST, LAG, GAIN, PATH, UNREACHED = 0, 1, 2, 6, 13, 14
WINDOW_S = (0.5, 1.0, 2.0)


def compare(performance: CanonicalMotion) -> Deviations:
    return compare_dances(performance, MOTION)


def describe(deviations: Deviations) -> Descriptors:
    evidence = gather_evidence(deviations, TOLERANCE, 0.07, EVEN)
    return join_descriptors(describe_moments(evidence, np.zeros(len(deviations.judged)), 1, at_once=20))


def look(descriptors: Descriptors, limb: int, window: int, name: int, start_s: float, end_s: float) -> np.ndarray:
    part = (descriptors.frames >= 30 * start_s) & (descriptors.frames < 30 * end_s)
    return descriptors.limbs[part, limb, window * FEATURES + name]


def test_deviations_at_the_same_and_the_best_time_are_means_over_the_window() -> None:
    deviations = compare(turn_limb(MOTION, [f"left_{joint}" for joint in ARM], 40.0, 5.0, 8.0))
    found = describe(deviations)
    reach = 24
    columns = slice(deviations.center - reach, deviations.center + reach + 1)
    for moment in (20, 90, 97, 200):
        frame = int(found.frames[moment])
        for window, seconds in enumerate(WINDOW_S):
            half = round(0.5 * seconds * 30)
            rows = slice(max(frame - half, 0), frame + half + 1)
            for limb in range(N_LIMBS):
                squared = np.minimum(deviations.squared[rows, columns][:, :, limb == LIMB_OF], 1.3).mean(axis=(0, 2))
                priced = squared + 2e-3 / 30 * np.abs(np.arange(-reach, reach + 1))
                best = int(priced.argmin())
                row = found.limbs[moment, limb, window * FEATURES :]
                assert row[OWN] == pytest.approx(np.sqrt(squared[reach]), abs=1e-5)
                assert row[BEST] == pytest.approx(np.sqrt(squared[best]), abs=1e-5)
                assert row[LAG] == pytest.approx(abs(best - reach) / 30, abs=1e-6)


@pytest.mark.parametrize("lag_s", [-0.3, 0.25])
def test_a_lag_is_seen_in_every_limb_that_moves(lag_s: float) -> None:
    found = describe(compare(be_late(MOTION, lag_s, 5.0, 9.0)))
    lags = [np.median(look(found, limb, 1, LAG, 6.0, 8.0)) for limb in (1, 2)]
    assert lags == pytest.approx([abs(lag_s)] * 2, abs=0.04)


def test_a_smaller_arm_has_its_gain_and_leaves_part_of_the_path_unreached() -> None:
    found = describe(compare(shrink_arm(MOTION, "left", 0.5, 5.0, 8.0)))
    assert np.median(look(found, 1, 1, GAIN, 5.5, 7.5)) == pytest.approx(0.5, abs=0.15)
    assert np.median(look(found, 2, 1, GAIN, 5.5, 7.5)) == pytest.approx(1.0, abs=0.02)
    assert look(found, 1, 2, UNREACHED, 5.5, 7.5).mean() > look(found, 2, 2, UNREACHED, 5.5, 7.5).mean()


def test_who_does_as_the_reference_has_nothing_to_see() -> None:
    found = describe(compare(MOTION))
    for name in (OWN, BEST, LAG, PATH, UNREACHED):
        assert np.abs(found.limbs[:, :, [name, FEATURES + name]]).max() < 1e-6
    assert np.isfinite(found.limbs).all() and np.isfinite(found.body).all()


LASTS, SHARE_LATE = -12, -10  # of the stretch in which a moment lies, from the end of a limb's features


def test_a_moment_knows_the_whole_stretch_in_which_it_lies() -> None:
    arm = [f"left_{joint}" for joint in ARM]
    wrong = turn_limb(turn_limb(MOTION, arm, 60.0, 5.0, 7.0), arm, 60.0, 9.0, 10.0)
    found = describe(compare(wrong))
    for start, end in ((5.0, 7.0), (9.0, 10.0)):
        part = (found.frames >= 30 * start + 5) & (found.frames < 30 * end - 5)
        assert found.limbs[part, 1, LASTS] == pytest.approx(end - start, abs=0.3)
        assert not found.limbs[part, 2, LASTS].any()
    late = describe(compare(be_late(MOTION, 0.4, 5.0, 9.0)))
    assert look(late, 1, 0, SHARE_LATE, 6.0, 8.0).max() < 0.3


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_few_frames_are_enough(count: int) -> None:
    few = first_frames(thin(MOTION), count)
    found = describe(compute_deviations(few, few, np.arange(float(count)), EVEN))
    assert np.isfinite(found.limbs).all() and len(found.frames) == -(-count // 2)
