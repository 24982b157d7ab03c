"""``dousa estimate`` with the tracker itself on bad input: recovered, or said in one line."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from dousa.app.pipelines.estimate import Estimation, estimate_files
from dousa.app.requests.estimation import EstimationRequest, Outputs
from dousa.errors import SilhouetteError
from dousa.estimation.silhouettes.mask_npz import read_true_joints
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import rotations as rot
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.estimation.metrics import compare_with_truth

QUICK = TrackerSettings(beam=1, passes=(1.0, 0.5), damping=(0.2,), lag=5)
CALIBRATION = ("camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A folder with a dozen frames of a jumping jack and what four cameras see of it."""
    from dousa.app.pipelines.render import render_file
    from dousa.app.requests.estimation import RenderRequest

    folder = tmp_path_factory.mktemp("scene")
    whole = make_motion("jumping_jack", draw_performer(10))
    write_motion(
        whole.replace(rotations=whole.rotations[10:22], translations=whole.translations[10:22]), folder / "jack.bvh"
    )
    render_file(RenderRequest(folder / "jack.bvh", folder / "seen.npz", size=(160, 120)))
    return folder


@pytest.fixture
def change(scene, tmp_path):
    """Makes another npz of silhouettes: of other masks, with other arrays."""

    def make(masks=None, **arrays) -> Path:
        with np.load(scene / "seen.npz") as file:
            kept = {**dict(file), **arrays}
        if masks is not None:
            kept["mask_packed"] = np.packbits(masks, axis=3)
        np.savez(tmp_path / "changed.npz", **kept)
        return tmp_path / "changed.npz"

    return make


@pytest.fixture
def masks(scene) -> np.ndarray:
    """(4, 12, 120, 160) true on the body."""
    with np.load(scene / "seen.npz") as file:
        return np.unpackbits(file["mask_packed"], axis=3, count=160).astype(bool)


@pytest.fixture
def calibration(scene) -> dict[str, np.ndarray]:
    with np.load(scene / "seen.npz") as file:
        return {key: file[key].copy() for key in CALIBRATION}


def track(scene: Path, path: Path, **options) -> Estimation:
    start = options.pop("start", f"{scene / 'jack.bvh'}:0")
    return estimate_files(EstimationRequest((path,), QUICK, start=start, **options))


def mean_error(done: Estimation, scene: Path) -> float:
    """mm"""
    names, truth = read_true_joints(scene / "seen.npz")
    points = done.estimate.points
    errors = compare_with_truth(points.names, points.positions, names, truth[: done.estimate.n_frames]).errors
    return 1000.0 * float(np.nanmean(errors))


def said(done: Estimation) -> str:
    return "\n".join(map(str, done.warnings))


class TestRight:
    def test_the_command_line_finds_the_joints(self, dousa, scene, tmp_path):
        out = tmp_path / "out.trc"
        code, answer, err = dousa(
            "estimate", scene / "seen.npz", "--start", f"{scene / 'jack.bvh'}:0", "-o", out, "--json"
        )
        assert code == 0 and err == ""
        found = json.loads(answer)
        assert found["iou"]["mean"] > 0.8 and found["lost_frames"] == [] and found["warnings"] == []
        names, truth = read_true_joints(scene / "seen.npz")
        trc = read_motion(out)
        assert np.nanmean(compare_with_truth(trc.names, trc.positions, names, truth).errors) < 0.06

    @pytest.mark.slow
    def test_the_start_is_found(self, scene):
        done = track(scene, scene / "seen.npz", start=None, frames=":3")
        assert done.start.code == "estimate.start_found" and float(np.nanmean(done.estimate.iou)) > 0.75

    @pytest.mark.parametrize("count", [1, 2])
    def test_a_frame_or_two(self, scene, count):
        done = track(scene, scene / "seen.npz", frames=f":{count}")
        assert done.estimate.n_frames == count and mean_error(done, scene) < 40.0

    def test_the_method_of_the_paper(self, dousa, scene, tmp_path):
        (tmp_path / "paper.toml").write_text("method = 'paper'")
        words = (
            "--settings",
            tmp_path / "paper.toml",
            "--start",
            f"{scene / 'jack.bvh'}:0",
            "--frames",
            ":4",
            "--json",
        )
        code, answer, _ = dousa("estimate", scene / "seen.npz", *words)
        assert code == 0 and json.loads(answer)["iou"]["mean"] > 0.5


class TestMasks:
    @pytest.mark.parametrize(("value", "words"), [(False, "every mask is empty"), (True, "every mask is full")])
    def test_nothing_to_see(self, scene, masks, change, tmp_path, value, words):
        path = change(np.full_like(masks, value))
        outputs = Outputs((tmp_path / "out.bvh",))
        for start in (None, f"{scene / 'jack.bvh'}:0"):
            with pytest.raises(SilhouetteError, match=rf"changed\.npz: .*{words}"):
                track(scene, path, start=start, outputs=outputs)
        assert [file.name for file in tmp_path.iterdir()] == ["changed.npz"]

    @pytest.mark.slow
    def test_two_people(self, scene, masks, change):
        done = track(scene, change(masks | np.roll(masks, 45, axis=3)))
        assert "several people" in said(done)

    def test_limbs_cut_off_by_the_border(self, scene, masks, change, calibration):
        matrix = calibration["camera_matrix"]
        matrix[:, 0, 2] -= 55
        done = track(scene, change(masks[..., 55:105], width=50, camera_matrix=matrix))
        assert "reach the border" in said(done) and mean_error(done, scene) < 80.0

    def test_a_person_who_leaves_and_comes_back(self, scene, masks, change):
        masks[:, 5:8] = False
        done = track(scene, change(masks))
        assert np.flatnonzero(done.estimate.lost).tolist() == [5, 6, 7]
        assert "3 of 12 silhouettes are empty" in said(done) and mean_error(done, scene) < 90.0

    def test_somebody_who_comes_late(self, scene, masks, change):
        masks[:, :3] = False
        done = track(scene, change(masks), start=f"{scene / 'jack.bvh'}:3")
        assert "tracking starts at frame 3" in said(done) and done.estimate.n_frames == 12
        assert mean_error(done, scene) < 80.0

    def test_folders_of_other_lengths_with_images_missing(self, scene, masks, tmp_path):
        import cv2

        from dousa.estimation.cameras.camera_files import read_cameras, write_cameras

        write_cameras(tmp_path / "cameras.toml", read_cameras(scene / "seen.npz"))
        names = [camera.name for camera in read_cameras(scene / "seen.npz")]
        for view, name in enumerate(names):
            (tmp_path / name).mkdir()
            for frame in range(12 - 2 * view):
                if (view, frame) != (1, 4):
                    image = masks[view, frame].astype(np.uint8) * 255
                    cv2.imwrite(str(tmp_path / name / f"{frame:03d}.png"), image)
        done = estimate_files(
            EstimationRequest(
                tuple(tmp_path / name for name in names),
                QUICK,
                cameras=tmp_path / "cameras.toml",
                rate=30.0,
                stature=1.7,
                start=f"{scene / 'jack.bvh'}:0",
            )
        )
        assert done.estimate.n_frames in (6, 12) and mean_error(done, scene) < 80.0
        assert "frames" in said(done)

    def test_an_image_that_cannot_be_read_is_named(self, dousa, scene, masks, tmp_path):
        import cv2

        (tmp_path / "view1").mkdir()
        for frame in range(4):
            cv2.imwrite(str(tmp_path / "view1" / f"{frame}.png"), masks[0, frame].astype(np.uint8) * 255)
        (tmp_path / "view1" / "2.png").write_bytes(b"no image")
        words = ("--cameras", scene / "seen.npz", "--rate", 30, "--start", f"{scene / 'jack.bvh'}:0")
        code, out, err = dousa("estimate", tmp_path / "view1", *words)
        lines = [line for line in err.splitlines() if "note:" not in line]
        assert code == 2 and out == "" and len(lines) == 1 and "2.png" in lines[0]

    def test_one_view_says_that_depth_is_unknown(self, scene, masks, change):
        masks[1:] = False
        assert "a single view gives no depth" in said(track(scene, change(masks), frames=":3"))


class TestCalibration:
    @pytest.mark.slow
    def test_cameras_exchanged(self, scene, change, calibration):
        order = [1, 0, 2, 3]
        done = track(scene, change(**{key: array[order] for key, array in calibration.items()}))
        assert "cameras may be exchanged" in said(done) or "check its calibration" in said(done)

    def test_one_lens_that_is_wrong_is_named(self, scene, change, calibration):
        matrix = calibration["camera_matrix"]
        matrix[1, :2, :2] *= 1.3
        assert "view 'view2' overlaps by" in said(track(scene, change(camera_matrix=matrix)))


class TestBodyAndStart:
    @pytest.mark.slow
    def test_a_body_ten_times_too_small(self, scene, tmp_path):
        from dousa.estimation.body.body_file import write_body
        from dousa.estimation.body.human import make_human

        body = make_human(1.7)
        small = dataclasses.replace(
            body,
            offsets=0.1 * body.offsets,
            tip_offsets=0.1 * body.tip_offsets,
            spheres=0.1 * body.spheres,
            stature=0.17,
        )
        write_body(small, tmp_path / "small.toml")
        done = track(scene, scene / "seen.npz", body=tmp_path / "small.toml", frames=":2")
        assert "do not trust this motion" in said(done) and done.estimate.lost.all()

    @pytest.mark.slow
    @pytest.mark.parametrize("stature", [1.15, 2.25])
    def test_a_stature_that_is_wrong(self, scene, stature):
        done = track(scene, scene / "seen.npz", stature=stature, start=None, frames=":2")
        assert "implausible body height" in said(done) or "overlap by" in said(done)

    @pytest.mark.slow
    def test_a_start_turned_by_30_degrees_is_put_right(self, scene, tmp_path):
        turned = self.turn(scene, tmp_path / "turned.bvh", 30.0)
        done = track(scene, scene / "seen.npz", start=f"{turned}:0")
        assert mean_error(done, scene) < 80.0

    @staticmethod
    def turn(scene: Path, path: Path, degrees: float) -> Path:
        motion = read_motion(scene / "jack.bvh")
        turn = rot.from_axis_angle(np.array([0.0, np.deg2rad(degrees), 0.0]))
        rotations = motion.rotations.copy()
        rotations[:, 0] = rot.multiply(np.broadcast_to(turn, rotations[:, 0].shape), rotations[:, 0])
        write_motion(motion.replace(rotations=rotations), path)
        return path

    @pytest.mark.slow
    def test_bones_are_those_of_the_start_where_it_agrees(self, scene):
        one = {"path": scene / "seen.npz", "frames": ":1"}
        auto, tables = track(scene, **one), track(scene, **one, bones="tables")
        assert "limbs of the start" in str(auto.body) and "limbs of the start" not in str(tables.body)
        off = track(scene, **one, stature=1.4)
        assert off.body.code == "body.tables_start_differs" and "bones = 'start'" in str(off.body)
        assert off.estimate.body.stature == 1.4
        forced = track(scene, **one, stature=1.4, bones="start")
        assert forced.body.code == "body.with_start" and forced.estimate.body.stature > 1.5

    def test_without_a_stature_the_start_tells_it(self, scene, change, tmp_path):
        with np.load(change()) as file:
            bare = {key: file[key] for key in file if key != "stature"}
        np.savez(tmp_path / "bare.npz", **bare)
        done = track(scene, tmp_path / "bare.npz", frames=":1")
        assert done.body.code == "body.of_start" and "is assumed" not in said(done)
        assert "is assumed" in said(track(scene, tmp_path / "bare.npz", frames=":1", bones="tables"))


class TestInterrupted:
    @pytest.mark.slow
    def test_going_on_gives_the_same_motion(self, scene, masks, change, tmp_path, monkeypatch):
        from dousa.estimation.tracking import tracker

        monkeypatch.setattr("dousa.app.pipelines.track_log.PartialFile.every_s", 0.0)
        monkeypatch.setitem(tracker.estimate.__kwdefaults__, "checkpoint_every", 3)
        path = change(masks)

        def run(name, stop_at=None):
            def progress(done, total, what):
                if str(what) == "tracking" and done == stop_at:
                    raise KeyboardInterrupt

            outputs = Outputs((tmp_path / name,))
            return estimate_files(EstimationRequest((path,), QUICK, outputs, start=f"{scene / 'jack.bvh'}:0"), progress)

        whole = run("whole.bvh")
        with pytest.raises(KeyboardInterrupt):
            run("parts.bvh", stop_at=11)
        assert (tmp_path / ".parts.bvh.partial.npz").exists()
        resumed = run("parts.bvh")
        assert resumed.resumed > 0 and not (tmp_path / ".parts.bvh.partial.npz").exists()
        for field in ("poses", "iou", "uncertainty", "occluded", "lost"):
            np.testing.assert_array_equal(getattr(resumed.estimate, field), getattr(whole.estimate, field))
        assert (tmp_path / "parts.bvh").read_bytes() == (tmp_path / "whole.bvh").read_bytes()
