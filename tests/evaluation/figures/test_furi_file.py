"""Furi files: every way to write a figure, and every way to write it wrong."""

from __future__ import annotations

import os
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import MotionFileError, MotionWriteError, OptionError
from dousa.evaluation import Furi, read_furi
from dousa.evaluation.figures.furi import uncovered, write_furi


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
        "31 60 A",
        "31-60 A",
        "31 - 60   A",
        "31–60 A",
        "31~60 A",
        "31,60,A",
        "31, 60, A",
        "31;60;A",
        "31\t60\tA",
        '31,60,"A"',
        "1s 2s A",
        "1.0s-2.0s A",
        "1s, 2S, A",
        "0:01 0:02 A",
        "0:01.0 - 0:02.000 A",
        "0:00:01 0:00:02 A",
        "1.0sec 0:02 A",
        "\ufeff31 60 A",
        "start,end,label\n31,60,A",
        "Start\tEnd\n31\t60\tA",
        "31 60 A\r\n\r\n# end",
    ],
)
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
        write_furi(path, furi, 29.97)
    except OptionError:
        return
    assert read_furi(path, 29.97, place) == tuple(furi)


@pytest.mark.parametrize("label", ["", " A", "a#b", "a\nb", '"A"', "A,\n", ", A", "a\0", "\ud800"])
def test_labels_that_a_file_cannot_hold(tmp_path, label):
    with pytest.raises(OptionError, match="cannot be written"):
        write_furi(tmp_path / "f", [Furi(0, 1, label)], 30.0)
    assert not list(tmp_path.iterdir())


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "dance.furi"
    write_furi(path, [Furi(0, 70, "A")], 30.0)
    before = path.read_text()
    assert (
        before == "# start-end label, frames from 1, last one included, 30 frames/s\n1-70 A  # 0:00.000 to 0:02.333\n"
    )

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(MotionWriteError, match="the disk is full"):
        write_furi(path, [Furi(0, 5, "B")], 30.0)
    assert path.read_text() == before and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(MotionWriteError):
        write_furi(tmp_path / "no folder" / "f", [Furi(0, 5, "B")], 30.0)


def test_gaps_are_told():
    furi = (Furi(5, 10, "A"), Furi(10, 20, "B"), Furi(30, 40, "C"))
    assert uncovered(furi, 50) == ((0, 5), (20, 30), (40, 50))
    assert uncovered((Furi(0, 50, "A"),), 50) == ()
    assert uncovered((), 50) == ((0, 50),)
