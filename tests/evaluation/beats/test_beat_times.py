"""Beats files as common programs write them, and lines that are none."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.errors import MotionFileError
from dousa.evaluation import read_beats

EXPECTED = [0.5, 1.0, 1.5, 2.0, 2.5]


@pytest.mark.parametrize(
    "text",
    [
        "0.5\n1.0\n1.5\n2\n2.5\n",
        "time\n0.5\n1.0\n1.5\n2\n2.5\n",
        "# beats of a song\n\n0.5\n1.0\n\n1.5\n2\n2.5",
        "TIME,LABEL\r\n0.5,1\r\n1.0,2\r\n1.5,3\r\n2.0,4\r\n2.5,1\r\n",
        '"0.5";"1"\n"1.0";"2"\n"1.5";"3"\n"2.0";"4"\n"2.5";"1"\n',
        "0.500000\t0.500000\t1\n1.0\t1.0\t2\n\\\t100.0\t2000.0\n1.5\t1.5\t3\n2.0\t2.0\t4\n2.5\t2.5\tlast beat\n",
        "0.50 1\n1.00 2\n1.50 3\n2.00 4\n2.50 1\n",
        "\ufeff0.5\n1.0\n1.5\n2\n25e-1\n",
    ],
)
def test_beats_are_read(tmp_path, text):
    (tmp_path / "beats.csv").write_bytes(text.encode("utf-8"))
    np.testing.assert_allclose(read_beats(tmp_path / "beats.csv").times, EXPECTED)


@pytest.mark.parametrize(
    ("content", "code", "line"),
    [
        (b"", "beats.too_few", None),
        (b"time\n", "beats.too_few", None),
        (b"0.5\nsoon\n", "beats.no_time", 2),
        (b"one\ntwo\nthree\n", "beats.no_time", 2),
        (b"time\n0.5\nnan\n", "beats.no_time", 3),
        (b"0.5\n1\n1.5\ninf\n", "beats.no_time", 4),
        (b"0.5\n1.5\n1\n2\n", "beats.unsorted", None),
        (b"RIFF\x00\x00\x00WAVE", "small_text.zero_bytes", None),
        (b"\xff\xfe\x30", "small_text.not_utf8", None),
    ],
)
def test_files_that_are_no_beats(tmp_path, content, code, line):
    path = tmp_path / "beats.csv"
    path.write_bytes(content)
    with pytest.raises(MotionFileError) as caught:
        read_beats(path)
    assert (caught.value.code, caught.value.line) == (code, line)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(MotionFileError):
        read_beats(tmp_path / "none.csv")
