"""The overlay video and the contact sheet: whole files, every frame, and failure said in more than colour."""

import dataclasses
import os

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.app.pictures.overlay import Timeline, _Page, lay_out, mean_overlap, write_overlay
from dousa.app.pictures.overlay_sheet import choose_frames, draw_overlay_sheet
from dousa.app.pictures.overlay_view import ALARM, DARK, ViewPainter, draw_lines
from dousa.errors import MotionWriteError, OptionError
from dousa.estimation.body.human import make_human
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rendering import render
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes, Silhouettes
from dousa.estimation.tracking.settings import Estimate
from dousa.messages import Message

N_FRAMES = 6


def front(name="front", width=64, height=48, place=(0.0, 0.9, 2.8)):
    """Looks at the body's face: its left is on the right of the image."""
    matrix = [[52, 0, width / 2], [0, 52, height / 2], [0, 0, 1]]
    return Camera(name, width, height, matrix, np.diag([1.0, -1.0, -1.0]), place)


@pytest.fixture(scope="module")
def body():
    return make_human()


@pytest.fixture(scope="module")
def made(body):
    """An estimate that is perfect, of a person who drifts sideways, in two views of different shape."""
    cameras = [front(), front("tall", 40, 60)]
    poses = np.tile(standing_state(body), (N_FRAMES, 1))
    poses[:, 0] += np.linspace(-0.3, 0.3, N_FRAMES)
    silhouettes = PackedSilhouettes(render(body, poses, cameras), 25.0, [camera.name for camera in cameras])
    return make_estimate(body, poses, np.ones((N_FRAMES, 2))), silhouettes, cameras


def make_estimate(body, poses, iou, lost=None, occluded=None):
    n_frames = len(poses)
    return Estimate(
        body,
        poses,
        25.0,
        iou,
        np.zeros((n_frames, body.n_parts + len(body.tips))),
        np.zeros((n_frames, body.n_parts), bool) if occluded is None else occluded,
        np.zeros(n_frames, bool) if lost is None else lost,
    )


def read_video(path):
    reader = cv2.VideoCapture(str(path))
    frames = []
    while (got := reader.read())[0]:
        frames.append(got[1])
    rate = reader.get(cv2.CAP_PROP_FPS)
    reader.release()
    return frames, rate


def near(picture, colour, tolerance=12):
    return (np.abs(picture.astype(int) - colour) <= tolerance).all(axis=-1)


@pytest.mark.parametrize("suffix", [".mp4", ".avi", ".mkv", ".MP4"])
def test_the_video_has_every_frame_and_an_even_size(made, tmp_path, suffix):
    told = []
    path = tmp_path / f"動き{suffix}"
    write_overlay(*made, path, progress=lambda *a: told.append(a))
    frames, rate = read_video(path)
    assert len(frames) == N_FRAMES and rate == pytest.approx(25.0)
    height, width, _ = frames[0].shape
    assert height % 2 == width % 2 == 0 and width <= 1920
    assert told[-1] == (N_FRAMES, N_FRAMES, Message("pictures.overlay_video"))
    assert os.listdir(tmp_path) == [path.name]


def test_frames_are_read_one_after_the_other(made, tmp_path):
    estimate, silhouettes, cameras = made
    asked = []

    class Watched(Silhouettes):
        names, sizes, n_frames, frame_rate = (silhouettes.names, silhouettes.sizes, N_FRAMES + 3, 25.0)

        def read(self, frame):
            asked.append(frame)
            return silhouettes.read(frame)

    write_overlay(estimate, Watched(), cameras, tmp_path / "a.mp4")
    assert asked == list(range(N_FRAMES))


def test_a_video_that_is_broken_off_leaves_the_old_one(made, tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")

    def break_off(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_overlay(*made, path, progress=break_off)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["a.mp4"]


@pytest.mark.parametrize("draw", [write_overlay, draw_overlay_sheet])
def test_a_folder_that_is_not_there_is_one_clear_line(made, tmp_path, draw):
    path = tmp_path / "none" / ("a.mp4" if draw is write_overlay else "a.png")
    with pytest.raises(MotionWriteError, match="the folder does not exist; create it first") as caught:
        draw(*made, path)
    assert "\n" not in str(caught.value)


def test_a_video_that_comes_out_short_is_not_handed_out(made, tmp_path, monkeypatch):
    class Silent:
        def __init__(self, *args):
            self.real = WRITER(*args)
            self.count = 0

        def isOpened(self):  # noqa: N802 - OpenCV's name
            return self.real.isOpened()

        def write(self, picture):
            self.count += 1
            if self.count < 3:
                self.real.write(picture)

        def release(self):
            self.real.release()

    WRITER = cv2.VideoWriter
    monkeypatch.setattr(cv2, "VideoWriter", Silent)
    with pytest.raises(MotionWriteError, match=r"of 6 frames could be written; is the disk full\?"):
        write_overlay(*made, tmp_path / "a.mp4")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("draw", "name"), [(write_overlay, "a.gif"), (draw_overlay_sheet, "a.bmp")])
def test_other_suffixes_are_refused(made, tmp_path, draw, name):
    with pytest.raises(OptionError, match=r"expected a (video|picture) \."):
        draw(*made, tmp_path / name)


def test_views_that_disagree_are_refused(made, tmp_path):
    estimate, silhouettes, cameras = made
    for draw, name in ((write_overlay, "a.mp4"), (draw_overlay_sheet, "a.png")):
        with pytest.raises(OptionError, match="expected the same number of cameras"):
            draw(estimate, silhouettes, cameras[:1], tmp_path / name)
    assert os.listdir(tmp_path) == []


def test_lost_frames_bear_the_word_and_a_frame(made):
    estimate, silhouettes, cameras = made
    lost = np.arange(N_FRAMES) == 3
    page = _Page(dataclasses.replace(estimate, lost=lost), silhouettes, cameras)
    height = page._grid_height
    marked = [near(page.paint(k)[:height], ALARM, 4).sum() for k in range(N_FRAMES)]
    assert marked[3] > 2000 and sum(marked) == marked[3]
    # The caption alone tells it too, not only the frame round the picture.
    assert near(page.paint(3)[: page._cells[0].top], ALARM, 4).sum() > 300


def test_a_view_without_an_image_is_hatched_and_said(made, body):
    estimate, silhouettes, cameras = made
    painter = ViewPainter(body, cameras[0], 320, 240)
    mask, hidden = silhouettes.read(2)[0], estimate.occluded[2]
    there = painter.paint(estimate.poses[2], mask, None, hidden)
    gone = painter.paint(estimate.poses[2], None, None, hidden)
    corner = (slice(0, 40), slice(0, 60))
    assert there[corner].std() < 1 < gone[corner].std()


@pytest.mark.parametrize("far", [30.0, 1e6, 1e300])
def test_lines_that_leave_the_picture_can_be_drawn(far):
    canvas = np.full((20, 100, 3), 255, np.uint8)
    for dashed in (False, True):
        draw_lines(canvas, [np.array([[5.0, 10.0], [far, -far]])], DARK, dashed=dashed)
    assert (canvas < 255).any()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 5000), st.integers(1, 5000)), min_size=1, max_size=12))
def test_views_fill_the_page_without_overlap(sizes):
    cells, width, height = lay_out(sizes)
    assert width % 2 == height % 2 == 0 and len(cells) == len(sizes)
    used = np.zeros((height, width), np.uint8)
    for cell in cells:
        assert cell.left >= 0 and cell.top >= 20 and cell.left + cell.width <= width
        used[cell.top : cell.top + cell.height, cell.left : cell.left + cell.width] += 1
    assert used.max() == 1
    assert len({cell.height for cell in cells}) == 1


@pytest.mark.parametrize(
    "damage",
    [
        *("missing", "behind", "one frame"),
        *(
            pytest.param(damage, marks=pytest.mark.slow)
            for damage in ("empty", "full", "elsewhere", "inside", "no overlap known")
        ),
    ],
)
def test_every_failure_can_be_drawn(made, body, tmp_path, damage):
    estimate, silhouettes, cameras = made
    poses, iou = estimate.poses.copy(), estimate.iou.copy()
    masks = [np.stack([silhouettes.read(k)[view] for k in range(N_FRAMES)]) for view in range(2)]
    missing = np.zeros((2, N_FRAMES), bool)
    if damage in ("empty", "full"):
        masks = [np.full_like(mask, damage == "full") for mask in masks]
    if damage == "missing":
        missing[:], iou[:] = True, np.nan
    if damage == "no overlap known":
        iou[:] = np.nan
    poses[:, :3] += {"elsewhere": (90, 90, 0), "behind": (0, 0, 9), "inside": (0, 0, 2.8)}.get(damage, (0, 0, 0))
    count = 1 if damage == "one frame" else N_FRAMES
    broken = make_estimate(body, poses[:count], iou[:count], np.ones(count, bool))
    views = PackedSilhouettes([mask[:count] for mask in masks], 25.0, ["a $x$ 正", "b"], missing[:, :count])
    write_overlay(broken, views, cameras, tmp_path / "a.mp4")
    draw_overlay_sheet(broken, views, cameras, tmp_path / "a.png")
    assert len(read_video(tmp_path / "a.mp4")[0]) == count
    assert cv2.imread(str(tmp_path / "a.png")).shape[1] > 1000


def test_a_sheet_reads_each_frame_once_in_rising_order(made, tmp_path):
    estimate, silhouettes, cameras = made
    asked, looked = [], []

    class Watched(Silhouettes):
        names, sizes, n_frames, frame_rate = silhouettes.names, silhouettes.sizes, N_FRAMES, 25.0

        def read(self, frame):
            asked.append(frame)
            return silhouettes.read(frame)

        def look(self, frame):
            looked.append(frame)
            return (None, None)

    draw_overlay_sheet(estimate, Watched(), cameras, tmp_path / "a.png", n_frames=4)
    assert asked == looked == sorted(set(asked)) and len(asked) == 4


@pytest.mark.parametrize("count", [0, 25])
def test_too_few_or_too_many_frames_for_a_sheet(made, tmp_path, count):
    with pytest.raises(OptionError, match="expected 1 to 24 frames"):
        draw_overlay_sheet(*made, tmp_path / "a.png", n_frames=count)


@settings(max_examples=80, deadline=None)
@given(st.integers(1, 60), st.integers(1, 24), st.integers(0, 10**6), st.floats(0, 1))
def test_the_worst_frame_is_among_those_chosen(n_frames, count, seed, gone):
    rng = np.random.default_rng(seed)
    iou = np.where(rng.random((n_frames, 2)) < gone, np.nan, rng.random((n_frames, 2)))
    estimate = make_estimate(BODY, np.tile(standing_state(BODY), (n_frames, 1)), iou)
    frames, worst = choose_frames(estimate, n_frames, count)
    assert frames == sorted(set(frames)) and 1 <= len(frames) <= count
    assert frames[0] >= 0 and frames[-1] < n_frames
    overlap = mean_overlap(iou)
    if worst is None:
        assert np.isnan(overlap).all()
    else:
        assert worst in frames and overlap[worst] == np.nanmin(overlap)


BODY = make_human()


def test_no_short_failure_vanishes_from_a_long_curve(body):
    """One bad frame of twenty thousand still shows in a strip of 800 columns."""
    iou = np.ones((20_000, 1))
    poses = np.broadcast_to(standing_state(body), (20_000, 7 + body.n_angles))
    good = Timeline(make_estimate(body, poses, iou), 800, 76).paint(0)
    iou = iou.copy()
    iou[7777] = 0.0
    bad = Timeline(make_estimate(body, poses, iou), 800, 76).paint(0)
    assert (good[40:60] != bad[40:60]).any()
    lost = np.arange(20_000) == 7777
    flagged = Timeline(make_estimate(body, poses, iou, lost), 800, 76).paint(0)
    assert (flagged != bad).any()
