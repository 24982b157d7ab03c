"""Labels that are likely wrong and clips that are nearly the same, of made motions and of real ones."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from dousa.app.cli.main import make_application
from dousa.errors import OptionError, TrainingError
from dousa.library import CHECKED
from dousa.library.care.review import find_pairs, split_halves
from dousa.motion import Trajectories

N_PEOPLE, N_WRONG = 12, 6


@pytest.fixture(scope="module")
def made(make_clips):
    """72 clips."""
    return make_clips(N_PEOPLE, ("kick_left", "squat", "wave_right", "walk", "bow", "jump"))


def plant(library, n, seed=0):
    """Give clips wrong labels; {number: right one}."""
    clips, chance = library.clips(), np.random.default_rng(seed)
    names = sorted({clip.category for clip in clips})
    right = {}
    for place in chance.choice(len(clips), n, replace=False):
        clip = clips[place]
        right[clip.id] = clip.category
        library.relabel([clip.id], category=str(chance.choice([name for name in names if name != clip.category])))
    return right


def test_wrong_labels_come_first_with_the_right_one_beside_them(library):
    right = plant(library, N_WRONG)
    review = library.review_labels()
    assert {one.clip_id for one in review.doubts[:N_WRONG]} == set(right)
    assert all(one.suggested == right[one.clip_id] for one in review.doubts[:N_WRONG])
    assert all(one.votes > one.own_votes for one in review.doubts)
    labels = {clip.id: clip.category for clip in library.clips()}
    for one in review.doubts[:N_WRONG]:
        assert one.clip_id not in one.alike and {labels[number] for number in one.alike} == {one.suggested}
        assert {labels[number] for number in one.same} == {one.category}
    assert (review.n_judged, review.n_few, review.n_checked) == (72, 0, 0)


def test_right_labels_are_not_in_doubt_and_what_was_checked_is_not_listed(library):
    assert library.review_labels().doubts == ()
    (number,) = plant(library, 1)
    library.tag([number], add=[CHECKED])
    review = library.review_labels()
    assert (review.doubts, review.n_checked) == ((), 1)


def test_categories_of_few_clips_are_not_judged(library):
    clip = library.clips()[0].id
    library.relabel([clip], category="alone")
    review = library.review_labels()
    assert review.n_few == 1 and clip not in [one.clip_id for one in review.doubts]
    library.relabel(category="one", where_category=None, selection=[one.id for one in library.clips()])
    with pytest.raises(TrainingError):
        library.review_labels()


def test_each_half_has_half_of_every_category():
    labels = np.repeat(["a", "b", "c"], [10, 5, 3])
    halves = split_halves(labels, 4)
    for name in "abc":
        counts = halves[:, labels == name].sum(axis=1)
        assert (abs(2 * counts - (labels == name).sum()) <= 1).all()
    assert len(np.unique(halves, axis=0)) == 4
    np.testing.assert_array_equal(halves, split_halves(labels, 4))


def test_copies_are_found_and_other_repetitions_are_not(library):
    assert library.find_near_duplicates() == []
    chance, clips = np.random.default_rng(3), library.clips()[:2]
    for clip, motion in library.iterate_trajectories([one.id for one in clips]):
        noisy = motion.positions + chance.normal(0, 0.004, motion.positions.shape)
        library.add_motion(Trajectories(motion.names, noisy, motion.frame_rate), f"noisy {clip}", "copy")
        half = motion.positions[::2]
        library.add_motion(Trajectories(motion.names, half, motion.frame_rate / 2), f"slow {clip}", "copy")
    groups = library.find_near_duplicates()
    paths = {clip.id: clip.path for clip in clips}
    expected = [{paths[number], f"noisy {number}", f"slow {number}"} for number in paths]
    assert sorted(sorted(group.paths) for group in groups) == sorted(map(sorted, expected))
    assert all(0 < group.distance < 0.01 for group in groups)
    with pytest.raises(OptionError):
        library.find_near_duplicates(near=0.0)


def test_pairs_are_those_of_comparing_all():
    chance = np.random.default_rng(0)
    poses = chance.normal(size=(40, 4, 3)).astype(np.float32)
    poses[30:] = poses[:10] + chance.normal(0, 0.01, (10, 4, 3))
    durations = chance.uniform(1, 1.5, 40)
    found = {(one, other): distance for one, other, distance in find_pairs(poses, durations, 0.03)}
    far = np.sqrt(((poses[:, np.newaxis] - poses) ** 2).sum(axis=-1).mean(axis=-1))
    expected = {
        (one, other)
        for one in range(40)
        for other in range(one + 1, 40)
        if far[one, other] < 0.03 and max(durations[[one, other]]) <= 1.15 * min(durations[[one, other]])
    }
    assert set(found) == expected and expected
    assert all(found[pair] == pytest.approx(far[pair], abs=1e-5) for pair in expected)


def test_the_command_lists_them(library):
    right = plant(library, 2)
    runner = CliRunner()
    answer = runner.invoke(make_application(), ["review", library.name, "--json"])
    assert {one["clip_id"] for one in json.loads(answer.stdout)["doubts"]} == set(right)
    lines = runner.invoke(make_application(), ["review", library.name, "-k", "1"]).stdout.splitlines()
    assert "looks like" in lines[0] and lines[1:] == ["... and 1 more (see --limit)", "2 of 72 labels in doubt"]
    none = runner.invoke(make_application(), ["review", library.name, "--duplicates"])
    assert none.stdout.splitlines() == ["0 groups of clips that are nearly the same"]
