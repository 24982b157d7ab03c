"""Orders of clips, unknown motions, mirror images and reasons."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.dense_clips import NO_FEATURES, make_clips

from dousa.errors import OptionError
from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.library.search.ranking import Asked
from dousa.library.search.search import Group, rank_groups
from dousa.library.store.forests import TreeAnswers
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.canonical.canonicalise import mirror_canonical
from dousa.retrieval.forest.calibration import _PRIORS
from dousa.retrieval.ranking.ranking import RANKINGS
from made_clips import write_clip, write_clips

WHOLE = SimpleNamespace(hidden=())


def search_index(index, asked, k, by, clips):
    return rank_groups([Group(WHOLE, index, index.living, clips.read_poses)], lambda _: asked, k, by)


@pytest.mark.parametrize("by", RANKINGS)
def test_a_motion_and_its_mirror_image_are_merged(by):
    clips = make_clips(5, 60)
    index, both = clips.make_index(), [clips.ask(10), clips.ask(20, mirrored=True)]
    hits, n_alike = search_index(index, both, 60, by, clips)
    assert sorted(hit.clip_id for hit in hits) == clips.ids.tolist()
    alike: set[int] = set()
    for one in both:
        alone, _ = search_index(index, [one], 60, by, clips)
        alike |= {hit.clip_id for hit in alone if hit.alike}
        own = {hit.clip_id: hit.rank_distance for hit in alone}
        assert all(hit.rank_distance == own[hit.clip_id] for hit in hits if hit.mirrored == one.mirrored)
    assert n_alike == len(alike)


def test_nothing_is_found_among_nothing():
    clips = make_clips(6, 0)
    answers = TreeAnswers(np.array([[6 * 64, 0, 0, 0]], np.int32), np.zeros((1, 6), np.int32), clips.categories)
    asked = Asked(answers, NO_FEATURES, np.zeros((4, 3), np.float32))
    assert search_index(clips.make_index(), [asked], 3, "leaves", clips)[0] == ()


def test_an_unknown_ranking_is_refused(library):
    with pytest.raises(OptionError, match="expected fused, histogram, leaves or pose, got 'best'"):
        library.search(1, ranking="best")


KNOWN = ("walk", "squat", "clap", "jump", "kick_left")


@pytest.fixture(scope="session")
def _five_categories(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("five")
    with Library.open(folder / "five.dousa", create=True) as library:
        library.add(write_clips(folder / "in", KNOWN, 4), performer_from=r"name:(p\d)", n_jobs=1)
        report = library.train(n_trees=40)
    assert report.calibration.auroc > 0.9
    return (folder / "five.dousa").read_bytes()


@pytest.fixture
def five_categories(_five_categories, tmp_path):
    """Five of the synthetic categories by four performers."""
    path = tmp_path / "five.dousa"
    path.write_bytes(_five_categories)
    with Library.open(path) as library:
        yield library


def test_a_motion_of_no_category_is_unknown(five_categories, tmp_path):
    strangers = [write_clip(tmp_path, category, 9) for category in ("bow", "jumping_jack", "sit_down")]
    friends = [write_clip(tmp_path, category, 9) for category in KNOWN]
    answers = five_categories.classify([*strangers, *friends])
    assert [answer.category for answer in answers] == [None] * 3 + list(KNOWN)
    unknown = answers[0]
    assert unknown.verdict.confidence < 0.2
    assert unknown.verdict.confidence <= unknown.verdict.known < 0.5
    assert min(answer.verdict.known for answer in answers[3:]) > 0.5
    assert unknown.verdict.guess in unknown.histogram
    assert (unknown.to_json()["category"], unknown.to_json()["guess"]) == (None, unknown.verdict.guess)
    assert "problem" not in unknown.to_json()
    result = five_categories.search(strangers[0], 30, same_category=True)
    assert result.category is None
    assert {hit.category for hit in result.results} == {result.verdict.guess}


def test_what_was_unknown_is_known_once_it_is_added(five_categories, tmp_path):
    query = write_clip(tmp_path / "query", "bow", 9)
    assert five_categories.search(query, 1).category is None
    for number in range(4, 9):
        write_clip(tmp_path / "new", "bow", number)
    assert five_categories.add(tmp_path / "new").new_categories == ("bow",)
    assert five_categories.search(query, 1).category == "bow"
    with Library.open(five_categories.name) as again:
        assert again.search(query, 1).verdict == five_categories.search(query, 1).verdict


def test_the_threshold_can_be_given(five_categories, tmp_path):
    path = write_clip(tmp_path, "bow", 9)
    (answer,) = five_categories.classify(path, threshold=0)
    assert answer.category == answer.verdict.guess
    (answer,) = five_categories.classify(path.parent.parent, threshold=1)
    assert answer.category is None
    for question in (five_categories.classify, five_categories.search):
        with pytest.raises(OptionError, match="from 0 to 1, got 2"):
            question(path, threshold=2)


def test_a_doubtful_guess_is_told_and_is_no_category(five_categories, tmp_path):
    paths = [write_clip(tmp_path, category, 9) for category in ("bow", "jumping_jack", "sit_down", *KNOWN)]
    told = five_categories.classify(paths)
    assert not any(answer.verdict.perhaps for answer in told if answer.category)
    named = five_categories.classify(paths, threshold=0)
    assert not any(answer.verdict.perhaps for answer in named)
    # What is asked to be as sure as nothing can be stays possible where it was known.
    asked = five_categories.classify(paths, threshold=1)
    assert all(answer.category is None for answer in asked)
    assert all(answer.verdict.perhaps for answer in asked[3:])
    assert [answer.verdict.perhaps for answer in asked[:3]] == [answer.verdict.perhaps for answer in told[:3]]
    assert all(answer.to_json()["perhaps"] is answer.verdict.perhaps for answer in asked)


def test_with_few_categories_nothing_is_unknown(empty_library, moves):
    empty_library.add([moves / "wave", moves / "bow"], category_from="name:([a-z]+)")
    assert empty_library.train(n_trees=5).calibration is None
    verdict = empty_library.search(moves / "squat" / "squat_p0.bvh").verdict
    assert (verdict.known, verdict.confidence, verdict.category) == (None, None, verdict.guess)


def test_of_single_examples_poses_decide_too(empty_library, moves):
    empty_library.add(sorted(moves.glob("*/*_p0.bvh")), category_from="name:([a-z]+)")
    calibration = empty_library.train(n_trees=5).calibration
    assert calibration is not None and calibration.known == _PRIORS[0][0]
    answers = empty_library.classify(sorted(moves.glob("*/*_p[123].bvh")))
    assert [answer.verdict.guess for answer in answers] == [name for name in ("bow", "squat", "wave") for _ in range(3)]
    assert all(answer.verdict.confidence > 0 for answer in answers)


@pytest.mark.parametrize(
    ("category", "code"),
    [(r"name:_p(\d)", "only_numbers"), (r"name:_(p\d)", "not_recognised"), ("name:([a-z]+)", None)],
)
def test_sessions_for_categories_are_told(empty_library, moves, category, code):
    empty_library.add(moves, category_from=category, performer_from="none")
    doubt = empty_library.train(n_trees=10).doubt
    assert (doubt and doubt.code) == (code and f"library_training.{code}")


def test_people_for_categories_are_told(empty_library, moves):
    people = r"name:_(p\d)"
    empty_library.add(moves, category_from=people, performer_from=people)
    assert empty_library.train(n_trees=10).doubt.code == "library_training.one_person_each"


@pytest.fixture
def other_hand(write_move, tmp_path):
    """A wave with the left hand; all waves of the library are with the right."""
    wave = read_motion(write_move(tmp_path / "right.bvh", "wave", 77))
    return mirror_canonical(canonicalise(compute_trajectories(wave)))


def test_the_mirror_image_is_searched_too(library, other_hand):
    result = library.search(other_hand, 5, mirror=True)
    assert result.mirrored is not None
    assert result.mirrored.guess == "wave"
    assert result.mirrored.fits_better_than(result.verdict)
    assert [(hit.category, hit.mirrored) for hit in result.results] == [("wave", True)] * 5
    answer = json.loads(json.dumps(result.to_json()))
    assert answer["mirrored"]["fits_better"] is True
    assert answer["results"][0]["mirrored"] is True
    assert "mirrored" not in library.search(other_hand, 1).to_json()


def test_a_motion_that_fits_as_it_is_is_not_mirrored(library, moves):
    result = library.search(moves / "wave" / "wave_p0.bvh", 5, mirror=True)
    assert not any(hit.mirrored for hit in result.results)
    assert result.results == library.search(moves / "wave" / "wave_p0.bvh", 5).results
    assert not result.mirrored.fits_better_than(result.verdict)


def test_classify_mirrored(library, other_hand, moves, tmp_path):
    path = tmp_path / "left.trc"
    write_motion(other_hand.to_trajectories(), path)
    first, second = library.classify([path, moves / "wave" / "wave_p0.bvh"], mirror=True)
    assert first.mirrored.guess == "wave" and first.mirrored.fits_better_than(first.verdict)
    assert not second.mirrored.fits_better_than(second.verdict)
    (taken,), (plain,) = library.classify(path), library.classify(path, mirror=False)
    assert taken.mirrored is None is plain.mirrored
    assert taken.verdict.guess == first.mirrored.guess and [note.code for note in taken.notes] == [
        "verdict.taken_mirrored"
    ]
    assert plain.verdict.guess == first.verdict.guess and not plain.notes
    assert not library.classify(moves / "wave" / "wave_p0.bvh")[0].notes
    found = library.search(path, 5, explain=True)
    assert found.verdict.guess == "wave" == found.verdict.explanation.category and all(
        h.mirrored for h in found.results
    )
    assert found.notes == taken.notes and not any(hit.mirrored for hit in library.search(path, 5, mirror=False).results)


def test_reasons_are_given_for_the_category_and_each_hit(library, moves, tmp_path):
    path = shutil.copy(moves / "bow" / "bow_p0.bvh", tmp_path / "q.bvh")
    result = library.search(path, 3, explain=True)
    why = result.verdict.explanation
    assert why is not None and why.category == "bow" and why.reasons
    for reason in why.reasons:
        assert reason.vote_without < reason.vote_before
        assert 0 <= reason.start < reason.end <= 24 / 30 + 1e-6
    assert all(hit.likeness is not None for hit in result.results)
    answer = json.loads(json.dumps(result.to_json()))
    assert answer["explanation"]["reasons"][0]["text"] == str(why.reasons[0].text)
    assert "likeness" in answer["results"][0]
    (same,) = library.classify(path, explain=True)
    assert same.verdict.explanation == why
    assert library.search(path).verdict.explanation is None


def test_reasons_for_a_mirror_image_are_its_own(library, other_hand):
    result = library.search(other_hand, 2, mirror=True, explain=True)
    assert result.mirrored.explanation.category == "wave"
    assert result.verdict.explanation.category == result.verdict.guess
    assert all(hit.likeness.alike == pytest.approx(hit.leaf_share) for hit in result.results)
