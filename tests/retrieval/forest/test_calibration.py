"""Telling unknown motions: scores against a slow transcription, curves, rounds, storage."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles import plain_novelty as slow
from oracles.plain_novelty import compare, fit_pose_space

from dousa.errors import DousaError, InvalidMotionError, TrainingError
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.forest.calibration import (
    Assessor,
    Calibration,
    Copies,
    _draw_rounds,
    guess_performers,
    learn_calibration,
)
from dousa.retrieval.forest.evidence import (
    EVIDENCE,
    PlacedClips,
    VoteScale,
    gather_evidence,
    learn_usual,
    relate_to_usual,
)
from dousa.retrieval.forest.forest_file import pack_arrays
from dousa.retrieval.forest.pose_space import Curve, compute_auroc, fit_curve


def make_clips(n_categories=8, n_performers=3, each=3, spread=0.4, seed=0):
    """Features (N, 4, 5), categories and performers; a category is a pattern, a performer a small habit."""
    rng = np.random.default_rng(seed)
    patterns, habits = rng.normal(size=(n_categories, 4, 5)), rng.normal(size=(n_performers, 4, 5)) * 0.2
    rows = [(c, p) for c in range(n_categories) for p in range(n_performers) for _ in range(each)]
    features = np.stack([patterns[c] + habits[p] + spread * rng.normal(size=(4, 5)) for c, p in rows])
    return features, np.array([f"c{c}" for c, _ in rows]), [f"p{p}" for _, p in rows]


FEATURES, CATEGORIES, PERFORMERS = make_clips()

KNOWN = Curve(-1.0, (2.0, 0.5, 0.5, 1.0, 1.0, 0.5, 0.0))
SPACE = fit_pose_space(FEATURES, CATEGORIES)
USUAL = np.column_stack([np.linspace(0.7, 0.9, 8), np.linspace(1.0, 2.0, 8)])
CALIBRATION = Calibration(KNOWN, KNOWN, SPACE, USUAL, 0.5, 0.9, 0.1, 0.2, 0.0, (0.0,) * 21, 1.0)


@pytest.fixture(scope="module")
def material():
    features, categories, performers = FEATURES, CATEGORIES, PERFORMERS
    kept = np.isin(categories, ["c0", "c1", "c2", "c3", "c4"])
    forest = MotionForest(30, random_state=0).fit(features[kept], categories[kept])
    people = [name for name, keep in zip(performers, kept, strict=True) if keep]
    return features, categories, kept, forest, people


class TestScores:
    def test_equal_the_slow_transcription(self, material):
        features, categories, kept, forest, _ = material
        stored = forest.apply(features[kept]).tolist()
        queries = forest.apply(features[::5])
        guess, scores, _ = Assessor(forest, CALIBRATION).scale.measure(queries)
        for leaves, number, row in zip(queries.tolist(), guess, scores, strict=True):
            votes = sorted(slow.votes_for(forest, leaves, name) for name in forest.classes_)
            name = forest.classes_[number]
            assert row[0] == pytest.approx(votes[-1])
            assert row[2] == pytest.approx(votes[-1] - votes[-2])
            company = slow.company_scores(leaves, name, stored, categories[kept].tolist())
            assert row[1] == pytest.approx(min(company, 2.0))

    def test_a_category_of_one_clip_and_a_forest_of_one_category(self):
        features, categories, _ = make_clips(3, 1, 1)
        for count in (1, 3):
            forest = MotionForest(5, random_state=0).fit(features[:count], categories[:count])
            verdicts = Assessor(forest, CALIBRATION).assess(forest.apply(features), features)
            assert np.isfinite(verdicts.known).all()

    def test_no_clips_and_leaves_that_are_not(self, material):
        assessor = Assessor(material[3], CALIBRATION)
        assert len(assessor.assess(np.zeros((0, 30), np.int32), FEATURES[:0]).known) == 0
        for leaves in (np.zeros((2, 29), int), np.full((2, 30), 10**6), np.full((2, 30), -1)):
            with pytest.raises(InvalidMotionError, match="expected leaves"):
                assessor.assess(leaves, FEATURES[:2])


class TestCurve:
    @given(
        st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.booleans()), min_size=1, max_size=40),
        st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
        st.tuples(st.floats(0, 1), st.floats(0, 1)),
    )
    @example([(0.0, 0.0, False), (0.0, 0.5, True), (1 / 32, -1.0, False)], (0.0, 0.0), (1.0, 0.0))
    @settings(max_examples=80, deadline=None)
    def test_never_falls_and_is_never_certain(self, rows, place, step):
        scores = np.array([row[:2] for row in rows])
        curve = fit_curve(scores, np.array([row[2] for row in rows]))
        low, high = curve.evaluate(np.array([place, np.add(place, step)]))
        assert 0.0 < low <= high < 1.0

    def test_finds_the_odds_that_made_the_data(self):
        rng = np.random.default_rng(0)
        scores = rng.uniform(-2, 2, size=(20000, 2))
        positive = rng.random(20000) < 1 / (1 + np.exp(-(0.5 + 1.5 * scores[:, 0] + 0.7 * scores[:, 1])))
        curve = fit_curve(scores, positive, np.ones(len(scores)), ridge=1e-3)
        assert curve.intercept == pytest.approx(0.5, abs=0.08)
        assert curve.slopes == pytest.approx((1.5, 0.7), abs=0.08)

    def test_both_sides_count_the_same_when_balanced(self):
        scores = np.r_[np.zeros((900, 1)), np.ones((100, 1))]
        positive = np.r_[np.zeros(900, bool), np.ones(100, bool)]
        middle = [fit_curve(scores, positive, each).evaluate(np.array([[0.5]]))[0] for each in (None, np.ones(1000))]
        assert middle[0] == pytest.approx(0.5, abs=0.06)  # but for the smoothed targets
        assert middle[1] < 0.35

    @given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2, max_size=30))
    def test_auroc_counts_pairs(self, rows):
        scores, positive = np.array([row[0] for row in rows], float), np.array([row[1] for row in rows])
        if positive.all() or not positive.any():
            assert compute_auroc(scores, positive) == 0.5
        else:
            assert compute_auroc(scores, positive) == pytest.approx(slow.area_under_curve(scores, positive))

    def test_the_prior_rules_where_there_is_little_to_learn(self):
        rng = np.random.default_rng(0)
        prior = Curve(0.5, (1.5, 0.7))
        few = rng.uniform(-2, 2, size=(2, 2))
        fitted = fit_curve(few, np.array([True, False]), np.ones(2), prior)
        assert fitted.slopes == pytest.approx(prior.slopes, abs=0.35)
        many = rng.uniform(-2, 2, size=(20000, 2))
        positive = rng.random(20000) < 1 / (1 + np.exp(-(-1.0 + 3.0 * many[:, 1])))
        fitted = fit_curve(many, positive, np.ones(20000), prior)
        assert fitted.slopes[0] < 0.5  # it stays a little near the prior
        assert fitted.slopes[1] > 2.0


class TestEvidence:
    def test_equals_the_slow_transcription(self, material):
        features, categories, kept, forest, _ = material
        space = fit_pose_space(features[kept], categories[kept])
        guess, scores, _ = VoteScale(forest).measure(forest.apply(features[::5]))
        evidence, places = gather_evidence(scores, PlacedClips.of(space, features[::5]), forest.classes_[guess])
        assert np.array_equal(space.categories[places], forest.classes_[guess])
        placed, own = space.place(features[kept]).tolist(), categories[kept].tolist()
        centres = {
            name: slow.middle_of([p for p, o in zip(placed, own, strict=True) if o == name]) for name in set(own)
        }
        rows = zip(evidence, space.place(features[::5]).tolist(), guess, scores.tolist(), strict=True)
        for row, place, number, (share, around, lead) in rows:
            said = dict(zip(EVIDENCE, row.tolist(), strict=True))
            cosines = {name: slow.cosine(place, centre) for name, centre in centres.items()}
            name = str(forest.classes_[number])
            assert said["typical"] == pytest.approx(cosines.pop(name))
            assert said["pose_lead"] == pytest.approx(said["typical"] - max(cosines.values()))
            far = float(np.linalg.norm(np.array(place) - np.array(centres[name])))
            assert said["near"] == pytest.approx(-np.log(far))
            assert (said["around"], said["apart"]) == (around, 0.0)
            assert said["log_share"] == pytest.approx(np.log(share + 0.02))
            assert said["log_lead"] == pytest.approx(np.log((share + 0.02) / (share - lead + 0.02)))

    def test_what_is_usual_is_learned_from_right_guesses_and_for_each_clip_without_it(self):
        rng = np.random.default_rng(0)
        values, names = rng.normal(size=(40, 2)), np.array(["a", "b", "c", "d"])
        evidence = np.zeros((40, len(EVIDENCE)))
        places = [EVIDENCE.index("typical"), EVIDENCE.index("near")]
        evidence[:, places] = values
        guess, right = names[rng.integers(0, 3, 40)], rng.random(40) < 0.7
        usual, own = learn_usual(evidence, guess, right, names)
        middle = np.median(values[right], axis=0)
        for place, name in enumerate(names):
            inside = values[right & (guess == name)]
            assert usual[place] == pytest.approx((inside.sum(axis=0) + 3 * middle) / (len(inside) + 3))
        for row in range(40):
            others = right & (guess == guess[row]) & (np.arange(40) != row)
            assert own[row] == pytest.approx((values[others].sum(axis=0) + 3 * middle) / (others.sum() + 3))
        assert usual[3] == pytest.approx(middle)  # never guessed
        related = relate_to_usual(evidence, own)
        assert related[:, places] == pytest.approx(values - own)

    def test_a_category_that_came_later_has_what_is_usual(self):
        more = CALIBRATION.with_clips(FEATURES[:4], np.repeat("new", 4))
        places = np.searchsorted(more.poses.categories, CALIBRATION.poses.categories)
        assert np.array_equal(more.usual[places], CALIBRATION.usual)
        assert more.usual[np.searchsorted(more.poses.categories, "new")] == pytest.approx([0.8, 1.5])


class TestLearning:
    def test_noise_is_not_taken_for_strangeness(self):
        """Copies of the clips show what noise does; without them known noisy motions are trusted less."""
        features, categories, performers = make_clips(12, 4, 4, spread=0.3)
        rng = np.random.default_rng(3)
        noisy = features + 0.7 * rng.normal(size=features.shape)
        test = np.array([name == "p3" for name in performers])
        forest = MotionForest(30, random_state=0).fit(features[~test], categories[~test])
        people = [name for name in performers if name != "p3"]
        again = features[~test] + 0.7 * rng.normal(size=features[~test].shape)
        said = []
        for copies in (None, Copies(np.arange(len(again)), again)):
            calibration = learn_calibration(forest, features[~test], categories[~test], people, copies=copies)
            verdicts = Assessor(forest, calibration).assess(forest.apply(noisy[test]), noisy[test])
            right = forest.classes_[verdicts.guess] == categories[test]
            said.append(abs(verdicts.confidence.mean() - right.mean()))
        assert said[1] < said[0]
        assert said[1] < 0.2

    def test_what_is_less_likely_known_than_most_of_those_held_back_is_unknown(self):
        """Categories far apart: the curves alone would call motions known that lie far from all of them."""
        features, categories, performers = make_clips(8, 4, 4, spread=0.3)
        again = features + 0.3 * np.random.default_rng(5).normal(size=features.shape)
        forest = MotionForest(30, random_state=0).fit(features, categories)
        copies = Copies(np.arange(len(again)), again)
        calibration = learn_calibration(forest, features, categories, performers, copies=copies)
        assert calibration.threshold == 0.5 < calibration.least_known <= 0.97
        assert calibration.false_alarms < 0.05
        between = 0.5 * (features[:-16] + features[16:])  # of two categories
        own, strange = (Assessor(forest, calibration).assess(forest.apply(some), some) for some in (features, between))
        alone = Assessor(forest, replace(calibration, least_known=0.0)).assess(forest.apply(between), between)
        assert own.unknown.mean() < 0.05
        limits = (strange.confidence < calibration.threshold) | (strange.known < calibration.least_known)
        assert np.array_equal(strange.unknown, limits)
        assert strange.unknown.mean() > 0.95 > (alone.confidence < 0.5).mean()
        assert strange.confidence.mean() < min(0.3, alone.confidence.mean())

    def test_what_is_known_no_more_than_hardly_any_that_was_held_back_is_hardly_known(self):
        lowest = tuple(np.round(np.arange(0.6, 1.01, 0.02), 2).tolist())
        told = replace(CALIBRATION, least_known=0.9, lowest=lowest)
        shares = np.array([0.04, 0.04, 0.08])  # of the motions held back that are known no better
        wanted = [*(shares / (shares + 0.1)), 1.0, 1.0]
        assert told.limit(np.array([0.3, 0.62, 0.76, 0.9, 0.99])) == pytest.approx(wanted)
        assert Calibration.from_bytes(told.to_bytes()).lowest == lowest

    def test_what_is_known_but_hard_to_name_is_no_stranger(self):
        """Two categories of one pattern: guesses are as often wrong as right, and no sign of a stranger."""
        clear = replace(CALIBRATION, least_known=0.8)
        known, confidence = np.array([0.95, 0.95, 0.7, 0.95]), np.array([0.9, 0.51, 0.6, 0.4])
        assert clear.is_unknown(known, confidence).tolist() == [False, False, True, True]
        assert Calibration.from_bytes(clear.to_bytes()).least_known == 0.8

    def test_what_is_likelier_known_than_gestures_without_a_name_is_perhaps_known(self):
        told = replace(CALIBRATION, least_known=0.9, least_possible=0.3)
        assert told.is_possible(np.array([0.29, 0.3, 0.31, 0.99])).tolist() == [False, False, True, True]
        again = Calibration.from_bytes(told.to_bytes())
        assert again.least_possible == 0.3

    def test_what_is_called_known_is_possible_and_so_is_some_that_is_not(self, material):
        features, categories, kept, forest, people = material
        calibration = learn_calibration(forest, features[kept], categories[kept], people)
        assert calibration.least_possible == 1.0  # features of no set, so nobody made gestures of them
        leaves = forest.apply(features)
        seen = [
            Assessor(forest, replace(calibration, least_possible=least)).assess(leaves, features)
            for least in (0.0, 0.5 * calibration.least_known, 1.0)
        ]
        assert seen[0].possible.all() and np.array_equal(seen[2].possible, ~seen[2].unknown)
        assert seen[0].possible.sum() >= seen[1].possible.sum() >= seen[2].possible.sum()
        assert all(np.array_equal(one.unknown, seen[0].unknown) for one in seen)
        assert all(one.possible[~one.unknown].all() for one in seen)

    def test_copies_are_those_of_their_rows(self):
        copies = Copies(np.array([1, 4, 6]), FEATURES[:3])
        assert copies.find(np.array([6, 0, 4])).tolist() == [1, 2]

    def test_strange_categories_are_told(self, material):
        features, categories, kept, forest, people = material
        calibration = learn_calibration(forest, features[kept], categories[kept], people)
        assessor = Assessor(forest, calibration)
        strange = assessor.assess(forest.apply(features[~kept]), features[~kept])
        own = assessor.assess(forest.apply(features[kept]), features[kept])
        assert strange.unknown.mean() > 0.8
        assert own.unknown.mean() < 0.1
        assert (strange.confidence <= strange.known).all()
        assert calibration.auroc > 0.9
        assert (forest.classes_[own.guess] == categories[kept]).all()

    def test_one_seed_gives_one_calibration_however_many_workers(self, material):
        features, categories, kept, _, people = material
        learned = [
            learn_calibration(MotionForest(20, n_jobs=jobs), features[kept], categories[kept], people)
            for jobs in (1, 2)
        ]
        assert learned[0].to_bytes() == learned[1].to_bytes()
        other = learn_calibration(MotionForest(20), features[kept], categories[kept], people, random_state=1)
        assert learned[0].to_bytes() != other.to_bytes()

    def test_two_categories_are_too_few(self):
        features, categories, _ = make_clips(2)
        with pytest.raises(TrainingError, match="at least 3 categories"):
            learn_calibration(MotionForest(5), features, categories)

    def test_one_clip_of_each_category_is_too_few(self):
        features, categories, _ = make_clips(5, 1, 1)
        with pytest.raises(TrainingError, match="too few clips"):
            learn_calibration(MotionForest(5), features, categories)

    @pytest.mark.parametrize("people", [3, 2, 1, 0])
    def test_a_round_never_trains_what_it_judges(self, people):
        _, categories, performers = make_clips(6, 3, 2)
        names = [name if int(name[1]) < people else None for name in performers]
        rounds = list(_draw_rounds(categories, names, 0))
        assert len(rounds) == 4
        for train, known, unknown in rounds:
            assert not set(categories[unknown]) & set(categories[train])
            assert set(categories[known]) <= set(categories[train])
            assert not set(train) & set(known)
            if people > 1:
                left = {names[k] for k in train} - {None}
                assert not left & {names[k] for k in known}

    def test_people_of_one_height_count_as_one(self):
        assert guess_performers([1.71, 1.73, 1.80]) == ("1.72 m", "1.72 m", "1.80 m")


class TestPoses:
    def test_the_scatter_within_categories_is_the_same_along_all_axes(self):
        features, categories, _ = make_clips(8, 5, 20)
        placed = fit_pose_space(features, categories).place(features)
        names, own = np.unique(categories, return_inverse=True)
        apart = placed - np.stack([placed[own == k].mean(axis=0) for k in range(len(names))])[own]
        scatter = apart.T @ apart / (len(apart) - len(names))
        assert np.diag(scatter).max() / np.diag(scatter).min() < 1.6  # but for the shrinking
        assert np.abs(scatter - np.diag(np.diag(scatter))).max() < 0.2

    def test_more_clips_make_new_centres_and_leave_the_axes(self):
        first = CATEGORIES != "c7"
        space = fit_pose_space(FEATURES[first], CATEGORIES[first])
        assert "c7" not in space.categories
        more = space.with_clips(FEATURES[~first], CATEGORIES[~first])
        assert (compare(more, FEATURES[~first], CATEGORIES[~first]) > 0.5).mean() > 0.9
        assert np.array_equal(
            compare(more, FEATURES[first], CATEGORIES[first]), compare(space, FEATURES[first], CATEGORIES[first])
        )

    def test_features_with_squares(self):
        kind = FEATURE_SETS["extended"]
        rng = np.random.default_rng(0)
        cells = rng.normal(size=(12, kind.n_frames, kind.n_columns))
        space = fit_pose_space(cells, np.repeat(["a", "b", "c"], 4), kind)
        assert len(space.middle) == 2 * 5 * len(kind.channels)
        with pytest.raises(InvalidMotionError, match="as in the training"):
            space.place(cells[:, :, :50])

    @pytest.mark.parametrize("categories", [["a", "b", "c"], ["a", "a", "a"]])
    def test_clips_that_are_all_alike(self, categories):
        features = np.ones((3, 4, 5))
        likeness = compare(fit_pose_space(features, np.array(categories)), features, np.array(categories))
        assert np.isfinite(likeness).all()


ARRAYS = {**CALIBRATION.poses.to_arrays(), "usual": CALIBRATION.usual}


class TestStorage:
    def test_round_trip(self):
        data = CALIBRATION.to_bytes()
        again = Calibration.from_bytes(data)
        assert again.to_bytes() == data
        assert again.to_json() == CALIBRATION.to_json()
        written = json.loads(json.dumps(again.to_json()))["known"]
        assert written["intercept"] == -1.0
        assert dict(zip(EVIDENCE, written["slopes"], strict=True))["around"] == 2.0
        assert np.array_equal(
            compare(again.poses, FEATURES, CATEGORIES), compare(CALIBRATION.poses, FEATURES, CATEGORIES)
        )

    @pytest.mark.parametrize(
        "change",
        [
            {"known": {"intercept": 0.0, "slopes": [1.0]}},
            {"known": {"intercept": float("nan"), "slopes": [1.0] * 7}},
            {"sure": {"intercept": 0.0, "slopes": [-1.0] * 7}},
            {"sure": 3},
            {"threshold": 1.5},
            {"threshold": "much"},
            {"least_known": -0.1},
            {"least_possible": 1.1},
            {"least_possible": "never"},
            {"auroc": None},
            {"lowest": [0.5] * 16},
        ],
    )
    def test_damaged_numbers(self, change):
        numbers = np.array(json.dumps({**CALIBRATION.to_json(), **change}, default=tuple))
        with pytest.raises(DousaError, match="damaged"):
            Calibration.from_bytes(pack_arrays({"numbers": numbers, **ARRAYS}))

    @pytest.mark.parametrize(
        "change",
        [
            {"layout": np.array([5], np.int64)},
            {"layout": np.array([0, 0], np.int64)},
            {"middle": np.zeros(3)},
            {"axes": np.full(CALIBRATION.poses.axes.shape, np.nan)},
            {"axes": CALIBRATION.poses.axes.astype(np.float32)},
            {"sums": CALIBRATION.poses.sums[:-1]},
            {"counts": CALIBRATION.poses.counts.astype(float)},
            {"categories": CALIBRATION.poses.categories[::-1]},
            {"categories": np.repeat("a", 8)},
            {"usual": CALIBRATION.usual[:-1]},
            {"usual": np.full(8, np.nan)},
            {"others": np.zeros((3, 1))},
            {"others": np.full_like(CALIBRATION.poses.axes[:0], np.nan).astype(np.float32)},
        ],
    )
    def test_damaged_poses(self, change):
        numbers = np.array(json.dumps(CALIBRATION.to_json()))
        with pytest.raises(DousaError, match="damaged"):
            Calibration.from_bytes(pack_arrays({"numbers": numbers, **ARRAYS, **change}))

    @given(st.integers(0, 10**6), st.integers(0, 255))
    @settings(max_examples=60, deadline=None)
    def test_a_changed_byte_is_a_number_or_an_error(self, place, byte):
        data = bytearray(CALIBRATION.to_bytes())
        data[place % len(data)] = byte
        try:
            Calibration.from_bytes(bytes(data))
        except DousaError as error:
            assert "damaged" in str(error)

    @pytest.mark.parametrize("data", [b"", b"\xff\xfe", b"[]", b"null", b"{", b"[" * 100000])
    def test_other_bytes(self, data):
        with pytest.raises(DousaError, match="the calibration: damaged or other"):
            Calibration.from_bytes(data)
