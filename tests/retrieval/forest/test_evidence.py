"""Made-up gestures: what spaces of poses and calibrations take for motions that nobody taught."""

import numpy as np
import pytest
from oracles.plain_novelty import fit_pose_space

from dousa.motion import canonicalise
from dousa.motion.synthetic import CATEGORIES, draw_performer, make_motion
from dousa.motion.synthetic.performers import make_gesture
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.forest.calibration import Assessor, learn_calibration
from dousa.retrieval.forest.evidence import EVIDENCE, describe_strangers

KIND = FEATURE_SETS["extended"]


@pytest.fixture(scope="module")
def library():
    """Six motions by six people: features, categories, and who performs."""
    rows = [(name, person) for name in CATEGORIES[:6] for person in range(6)]
    features = np.stack([KIND.compute(canonicalise(make_motion(name, draw_performer(70 + k)))) for name, k in rows])
    return features, np.array([name for name, _ in rows]), [f"p{person}" for _, person in rows]


def test_a_seed_is_a_gesture_within_what_a_body_can_do():
    for seed in range(12):
        motion, again = make_gesture(seed), make_gesture(seed)
        assert np.array_equal(motion.rotations, again.rotations)
        assert np.isfinite(motion.rotations).all() and np.isfinite(motion.translations).all()
        canonical = canonicalise(motion)
        assert 1.0 < canonical.height < 2.2
        assert 0.5 < len(canonical.positions) / canonical.frame_rate < 20
    assert not np.array_equal(make_gesture(0).rotations[:5], make_gesture(1).rotations[:5])


def test_they_are_described_as_clips_are():
    strangers = describe_strangers(KIND)
    assert strangers is not None and describe_strangers(KIND) is strangers
    assert strangers.beside.shape[1:] == strangers.asked.shape[1:] == (KIND.n_frames, KIND.n_columns)
    assert np.isfinite(strangers.beside).all() and not strangers.beside.flags.writeable
    assert strangers.beside[0] == pytest.approx(KIND.compute(canonicalise(make_gesture(0))))
    legs = describe_strangers(KIND.without(["left_hand", "right_hand"]))
    assert legs is not None and legs.asked.shape == strangers.asked.shape
    assert describe_strangers(FEATURE_SETS["paper"]) is None is describe_strangers(None)


def test_a_space_compares_with_them(library):
    features, categories, _ = library
    strangers = describe_strangers(KIND)
    space = fit_pose_space(features, categories, KIND, strangers.beside)
    assert np.linalg.norm(space.others, axis=1) == pytest.approx(np.ones(len(strangers.beside)))
    placed = space.place(np.concatenate([features[:3], strangers.beside[:2]]))
    directions = placed / np.linalg.norm(placed, axis=1, keepdims=True)
    assert space.compare_others(placed) == pytest.approx((directions @ space.others.T).max(axis=1))
    assert space.compare_others(placed)[3:] == pytest.approx([1.0, 1.0])
    more = space.with_clips(features[:2], categories[:2])
    assert np.array_equal(more.others, space.others)
    assert (fit_pose_space(features, categories, KIND).compare_others(placed) == 0).all()


def test_gestures_that_nobody_saw_are_unknown_and_own_motions_are_not(library):
    features, categories, people = library
    own = np.array([name != "p5" for name in people])
    forest = MotionForest(40, thresholds=KIND.thresholds, random_state=0)
    forest.fit(features[own], categories[own], feature_set=KIND)
    taught = [name for name, keep in zip(people, own, strict=True) if keep]
    calibration = learn_calibration(forest, features[own], categories[own], taught, feature_set=KIND)
    strange = np.stack([KIND.compute(canonicalise(make_gesture(900 + seed))) for seed in range(20)])
    assessor = Assessor(forest, calibration)
    known, other = (assessor.assess(forest.apply(some), some) for some in (features[~own], strange))
    apart = EVIDENCE.index("apart")
    assert known.evidence[:, apart].min() > np.median(other.evidence[:, apart])
    assert other.unknown.mean() > 0.8
    assert known.unknown.mean() < 0.4
    assert known.confidence.mean() > other.confidence.mean() + 0.4
