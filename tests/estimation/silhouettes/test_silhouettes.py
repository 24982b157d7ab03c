"""Silhouettes in memory, in npz files and in folders of images; views on one clock."""

import io
import os
import tracemalloc
import zipfile

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dousa.errors import CalibrationError, DousaError, MotionWriteError, OptionError, SilhouetteError
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.cameras.camera_files import read_cameras
from dousa.estimation.silhouettes.images import MaskFolder
from dousa.estimation.silhouettes.mask_npz import read_silhouettes, read_stature, read_true_joints, write_silhouettes
from dousa.estimation.silhouettes.silhouette_files import open_silhouettes
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes, View, synchronise
from dousa.files.frame_files import number_frames


def _masks(n_views=2, n_frames=3, height=12, width=21, seed=0):
    return np.random.default_rng(seed).random((n_views, n_frames, height, width)) < 0.4


def _camera(width, height, name="a"):
    matrix = [[100.0, 0, width / 2], [0, 100.0, height / 2], [0, 0, 1]]
    return Camera(name, width, height, np.array(matrix), np.eye(3), np.array([0.0, 1.0, 3.0]), np.full(5, 0.01))


def _save(path, **members):
    np.savez_compressed(path, **members)
    return path


@given(arrays(bool, st.tuples(*[st.integers(1, 4)] * 2, *[st.integers(1, 19)] * 2)))
@settings(max_examples=50, deadline=None)
def test_packing_loses_nothing(masks):
    packed = PackedSilhouettes(masks, 30.0)
    assert packed.n_views, packed.n_frames == masks.shape[:2]
    for frame in range(packed.n_frames):
        for mask, expected in zip(packed.read(frame), masks[:, frame], strict=True):
            assert mask.dtype == bool
            np.testing.assert_array_equal(mask, expected)


def test_views_may_differ_in_size_and_length():
    one, other = _masks(1, 5)[0], _masks(1, 3, 8, 9)[0]
    packed = PackedSilhouettes([one, other], 30, names=("left", "right"))
    assert packed.sizes == ((21, 12), (9, 8)) and packed.n_frames == 3 and packed.names == ("left", "right")
    assert "5, 3 frames" in str(packed.warnings[0])


def test_missing_frames_are_none():
    packed = PackedSilhouettes(_masks(), 30, missing=[[False, True, False], [False, False, False]])
    assert packed.read(1)[0] is None and packed.read(1)[1] is not None


@pytest.mark.parametrize("frame", [-1, 3, 1.5, "a"])
def test_frames_that_are_not_there(frame):
    with pytest.raises(SilhouetteError, match="expected a"):
        PackedSilhouettes(_masks(), 30).read(frame)


@pytest.mark.parametrize(
    ("masks", "rate", "names"),
    [
        ([], 30, None), (np.zeros((2, 0, 4, 4), bool), 30, None), (np.zeros((2, 3, 4), bool), 30, None),
        (_masks(), 0, None), (_masks(), float("nan"), None), (_masks(), "fast", None), (_masks(), 30, ("one",)),
        ([np.full((2, 3, 3), "x")], 30, None),
    ],
)  # fmt: skip
def test_masks_that_are_none(masks, rate, names):
    with pytest.raises(SilhouetteError):
        PackedSilhouettes(masks, rate, names)


def test_written_sequence_comes_back(tmp_path):
    path = tmp_path / "walk.npz"
    masks = _masks()
    cameras = [_camera(21, 12, "left"), _camera(21, 12, "right")]
    positions = np.arange(18.0).reshape(3, 2, 3)
    write_silhouettes(path, masks, cameras, 25.0, stature=1.7, truth=(("hip", "knee"), positions))
    back = read_silhouettes(path)
    assert back.names == ("left", "right") and back.frame_rate == 25 and back.warnings == ()
    for frame in range(3):
        np.testing.assert_array_equal(np.stack(back.read(frame)), masks[:, frame])
    assert read_stature(path) == 1.7
    names, read = read_true_joints(path)
    assert names == ("hip", "knee")
    np.testing.assert_array_equal(read, positions)
    with np.load(path) as file:
        np.testing.assert_array_equal(file["mask_packed"], np.packbits(masks, axis=3))
        np.testing.assert_array_equal(file["camera_matrix"], [camera.matrix for camera in cameras])
    again = read_cameras(path)
    assert [camera.name for camera in again] == ["left", "right"]
    np.testing.assert_array_equal(again[0].distortion, np.full(5, 0.01))
    assert os.listdir(tmp_path) == ["walk.npz"]


def test_views_of_other_sizes_and_missing_frames_are_written(tmp_path):
    path = tmp_path / "walk.npz"
    views = [_masks(1, 3)[0], _masks(1, 3, 30, 9)[0]]
    source = PackedSilhouettes(views, 30, missing=[[False, True, False], [False] * 3])
    seen = []
    write_silhouettes(path, source, progress=lambda done, total, what: seen.append((done, total)))
    back = read_silhouettes(path)
    assert back.sizes == ((21, 12), (9, 30)) and back.read(1)[0] is None
    np.testing.assert_array_equal(back.read(2)[1], views[1][2])
    np.testing.assert_array_equal(back.read(2)[0], views[0][2])
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_what_cannot_be_written(tmp_path):
    path = tmp_path / "walk.npz"
    with pytest.raises(SilhouetteError, match="frame rate"):
        write_silhouettes(path, _masks())
    with pytest.raises(CalibrationError, match="1 camera for 2 views"):
        write_silhouettes(path, _masks(), [_camera(21, 12)], 30)
    with pytest.raises(CalibrationError, match="expected a camera for 21 x 12 pixels"):
        write_silhouettes(path, _masks(), [_camera(42, 24)] * 2, 30)
    with pytest.raises(SilhouetteError, match="joint positions"):
        write_silhouettes(path, _masks(), None, 30, truth=(("hip",), np.zeros((2, 1, 3))))
    with pytest.raises(MotionWriteError, match="folder does not exist"):
        write_silhouettes(tmp_path / "no" / "walk.npz", _masks(), None, 30)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("key", ["mask", "masks"])
@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_plain_masks_are_read(tmp_path, key, dtype):
    masks = _masks(2)
    path = _save(tmp_path / "a.npz", **{key: (masks * 255).astype(dtype), "frame_rate": 50})
    back = read_silhouettes(path)
    assert back.frame_rate == 50 and back.n_views == 2
    np.testing.assert_array_equal(np.stack(back.read(2)), masks[:, 2])


def test_one_view_is_named_after_its_file_and_its_rate_assumed(tmp_path):
    masks = _masks(1)[0]
    path = _save(tmp_path / "clap.npz", mask_packed=np.packbits(masks, axis=2), width=21, height=12)
    back = read_silhouettes(path)
    assert back.names == ("clap",) and back.frame_rate == 30 and "30 Hz is assumed" in str(back.warnings[0])
    assert read_silhouettes(path, 60).frame_rate == 60
    assert read_stature(path) is None and read_true_joints(path) is None


def _packed_file(tmp_path, **changes):
    members = {"mask_packed": np.packbits(_masks(), axis=3), "width": 21, "height": 12, "frame_rate": 30.0}
    members |= changes
    return _save(tmp_path / "bad.npz", **{key: value for key, value in members.items() if value is not None})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": 99}, "pack along the width"),
        ({"height": 13}, "13 rows"),
        ({"width": -5}, "expected a width"),
        ({"width": 10**12}, "expected a width"),
        ({"width": None}, "'width'"),
        ({"frame_rate": 0.0}, "frame rate"),
        ({"frame_rate": np.array("fast")}, "frame_rate"),
        ({"mask_packed": np.zeros((2, 3), np.uint8)}, "expected the axes"),
        ({"mask_packed": np.zeros((0, 3, 12, 3), np.uint8)}, "at least one"),
        ({"mask_packed": np.zeros((2, 3, 12, 3), np.int32)}, "uint8"),
        ({"mask_packed": None}, "expected an array"),
        ({"mask_packed": None, "mask": np.array([["a"]], object)}, "not a plain numpy array"),
        ({"mask_packed": None, "mask": np.array([[["a"]]])}, "bool or numbers"),
        ({"view_names": np.array(["one"])}, "view_names"),
        ({"view_sizes": np.array([[99, 12], [21, 12]])}, "view_sizes"),
        ({"present": np.ones((1, 3), bool)}, "present"),
    ],
)
def test_files_that_disagree_with_themselves(tmp_path, changes, words):
    with pytest.raises(SilhouetteError, match=words) as caught:
        read_silhouettes(_packed_file(tmp_path, **changes))
    assert "bad.npz" in str(caught.value) and "\n" not in str(caught.value)


def _with_header(path, header, data=b""):
    """An npz whose only mask array has a header of our own making."""
    text = header.encode().ljust(118) + b"\n"
    member = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mask.npy", member)
    return path


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '|b1', 'fortran_order': False, 'shape': (1000000, 1000000, 1000000), }",
        "{'descr': '|b1', 'fortran_order': False, 'shape': (99999999999999999999, 2, 2), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1, 2, 2), }",
        "{'descr': '|b0', 'fortran_order': False, 'shape': (100000000, 2, 2), }",
        "{'descr': '<f9', 'fortran_order': False, 'shape': (1, 2, 2), }",
        "__import__('os')",
    ],
)
def test_headers_that_lie(tmp_path, header):
    with pytest.raises(SilhouetteError):
        read_silhouettes(_with_header(tmp_path / "a.npz", header, b"\0" * 4))


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    shape = (40_000, 800, 100)
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(118) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("mask_packed.npy", "w", force_zip64=True) as member:
            member.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
            member.write(b"")
        for name, value in (("width", 800), ("height", 800)):
            with archive.open(f"{name}.npy", "w") as member:
                np.save(member, np.array(value))
    with pytest.raises(SilhouetteError, match="declares"):
        read_silhouettes(path)


def test_masks_of_nobody_do_not_fill_the_memory(tmp_path):
    path = tmp_path / "bomb.npz"
    shape = (2_600, 800, 100)
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(118) + b"\n"
    zeros, deflate = bytes(1_000_000), zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(path, "w", deflate) as archive:
        with archive.open("mask_packed.npy", "w", force_zip64=True) as member:
            member.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
            left = int(np.prod(shape))
            while left:
                left -= member.write(zeros[:left])
        for side in ("width", "height"):
            with archive.open(f"{side}.npy", "w") as member:
                np.save(member, np.array(800))
    tracemalloc.start()
    with pytest.raises(SilhouetteError, match="no person"):
        read_silhouettes(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20_000_000


@pytest.mark.parametrize("make", [lambda p: None, lambda p: p.mkdir(), lambda p: p.write_bytes(b"")])
def test_what_is_no_file(tmp_path, make):
    path = tmp_path / "a.npz"
    make(path)
    with pytest.raises(SilhouetteError, match=r"a\.npz"):
        read_silhouettes(path)


def test_the_bench_is_read(shared_data):
    path = shared_data("silhouette_bench/bd_jog_clean.npz")
    read = read_silhouettes(path)
    with np.load(path) as file:
        masks = np.unpackbits(file["mask_packed"], axis=3, count=320).view(bool)
    assert read.sizes == ((320, 240),) * 4 and read.n_frames == masks.shape[1] and read.frame_rate == 30
    np.testing.assert_array_equal(np.stack(read.read(7)), masks[:, 7])
    assert 1.5 < read_stature(path) < 2 and read_true_joints(path)[1].shape[0] == read.n_frames


def test_kinect_silhouettes_are_read(shared_data):
    folder = shared_data("utd_mhad/silhouette/arm_cross")
    path = sorted(folder.glob("*.npz"))[0]
    read = read_silhouettes(path)
    assert read.sizes == ((320, 240),) and read.read(0)[0].any()


# Folders of images


def _write_images(folder, images, name="frame_{:04d}.png", first=1):
    folder.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images, first):
        if image is not None:
            assert cv2.imwrite(str(folder / name.format(number)), image)
    return folder


def _grey(masks):
    return [mask.astype(np.uint8) * 255 for mask in masks]


@pytest.mark.parametrize("ending", ["png", "bmp", "tif", "jpg"])
def test_a_folder_of_images(tmp_path, ending):
    masks = np.kron(_masks(1, 3)[0], np.ones((1, 8, 8))).astype(bool)  # blocks, so that JPEG keeps them
    view = MaskFolder(_write_images(tmp_path / "left", _grey(masks), f"{{}}.{ending}"), 30)
    assert view.name == "left" and view.n_frames == 3 and not view.warnings
    for frame in range(3):
        assert (view.read(frame) == masks[frame]).mean() > 0.99


@pytest.mark.parametrize(
    "make",
    [
        lambda m: m.astype(np.uint8),  # labels 0 and 1
        lambda m: m.astype(np.uint8) * 3,
        lambda m: m.astype(np.uint16) * 65535,
        lambda m: m.astype(np.uint16) * 255,
        lambda m: m.astype(np.uint16),
        lambda m: np.dstack([m * 255] * 3).astype(np.uint8),
        lambda m: np.dstack([m * 0, m * 0, m * 255]).astype(np.uint8),  # a red label
        lambda m: np.dstack([m * 255] * 3 + [np.full(m.shape, 255)]).astype(np.uint8),
        lambda m: np.dstack([m * 255] * 3 + [np.zeros(m.shape)]).astype(np.uint8),
    ],
)
def test_kinds_of_mask_images(tmp_path, make):
    mask = _masks(1, 1)[0, 0]
    view = MaskFolder(_write_images(tmp_path / "v", [make(mask)]), 30)
    np.testing.assert_array_equal(view.read(0), mask)


def test_gaps_in_the_numbers_are_missing_frames(tmp_path):
    images = _grey(_masks(1, 4)[0])
    images[1] = None
    view = MaskFolder(_write_images(tmp_path / "v", images, "frame_{}.png", first=9), 30)
    assert view.n_frames == 4 and view.read(1) is None and view.read(3) is not None
    assert "1 of 4 frames are missing" in str(view.warnings[0])


@pytest.mark.parametrize(
    ("names", "frames"),
    [
        (["a1.png", "a2.png", "a4.png"], [0, 1, 3]),
        (["a0.png", "a5.png", "a10.png", "a20.png"], [0, 1, 2, 4]),
        (["a1.png", "b2.png"], [0, 1]),
        (["20240101.png", "20240102.png", "20250101.png"], [0, 1, 2]),
        (["x.png", "y.png"], [0, 1]),
        (["a01.png", "a1.png"], [0, 1]),
        (["a7.png"], [0]),
    ],
)
def test_numbers_in_names(names, frames):
    assert list(number_frames(names)) == frames


def test_a_folder_of_folders_is_all_views(tmp_path):
    masks = _masks(11, 2)
    for view, frames in enumerate(masks):
        _write_images(tmp_path / "all" / f"cam{view + 1}", _grey(frames))
    (tmp_path / "all" / "notes.txt").write_text("hello")
    opened = open_silhouettes(tmp_path / "all", frame_rate=30)
    assert opened.names[1] == "cam2" and opened.names[10] == "cam11"
    np.testing.assert_array_equal(np.stack(opened.read(1)), masks[:, 1])


def test_folders_that_are_none(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SilhouetteError, match="found none"):
        open_silhouettes([tmp_path / "empty"])
    damaged = _write_images(tmp_path / "v", _grey(_masks(1, 2)[0]))
    (damaged / "frame_0002.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"\0" * 40)
    with pytest.raises(SilhouetteError, match="frame_0002"):
        MaskFolder(damaged, 30).read(1)
    (damaged / "frame_0002.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (2**31 - 1).to_bytes(4, "big") * 2)
    with pytest.raises(SilhouetteError, match="declares"):
        MaskFolder(damaged, 30).read(1)
    cv2.imwrite(str(damaged / "frame_0002.png"), np.zeros((5, 5), np.uint8))
    with pytest.raises(SilhouetteError, match="like the first image"):
        MaskFolder(damaged, 30).read(1)


def test_dark_on_bright_is_said(tmp_path):
    mask = np.zeros((20, 20), bool)
    mask[5:15, 8:12] = True
    view = MaskFolder(_write_images(tmp_path / "v", _grey([~mask])), 30)
    assert "bright on dark" in str(view.warnings[0])


# Views on one clock


class _Counter(View):
    """A view whose masks tell which frame they are."""

    def __init__(self, n_frames, frame_rate, name="v"):
        self.name, self.size, self.n_frames, self.frame_rate = name, (64, 1), n_frames, frame_rate

    def read(self, frame):
        mask = np.zeros((1, 64), bool)
        mask[0, frame] = True
        return mask


def _frames(silhouettes):
    return [[int(mask.argmax()) for mask in silhouettes.read(k)] for k in range(silhouettes.n_frames)]


def test_the_slowest_view_sets_the_clock():
    both = synchronise([_Counter(10, 60.0), _Counter(5, 30.0)])
    assert both.frame_rate == 30 and both.n_frames == 5
    assert _frames(both) == [[0, 0], [2, 1], [4, 2], [6, 3], [8, 4]]
    assert "60, 30 Hz" in str(both.warnings[0])


def test_the_shortest_view_sets_the_end():
    both = synchronise([_Counter(7, 30.0), _Counter(5, 30.0)])
    assert both.n_frames == 5 and "differ in length" in str(both.warnings[0])
    assert both.names == ("v", "v 2")


def test_rates_that_are_the_same_but_for_rounding():
    both = synchronise([_Counter(60, 29.97), _Counter(60, 30000 / 1001)])
    assert both.n_frames == 60 and both.warnings == ()
    assert _frames(both) == [[k, k] for k in range(60)]


def test_offsets_move_the_start():
    both = synchronise([_Counter(10, 10.0), _Counter(10, 10.0)], offsets=[0.0, 0.3])
    assert _frames(both)[0] == [0, 3] and both.n_frames == 7
    with pytest.raises(SilhouetteError, match="no moment in common"):
        synchronise([_Counter(10, 10.0), _Counter(10, 10.0)], offsets=[0.0, 2.0])
    with pytest.raises(SilhouetteError, match="offsets"):
        synchronise([_Counter(10, 10.0)], offsets=[0.0, 1.0])


@given(
    st.lists(
        st.tuples(st.integers(1, 60), st.sampled_from([10.0, 24.0, 25.0, 30.0, 50.0, 60.0])), min_size=1, max_size=4
    )
)
@settings(max_examples=100, deadline=None)
def test_every_frame_is_the_nearest_image(views):
    together = synchronise([_Counter(n, rate, str(k)) for k, (n, rate) in enumerate(views)])
    for index, row in enumerate(_frames(together)):
        for frame, (_, rate) in zip(row, views, strict=True):
            assert abs(frame / rate - index / together.frame_rate) <= 0.5 / rate + 1e-9


def test_part_of_the_frames():
    part = synchronise([_Counter(10, 30.0)], frames=(4, 6))
    assert _frames(part) == [[4], [5]]
    for wrong in ((-1, 3), (3, 3), (0, 11)):
        with pytest.raises(SilhouetteError, match="expected frames within"):
            synchronise([_Counter(10, 30.0)], frames=wrong)


# Opening whatever there is


def test_an_npz_opens_as_it_is_read(tmp_path):
    path = tmp_path / "a.npz"
    masks = _masks(2)
    write_silhouettes(path, masks, None, 30)
    opened = open_silhouettes([path], frames=(1, 3))
    assert opened.n_frames == 2
    np.testing.assert_array_equal(np.stack(opened.read(0)), masks[:, 1])
    halved = open_silhouettes([path], sizes=[(42, 24)])
    assert halved.sizes == ((42, 24),) * 2
    np.testing.assert_array_equal(halved.read(0)[0][::2, ::2], masks[0, 0])


def test_sources_that_do_not_go_together(tmp_path):
    path = tmp_path / "a.npz"
    write_silhouettes(path, _masks(2), None, 30)
    folder = _write_images(tmp_path / "v", _grey(_masks(1, 2)[0]))
    for sources, options, words in (
        ([], {}, "at least one source"),
        ([tmp_path / "none.mp4"], {}, "no such file"),
        ([path, folder], {}, "cannot be combined with other sources"),
        ([folder / "frame_0001.png"], {}, "name the folder"),
        ([path], {"sizes": [(40, 30)] * 3}, "do the cameras fit"),
        ([path], {"sizes": [(1, 1)]}, "8 to 20000"),
        ([path], {"method": "magic"}, "expected the background method"),
        ([path], {"method": "plate"}, "needs an image"),
        ([path], {"backgrounds": [folder]}, "belong to videos"),
        ([path], {"backgrounds": [folder], "method": "mog2"}, "cannot be combined with the method"),
    ):
        with pytest.raises((SilhouetteError, OptionError), match=words):
            open_silhouettes(sources, **options)


@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"not a video at all", io.BytesIO(b"x" * 5000).read()])
def test_bytes_that_are_nothing(tmp_path, data):
    for name in ("a.mp4", "a.npz", "a"):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(DousaError, match=name):
            open_silhouettes([path])
