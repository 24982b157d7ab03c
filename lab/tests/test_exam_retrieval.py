"""The exam of retrieval, where it can be wrong without anybody noticing: takes made, and answers marked."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest

MODULES = ("baseline", "marks", "material", "takes", "take_rows", "clip_rows")


@pytest.fixture
def exam() -> dict[str, ModuleType]:
    """Its modules by their names."""
    return {name: importlib.import_module(f"lab.exams.search.{name}") for name in MODULES}


@pytest.fixture
def parts(exam):
    """A clip of every made motion, each by somebody else."""
    rng = np.random.default_rng(3)
    make = exam["takes"].make_cycles
    return [(make(name, 2, rng, 0.9 + 0.05 * i), name) for i, name in enumerate(exam["takes"].MOTIONS)]


def test_clips_lie_in_a_take_where_its_truth_says_and_no_joint_leaps(exam, parts):
    takes = exam["takes"]
    turned = [
        (exam["material"].Points(takes.turn(p.positions, 1.3 * i, 2.0), p.rate), n) for i, (p, n) in enumerate(parts)
    ]
    take, truth = takes.join(turned)
    for (points, name), (start, end, told) in zip(parts, truth, strict=True):
        inside = take.cut(start, end).positions
        assert told == name and len(inside) == len(points)
        np.testing.assert_allclose(pairwise(inside), pairwise(points.positions), atol=1e-9)
    step = np.linalg.norm(np.diff(take.positions, axis=0), axis=2).max()
    assert step < 0.1 + max(np.linalg.norm(np.diff(p.positions, axis=0), axis=2).max() for p, _ in parts)
    headings = [takes.heading(take.positions[round(t[0] * take.rate)]) for t in truth]
    assert np.ptp(headings) < 0.2


def pairwise(positions):
    return np.linalg.norm(positions[:, :, None] - positions[:, None], axis=3)


def test_a_quicker_clip_is_shorter_by_its_tempo(exam, parts):
    points = parts[0][0]
    quick = points.at_rate(30.0, tempo=1.4)
    assert len(quick) == pytest.approx(len(points) / 1.4, abs=1.5)
    np.testing.assert_allclose(quick.positions[5], points.positions[7], atol=1e-9)


def test_a_bad_sensor_is_as_bad_as_it_is_said_to_be(exam, parts):
    points = exam["takes"].join(parts)[0]
    bad = exam["material"].disturb(points, np.random.default_rng(0))
    lost = np.isnan(bad.positions).all(axis=2)
    assert bad.rate == 15 and lost.mean() == pytest.approx(0.05, abs=0.003)
    off = bad.positions - points.at_rate(15.0).positions
    assert np.nanstd(off) == pytest.approx(0.03, rel=0.03)


def test_the_made_figure_repeats_itself_as_often_as_its_truth_says(exam):
    take, truth = exam["takes"].draw_made(np.random.default_rng(1))
    away = [exam["take_rows"].plain_count(take.cut(t[0], t[1])) - t[3] for t in truth]
    assert {t[2] for t in truth} == set(exam["takes"].MOTIONS) and np.mean(np.abs(away) <= 1) == 1


@pytest.fixture
def truth(exam, parts):
    return exam["takes"].join(parts)[1]


def tell(truth, names, confidence=1.0):
    return [(start, end, name, confidence) for (start, end, _), name in zip(truth, names, strict=True)]


def test_a_perfect_answer_has_full_marks_and_a_shuffled_one_none(exam, truth):
    marks = exam["marks"]
    names = [t[2] for t in truth]
    for told, share in ((tell(truth, names), 1.0), (tell(truth, names[1:] + names[:1]), 0.0)):
        right, there, called, rest = marks.frames(truth, told, truth[-1][1] + 2)
        assert marks.f_measure([marks.match(truth, told)]) == share
        assert right / there == share and called == 0 and rest > 0
        assert {r for _, r in marks.named_right(truth, told) + marks.placed_right(truth, told)} == {share == 1}
    assert marks.f_measure([marks.match(truth, [])]) == 0


def test_one_segment_answers_one_action_and_only_where_half_of_both_is_common(exam):
    marks = exam["marks"]
    truth = [(0.0, 2.0, "a"), (3.0, 5.0, "a")]
    assert list(marks.match(truth, [(0.0, 5.0, "a", 1)])) == [0, 2, 1]
    assert list(marks.match(truth, [(0.0, 1.9, "a", 1), (0.1, 2.0, "a", 1)])) == [1, 2, 2]


def test_where_labels_overlap_the_shorter_counts(exam):
    names = exam["marks"].at_times([(2.0, 3.0, "short"), (0.0, 9.0, "long")], np.array([1.0, 2.5, 9.5]))
    assert list(names) == ["long", "short", None]


def test_confidences_that_hold_have_no_error_and_bold_ones_do(exam):
    marks = exam["marks"]
    right = [(0.75, i % 4 > 0) for i in range(40)]
    assert marks.calibration_error(right) == pytest.approx(0, abs=1e-9)
    assert marks.calibration_error([(1.0, r) for _, r in right]) == pytest.approx(0.25)
    assert 0 < marks.luck(right) < 0.1
    assert (marks.auroc([0.9, 0.8], [0.1]), marks.auroc([0.5], [0.5]), marks.auroc([0.1], [0.2])) == (1, 0.5, 0)


def test_counts_are_those_of_the_segment_that_overlaps_most(exam):
    truth = [(0.0, 4.0, "a", 3), (5.0, 9.0, "b", 2)]
    told = [(0.0, 3.5, "a", 1, 4), (3.5, 4.0, "a", 1, 1), (5.0, 9.0, "a", 1, 2)]
    assert exam["marks"].counted(truth, told) == [1, None]


def test_what_is_found_by_words_is_marked_by_what_is_relevant(exam):
    mark = exam["marks"].retrieved
    assert mark("abx", "ab", "x") == (1, 1, 1) and mark("xy", "ab", "x") == (0, 0, 0)
    assert mark("", "") == (1, 1, 1) and mark("a", "") == (0, 0, 0)


def test_what_means_the_same_means_it_both_ways_and_is_no_matter_of_opinion(exam):
    material = exam["material"]
    groups = material.SAME + material.UNCLEAR
    keys = {k for group in groups for k in group}
    for a in keys:
        assert material.mean_same(a, a)
        assert all(material.mean_same(a, b) is material.mean_same(b, a) for b in keys)
    for group in material.SAME:
        assert len({k.split(":")[0] for k in group}) == len(group)
    assert material.relate("utd:jog", "run", {"bandai:run"}) is True
    assert material.relate("utd:jog", "squat1Reps", {"hdm05:squat1Reps"}) is False


def test_the_baseline_knows_its_own_clips_and_finds_them_in_a_take(exam, parts):
    rng = np.random.default_rng(5)
    make = exam["takes"].make_cycles
    clips = [(make(name, 2, rng, 1 + 0.1 * i), name, str(i)) for i in range(3) for _, name in parts]
    nearest = exam["baseline"].Nearest(clips)
    assert [nearest.classify(points)[0] for points, _, _ in clips] == [name for _, name, _ in clips]
    take, truth = exam["takes"].join([clip[:2] for clip in clips[: len(parts)]])
    found = [nearest.find(points, [take])[1:3] for points, _, _ in clips[: len(parts)]]
    assert all(exam["marks"].overlap(place, t) > 0.5 for place, t in zip(found, truth, strict=True))
