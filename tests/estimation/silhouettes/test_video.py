"""Video: decoding, masks as video, background subtraction from the file to the mask."""

import os
import subprocess
import sys

import av
import av.logging
import cv2
import numpy as np
import pytest
from oracles.film_files import turn_film, write_film

from dousa.errors import OptionError, SilhouetteError
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.silhouettes.cleaning import label_pieces
from dousa.estimation.silhouettes.images import fit_frame, quiet_opencv
from dousa.estimation.silhouettes.silhouette_files import open_silhouettes
from dousa.estimation.silhouettes.video import VideoFile, guess_video_kind, reduce_size
from patience import PATIENCE

H, W = 120, 160


def write_video(path, frames, rate=25.0):
    height, width = frames[0].shape[:2]
    codec = "mp4v" if path.suffix == ".mp4" else "MJPG"
    with quiet_opencv():
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, (width, height))
        if not writer.isOpened():
            pytest.skip(f"this OpenCV writes no {codec}")
        for frame in frames:
            writer.write(np.ascontiguousarray(frame))
        writer.release()
    return path


def _figure(column):
    mask = np.zeros((H, W), bool)
    mask[30:100, column : column + 22] = True
    return mask


MASKS = [_figure(10 + 6 * k) for k in range(20)]


def _scene():
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(40, 220, (H, W, 3)).astype(np.uint8), (0, 0), 6)


def _clip(masks=MASKS):
    frames = []
    for mask in masks:
        frame = _scene()
        frame[mask] = (40, 60, 230)
        frames.append(frame)
    return frames


def _iou(found, truth):
    return (found & truth).sum() / (found | truth).sum()


@pytest.fixture
def clip(tmp_path):
    return write_video(tmp_path / "walk.avi", _clip())


def test_frames_in_any_order_are_the_same(tmp_path):
    frames = [np.full((48, 64, 3), 2 * k, np.uint8) for k in range(100)]
    file = VideoFile(write_video(tmp_path / "a.mp4", frames))
    assert file.n_frames == 100 and file.frame_rate == 25 and file.size == (64, 48)
    rising = [file.read(k).mean() for k in range(100)]
    np.testing.assert_allclose(rising, 2.0 * np.arange(100), atol=6)
    for frame in (99, 0, 80, 3, 3, 4, 98):
        assert abs(file.read(frame).mean() - rising[frame]) < 3
    file.close()
    assert abs(file.read(50).mean() - rising[50]) < 3
    with pytest.raises(SilhouetteError, match="expected a frame"):
        file.read(100)


def test_frames_of_an_uneven_film_are_taken_at_their_times(tmp_path):
    times = np.cumsum([7, *[20] * 20, *[60] * 20])
    path = write_film(tmp_path / "uneven.mkv", times.tolist())
    with open_silhouettes([path], kind="mask") as opened:
        assert abs(opened.n_frames / opened.frame_rate - 1.6) < 0.05
        for k in (0, 8, 15, 30, opened.n_frames - 1, 20):
            number = opened.read(k)[0][-4].sum() // 2  # the film counts its frames in its lowest rows
            late = np.abs(times - times[0] - 1000 * k / opened.frame_rate)
            assert late[number] <= late.min() + 20
    file = VideoFile(path)
    shown = [(number, seconds, frame) for number, seconds, frame in FilmFrames(path).read()]
    np.testing.assert_allclose(file.times, [seconds for _, seconds, _ in shown], atol=1e-9)
    for number, _, frame in shown[::-5]:
        np.testing.assert_array_equal(file.read(number)[..., ::-1], frame)
    assert VideoFile(path, 50.0).times[-1] == 0.8


@pytest.mark.parametrize("name", ["a.avi", "a.h264", "a.mkv", "a.ts"])
def test_any_frame_is_found_where_containers_seek_badly(tmp_path, name):
    codec = {"a.avi": "mpeg4", "a.mkv": "mpeg4"}.get(name, "libx264")
    path = write_film(tmp_path / name, list(range(0, 4800, 40)), (256, 64), codec)
    file = VideoFile(path)
    assert file.n_frames == 120
    for frame in (119, 3, 100, 0, 1, 90, 118):
        assert abs((file.read(frame)[-4].max(axis=1) > 127).sum() - 2 * frame) < 4
    # With a level of its log a thread of FFmpeg that complains waits for Python, which may be waiting for the thread.
    assert av.logging.get_level() is None


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (0, -1, 1, 0), (-1, 0, 0, -1)])
def test_turned_films_are_upright_for_silhouettes_and_keypoints(tmp_path, matrix):
    path = turn_film(write_film(tmp_path / "a.mp4"), tmp_path / "turned.mp4", matrix)
    file = VideoFile(path)
    with FilmFrames(path) as film:
        assert file.size == film.size == ((64, 96) if matrix[0] == 0 else (96, 64))
        for number, _, frame in film.read():
            np.testing.assert_array_equal(file.read(number)[..., ::-1], frame)
    mask = open_silhouettes([path], kind="mask").read(3)[0]
    assert mask.shape == file.size[::-1] and abs(mask.mean() - 0.28) < 0.05


def test_a_video_of_masks_is_told_from_its_frames(tmp_path):
    frames = [np.dstack([mask.astype(np.uint8) * 255] * 3) for mask in MASKS]
    path = write_video(tmp_path / "masks.avi", frames)
    opened = open_silhouettes([path])
    assert "taken for a video of masks" in str(opened.warnings[0])
    for frame in (0, 7, 19):
        assert _iou(opened.read(frame)[0], MASKS[frame]) > 0.95
    assert open_silhouettes([path], kind="mask").warnings == ()
    half = open_silhouettes([path], kind="mask", sizes=[(80, 60)]).read(3)[0]
    assert half.shape == (60, 80)


def test_kinds_of_frames():
    dark, white = np.zeros((20, 20, 3), np.uint8), np.full((20, 20, 3), 255, np.uint8)
    person = dark.copy()
    person[5:15, 8:12] = 255
    assert guess_video_kind([person, dark]) == "mask"
    assert guess_video_kind([dark]) == guess_video_kind([white]) == guess_video_kind([]) == "video"
    assert guess_video_kind(_clip()[:2]) == "video"


@pytest.mark.parametrize("method", ["median", "mog2"])
def test_a_person_who_walks_through(clip, method):
    opened = open_silhouettes([clip], method=method)
    found = [_iou(opened.read(k)[0], MASKS[k]) for k in range(opened.n_frames)]
    assert opened.names == ("walk",) and opened.frame_rate == 25 and opened.n_frames == 20
    assert np.mean(found) > 0.85


def test_a_plate_and_progress(tmp_path, clip):
    plate = tmp_path / "plate.png"
    cv2.imwrite(str(plate), _scene())
    seen = []
    opened = open_silhouettes([clip], [plate], progress=lambda *step: seen.append(step))
    assert np.mean([_iou(opened.read(k)[0], MASKS[k]) for k in range(20)]) > 0.85
    assert seen[-1][0] == seen[-1][1] == 20 and "walk" in str(seen[-1][2])
    with pytest.raises(OptionError, match="each view, got 2 for 1 view"):
        open_silhouettes([clip], [plate, plate])
    plate.write_bytes(b"no image")
    with pytest.raises(SilhouetteError, match=r"plate\.png"):
        open_silhouettes([clip], [plate])


def test_views_of_another_rate_and_length(tmp_path, clip):
    other = write_video(tmp_path / "other.avi", [frame for frame in _clip() for _ in range(2)][:30], 50.0)
    opened = open_silhouettes([clip, other])
    assert opened.frame_rate == 25 and opened.n_frames == 15 and len(opened.warnings) == 2
    for left, right in (opened.read(k) for k in (0, 7, 14)):
        assert _iou(left, right) > 0.8


def test_an_empty_scene_gives_empty_masks(tmp_path):
    path = write_video(tmp_path / "empty.avi", [_scene()] * 6)
    opened = open_silhouettes([path])
    assert not opened.read(2)[0].any()


def test_black_bars_are_cut_off():
    frame = np.full((1920, 1080, 3), 128, np.uint8)
    frame[:7] = frame[-7:] = 10
    assert fit_frame((1080, 1920), (1088, 1920), frame) == (slice(7, 1913), slice(0, 1080))
    assert fit_frame((1080, 1920), (1088, 1920), frame[::-1] * 0 + 128) == (slice(0, 1920), slice(0, 1080))
    sides = np.full((100, 200, 3), 128, np.uint8)
    sides[:, :50] = sides[:, -50:] = 0
    assert fit_frame((200, 100), (100, 100), sides) == (slice(0, 100), slice(50, 150))
    assert fit_frame((200, 100), (400, 200), sides) == (slice(0, 100), slice(0, 200))


@pytest.mark.parametrize(
    ("size", "reduced"),
    [((1088, 1920), (357, 630)), ((1920, 1080), (640, 360)), ((320, 240), (320, 240)), ((1000, 997), (640, 638))],
)
def test_large_videos_are_reduced(size, reduced):
    assert reduce_size(size, 640) == reduced


def test_files_that_are_no_video(tmp_path, clip):
    whole = clip.read_bytes()
    for data in (b"", b"x" * 3000, whole[:200], whole[:4000]):
        path = tmp_path / "bad.avi"
        path.write_bytes(data)
        with pytest.raises(SilhouetteError, match=r"bad\.avi"):
            VideoFile(path)
    for path in (tmp_path / "none.mp4", tmp_path):
        with pytest.raises(SilhouetteError):
            VideoFile(path)


def test_a_truncated_video_is_read_as_far_as_it_goes(tmp_path, clip):
    path = tmp_path / "cut.avi"
    path.write_bytes(clip.read_bytes()[: clip.stat().st_size * 6 // 10])
    try:
        file = VideoFile(path)
    except SilhouetteError as error:
        assert "cut.avi" in str(error)
    else:
        assert 1 <= file.n_frames < 20 and file.read(file.n_frames - 1) is not None


def test_one_frame_teaches_no_background(tmp_path):
    path = write_video(tmp_path / "one.avi", _clip()[:1])
    with pytest.raises(SilhouetteError, match="at least 2 frames"):
        open_silhouettes([path], kind="video")


def test_nothing_but_the_error_is_printed(tmp_path):
    path = tmp_path / "bad.mp4"
    path.write_bytes(b"\0\0\0\x20ftypisom" + b"\0" * 4000)
    code = (
        "import sys\nfrom dousa.errors import SilhouetteError\n"
        "from dousa.estimation.silhouettes.silhouette_files import open_silhouettes\n"
        "try:\n    open_silhouettes([sys.argv[1]])\nexcept SilhouetteError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    assert done.stderr == "" and done.stdout.count("\n") == 1 and "bad.mp4" in done.stdout


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root reads everything")
def test_no_permission(clip):
    clip.chmod(0)
    with pytest.raises(SilhouetteError, match="permission"):
        VideoFile(clip)


@pytest.mark.slow
def test_a_real_recording_with_somebody_in_its_plate(shared_data):
    folder = shared_data("pose2sim")
    with open_silhouettes(
        [folder / "videos" / "cam01.mp4"], [folder / "background" / "cam01.png"], sizes=[(136, 240)]
    ) as opened:
        assert opened.n_frames == 100 and opened.frame_rate == 60
        assert any("black bars" in str(text) for text in opened.warnings)
        for frame in (0, 50, 99):
            mask = opened.read(frame)[0]
            largest = label_pieces(mask)[1][1:, cv2.CC_STAT_AREA].max()
            assert 0.04 < mask.mean() < 0.11 and largest > 0.9 * mask.sum()
