"""Where likeness ends: which hits are alike is learned, the others follow and are told apart."""

import shutil

import numpy as np
import pytest

from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library.search.text_store import find_meanings
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.forest.likeness import Likeness, merge_votes

MOVES = ("walk", "squat", "clap", "kick_left", "kick_right", "bow", "wave_right", "jump", "march", "throw")
PEOPLE = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Ten moves of six people; kicks and claps once more under the names of another producer."""
    folder = tmp_path_factory.mktemp("alike")
    for move in MOVES:
        for number in range(PEOPLE):
            category = {"kick_left": "kickLFront1Reps", "clap": "clapHands"}.get(move, move) if number % 2 else move
            (folder / category).mkdir(exist_ok=True)
            motion = make_motion(move, draw_performer(number), seed=number)
            write_motion(motion, folder / category / f"p{number}.bvh")
    with Library.open(folder / "moves.dousa", create=True) as library:
        library.add(folder, performer_from=r"name:(p\d)", n_jobs=1)
        library.train(n_trees=50, n_jobs=1)
        yield library


def test_names_that_mean_the_same_are_one_meaning():
    names = (
        "squat1Reps", "squat", "しゃがむ", "walk/active", "walk/tired", "wave-left-hand", "wave-right-hand", "x1", "x2",
    )  # fmt: skip
    means = find_meanings(names)
    assert len({means[name] for name in names[:3]}) == 1
    assert means["walk/active"] == means["walk/tired"]
    assert len({means[name] for name in names[5:]}) == 4


def test_alike_ones_come_first_and_are_counted(made):
    query = made.clips(category="squat")[0].id
    answer = made.search(query, 60)
    flags = [hit.alike for hit in answer.results]
    assert flags == sorted(flags, reverse=True)
    assert answer.alike_count == sum(flags)
    assert {hit.category for hit in answer.results if hit.alike} == {"squat"}
    assert 3 <= answer.alike_count <= 6
    assert all(0 <= hit.probability <= 1 for hit in answer.results)
    some = [hit.clip_id for hit in answer.results[:2]]
    assert made.search(query, 60, among=some).alike_count == 2
    assert made.search(query, 60, among=[]).alike_count == 0
    clap = made.clips(category="clap")[0].id  # other names of the same are alike
    assert {hit.category for hit in made.search(clap, 60).results if hit.alike} == {"clap", "clapHands"}
    told = answer.to_json()
    assert told["alike_count"] == answer.alike_count and told["results"][0]["alike"] is True


def test_a_motion_that_is_not_there_has_nothing_alike(made):
    strange = make_motion("turn_around", draw_performer(40), seed=40)
    answer = made.search(strange, 5)
    assert len(answer.results) == 5
    assert answer.alike_count <= 2


def test_new_people_find_their_like(made):
    counts = []
    for number in range(30, 34):
        answer = made.search(make_motion("squat", draw_performer(number), seed=number), 60)
        counts.append(sum(hit.category == "squat" and bool(hit.alike) for hit in answer.results))
        assert sum(hit.category != "squat" and bool(hit.alike) for hit in answer.results) <= 2
    assert np.mean(counts) >= 4


def test_other_rankings_keep_their_order(made):
    answer = made.search(made.clips(category="squat")[0].id, 60, ranking="histogram")
    distances = [hit.distance for hit in answer.results]
    assert distances == sorted(distances)
    assert answer.results[0].alike is True


def test_new_clips_are_judged_too(made, tmp_path):
    made.close()  # all of it is in the file then
    path = shutil.copy(made.name, tmp_path / "grown.dousa")
    with Library.open(path) as library:
        library.add_motion(make_motion("squat", draw_performer(50), seed=50), "new", "squat")
        answer = library.search(library.clips(["new"])[0].id, 60)
        assert answer.alike_count >= 3
        assert answer.results[0].path == "new"


def test_a_library_without_enough_to_learn_says_nothing_of_likeness(tmp_path):
    with Library.open(tmp_path / "small.dousa", create=True) as library:
        for move in ("walk", "squat"):
            library.add_motion(make_motion(move, draw_performer(1), seed=1), move, move)
        library.train(n_trees=5)
        answer = library.search(1, 2)
    assert (answer.alike_count, [hit.alike for hit in answer.results]) == (None, [None, None])


def test_places_in_takes_are_judged(made, tmp_path):
    squat = make_motion("squat", draw_performer(3), seed=3)
    write_motion(squat, tmp_path / "take.bvh")
    answer = made.find(made.clips(category="squat")[0].id, tmp_path / "take.bvh", 5)
    assert answer.alike_count == sum(bool(place.alike) for place in answer.results)
    flags = [place.alike for place in answer.results]
    assert flags == sorted(flags, reverse=True)
    assert [place.rank for place in answer.results] == list(range(1, len(flags) + 1))
    chances = [place.probability for place in answer.results]
    assert chances == sorted(chances, reverse=True)
    assert [chance >= 0.5 for chance in chances] == flags
    nothing = made.find(made.clips(category="throw")[0].id, tmp_path / "take.bvh", 5)
    assert nothing.alike_count == 0


def test_it_is_written_and_read(made):
    with made.database.reading() as connection:
        likeness = made._forests.load(connection).likeness
    again = Likeness.from_bytes(likeness.to_bytes())
    assert again.to_bytes() == likeness.to_bytes()
    assert (again.threshold, again.curve) == (likeness.threshold, likeness.curve)
    assert 0.5 < likeness.precision <= 1 and 0.5 < likeness.recall <= 1


def test_votes_are_merged():
    votes = np.array([[0.5, 0.25, 0.25], [0.0, 1.0, 0.0]])
    assert np.array_equal(merge_votes(votes, np.array([0, 1, 0])), [[0.75, 0.25], [0.0, 1.0]])
