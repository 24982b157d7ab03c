"""Cameras in npz files, and files that are damaged, hostile or no calibration."""

import dataclasses
import os
import zipfile

import numpy as np
import pytest
from oracles.calibration_files import POSE2SIM, ROS, same_cameras, turned_view, write

from dousa.errors import CalibrationError
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.cameras.camera_files import read_cameras
from dousa.estimation.cameras.camera_formats import cameras_to_arrays


def test_the_cameras_of_the_bench(shared_data):
    path = shared_data("silhouette_bench/bd_jog_clean.npz")
    views = read_cameras(path)
    with np.load(path) as arrays:
        for index, view in enumerate(views):
            assert (view.name, view.size) == (f"view{index + 1}", (320, 240))
            np.testing.assert_allclose(view.matrix, arrays["camera_matrix"][index])
            np.testing.assert_allclose(view.rotation, arrays["world_to_camera_rotation"][index], atol=1e-9)
            image = view.project(arrays["joint_positions"][0])
            masks = np.unpackbits(arrays["mask_packed"][index, 0], axis=1).astype(bool)
            columns, rows = np.round(image).astype(int).T
            inside = (columns >= 0) & (columns < 320) & (rows >= 0) & (rows < 240)
            assert masks[rows[inside], columns[inside]].mean() > 0.8
    assert len(views) == 4


def test_arrays_round_trip(tmp_path):
    views = [
        dataclasses.replace(make_ring(1)[0], name="a b", distortion=[0.1, 0.2, 0.3, 0.4, 0.5]),
        dataclasses.replace(turned_view(), kind="orthographic"),
    ]
    np.savez(tmp_path / "cameras.npz", mask_packed=np.zeros(3), **cameras_to_arrays(views))
    same_cameras(read_cameras(tmp_path / "cameras.npz"), views, atol=1e-12)
    assert set(cameras_to_arrays(make_ring(2))) == {
        "camera_matrix", "world_to_camera_rotation", "world_to_camera_translation", "width", "height", "view_names"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_matrix": None}, "expected the array camera_matrix, got none"),
        ({"camera_matrix": np.zeros((2, 3, 3))}, "world_to_camera_rotation: expected 2 x 3 x 3 numbers, got 27"),
        ({"camera_matrix": np.zeros((3, 3, 3))}, "expected a matrix"),
        ({"camera_matrix": np.zeros((0, 3, 3))}, "expected 1 to 1000 cameras"),
        ({"camera_matrix": np.array(["a"] * 3)}, "camera_matrix"),
        ({"camera_matrix": np.array([object()] * 3)}, "not a plain numpy array"),
        ({"camera_matrix": np.zeros((200_000, 3, 3))}, "at most 1,000,000 are read"),
        ({"width": None}, "size of the image"),
        ({"width": np.array([1, 2])}, "width: expected 1 numbers, got 2"),
        ({"view_names": np.array(["a"] * 3)}, "two of 'a'"),
        ({"view_sizes": np.array([1, 2])}, "view_sizes: expected 3 x 2 numbers, got 2"),
        ({"view_names": np.array(["a"])}, "view_names: expected 3 words"),
        ({"camera_kind": np.array(["fisheye"] * 3)}, "pinhole or orthographic"),
    ],
)
def test_damaged_arrays(tmp_path, changes, message):
    arrays = {**cameras_to_arrays(make_ring(3)), **changes}
    path = tmp_path / "cameras.npz"
    np.savez_compressed(path, **{key: value for key, value in arrays.items() if value is not None})
    with pytest.raises(CalibrationError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"hello", "expected a calibration"),
        (b"\x00\x01\x02\xff" * 50, "expected a calibration"),
        (b"PK\x03\x04 and nothing", "damaged, or not an .npz file"),
        (b"<html><body/></html>", "expected a calibration"),
        (b"<html>", "incomplete XML"),
        (b"{", ":1: invalid JSON"),
        (b"[1, 2]", "expected a calibration"),
        (b'{"a": 1}', "expected a calibration"),
        (b"[cam]\nname = 'x'\n", "expected a calibration"),
        (b"%YAML:1.0\n---\n", "expected a calibration"),
        (b'{"K": ' + b"[" * 100_000, "invalid JSON|brackets without end"),
        (b"K: " + b"[" * 100_000, "brackets"),
        (b"x = " + b"[" * 100_000, "expected a calibration|brackets"),
        (b"<a>" * 100_000, "incomplete XML"),
        (b"<opencv_storage>" + b"<a>" * 1000 + b"</a>" * 1000 + b"</opencv_storage>", "too deep"),
        ("<?xml version='1.0'?><!DOCTYPE a><calibration/>".encode("utf-16"), "DOCTYPE|expected a calibration"),
        (b"K: \xff\xfe", "UTF-8"),
        (b"# " + b"x" * 6_000_000, "a file of 6 MB"),
    ],
)
def test_what_is_no_calibration(tmp_path, content, message):
    path = tmp_path / "calibration.txt"
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < 500 + len(str(path))


@pytest.mark.parametrize(
    "line", ["a" + " " * 400_000, "# " * 200_000 + '"', "'" + " #" * 200_000, '"a' * 200_000, "K: " + "[ '" * 100_000]
)
def test_long_lines_take_no_time(tmp_path, line):
    with pytest.raises(CalibrationError, match=r":2: invalid YAML|pose of the camera|expected a calibration"):
        read_cameras(write(tmp_path, f"K: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n{line}\n"))


def _npy(header, data=b""):
    text = header.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


@pytest.mark.parametrize(
    "member",
    [
        _npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000000,), }"),  # ends in all memory
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 99999999999999999999), }"),
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (3, '3', 3), }"),
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': ("),  # no whole Python
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (3.5, 3, 3), }"),
        _npy("{1: 2}"),
        b"\x93NUMPY",
        b"",
    ],
)
def test_headers_that_lie(tmp_path, member):
    path = tmp_path / "cameras.npz"
    np.savez(path, **cameras_to_arrays(make_ring(3)))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | {"view_names.npy": member}).items():
            archive.writestr(name, data)
    with pytest.raises(CalibrationError, match=r"cameras\.npz: 'view_names'"):
        read_cameras(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_damage_of_every_compression_is_said(tmp_path, method):
    path = tmp_path / "cameras.npz"
    np.savez(path, **cameras_to_arrays(make_ring(3)))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    same_cameras(read_cameras(path), make_ring(3), atol=1e-12)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        data = bytearray(whole)
        for place in rng.integers(0, len(data), 4):
            data[place] = int(rng.integers(0, 256))
        path.write_bytes(data)
        try:
            read_cameras(path)
        except CalibrationError:
            refused += 1
    assert refused > 50


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("K: &a [1, 2]\nD: *a\n", "opencv.alias", 1),
        ("a: 1\nK: *a\n", "opencv.alias", 2),
        ("K: 1\n? [a, b]\n: 2\n", "opencv.key", 2),
        ("K: " + "[" * 50 + "]" * 50, "opencv.deep", 1),
        ("K: 1\n---\n- 1\n", "opencv.no_mapping", 3),
        ("K: 1\nk: 2\nK: 3\n", "opencv.twice", 3),
    ],
)
def test_yaml_that_is_refused_with_its_line(tmp_path, text, code, line):
    with pytest.raises(CalibrationError) as caught:
        read_cameras(write(tmp_path, text))
    assert (caught.value.code, caught.value.line) == (code, line)


def test_names_do_not_break_messages(tmp_path):
    text = POSE2SIM.replace('"left"', f'"le\\n\\u001b{"x" * 10_000}"').replace("1680.0", "-1.0")
    with pytest.raises(CalibrationError, match="camera 'le  xxx") as caught:
        read_cameras(write(tmp_path, text))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500 + len(str(tmp_path))


def test_comments_and_quotes_of_yaml(tmp_path):
    text = ROS.replace("left cam   # a comment", "'left # cam' # it's a comment")
    assert read_cameras(write(tmp_path, text))[0].name == "left # cam"


def test_an_entity_bomb_is_refused(tmp_path):
    levels = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 10))
    bomb = f'<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a0 "x">{levels}]><calibration>&a9;</calibration>'
    with pytest.raises(CalibrationError, match="DOCTYPE"):
        read_cameras(write(tmp_path, bomb))


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(CalibrationError, match="no such file"):
        read_cameras(tmp_path / "none.toml")
    with pytest.raises(CalibrationError, match="file name"):
        read_cameras("a\0b")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CalibrationError, match="pipe or device"):
        read_cameras(tmp_path / "pipe")
