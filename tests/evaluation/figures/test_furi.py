"""Furi: dances joined from known figures are cut where they were joined; single gestures are not cut."""

import itertools
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.evaluation import (
    Furi,
    PostureSequence,
    compute_distance_from_space,
    compute_postures,
    estimate_yaw,
    find_furi,
    read_furi,
    rotate_yaw,
)
from dousa.evaluation.figures.furi import fit_furi_eigenspaces, format_furi, name_label, uncovered
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.errors.experiment import is_held_out

BLEND_S = 0.4


def sequence(segments: np.ndarray, rate: float = 30.0, seen: np.ndarray | None = None) -> PostureSequence:
    n = len(segments)
    seen = np.ones((n, 9), bool) if seen is None else seen
    return PostureSequence(segments, seen, np.zeros((n, 20, 3)), rate)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def takes(category: str, seed: int, count: int, rate: float) -> list[np.ndarray]:
    """Takes of a figure by one person, of about one length: each has as many rounds as the others."""
    all_takes = [make_motion(category, draw_performer(seed), k, rate) for k in range(12)]
    shortest = min(motion.n_frames for motion in all_takes)
    alike = [motion for motion in all_takes if motion.n_frames <= 1.2 * shortest]
    return [
        compute_postures(canonicalise(motion)).segments for motion in itertools.islice(itertools.cycle(alike), count)
    ]


def make_dance(
    form: str, figures: dict[str, str], seed: int, rate: float = 30.0, noise: float = 0.0
) -> tuple[PostureSequence, list[int]]:
    """Figures one after the other, each of another take, and the frames at which they meet."""
    rng = np.random.default_rng(seed)
    stock = {letter: iter(takes(figures[letter], seed, form.count(letter), rate)) for letter in set(form)}
    n_blend = int(BLEND_S * rate)
    share = np.linspace(0, 1, n_blend + 2)[1:-1, None, None]
    dance, joints = next(stock[form[0]]), [0]
    for letter in form[1:]:
        figure = next(stock[letter])
        figure = rotate_yaw(figure, estimate_yaw(dance[-n_blend:].mean(axis=0), figure[:n_blend].mean(axis=0)))
        joints.append(len(dance) - n_blend // 2)
        blend = dance[-n_blend:] * (1 - share) + figure[:n_blend] * share
        dance = np.concatenate([dance[:-n_blend], blend, figure[n_blend:]])
    dance = unit(dance + noise * rng.normal(size=dance.shape))
    return sequence(dance, rate), [*joints, len(dance)]


def check_cover(furi: tuple[Furi, ...], n_frames: int) -> None:
    assert furi[0].start == 0 and furi[-1].end == n_frames
    assert all(a.end == b.start for a, b in itertools.pairwise(furi))
    seen: list[str] = []
    for figure in furi:
        assert figure.n_frames > 0
        if figure.label not in seen:
            assert figure.label == name_label(len(seen))  # in order of appearance
            seen.append(figure.label)


@pytest.mark.parametrize("rate", [30.0, 120.0])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_dance_is_cut_where_its_figures_meet(rate, noise):
    figures = {"A": "kick_left", "B": "throw", "C": "kick_right"}
    dance, joints = make_dance("ABACB", figures, 4, rate, noise)
    furi = find_furi(dance)
    check_cover(furi, dance.n_frames)
    assert "".join(figure.label for figure in furi) == "ABACB"
    assert max(abs(f.start - joint) for f, joint in zip(furi, joints[:-1], strict=True)) <= 0.4 * rate


def test_most_joints_of_many_dances_are_found():
    pool = ["bow", "kick_left", "lunge", "punch", "throw", "squat", "turn_around", "wave_left", "jump"]
    hits = cuts = joints = agree = pairs = 0
    for seed, form in itertools.product(range(3), ["ABACB", "ABCBACA", "AABAB"]):
        names = np.random.default_rng(seed).permutation(pool)
        dance, truth = make_dance(form, dict(zip("ABC", names, strict=False)), seed)
        furi = find_furi(dance)
        check_cover(furi, dance.n_frames)
        starts = [figure.start for figure in furi[1:]]
        hits += sum(min([abs(joint - start) for start in starts], default=99) <= 15 for joint in truth[1:-1])
        cuts, joints = cuts + len(starts), joints + len(truth) - 2
        true = np.repeat(list(form), np.diff(truth))[::5]
        found = np.repeat([f.label for f in furi], [f.n_frames for f in furi])[::5]
        same, same_found = true[:, None] == true, found[:, None] == found
        agree, pairs = agree + 2 * (same & same_found).sum(), pairs + same.sum() + same_found.sum()
    assert hits / joints >= 0.8 and hits / cuts >= 0.75
    assert agree / pairs >= 0.7


def test_a_long_dance_of_few_figures_is_cut_and_named():
    form = "".join(np.random.default_rng(2).choice(list("ABCD"), 40))
    figures = {"A": "kick_left", "B": "throw", "C": "bow", "D": "wave_left"}
    dance, truth = make_dance(form, figures, 1)
    starts = [figure.start for figure in find_furi(dance)]
    found = [min(abs(joint - start) for start in starts) <= 15 for joint in truth[1:-1]]
    assert np.mean(found) >= 0.75


@pytest.mark.parametrize("category", ["bow", "kick_left", "sit_down", "throw", "punch", "lunge"])
def test_one_gesture_is_one_furi(category):
    for take in takes(category, 3, 2, 60.0):
        furi = find_furi(sequence(take, 60.0))
        assert [figure.label for figure in furi] == ["A"]


@pytest.mark.parametrize("folder", ["squat1Reps", "kickLFront1Reps", "depositFloorR"])
def test_one_gesture_of_a_real_person_is_one_furi(shared_data: Callable[[str], Path], folder):
    files = sorted(path for path in shared_data(f"hdm05/{folder}").iterdir() if not is_held_out(path.name))[:3]
    for path in files:
        assert len(find_furi(compute_postures(canonicalise(read_motion(path))))) == 1


def test_walking_goes_in_equal_pieces(shared_data: Callable[[str], Path]):
    path = min(path for path in shared_data("bandai/walk/normal").iterdir() if not is_held_out(path.name))
    postures = compute_postures(canonicalise(read_motion(path)))
    furi = find_furi(postures)
    check_cover(furi, postures.n_frames)
    labels = [figure.label for figure in furi]
    assert len(labels) > 1 and len(set(labels)) < len(labels)


def test_a_still_stretch_is_no_repetition():
    rng = np.random.default_rng(0)
    pose = unit(rng.normal(size=(9, 3)))
    still = unit(pose + 0.003 * rng.normal(size=(900, 9, 3)))
    furi = find_furi(sequence(still), max_s=30.0)
    assert [(f.start, f.end) for f in furi] == [(0, 900)]
    check_cover(find_furi(sequence(still)), 900)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 400), st.sampled_from([7.0, 25.0, 30.0, 59.94]), st.floats(0.2, 3.0), st.integers(0, 99))
def test_any_motion_is_covered_within_the_lengths(n_more, rate, min_s, seed):
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.normal(size=(1 + n_more, 9, 3)), axis=0) * 0.3
    postures = sequence(unit(steps + 0.1), rate)
    furi = find_furi(postures, min_s, 4 * min_s)
    check_cover(furi, 1 + n_more)
    if n_more + 1 >= 2 * min_s * rate:
        block = int(np.ceil(rate / 10))
        lengths = np.array([figure.n_frames for figure in furi])
        assert (lengths >= min_s * rate - block).all()
        assert (lengths <= 4 * min_s * rate + 3 * block).all()
    else:
        assert len(furi) == 1


def test_cuts_do_not_depend_on_facing_and_are_always_the_same():
    figures = {"A": "kick_left", "B": "throw", "C": "kick_right"}
    dance, _ = make_dance("ABACB", figures, 0)
    turned = sequence(rotate_yaw(dance.segments, np.array([2.0])))
    assert find_furi(dance) == find_furi(dance)
    cuts, turned_cuts = find_furi(dance), find_furi(turned)
    assert [f.label for f in cuts] == [f.label for f in turned_cuts]
    assert max(abs(a.start - b.start) for a, b in zip(cuts, turned_cuts, strict=True)) <= 1


def test_lengths_that_cannot_be_are_refused():
    postures = sequence(np.tile(np.eye(3)[1], (50, 9, 1)))
    for lengths in ((0.0, 5.0), (2.0, 3.0), (np.nan, 5.0), (1.0, np.inf), (1.0, np.nan)):
        with pytest.raises(OptionError, match="2 min_s <= max_s"):
            find_furi(postures, *lengths)
    with pytest.raises(InvalidMotionError, match="at least one frame"):
        find_furi(sequence(np.zeros((0, 9, 3))))


def test_labels_are_letters():
    assert [name_label(k) for k in (0, 1, 25, 26, 27, 51, 52, 701, 702)] == "A B Z AA AB AZ BA ZZ AAA".split()


def test_equal_figures_share_an_eigenspace():
    dance, joints = make_dance("ABAB", {"A": "kick_left", "B": "throw"}, 0)
    furi = [Furi(a, b, label) for a, b, label in zip(joints[:-1], joints[1:], "ABAB", strict=True)]
    spaces = fit_furi_eigenspaces(dance, furi)
    assert list(spaces) == ["A", "B"]
    assert spaces["A"].n_frames == furi[0].n_frames + furi[2].n_frames
    own, other = (
        compute_distance_from_space(space, space.align(dance.segments[furi[2].start : furi[2].end])).mean()
        for space in (spaces["A"], spaces["B"])
    )
    assert own < 0.5 * other
    more = {"A": dance.segments[:10], "nobody": dance.segments[:5]}
    assert fit_furi_eigenspaces(dance, furi, more=more)["A"].n_frames == spaces["A"].n_frames + 10


def test_frames_that_are_not_seen_do_not_shape_the_space():
    dance, _ = make_dance("AB", {"A": "kick_left", "B": "throw"}, 0)
    n = dance.n_frames
    seen = np.ones((n, 9), bool)
    seen[10:30, 4] = False
    broken = dance.segments.copy()
    broken[10:30, 4] = [0.0, 1.0, 0.0]
    furi = [Furi(0, n, "A")]
    space = fit_furi_eigenspaces(sequence(broken, seen=seen), furi)["A"]
    assert space.n_frames == n - 20
    nothing = fit_furi_eigenspaces(sequence(broken, seen=np.zeros((n, 9), bool)), furi)["A"]
    assert nothing.n_frames == n


@pytest.mark.parametrize("frames", [(-1, 5), (5, 5), (0, 10_000)])
def test_figures_outside_the_dance_are_refused(frames):
    postures = sequence(np.tile(np.eye(3)[1], (50, 9, 1)))
    with pytest.raises(InvalidMotionError, match="within 0 to 50"):
        fit_furi_eigenspaces(postures, [Furi(*frames, "A")])


@pytest.fixture
def furi(tmp_path):
    def read(text, frame_rate=30.0, n_frames=150):
        path = tmp_path / "dance.furi"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_furi(path, frame_rate, n_frames)

    return read


def test_the_dance_of_the_paper(furi):
    text = "# Ushibuka Haiya-bushi\n\n1-70 手振り動作1\n71-100\t回転  # turn\n101-150 手振り動作2\n"
    assert furi(text) == (Furi(0, 70, "手振り動作1"), Furi(70, 100, "回転"), Furi(100, 150, "手振り動作2"))


@pytest.mark.parametrize(
    "line",
    [
        "31 60 A", "31-60 A", "31 - 60   A", "31–60 A", "31~60 A", "31,60,A", "31, 60, A", "31;60;A", "31\t60\tA",
        '31,60,"A"', "1s 2s A", "1.0s-2.0s A", "1s, 2S, A", "0:01 0:02 A", "0:01.0 - 0:02.000 A", "0:00:01 0:00:02 A",
        "1.0sec 0:02 A", "\ufeff31 60 A", "start,end,label\n31,60,A", "Start\tEnd\n31\t60\tA", "31 60 A\r\n\r\n# end",
    ],
)  # fmt: skip
def test_all_ways_to_write_a_figure(furi, line):
    assert furi(line) == (Furi(30, 60, "A"),)


def test_labels_may_have_words_and_figures_any_order(furi):
    assert furi("71-100 big turn\n1-70 big turn\n101-150 7, left") == (
        Furi(0, 70, "big turn"),
        Furi(70, 100, "big turn"),
        Furi(100, 150, "7, left"),
    )


def test_figures_without_a_label_are_alone(furi):
    assert [f.label for f in furi("1-10\n11-20 A\n21-30\n31-40 B")] == ["C", "A", "D", "B"]


def test_the_end_of_the_dance_may_be_rounded(furi):
    assert furi("0s 5.07s") == (Furi(0, 150, "A"),)
    assert furi("1 150") == (Furi(0, 150, "A"),)


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("", None, "got no line"),
        ("# nothing\n\n", None, "got no line"),
        ("start,end,label\n", None, "got no line"),
        ("hello", 1, r"expected 'start end \[label\]'"),
        ("1-10 A\nhello world", 2, "got 'hello'"),
        ("12", 1, "got '12'"),
        ("0-10", 1, "expected frames 1 to 150, got 0 to 10"),
        ("1-151", 1, "expected frames 1 to 150, got 1 to 151"),
        ("1-99999999999999999999", 1, "expected frames 1 to 150"),
        ("1 1e9", 1, "got '1e9'"),
        ("-5 10", 1, "got '-5 10'"),
        ("nan 10", 1, "got 'nan'"),
        ("0s nans", 1, "got 'nans'"),
        ("infs 1s", 1, "got 'infs'"),
        ("0s 6s", 1, "up to 5.000 s, the end of the dance, got 6s"),
        ("0:00 1:00:00", 1, "the end of the dance, got 1:00:00"),
        ("60-31", 1, "end after the start, got 60 to 31"),
        ("2s 1s", 1, "end after the start"),
        ("1s 1s", 1, "end after the start"),
        ("1.5 3.0", 1, r"seconds are written with an s \(1.5s\)"),
        ("1 3.0s", 1, "both ends in frames or both in time"),
        ("0:61x 0:02", 1, "got '0:61x'"),
        ("1-70 A\n60-100 B", 2, "this figure and the one of line 1 overlap"),
        ("60-100 B\n# c\n1-60 A", 3, "this figure and the one of line 1 overlap"),
        ("1-70 A\n1-70 A", 2, "overlap"),
        (b"\xff\xfe1\x00 \x002\x00", None, "expected text in UTF-8"),
        (b"1-70 A\n\x00\x00", None, "zero bytes"),
        ("x" * 500, 1, r"x{40}\.\.\.'"),
        ("9" * 5000 + " 1", 1, "expected a frame"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(furi, text, line, says):
    with pytest.raises(MotionFileError, match=says) as caught:
        furi(text)
    assert caught.value.line == line


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "none", tmp_path, "a\0b"):
        with pytest.raises(MotionFileError):
            read_furi(path, 30.0, 10)
    large = tmp_path / "large"
    large.write_bytes(b"#" * 1_000_001)
    with pytest.raises(MotionFileError, match="over 1 MB"):
        read_furi(large, 30.0, 10)


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.text("0123456789s:.,- \n#AB", max_size=60).map(str.encode)))
def test_any_bytes_are_figures_or_one_error(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.furi"
    path.write_bytes(data)
    try:
        found = read_furi(path, 30.0, 100)
    except MotionFileError:
        return
    assert found and all(0 <= f.start < f.end <= 100 and f.label for f in found)
    assert all(a.end <= b.start for a, b in pairwise(found))


labels = st.one_of(st.sampled_from(["A", "hand 1", "手振り", "7", "1-2"]), st.text(min_size=1, max_size=8))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 50), st.integers(0, 20), labels), min_size=1, max_size=8))
def test_what_is_written_is_read_again(tmp_path_factory, pieces):
    path = tmp_path_factory.getbasetemp() / "again.furi"
    furi, place = [], 0
    for length, gap, label in pieces:
        furi.append(Furi(place + gap, place + gap + length, label))
        place += gap + length
    try:
        path.write_text(format_furi(furi, 29.97))
    except OptionError:
        return
    assert read_furi(path, 29.97, place) == tuple(furi)


@pytest.mark.parametrize("label", ["", " A", "a#b", "a\nb", '"A"', "A,\n", ", A", "a\0", "\ud800"])
def test_labels_that_a_file_cannot_hold(label):
    with pytest.raises(OptionError, match="cannot be written"):
        format_furi([Furi(0, 1, label)], 30.0)


def test_a_file_of_figures_is_readable():
    assert format_furi([Furi(0, 70, "A")], 30.0) == (
        "# start-end label, frames from 1, last one included, 30 frames/s\n1-70 A  # 0:00.000 to 0:02.333\n"
    )


def test_gaps_are_told():
    furi = (Furi(5, 10, "A"), Furi(10, 20, "B"), Furi(30, 40, "C"))
    assert uncovered(furi, 50) == ((0, 5), (20, 30), (40, 50))
    assert uncovered((Furi(0, 50, "A"),), 50) == ()
    assert uncovered((), 50) == ((0, 50),)
