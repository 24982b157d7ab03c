"""``dousa estimate`` and ``dousa render`` as a person uses them: every mistake is one line with exit code 2."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from dousa.estimation.tracking.settings import PAPER, TrackerSettings
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import CANONICAL_JOINTS
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="session")
def jack(tmp_path_factory) -> Path:
    """A folder with half a second of a synthetic jumping jack, and what four cameras see of it."""
    from dousa.app.pipelines.render import render_file
    from dousa.app.requests.estimation import RenderRequest

    folder = tmp_path_factory.mktemp("jack")
    whole = make_motion("jumping_jack", draw_performer(10))
    motion = whole.replace(rotations=whole.rotations[10:26], translations=whole.translations[10:26])
    write_motion(motion, folder / "jack.bvh")
    render_file(RenderRequest(folder / "jack.bvh", folder / "seen.npz", size=(160, 120)))
    return folder


def failed(answer, *words):
    """The one line of an error with exit code 2."""
    code, out, err = answer
    lines = [line for line in err.splitlines() if not line.startswith("dousa: note:")]
    assert code == 2 and out == "" and len(lines) == 1, answer
    assert lines[0].startswith("dousa: ") and "Traceback" not in err
    for word in words:
        assert word in lines[0]
    return lines[0]


class TestRender:
    def test_the_file_holds_masks_cameras_stature_and_truth(self, succeed, jack, tmp_path):
        words = ("--ring", 3, "--size", "96x64", "--frames", "2:9", "--json", "-o", tmp_path / "seen.npz")
        out, _ = succeed("render", jack / "jack.bvh", *words)
        answer = json.loads(out)
        assert (answer["n_frames"], answer["sizes"], len(answer["views"])) == (7, [[96, 64]] * 3, 3)
        with np.load(tmp_path / "seen.npz") as file:
            assert file["mask_packed"].shape == (3, 7, 64, 12)
            assert file["joint_positions"].shape == (7, 20, 3)
            assert tuple(file["joint_names"]) == CANONICAL_JOINTS
            assert file["camera_matrix"].shape == (3, 3, 3)
            assert 1.4 < float(file["stature"]) < 2.0
            assert float(file["frame_rate"]) == 30.0

    def test_the_true_joints_are_those_of_the_motion(self, jack):
        from dousa.motion import canonicalise

        with np.load(jack / "seen.npz") as file:
            off = np.linalg.norm(
                file["joint_positions"] - canonicalise(read_motion(jack / "jack.bvh")).positions, axis=2
            )
        assert off.mean() < 0.02

    def test_the_body_is_in_the_middle_of_every_view_and_whole(self, jack):
        with np.load(jack / "seen.npz") as file:
            masks = np.unpackbits(file["mask_packed"], axis=3, count=160).astype(bool)
        for edge in (masks[:, :, 0], masks[:, :, -1], masks[..., 0], masks[..., -1]):
            assert not edge.any()
        assert masks.any(axis=(2, 3)).all()

    def test_another_rate_and_noise(self, dousa, jack, tmp_path):
        for name, noise in (("clean", "clean"), ("noisy", "noisy"), ("again", "noisy")):
            words = ("--rate", 10, "--noise", noise, "--size", "96x64", "-o", tmp_path / f"{name}.npz")
            assert dousa("render", jack / "jack.bvh", *words)[0] == 0
        masks = {name: np.load(tmp_path / f"{name}.npz")["mask_packed"] for name in ("clean", "noisy", "again")}
        assert masks["clean"].shape[1] == 6
        assert (masks["clean"] != masks["noisy"]).any() and (masks["noisy"] == masks["again"]).all()

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ((), "output file required: -o OUT.npz"),
            (("-o", "a.mp4"), "written as .npz"),
            (("-o", "none/a.npz"), "folder does not exist"),
            (("-o", "a.npz", "--size", "big"), "WIDTHxHEIGHT"),
            (("-o", "a.npz", "--size", "0x9"), "WIDTHxHEIGHT"),
            (("-o", "a.npz", "--stature", 172), "centimetres"),
            (("-o", "a.npz", "--stature", 1.7, "--body", "x.toml"), "cannot be combined"),
            (("-o", "a.npz", "--body", "x.toml"), "x.toml"),
            (("-o", "a.npz", "--cameras", "x.toml"), "x.toml"),
            (("-o", "a.npz", "--cameras", "x.toml", "--ring", 3), "cannot be combined"),
            (("-o", "a.npz", "--frames", "90:"), "--frames"),
            (("-o", "a.npz", "--rate", 0), "frame rate"),
            (("-o", "jack.bvh"), "written as .npz"),
        ],
    )
    def test_mistakes(self, dousa, jack, tmp_path, monkeypatch, words, said):
        monkeypatch.chdir(tmp_path)
        failed(dousa("render", jack / "jack.bvh", *words), said)
        assert list(tmp_path.iterdir()) == []

    def test_cameras_that_see_nobody(self, dousa, jack, tmp_path):
        with np.load(jack / "seen.npz") as file:
            arrays = dict(file)
        arrays["world_to_camera_translation"] = arrays["world_to_camera_translation"] + [0.0, 90.0, 0.0]
        np.savez(tmp_path / "away.npz", **arrays)
        answer = dousa("render", jack / "jack.bvh", "--cameras", tmp_path / "away.npz", "-o", tmp_path / "out.npz")
        failed(answer, "no camera sees the body")


@pytest.fixture
def tracked(monkeypatch):
    """A made-up tracker that holds the start; it notes what it was asked, and can be interrupted."""
    import sys
    from types import SimpleNamespace

    from dousa.estimation.body.posing import standing_state
    from dousa.estimation.tracking.settings import Estimate

    calls = SimpleNamespace(asked=[], stop_at=None, iou=0.8, lost=[])

    def estimate(
        views, cameras, body, start=None, *, settings, resume=None, on_checkpoint=None, progress=None, on_frame=None
    ):
        calls.asked.append(
            SimpleNamespace(views=views, cameras=cameras, body=body, start=start, settings=settings, resume=resume)
        )
        done = [] if resume is None else list(resume.poses)
        for frame in range(len(done), views.n_frames):
            if frame == calls.stop_at:
                raise KeyboardInterrupt
            views.read(frame)
            done.append(standing_state(body) if start is None else start)
            on_checkpoint(lambda: Partial(np.array(done)))
            progress(frame + 1, views.n_frames, "tracking")
        n_frames, n_points = len(done), body.n_parts + len(body.tips)
        lost = np.zeros(n_frames, bool)
        lost[calls.lost] = True
        iou = np.full((n_frames, len(cameras)), calls.iou)
        hidden = np.zeros((n_frames, body.n_parts), bool)
        return Estimate(
            body, np.array(done), views.frame_rate, iou, np.full((n_frames, n_points), 0.02), hidden, lost, (), 99.0
        )

    module = SimpleNamespace(estimate=estimate, PartialTrack=Partial)
    monkeypatch.setitem(sys.modules, "dousa.estimation.tracking.tracker", module)
    monkeypatch.setattr("dousa.app.pipelines.track_log.PartialFile.every_s", 0.0)
    return calls


@dataclasses.dataclass(frozen=True)
class Partial:
    """Stands in for what the tracker keeps."""

    poses: np.ndarray

    @property
    def n_tracked(self) -> int:
        return len(self.poses)


class TestEstimateAround:
    """Everything around the tracker, with one that holds its start."""

    def test_json_begins_with_what_was_promised(self, succeed, jack, tracked, tmp_path):
        out = tmp_path / "out.bvh"
        answer, _ = succeed("estimate", jack / "seen.npz", "--start", f"{jack / 'jack.bvh'}:0", "-o", out, "--json")
        said = json.loads(answer)
        assert list(said)[:5] == ["n_frames", "frame_rate", "iou", "lost_frames", "frames_per_second"]
        assert (said["n_frames"], said["frame_rate"], said["lost_frames"]) == (16, 30.0, [])
        assert said["iou"] == {"mean": pytest.approx(0.8), "per_view": [pytest.approx(0.8)] * 4}
        assert said["outputs"] == [str(out)] and read_motion(out).n_frames == 16
        assert "from the file of the silhouettes" in said["body"]

    def test_the_start_is_the_pose_of_the_frame(self, dousa, jack, tracked):
        assert dousa("estimate", jack / "seen.npz", "--start", f"{jack / 'jack.bvh'}:7", "--json")[0] == 0
        assert dousa("estimate", jack / "seen.npz", "--start", f"{jack / 'seen.npz'}:7", "--json")[0] == 0
        assert dousa("estimate", jack / "seen.npz", "--json")[0] == 0
        from dousa.estimation.body.kinematics import compute_points, point_names

        one, two, three = tracked.asked
        assert three.start is None
        with np.load(jack / "seen.npz") as file:
            truth = file["joint_positions"][7]
        for asked in (one, two):
            names = point_names(asked.body)
            points = compute_points(asked.body, asked.start)[[names.index(name) for name in CANONICAL_JOINTS]]
            assert np.linalg.norm(points - truth, axis=1).mean() < 0.06

    def test_every_output_is_written(self, succeed, jack, tracked, tmp_path):
        files = [tmp_path / name for name in ("a.npz", "a.trc", "a.csv", "a.png", "a.mp4", "a.mot")]
        options = ("-o", "-o", "--angles", "-o", "-o", "-o")
        words = [word for pair in zip(options, files, strict=True) for word in pair]
        out, _ = succeed("estimate", jack / "seen.npz", "--frames", "0:5", *words)
        assert sorted(tmp_path.iterdir()) == sorted(files)
        trc = read_motion(files[1])
        assert trc.names == CANONICAL_JOINTS and trc.n_frames == 5
        with open(files[2], newline="") as file:
            rows = list(csv.reader(file))
        assert len(rows) == 6 and rows[0][0] == "time_s" and rows[0][-1] == "lost" and len(rows[0]) == len(rows[3])
        lines = [line.split("\t") for line in files[5].read_text().split("endheader\n")[1].splitlines()]
        assert rows[0][1:-1] == lines[0][1:]
        own, theirs = (np.array(table[1:], float) for table in ([row[:-1] for row in rows], lines))
        np.testing.assert_allclose(own, theirs, atol=1e-6)
        for file in files[3:5]:
            assert file.stat().st_size > 1000
        assert "view1" in out and "0.80" in out and "no frame lost" in out

    def test_without_an_output_the_numbers_are_shown(self, dousa, jack, tracked):
        tracked.lost = [3, 4, 9]
        code, out, err = dousa("estimate", jack / "seen.npz", "--frames", "2:14")
        assert code == 0 and "the motion is not saved" in err
        assert "lost in 3 of 12 frames: 5-6, 11" in out

    def test_settings_reach_the_tracker(self, dousa, jack, tracked, tmp_path):
        settings = tmp_path / "tracker.toml"
        words = ("estimate", jack / "seen.npz", "--frames", ":2")
        settings.write_text("reading = 'residual'\nevidence = 'global'\nsmoothing = 0\nbeam = 3\n")
        assert dousa(*words, "--stature", 1.5, "--settings", settings)[0] == 0
        settings.write_text("method = 'paper'\nbeam = 2\n")
        assert dousa(*words, "--settings", settings)[0] == 0
        assert dousa(*words)[0] == 0
        asked, paper, usual = tracked.asked
        assert paper.settings == dataclasses.replace(PAPER, beam=2) and usual.settings == TrackerSettings()
        settings = asked.settings
        assert (settings.reading, settings.evidence) == ("residual", "global")
        assert (settings.smoothing, settings.beam, asked.body.stature) == (0.0, 3, 1.5)

    def test_interrupted_work_goes_on(self, dousa, jack, tracked, tmp_path):
        words = ("estimate", jack / "seen.npz", "-o", tmp_path / "out.bvh", "--json")
        tracked.stop_at = 9
        code, out, err = dousa(*words)
        assert code == 130 and out == "" and "run the same command again" in err
        assert [path.name for path in tmp_path.iterdir()] == [".out.bvh.partial.npz"]
        tracked.stop_at = None
        code, out, err = dousa(*words)
        assert code == 0 and "resuming at frame 9 of 16" in err
        assert json.loads(out)["resumed_frames"] == 9
        assert tracked.asked[1].resume.poses.shape[0] == 9
        assert [path.name for path in tmp_path.iterdir()] == ["out.bvh"]

    def test_other_settings_start_anew(self, dousa, jack, tracked, tmp_path):
        words = ("estimate", jack / "seen.npz", "-o", tmp_path / "out.bvh")
        tracked.stop_at = 9
        dousa(*words)
        tracked.stop_at = None
        (tmp_path / "tracker.toml").write_text("smoothing = 3")
        code, _, err = dousa(*words, "--settings", tmp_path / "tracker.toml")
        assert code == 0 and "starting from the beginning" in err and tracked.asked[1].resume is None

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (("none.npz",), "none.npz: no such file"),
            (("SEEN", "-o", "a.xyz"), ".bvh"),
            (("SEEN", "-o", "none/a.bvh"), "folder does not exist"),
            (("SEEN", "-o", "SEEN"), "is an input"),
            (("SEEN", "--start", "none.bvh:3"), "no file none.bvh"),
            (("SEEN", "--start", "JACK:999"), "frames 0 to 15, there is no frame 999"),
            (("SEEN", "--body", "x.toml", "--stature", 1.7), "cannot be combined"),
            (("SEEN", "--body", "x.toml"), "x.toml"),
            (("SEEN", "--stature", 0.17), "stature"),
            (("SEEN", "--stature", 170), "centimetres"),
            (("SEEN", "--cameras", "x.toml", "--stature", 170), "centimetres"),
            (("SEEN", "--cameras", "x.toml"), "x.toml"),
            (("SEEN", "--frames", "5:5"), "--frames"),
            (("SEEN", "SEEN"), "seen.npz' is given twice"),
            (("SEEN", "--settings", "no.toml"), "cannot be read"),
            (("SEEN", "--background", "x.png"), "background"),
            (("JACK",), "jack.bvh is a motion already"),
        ],
    )  # fmt: skip
    def test_mistakes(self, dousa, jack, tracked, tmp_path, monkeypatch, words, said):
        monkeypatch.chdir(tmp_path)
        places = {
            "SEEN": str(jack / "seen.npz"),
            "JACK": str(jack / "jack.bvh"),
            "JACK:999": f"{jack / 'jack.bvh'}:999",
        }
        failed(dousa("estimate", *(places.get(word, word) for word in words)), said)
        assert list(tmp_path.iterdir()) == [] and tracked.asked == []

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("mood = 'glad'", "expected one of background_method, kind"),
            ("beam = 'wide'", "beam: 'wide' cannot be used"),
            ("smoothing = -1", "smoothing: -1 cannot be used"),
            ("reading = 'backwards'", "masked"),
            ("method = 'new'", "default or paper"),
            ("bones = 'start'", "--start"),
            ("beam = ", "cannot be read"),
        ],
    )
    def test_mistakes_in_settings(self, dousa, jack, tracked, tmp_path, text, expected):
        (tmp_path / "tracker.toml").write_text(text)
        failed(dousa("estimate", jack / "seen.npz", "--settings", tmp_path / "tracker.toml"), expected)
        assert tracked.asked == []

    def change(self, jack, path, **arrays):
        """Another npz of silhouettes."""
        with np.load(jack / "seen.npz") as file:
            kept = {**dict(file), **arrays}
        np.savez(path, **{key: value for key, value in kept.items() if value is not None})
        return path

    def test_mirror_images_are_turned_round(self, dousa, jack, tracked, tmp_path):
        from dousa.estimation.silhouettes.mask_npz import read_silhouettes

        with np.load(jack / "seen.npz") as file:
            turned = np.packbits(np.unpackbits(file["mask_packed"], axis=3, count=160)[..., ::-1], axis=3)
        path = self.change(jack, tmp_path / "turned.npz", mask_packed=turned)
        assert dousa("estimate", path, "--mirror-left-right")[0] == 0
        for mask, expected in zip(
            tracked.asked[0].views.read(4), read_silhouettes(jack / "seen.npz").read(4), strict=True
        ):
            np.testing.assert_array_equal(mask, expected)

    def test_cameras_that_are_lacking_or_too_few(self, dousa, jack, tracked, tmp_path):
        bare = self.change(jack, tmp_path / "bare.npz", camera_matrix=None, world_to_camera_rotation=None,
                           world_to_camera_translation=None)  # fmt: skip
        failed(dousa("estimate", bare), "add --cameras FILE")
        assert dousa("estimate", bare, "--cameras", jack / "seen.npz")[0] == 0
        with np.load(jack / "seen.npz") as file:
            keys = ("camera_matrix", "world_to_camera_rotation", "world_to_camera_translation", "view_names")
            fewer = {key: file[key][:3] for key in keys}
        np.savez(tmp_path / "three.npz", mask_packed=np.zeros((3, 2, 8, 1), np.uint8), width=8, height=8, **fewer)
        failed(dousa("estimate", bare, "--cameras", tmp_path / "three.npz"), "3 cameras for the views view1, view2,")

    @pytest.mark.parametrize(
        ("iou", "said"),
        [
            (0.3, ("overlap by only 30%", "calibration")),
            ([0.8, 0.8, 0.3, 0.8], ("view 'view3' overlaps by only 30%, the others by 80%",)),
        ],
    )
    def test_what_hardly_overlaps_is_said(self, dousa, jack, tracked, iou, said):
        tracked.iou = iou
        code, _, err = dousa("estimate", jack / "seen.npz")
        assert code == 0 and all(words in err for words in said)

    def test_a_camera_inside_the_body(self, dousa, jack, tracked, tmp_path):
        with np.load(jack / "seen.npz") as file:
            rotations, shifts = file["world_to_camera_rotation"], file["world_to_camera_translation"].copy()
        shifts[0] = -rotations[0] @ [0.0, 1.0, 0.0]
        path = self.change(jack, tmp_path / "inside.npz", world_to_camera_translation=shifts)
        assert "camera 'view1' is inside the body" in dousa("estimate", path)[2]

    def test_a_start_elsewhere(self, dousa, jack, tracked, tmp_path):
        motion = read_motion(jack / "jack.bvh")
        for offset, code, words in ((50.0, 2, "outside the image of every view"), (0.35, 0, "hardly covers")):
            moved = motion.translations.copy()
            moved[:, 0, 0] += offset
            write_motion(motion.replace(translations=moved), tmp_path / "far.bvh")
            answer = dousa("estimate", jack / "seen.npz", "--start", f"{tmp_path / 'far.bvh'}:0")
            assert answer[0] == code and words in answer[2]


@pytest.fixture(scope="session")
def sources(jack, tmp_path_factory):
    """Folders view1 ... view4 of masks, mp4 of the same, and cameras.toml with the cameras in another order."""
    import cv2

    from dousa.estimation.cameras.camera_files import read_cameras, write_cameras
    from dousa.estimation.silhouettes.mask_npz import read_silhouettes

    folder = tmp_path_factory.mktemp("sources")
    views = read_silhouettes(jack / "seen.npz")
    write_cameras(folder / "cameras.toml", read_cameras(jack / "seen.npz")[::-1])
    videos = []
    for name, size in zip(views.names, views.sizes, strict=True):
        (folder / name).mkdir()
        code = cv2.VideoWriter_fourcc(*"mp4v")
        videos.append(cv2.VideoWriter(str(folder / f"{name}.mp4"), code, 30.0, size))
    for frame in range(6):
        for name, video, mask in zip(views.names, videos, views.read(frame), strict=True):
            image = mask.astype(np.uint8) * 255
            cv2.imwrite(str(folder / name / f"{frame:03d}.png"), image)
            video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    for video in videos:
        video.release()
    return folder


class TestSources:
    """Folders and videos, matched to the cameras of a calibration file by name."""

    @pytest.mark.parametrize("ending", ["", ".mp4"])
    def test_views_find_their_cameras(self, succeed, jack, tracked, sources, ending):
        from dousa.estimation.cameras.camera_files import read_cameras

        own = {camera.name: camera for camera in read_cameras(jack / "seen.npz")}
        paths = [sources / f"view{k}{ending}" for k in (2, 1, 4)]
        words = ("--cameras", sources / "cameras.toml", "--rate", 30, "--stature", 1.7, "--json")
        out, _ = succeed("estimate", *paths, *words)
        assert json.loads(out)["views"] == ["view2", "view1", "view4"] and json.loads(out)["n_frames"] == 6
        (asked,) = tracked.asked
        for camera in asked.cameras:
            np.testing.assert_allclose(camera.position, own[camera.name].position, atol=1e-6)

    def test_videos_are_drawn_below_the_model(self, dousa, tracked, sources, tmp_path):
        words = ("--cameras", sources / "cameras.toml", "-o", tmp_path / "a.png", "--frames", "1:4")
        code, _, err = dousa("estimate", sources / "view1.mp4", *words)
        assert code == 0 and (tmp_path / "a.png").stat().st_size > 1000, err
        assert "a body height of 1.72 m is assumed" in err

    def test_pictures_are_those_of_the_frames(self, sources):
        import cv2

        from dousa.app.pipelines.doubts import MirroredSilhouettes, WatchedSilhouettes
        from dousa.estimation import open_silhouettes

        films, sizes = [sources / "view1.mp4", sources / "view2.mp4"], [(160, 120), (80, 60)]
        with open_silhouettes(films, kind="video", sizes=sizes) as views:
            large, small = WatchedSilhouettes(views, 3, 6).look(1)
            assert np.array_equal(MirroredSilhouettes(views).look(4)[0], large[:, ::-1])
        assert large.shape == (120, 160, 3) and small.shape == (60, 80, 3)
        mask = cv2.imread(str(sources / "view1" / "004.png"), cv2.IMREAD_GRAYSCALE) > 127
        assert ((large[..., 0] > 127) == mask).mean() > 0.98

    def test_mistakes(self, dousa, tracked, sources, tmp_path):
        (tmp_path / "view1.mp4").write_bytes(b"no video at all")
        (tmp_path / "empty").mkdir()
        calibration = ("--cameras", sources / "cameras.toml")
        failed(dousa("estimate", tmp_path / "view1.mp4", *calibration), "cannot be opened as a film")
        failed(dousa("estimate", tmp_path / "empty", *calibration), "empty", "images")
        failed(dousa("estimate", sources / "view1.mp4"), "calibration file required", "dousa keypoints --install")
        plates = ("--background", "x.png", "--background", "y.png")
        failed(dousa("estimate", sources / "view1.mp4", *calibration, *plates), "background")
        failed(dousa("estimate", sources / "view1", sources / "view1", *calibration), "view1' is given twice")
        assert tracked.asked == []


def test_backgrounds_may_follow_one_another(tmp_path):
    from dousa.app.cli.estimation import sort_sources

    first, second, film = tmp_path / "a.png", tmp_path / "b.png", tmp_path / "b.mp4"
    for path in (first, second, film):
        path.write_bytes(b"x")
    assert sort_sources([film, second], [first]) == ((film,), (first, second))
    assert sort_sources([film, second], None) == ((film, second), ())
