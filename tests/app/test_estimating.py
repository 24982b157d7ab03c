"""What ``dousa estimate`` does around the tracker: start poses, outputs, partial tracks, and a look at the masks."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from dousa.app.pipelines.doubts import WatchedSilhouettes, parse_frames
from dousa.app.pipelines.estimation_body import read_start
from dousa.app.pipelines.estimation_output import check_outputs
from dousa.app.pipelines.track_log import PartialFile, describe_files, fingerprint
from dousa.app.requests.estimation import EstimationRequest, Outputs, parse_start
from dousa.app.tables.estimation import describe_frames
from dousa.errors import MotionWriteError, OptionError
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.estimation.tracking.settings import PAPER, TrackerSettings
from dousa.formats import ReadOptions
from dousa.formats.registry import write_motion
from dousa.messages import Message
from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion


@dataclasses.dataclass(frozen=True)
class Track:
    """Stands in for what a tracker keeps."""

    poses: np.ndarray
    iou: np.ndarray
    warnings: tuple[str, ...] = ()
    velocity: np.ndarray | None = None
    seconds: float = 0.0


@pytest.fixture
def walk(tmp_path) -> Path:
    path = tmp_path / "walk.bvh"
    write_motion(make_motion("walk", draw_performer(3)), path)
    return path


class TestStart:
    def test_the_frame_comes_after_the_last_colon(self, walk):
        assert parse_start(str(walk)) == (walk, 0)
        assert parse_start(f"{walk}:12") == (walk, 12)

    @pytest.mark.skipif(os.name == "nt", reason="colons are not allowed in names there")
    def test_a_colon_in_the_name_is_no_trouble(self, walk):
        odd = walk.with_name("take:3")
        odd.write_bytes(walk.read_bytes())
        assert parse_start(str(odd)) == (odd, 0)
        assert parse_start(f"{odd}:4") == (odd, 4)

    def test_a_drive_letter_is_no_file(self):
        with pytest.raises(OptionError, match=r"no file C:\\takes\\walk\.bvh;"):
            parse_start(r"C:\takes\walk.bvh:7")
        with pytest.raises(OptionError, match=r"no file C:7"):
            parse_start("C:7")

    @pytest.mark.parametrize("tail", [":", ":-1", ":x", ":1.5"])
    def test_what_is_no_frame_is_named(self, walk, tail):
        with pytest.raises(OptionError, match="expected a frame number"):
            parse_start(f"{walk}{tail}")

    def test_folders_and_missing_files(self, tmp_path):
        with pytest.raises(OptionError, match="is a folder"):
            parse_start(str(tmp_path))
        with pytest.raises(OptionError, match="no file"):
            parse_start(str(tmp_path / "none.bvh:3"))

    def test_the_joints_are_those_of_the_frame(self, walk):
        motion = make_motion("walk", draw_performer(3))
        expected = canonicalise(motion).positions[5]
        said = read_start(f"{walk}:5", ReadOptions())
        assert said.frame == 5
        for name, place in said.positions.items():
            np.testing.assert_allclose(place, expected[CANONICAL_JOINTS.index(name)], atol=1e-5)

    @pytest.mark.parametrize("suffix", [".trc", ".c3d", ".npz"])
    def test_every_format_serves(self, walk, suffix):
        other = walk.with_suffix(suffix)
        write_motion(compute_trajectories(make_motion("walk", draw_performer(3))), other)
        one, two = (read_start(f"{path}:9", ReadOptions()).positions for path in (walk, other))
        for name in set(one) & set(two):
            np.testing.assert_allclose(one[name], two[name], atol=1e-4)

    def test_true_joints_beside_silhouettes_serve_too(self, tmp_path):
        path = tmp_path / "seen.npz"
        places = np.random.default_rng(0).normal(size=(4, 20, 3))
        np.savez(path, mask_packed=np.zeros((4, 8, 1), np.uint8), width=8, height=8,
                 joint_names=np.array(CANONICAL_JOINTS), joint_positions=places)  # fmt: skip
        said = read_start(f"{path}:2", ReadOptions())
        np.testing.assert_array_equal(said.positions["head"], places[2, 3])
        with pytest.raises(OptionError, match="frames 0 to 3"):
            read_start(f"{path}:4", ReadOptions())

    def test_joints_that_were_not_seen_do_not_count(self, tmp_path):
        moving = compute_trajectories(make_motion("walk", draw_performer(3)))
        positions = np.array(canonicalise(moving).positions)
        positions[3, 6] = np.nan
        path = tmp_path / "gap.trc"
        write_motion(canonicalise(moving).to_trajectories().replace(positions=positions), path)
        assert "left_wrist" not in read_start(f"{path}:3", ReadOptions()).positions
        assert "left_wrist" in read_start(f"{path}:4", ReadOptions()).positions

    def test_a_damaged_file_is_one_sentence(self, tmp_path):
        path = tmp_path / "bad.bvh"
        path.write_text("HIERARCHY\nnonsense")
        with pytest.raises(OptionError, match=r"--start .*bad\.bvh:0: .*bad\.bvh"):
            read_start(f"{path}:0", ReadOptions())


class TestRequest:
    def test_plain_values_make_a_request(self, walk):
        given = {
            "sources": [str(walk)],
            "motions": ["out.bvh"],
            "overlay": None,
            "backgrounds": ["a.png", "b.png"],
            "background_method": "plate",
            "stature": 1.7,
            "start": f"{walk}:3",
            "method": "paper",
            "beam": 2,
            "up": "z",
            "joint_map": {"head": "Head"},
            "json": True,
        }
        request = EstimationRequest.from_dict(given)
        assert request.settings == dataclasses.replace(PAPER, beam=2)
        assert request.outputs == Outputs((Path("out.bvh"),))
        assert request.options == ReadOptions(joint_map={"head": "Head"}, up="z")
        assert request.inputs == (walk, Path("a.png"), Path("b.png"), walk)

    def test_nothing_said_is_the_default(self):
        request = EstimationRequest.from_dict({"sources": ["a.npz"], "sex": None})
        assert request == EstimationRequest((Path("a.npz"),)) and request.settings == TrackerSettings()

    @pytest.mark.parametrize(
        ("name", "value"), [("sex", "x"), ("kind", "film"), ("bones", ""), ("background_method", "guess")]
    )
    def test_a_choice_that_there_is_not(self, name, value):
        with pytest.raises(OptionError, match=f"{name}: expected .*, got '{value}'"):
            EstimationRequest.from_dict({"sources": ["a.npz"], name: value})


class TestOutputs:
    @pytest.mark.parametrize(
        ("outputs", "words"),
        [
            ({"motions": "a.xyz"}, r"ending in \.bvh"),
            ({"motions": "a"}, "no suffix"),
            ({"motions": "a.amc"}, r"ending in \.bvh"),
            ({"angles": "a.txt"}, r"--angles .*\.csv"),
            ({"overlay": "a.png"}, r"--output .*\.mp4"),
            ({"sheet": "a.mp4"}, r"--output .*\.png"),
            ({"motions": "a.trc a.trc"}, "same file"),
            ({"motions": "in.npz"}, "is an input"),
        ],
    )
    def test_what_makes_no_sense_is_said_before_the_work(self, tmp_path, outputs, words):
        paths = {key: tuple(tmp_path / name for name in names.split()) for key, names in outputs.items()}
        chosen = Outputs(**{key: found if key == "motions" else found[0] for key, found in paths.items()})
        with pytest.raises(OptionError, match=words):
            check_outputs(chosen, [tmp_path / "in.npz"])

    def test_folders_that_are_missing_or_files(self, tmp_path):
        (tmp_path / "file").write_text("")
        (tmp_path / "dir.bvh").mkdir()
        for name, words in (
            ("none/a.bvh", "the folder does not exist"),
            ("file/a.bvh", "the folder does not exist"),
            ("dir.bvh", "this is a folder"),
            ("n" * 250 + ".bvh", "too long"),
        ):
            with pytest.raises(MotionWriteError, match=words):
                check_outputs(Outputs((tmp_path / name,)), [])

    def test_no_permission_is_found_before_the_work(self, tmp_path, monkeypatch):
        monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
        with pytest.raises(MotionWriteError, match="no permission"):
            check_outputs(Outputs((tmp_path / "a.bvh",)), [])

    def test_good_names_pass_and_nothing_is_made(self, tmp_path):
        outputs = Outputs.from_paths([tmp_path / name for name in ("a.BVH", "a.trc", "a.mot", "a.mp4", "a.png")])
        check_outputs(outputs, [tmp_path / "in.npz"])
        assert outputs.first == tmp_path / "a.BVH"
        assert list(tmp_path.iterdir()) == []


class TestPartialFile:
    track = Track(np.arange(12.0).reshape(3, 4), np.ones((3, 2)), ("a", "b"), None, 1.5)

    def test_what_was_saved_comes_back(self, tmp_path):
        kept = PartialFile(tmp_path / "out.bvh", "key", every=0.0)
        assert kept.load(Track) == (None, None)
        kept.save(lambda: self.track)
        assert [path.name for path in tmp_path.iterdir()] == [".out.bvh.partial.npz"]
        found, note = PartialFile(tmp_path / "out.bvh", "key").load(Track)
        assert note is None
        np.testing.assert_array_equal(found.poses, self.track.poses)
        assert (found.warnings, found.velocity, found.seconds) == (("a", "b"), None, 1.5)
        kept.remove()
        assert list(tmp_path.iterdir()) == []
        kept.remove()

    @pytest.mark.parametrize("damage", ["cut", "text", "empty", "bits", "lacking"])
    def test_damaged_files_start_anew_and_say_so(self, tmp_path, damage):
        kept = PartialFile(tmp_path / "out.bvh", "key", every=0.0)
        kept.save(lambda: self.track)
        whole = kept.path.read_bytes()
        bits = bytearray(whole)
        bits[len(bits) // 3] ^= 255
        if damage == "lacking":
            np.savez(kept.path, fingerprint=np.array("key"), poses=np.zeros(3))
        else:
            kept.path.write_bytes({"cut": whole[: len(whole) // 2], "text": b"no", "empty": b"", "bits": bits}[damage])
        found, note = kept.load(Track)
        assert found is None and note.code == "track_log.unusable" and "starting from the beginning" in str(note)

    def test_it_is_written_now_and_then_only(self, tmp_path):
        kept = PartialFile(tmp_path / "out.bvh", "key")
        kept.save(lambda: pytest.fail("nothing is written, so nothing need be made"))
        assert list(tmp_path.iterdir()) == []

    def test_a_full_disk_does_not_end_the_work(self, tmp_path):
        kept = PartialFile(tmp_path / "none" / "out.bvh", "key", every=0.0)
        kept.save(lambda: self.track)
        assert kept.problem.code == "track_log.not_kept" and "could not be resumed" in str(kept.problem)

    def test_nothing_is_kept_without_an_output(self):
        kept = PartialFile(None, "key", every=0.0)
        kept.save(lambda: self.track)
        assert kept.load(Track) == (None, None)
        kept.remove()

    def test_the_fingerprint_knows_every_value(self, tmp_path):
        base = {"a": np.arange(3.0), "b": [1, "x", None], "c": self.track}
        keys = {fingerprint(base)}
        for change in (
            {"a": np.arange(3)},
            {"a": np.arange(4.0)},
            {"b": [1, "y", None]},
            {"c": dataclasses.replace(self.track, seconds=2.0)},
            {"d": 0},
        ):
            keys.add(fingerprint({**base, **change}))
        assert len(keys) == 6
        assert fingerprint(dict(reversed(base.items()))) in keys

    def test_files_are_known_by_size_and_time(self, tmp_path):
        (tmp_path / "masks").mkdir()
        (tmp_path / "masks" / "0.png").write_bytes(b"1")
        before = describe_files([tmp_path])
        (tmp_path / "masks" / "1.png").write_bytes(b"1")
        assert len(before) == 1 and describe_files([tmp_path]) != before
        assert describe_files([tmp_path / "none"]) == []


class TestFrames:
    @pytest.mark.parametrize(
        ("text", "expected"),
        [(None, (0, 9)), ("2:5", (2, 5)), (":5", (0, 5)), ("4:", (4, 9)), ("-3:", (6, 9)), ("0:99", (0, 9))],
    )
    def test_ranges(self, text, expected):
        assert parse_frames(text, 9, Message("frames.recording")) == expected

    @pytest.mark.parametrize("text", ["5", "a:b", "1:2:3", "5:5", "20:30", "", "3:1"])
    def test_what_is_none(self, text):
        with pytest.raises(OptionError, match="--frames"):
            parse_frames(text, 9, Message("frames.recording"))

    def test_frames_as_stretches(self):
        assert describe_frames([3, 4, 5, 9]) == "3-5, 9"
        assert describe_frames([]) == "none"
        assert describe_frames(range(0, 40, 2)).endswith("and 14 more stretches")


class TestWatched:
    @staticmethod
    def watch(masks, missing=None):
        views = WatchedSilhouettes(PackedSilhouettes(masks, 30.0, missing=missing), 0, masks.shape[1])
        for frame in range(views.n_frames):
            views.read(frame)
        return views

    @staticmethod
    def blob():
        masks = np.zeros((1, 20, 60, 80), bool)
        masks[:, :, 10:50, 30:45] = True
        return masks

    def test_good_masks_are_not_talked_about(self):
        views = self.watch(self.blob())
        assert views.describe() == () and not views.is_blank

    def test_a_range_is_counted_from_its_start(self):
        masks = self.blob()
        masks[:, 5] = False
        views = WatchedSilhouettes(PackedSilhouettes(masks, 30.0), 5, 9)
        assert views.n_frames == 4 and not views.read(0)[0].any() and views.read(1)[0].any()

    def test_empty_full_missing_cut_and_several(self):
        for change, words in (
            (lambda m: m[:, 3:6].fill(False), "3 of 20 silhouettes are empty"),
            (lambda m: m[:, 3:6].fill(True), "3 of 20 silhouettes fill the image"),
            (lambda m: m[:, :, 10:, 30:45].fill(True), "20 of 20 silhouettes reach the border"),
            (lambda m: m[:, :, 10:50, 60:70].fill(True), "a second region"),
        ):
            masks = self.blob()
            change(masks)
            (said,) = self.watch(masks).describe()
            assert words in str(said) and "view1" in str(said)
        (said,) = self.watch(self.blob(), missing=np.arange(20)[None] < 2).describe()
        assert "2 of 20 frames have no image" in str(said)

    def test_masks_are_kept_as_far_as_there_is_room(self):
        masks = np.random.default_rng(0).random((2, 9, 10, 13)) > 0.5
        inner = PackedSilhouettes(masks, 30.0, missing=np.arange(18).reshape(2, 9) == 3)
        views = WatchedSilhouettes(inner, 1, 9, most_kept=4 * 2 * 10 * 2)
        first = [views.read(frame) for frame in range(8)]
        inner._packed = [np.zeros_like(array) for array in inner._packed]
        for frame, before in enumerate(first):
            for view, mask in enumerate(views.read(frame)):
                if (view, frame) == (0, 2):
                    assert mask is None and before[view] is None
                else:
                    np.testing.assert_array_equal(before[view], masks[view, frame + 1])
                    np.testing.assert_array_equal(mask, before[view] if frame < 4 else False)

    @pytest.mark.parametrize("value", [False, True])
    def test_nothing_at_all_is_blank(self, value):
        assert self.watch(np.full((2, 3, 60, 80), value)).is_blank
