"""Time offsets go through their file, and mistakes in it are said."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.errors import CalibrationError
from dousa.estimation import Synchronisation, read_offsets, write_offsets

FOUND = Synchronisation(
    np.array([0.0, -1.25, 0.0333]),
    np.array([0.0, 0.002, 0.004]),
    ("reference", "movement", "both"),
    (0, 0, 0),
    np.array([0.0, np.nan, 0.03]),
    0.2,
)


def test_offsets_are_read_by_name(tmp_path):
    path = tmp_path / "sync.toml"
    write_offsets(path, ['le"ft', "front", "cam 03"], FOUND)
    assert read_offsets(path, ["cam3", 'le"ft']) == [0.0333, 0.0]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[[film]\n", "sync_file.toml"),
        ("offset = 1\n", "sync_file.no_films"),
        ("[[film]]\noffset = 1\n", "sync_file.no_films"),
        ('[[film]]\nname = "a"\n', "sync_file.offset"),
        ('[[film]]\nname = "a"\noffset = nan\n', "sync_file.offset"),
        ('[[film]]\nname = "a"\noffset = true\n', "sync_file.offset"),
        ('[[film]]\nname = "b"\noffset = 1\n', "camera.none_for_view"),
    ],
)
def test_mistakes_name_the_file(tmp_path, text, code):
    path = tmp_path / "sync.toml"
    path.write_text(text)
    with pytest.raises(CalibrationError) as caught:
        read_offsets(path, ["a"])
    assert caught.value.code == code and str(caught.value).startswith(str(path))


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(CalibrationError, match=r"none\.toml"):
        read_offsets(tmp_path / "none.toml", ["a"])
