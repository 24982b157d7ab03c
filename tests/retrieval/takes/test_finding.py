"""Search inside takes: a clip is found where it is, at any tempo, and nowhere else as well."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.errors import InvalidMotionError, OptionError
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.takes import find
from dousa.retrieval.takes.find import describe_query, find_in_takes, judge_place, overlap
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips
from dousa.retrieval.takes.moment_kernels import compare_poses
from dousa.retrieval.takes.windows import TakeWindows, WindowGrid, describe_take

SET = FEATURE_SETS["extended"]
CLIPS = make_library((0, 1), 3)
FOREST = MotionForest(n_trees=40, thresholds="random", random_state=0).fit(
    np.stack([SET.compute(clip) for clip in CLIPS]), [clip.category for clip in CLIPS], feature_set=SET
)
GRID = WindowGrid((24, 32, 48, 64, 96, 128))


def describe(take):
    return describe_take(FOREST, SET, take, GRID)


def take_of(clips, seed=0, tempos=None):
    return join_clips(clips, np.random.default_rng(seed), tempos=tempos)


def span(piece):
    return piece.start / 30, piece.stop / 30


def test_a_clip_inside_a_take_is_found_at_its_place():
    clips = [make_clip("kick", 5), make_clip("bow", 0, 1, seconds=64 / 30), make_clip("wave", 5)]
    take = take_of(clips)
    found = find_in_takes(describe_query(FOREST, SET, clips[1]), [("one", describe(take))])
    assert found[0].score > 0.95
    assert overlap((found[0].start, found[0].stop), span(take.pieces[1])) > 0.7
    assert found[0].tempo == pytest.approx(1.0, abs=0.15)
    assert all(one.score < 0.5 * found[0].score for one in found[1:])


@pytest.mark.parametrize("tempo", [0.5, 2.0])
def test_other_tempos_are_found(tempo):
    clip = make_clip("raise left", 1, 0, seconds=2.0)
    take = take_of([make_clip("kick", 5), clip, make_clip("bow", 5)], tempos=[1.0, tempo, 1.0])
    found = find_in_takes(describe_query(FOREST, SET, clip), [("one", describe(take))])
    assert overlap((found[0].start, found[0].stop), span(take.pieces[1])) > 0.6
    assert found[0].tempo == pytest.approx(tempo, rel=0.3)


def test_no_answer_is_faster_or_slower_than_the_range():
    take = take_of([make_clip(category, 5) for category in ("kick", "bow", "wave", "kick", "bow")])
    for seconds in (0.8, 2.0, 4.0):
        query = describe_query(FOREST, SET, make_clip("raise left", 1, 0, seconds=seconds))
        found = find_in_takes(query, [("one", describe(take))], limit=50)
        assert found
        assert all(0.5 <= one.tempo <= 2.0 for one in found)


def test_all_takes_are_searched_and_named():
    takes = [take_of([make_clip(a, 5) for a in order]) for order in (ACTIONS, ACTIONS[::-1])]
    query = describe_query(FOREST, SET, make_clip("spread", 0))
    found = find_in_takes(query, [(str(k), describe(take)) for k, take in enumerate(takes)], limit=2)
    assert sorted(one.take for one in found) == ["0", "1"]
    for one in found:
        piece = next(p for p in takes[int(one.take)].pieces if p.category == "spread")
        assert overlap((one.start, one.stop), span(piece)) > 0.5


def test_a_category_that_was_never_trained_is_found_by_its_poses():
    some = [clip for clip in CLIPS if clip.category != "wave"]
    forest = MotionForest(n_trees=40, thresholds="random", random_state=0).fit(
        np.stack([SET.compute(clip) for clip in some]), [clip.category for clip in some], feature_set=SET
    )
    take = take_of([make_clip(action, 5) for action in ACTIONS])
    windows = describe_take(forest, SET, take, GRID)
    found = find_in_takes(describe_query(forest, SET, make_clip("wave", 0)), [("one", windows)])
    assert overlap((found[0].start, found[0].stop), span(take.pieces[-1])) > 0.5


def test_nothing_is_found_in_takes_that_are_too_short_or_in_none():
    clip = make_clip("bow", 0, seconds=2.0)
    short, one_frame = (JoinedTake(clip.positions[:n_frames], clip.height, ()) for n_frames in (30, 1))
    long = replace(clip, positions=np.concatenate([clip.positions] * 4))
    for query, takes in ((long, [("short", describe(short))]), (clip, [("frame", describe(one_frame))]), (clip, [])):
        assert find_in_takes(describe_query(FOREST, SET, query), takes) == []


def test_queries_that_cannot_be_are_refused():
    clip = make_clip("bow", 0)
    with pytest.raises(InvalidMotionError, match=r"at least 0\.27 s"):
        describe_query(FOREST, SET, replace(clip, positions=clip.positions[:7]))
    with pytest.raises(InvalidMotionError, match="finite"):
        describe_query(FOREST, SET, replace(clip, positions=clip.positions * np.nan))


def test_windows_of_another_forest_are_refused():
    windows = describe(take_of([make_clip("bow", 0)]))
    query = describe_query(FOREST, SET, make_clip("bow", 0))
    with pytest.raises(InvalidMotionError, match="another forest"):
        find_in_takes(replace(query, leaves=query.leaves[:3]), [("one", windows)])


@pytest.mark.parametrize("options", [{"limit": 0}, {"slowest": 0.0}, {"slowest": 3.0}, {"fastest": np.inf}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(OptionError, match="limit of 1 or more"):
        find_in_takes(describe_query(FOREST, SET, make_clip("bow", 0)), [], **options)


@given(st.tuples(*[st.floats(0, 1)] * 3), st.tuples(*[st.floats(0, 1)] * 3))
def test_a_place_is_the_likelier_right_the_more_speaks_for_it(one, other):
    low, high = (judge_place(*pair(one, other)) for pair in (lambda a, b: map(min, a, b), lambda a, b: map(max, a, b)))
    assert 0.0 < low <= high < 1.0
    assert judge_place(1.0, 1.0, 1.0) > 0.95
    assert judge_place(0.5, 0.0, 0.0) < 0.05


def find_slowly(query, takes, limit, most):
    """All windows of all takes compared, put in order, and looked through."""
    every = []
    for number, (_, windows) in enumerate(takes):
        lengths = windows.stops - windows.starts
        fits = (lengths >= len(query.poses) / 2 / 1.1) & (lengths <= len(query.poses) * 2 * 1.1)
        for row in np.flatnonzero(fits):
            distance = np.empty(1)
            one = slice(row, row + 1)
            compare_poses(
                windows.sums, windows.starts[one], windows.stops[one], find.cut_parts(query.poses), np.inf, distance
            )
            share = (windows.leaves[row] == query.leaves).mean()
            every.append((float(find.cost_windows(distance[0], share)), number, row, share))
    every.sort(key=lambda one: one[:3])
    kept, spans = [], []
    for _, number, row, share in every[:most]:
        span = takes[number][1].starts[row], takes[number][1].stops[row]
        if all(other != number or overlap(span, there) < 0.3 for other, there in spans):
            spans.append((number, span))
            name, windows = takes[number]
            window = {"start": windows.starts[row], "stop": windows.stops[row], "share": share}
            kept.append(find._refine(query, (name, partial(find.cut_stretch, windows)), window, (0.5, 2.0)))
    found = sorted(kept[: 2 * limit + 20], key=lambda one: (-one.score, one.take, one.start))
    return find._drop_same(found)[:limit]


@pytest.mark.parametrize("most", [25, 200, 4000])
@pytest.mark.parametrize("limit", [2, 9])
def test_takes_that_are_shown_one_after_the_other_give_the_answers_of_all_together(most, limit):
    clips = [[make_clip(ACTIONS[(k + n) % len(ACTIONS)], 3 + k, n) for n in range(3)] for k in range(6)]
    takes = [(str(k), describe(take_of(some, k))) for k, some in enumerate(clips)]
    takes.append(("again", takes[2][1]))  # equal costs
    for category in ("bow", "wave"):
        query = describe_query(FOREST, SET, make_clip(category, 0))
        expected = find_slowly(query, takes, limit, most)
        assert find_in_takes(query, takes, limit=limit, most_windows=most) == expected
        assert 2 <= len(expected) <= limit
        search = find.TakeSearch(query, limit, most_windows=most)
        for name, windows in takes:
            search.look(name, TakeWindows.from_bytes(windows.to_bytes()))
        assert search.finish(lambda number: TakeWindows.from_bytes(takes[number][1].to_bytes())) == expected
