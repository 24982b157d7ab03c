"""Adding files: what is stored, what is left alone, what is skipped and why."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor

import joblib
import numpy as np
import pytest

from dousa.errors import OptionError
from dousa.formats import ReadOptions, read_motion
from dousa.library import Library
from dousa.library.store.engine import choose_jobs
from dousa.messages import Message
from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories


def test_a_folder_becomes_clips(empty_library, moves):
    report = empty_library.add(moves, performer_from=r"name:_(p\d)")
    assert (len(report.added), report.skipped, report.unchanged, report.duplicates) == (15, (), (), ())
    assert report.bytes == sum(path.stat().st_size for path in moves.rglob("*.bvh"))
    clips = empty_library.clips()
    assert [clip.path for clip in clips] == sorted(str(path) for path in moves.rglob("*.bvh")) == sorted(report.added)
    first = clips[0]
    assert (first.category, first.performer, first.format, first.n_frames) == ("bow", "p0", "bvh", 24)
    assert first.predicted_category is None
    assert first.duration == pytest.approx(24 / first.frame_rate)
    assert empty_library.categories() == {"bow": 5, "squat": 5, "wave": 5}


def test_trajectories_are_the_canonical_joints(library, moves):
    clip = library.clips()[0]
    stored = library.trajectories(clip.id)
    expected = canonicalise(compute_trajectories(read_motion(clip.path)))
    np.testing.assert_allclose(stored.positions, expected.positions, atol=1e-6)
    assert stored.names == CANONICAL_JOINTS
    assert stored.frame_rate == expected.frame_rate
    assert clip.height == expected.height


def test_the_same_file_twice_is_no_change(library, moves):
    before = library.stats()
    report = library.add(moves)
    assert "unchanged=<15 in a tuple>" in repr(report)  # in a notebook too
    assert (len(report.unchanged), report.added, report.bytes) == (15, (), 0)
    assert library.stats() == before
    assert library.add(moves, category_from="name:([a-z])").other_labels == report.unchanged  # and not taken
    assert library.categories() == {"bow": 5, "squat": 5, "wave": 5}


def test_a_rule_that_finds_nothing_is_told(empty_library, moves):
    report = empty_library.add(moves / "bow", performer_from="name:(nobody)", n_jobs=1)
    assert len(report.added) == 5
    assert [message.code for _, message in report.warnings] == [
        "library_add.no_category",
        "library_add.no_performer",
    ] * 5
    assert empty_library.add(moves / "wave", category_from="none", n_jobs=1).warnings == ()  # nobody asked for labels


def test_a_single_pose_is_told(empty_library, write_move, tmp_path):
    report = empty_library.add(write_move(tmp_path / "rest" / "a.bvh", n_frames=1))
    assert "library_add.one_frame" in {message.code for _, message in report.warnings}


def test_a_touched_file_is_unchanged_and_then_not_read_again(empty_library, write_move, tmp_path):
    path = write_move(tmp_path / "a.bvh")
    empty_library.add(path)
    os.utime(path, (1, 1))
    revision = empty_library.stats().revision
    again = empty_library.add(path)
    assert empty_library.stats().revision == revision
    assert (again.unchanged, again.bytes) == ((str(path),), path.stat().st_size)
    assert empty_library.add(path).bytes == 0


def test_the_same_content_elsewhere_is_a_duplicate(empty_library, write_move, tmp_path):
    first = write_move(tmp_path / "in" / "a.bvh")
    second = tmp_path / "in" / "b.bvh"
    shutil.copy(first, second)
    report = empty_library.add(tmp_path / "in")
    assert report.added == (str(first),)
    assert [(item.path, item.same_as) for item in report.duplicates] == [(str(second), str(first))]
    shutil.copy(first, tmp_path / "c.bvh")
    assert [item.same_as for item in empty_library.add(tmp_path / "c.bvh").duplicates] == [str(first)]
    assert len(empty_library.clips()) == 1


def test_a_file_that_moved_keeps_its_clip(empty_library, write_move, tmp_path):
    path = write_move(tmp_path / "walk" / "a.bvh")
    empty_library.add(tmp_path)
    (clip,) = empty_library.clips()
    moved = path.rename(tmp_path / "b.bvh")
    report = empty_library.add(tmp_path)
    assert [(item.path, item.same_as) for item in report.moved] == [(str(moved), str(path))]
    (now,) = empty_library.clips()
    assert (now.id, now.path, now.category) == (clip.id, str(moved), "walk")


def test_a_changed_file_replaces_its_clip_and_keeps_the_label(library, write_move, tmp_path):
    path = write_move(tmp_path / "new" / "x.bvh", "wave", 7)
    library.add(path)
    library.relabel(path, category="greeting")
    (before,) = library.clips(path)
    write_move(path, "squat", 7, n_frames=30)
    report = library.add(path)
    assert (report.added, report.replaced) == ((), (str(path),))
    (after,) = library.clips(path)
    assert (after.n_frames, after.category) == (30, "greeting")
    assert after.predicted_category == "greeting"  # the forest has learned the new category from this clip
    assert after.id != before.id


def test_a_file_that_became_a_copy_of_another_gives_up_its_clip(empty_library, write_move, tmp_path):
    first, second = write_move(tmp_path / "a.bvh", seed=1), write_move(tmp_path / "b.bvh", seed=2)
    empty_library.add(tmp_path)
    shutil.copy(first, second)
    assert [item.path for item in empty_library.add(tmp_path).duplicates] == [str(second)]
    assert [clip.path for clip in empty_library.clips()] == [str(first)]


def test_two_files_that_changed_places(empty_library, write_move, tmp_path):
    first, second = write_move(tmp_path / "a.bvh", seed=1), write_move(tmp_path / "b.bvh", "bow")
    empty_library.add(tmp_path)
    first.rename(tmp_path / "c")
    second.rename(first)
    (tmp_path / "c").rename(second)
    os.utime(first, (5, 5))
    os.utime(second, (6, 6))
    empty_library.relabel(first, category="x")
    report = empty_library.add(tmp_path)
    assert (report.replaced, report.duplicates) == ((str(first), str(second)), ())
    assert [(clip.path, clip.category) for clip in empty_library.clips()] == [(str(first), "x"), (str(second), None)]


def test_a_file_that_moved_and_was_copied_moves_once(empty_library, write_move, tmp_path):
    old = write_move(tmp_path / "wave" / "a.bvh", seed=1)
    empty_library.add(tmp_path)
    new = [tmp_path / "greet" / name for name in ("b.bvh", "c.bvh")]
    new[0].parent.mkdir()
    for path in new:
        shutil.copy(old, path)
    old.unlink()
    report = empty_library.add(tmp_path)
    assert [(item.path, item.same_as) for item in report.moved] == [(str(new[0]), str(old))]
    assert [(item.path, item.same_as) for item in report.duplicates] == [(str(new[1]), str(new[0]))]
    assert [(clip.path, clip.category) for clip in empty_library.clips()] == [(str(new[0]), "wave")]
    assert report.other_labels == (str(new[0]),)  # the folder says something else now


def test_bad_files_are_named_and_the_others_go_on(empty_library, write_move, tmp_path):
    root = tmp_path / "in"
    good = write_move(root / "walk" / "good.bvh")
    (root / "broken.bvh").write_text("HIERARCHY\nROOT Hips\n{")
    (root / "empty.bvh").write_text("")
    (root / "notes.txt").write_text("not a motion")
    report = empty_library.add([root, tmp_path / "none.bvh", root / "notes.txt"])
    assert report.added == (str(good),)
    reasons = {os.path.basename(item.path): str(item.reason) for item in report.skipped}
    assert set(reasons) == {"broken.bvh", "empty.bvh", "none.bvh", "notes.txt"}
    assert "no such file" in reasons["none.bvh"]
    assert ".txt" in reasons["notes.txt"]
    assert "is empty" in reasons["empty.bvh"]
    assert not any(str(root) in reason for reason in reasons.values()), reasons


def test_a_name_that_is_no_unicode_is_skipped(empty_library, write_move, tmp_path):
    good = write_move(tmp_path / "in" / "good.bvh")
    try:
        shutil.copy(good, os.fsencode(tmp_path / "in") + b"/bad\xff.bvh")
    except OSError:
        pytest.skip("this disk takes Unicode names only")
    report = empty_library.add(tmp_path / "in")
    assert report.added == (str(good),)
    assert [(os.path.basename(item.path), item.reason) for item in report.skipped] == [
        ("bad\\udcff.bvh", Message("motion_files.not_unicode"))
    ]


def test_several_programs_add_at_the_same_time(moves, tmp_path):
    path = tmp_path / "m.dousa"

    def work(number: int) -> tuple[int, int]:
        with Library.open(path, create=True, timeout=60) as library:
            report = library.add(moves, n_jobs=1)
            return len(report.added), len(report.added) + len(report.unchanged)

    with ThreadPoolExecutor(4) as pool:
        reports = list(pool.map(work, range(4)))
    assert sum(added for added, _ in reports) == 15
    assert {handled for _, handled in reports} == {15}
    with Library.open(path) as library:
        assert len(library.clips()) == 15


def test_a_file_without_a_body_is_skipped_with_its_joints(empty_library, tmp_path):
    chain = "ROOT Tail\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 1 0\n}\n}"
    path = tmp_path / "tail.bvh"
    path.write_text(f"HIERARCHY\n{chain}\nMOTION\nFrames: 1\nFrame Time: 0.01\n0 0 0\n")
    (skipped,) = empty_library.add(path).skipped
    assert "Tail" in str(skipped.reason)


def test_options_given_by_hand_read_a_file_again(empty_library, write_move, tmp_path):
    path = write_move(tmp_path / "a.bvh")
    empty_library.add(path, options=ReadOptions(unit="cm"))
    (small,) = empty_library.clips()
    assert empty_library.add(path, options=ReadOptions(unit="cm")).unchanged
    assert empty_library.add(path, options=ReadOptions(unit="in")).replaced
    (large,) = empty_library.clips()
    assert large.height == pytest.approx(2.54 * small.height)


def test_new_clips_of_a_trained_library_are_classified_at_once(library, write_move, tmp_path):
    path = write_move(tmp_path / "new.bvh", "squat", 99)
    library.add(path)
    (clip,) = library.clips(path)
    assert (clip.category, clip.predicted_category) == (None, "squat")
    assert str(path) in [hit.path for hit in library.search(path, k=16).results]


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["threading", "loky", "sequential"])
def test_another_backend_of_joblib_gives_the_same_library(library, moves, tmp_path, backend):
    with Library.open(tmp_path / "other.dousa", create=True) as other:
        with joblib.parallel_config(backend=backend, n_jobs=2):
            other.add(moves, performer_from=r"name:_(p\d)")
        other.train(n_trees=20)
        assert [clip.to_json() for clip in other.clips()] == [clip.to_json() for clip in library.clips()]
        query = library.clips()[3].path
        assert other.search(query) == library.search(query)


def test_every_core_is_used_unless_joblib_or_the_caller_says_otherwise():
    assert choose_jobs(None) == -1
    assert choose_jobs(1) == 1
    with joblib.parallel_config(backend="threading", n_jobs=3):
        assert joblib.effective_n_jobs(choose_jobs(None)) == 3


def test_progress_counts_every_file(empty_library, moves):
    calls = []
    empty_library.add(moves, n_jobs=1, progress=lambda *call: calls.append(call))
    assert [done for done, _, _ in calls] == list(range(16))
    assert {total for _, total, _ in calls} == {15}


def test_ctrl_c_keeps_what_was_read(empty_library, moves):
    def stop(done: int, total: int, path: str) -> None:
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        empty_library.add(moves, n_jobs=2, progress=stop)
    assert len(empty_library.clips()) == 7
    report = empty_library.add(moves)
    assert (len(report.unchanged), len(report.added)) == (7, 8)


@pytest.mark.parametrize("options", [{"n_jobs": 0}, {"category_from": "name:("}, {"performer_from": "nonsense"}])
def test_bad_options_change_nothing(empty_library, moves, options):
    with pytest.raises(OptionError):
        empty_library.add(moves, **options)
    assert empty_library.clips() == []


def test_amc_with_its_skeleton(empty_library, shared_data, tmp_path):
    source = shared_data("hdm05")
    motion = next(source.glob("*/*bd*.amc"))
    skeleton = next(source.glob("*bd*.asf"))
    folder = tmp_path / "in" / "kick"
    folder.mkdir(parents=True)
    shutil.copy(motion, folder)
    (skipped,) = empty_library.add(tmp_path / "in").skipped
    assert ".asf" in str(skipped.reason)
    shutil.copy(skeleton, tmp_path / "in")
    report = empty_library.add(tmp_path / "in")
    assert (len(report.added), report.skipped) == (1, ())
    assert empty_library.add(tmp_path / "in").unchanged
    (tmp_path / "in" / skeleton.name).write_bytes(skeleton.read_bytes() + b"\n")
    assert empty_library.add(tmp_path / "in").replaced


def test_mixed_skeletons_in_one_library(empty_library, shared_data):
    bandai = sorted(shared_data("bandai").rglob("*.bvh"))[0]
    kinect = sorted(shared_data("utd_mhad/skeleton").rglob("*.c3d"))[0]
    report = empty_library.add([bandai, kinect])
    assert (len(report.added), report.skipped) == (2, ())
    assert {clip.format for clip in empty_library.clips()} == {"bvh", "c3d"}


def test_a_skeleton_that_was_used_is_not_passed_over(empty_library, shared_data, tmp_path):
    source = shared_data("hdm05")
    folder = tmp_path / "in"
    folder.mkdir()
    for path in (next(source.glob("*/*bd*.amc")), source / "HDM_bd.asf", source / "HDM_dg.asf"):
        shutil.copy(path, folder)
    report = empty_library.add(folder, category_from=None)
    assert len(report.added) == 1 and report.passed_over == ((".asf", 1),)
