"""Uncut recordings: kept beside the clips, looked into, labelled."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import (
    DousaError,
    InvalidMotionError,
    LibraryDamagedError,
    LibraryError,
    MotionFileError,
    NotTrainedError,
    OptionError,
)
from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.library.takes import takes
from dousa.library.takes import windows as kept_windows
from dousa.motion import CANONICAL_JOINTS, Trajectories, compute_trajectories
from dousa.retrieval.takes.windows import TakeWindows
from library.database_server import run_sql, seal_again

RATE = 30.0


def join(*parts: Path) -> Trajectories:
    """Recordings one after another, on one skeleton's joints, with half a second of blending between them."""
    motions = [compute_trajectories(read_motion(part)) for part in parts]
    names = motions[0].names
    pieces = [motion.select(names) for motion in motions]
    blended = [pieces[0]]
    for piece in pieces[1:]:
        shares = np.linspace(0, 1, 16)[1:-1, None, None]
        blended += [blended[-1][-1:] * (1 - shares) + piece[:1] * shares, piece]
    return Trajectories(names, np.concatenate(blended), RATE, motions[0].parents)


@pytest.fixture(scope="session")
def long_moves(write_move, tmp_path_factory) -> Path:
    """Moves of about two seconds: the ``moves`` of other tests are shorter than a window should be."""
    root = tmp_path_factory.mktemp("long")
    for move in ("wave", "squat", "bow"):
        for seed in range(5):
            write_move(root / move / f"{move}_p{seed}.bvh", move, seed, n_frames=50 + 5 * seed)
    return root


@pytest.fixture(scope="session")
def take_file(write_move, tmp_path_factory) -> Path:
    """A bow, a wave, a squat and a bow by somebody else, each with 60 frames, 14 frames between them."""
    root = tmp_path_factory.mktemp("takes")
    order = ("bow", "wave", "squat", "bow")
    parts = [write_move(root / f"part{k}.bvh", move, 50 + k, n_frames=60) for k, move in enumerate(order)]
    path = root / "take.trc"
    write_motion(join(*parts), path)
    return path


@pytest.fixture(scope="session")
def _bytes_with_take(long_moves, take_file, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("library") / "moves.dousa"
    with Library.open(path, create=True) as library:
        library.add(long_moves, performer_from=r"name:_(p\d)", n_jobs=1)
        library.train(n_trees=30)
        library.add(take_file, kind="take", n_jobs=1)
    return path.read_bytes()


@pytest.fixture
def path_with_take(_bytes_with_take, tmp_path) -> Path:
    path = tmp_path / "moves.dousa"
    path.write_bytes(_bytes_with_take)
    return path


@pytest.fixture
def library(path_with_take):
    with Library.open(path_with_take) as opened:
        yield opened


def change(path: Path, statement: str) -> None:
    run_sql(path, statement)


def count(path: Path, table: str) -> int:
    return run_sql(path, f"SELECT count(*) FROM {table}")[0][0]


def where(start: float) -> int:
    """Which part of the take a moment lies in."""
    return int(start * RATE / 74)


def test_a_take_is_kept_and_teaches_nothing(library, take_file):
    stats = library.stats()
    assert (stats.n_clips, stats.n_takes, stats.n_trained, stats.n_learned) == (15, 1, 15, 0)
    assert stats.take_seconds == pytest.approx((4 * 60 + 3 * 14) / RATE)
    assert stats.forest_is_current
    assert stats.n_unlabelled == 0
    (take,) = (clip for clip in library.clips() if clip.kind == "take")
    assert (take.path, take.category, take.predicted_category) == (str(take_file), None, None)
    assert library.trajectories(take.id).n_frames == 282
    assert library.train(n_trees=5).n_clips == 15


def test_a_take_is_no_answer_to_a_search(library, take_file):
    assert len(library.search(1, 100).results) == 15
    (take,) = library.clips(take_file)
    with pytest.raises(LibraryError, match=r"is the take .*dousa find, dousa label"):
        library.search(take.id)
    assert len(library.search(take_file, 100).results) == 15  # as a motion it can be asked for


def test_a_file_stays_the_kind_it_is(library, long_moves, take_file):
    clip = long_moves / "bow" / "bow_p0.bvh"
    report = library.add([clip, take_file], kind="take")
    assert (report.other_kind, len(report.unchanged)) == ((str(clip),), 2)
    assert library.add([clip, take_file], category_from="none").other_kind == (str(take_file),)
    assert library.stats().n_takes == 1


def test_a_take_that_changed_stays_a_take(library, write_move, tmp_path):
    path = write_move(tmp_path / "session.bvh", "wave", n_frames=90)
    library.add(path, kind="take")
    write_move(path, "squat", n_frames=120)
    assert library.add(path).replaced == (str(path),)
    (take,) = library.clips(path)
    assert (take.kind, take.n_frames) == ("take", 120)
    assert library.find(1, path, k=1).n_takes == 1


def test_another_kind_is_refused(library, take_file):
    with pytest.raises(OptionError, match="kind: expected 'clip' or 'take', got 'film'"):
        library.add(take_file, kind="film")


def test_a_take_is_removed_with_its_windows(library, path_with_take, take_file):
    assert count(path_with_take, "take_windows") == 1
    library.relabel(take_file, performer="somebody")
    assert library.remove(performer="somebody") == [str(take_file)]
    assert count(path_with_take, "take_windows") == 0
    assert library.stats().forest_is_current  # nothing was learned from it
    with pytest.raises(LibraryError, match=r"holds no takes.*dousa add --takes"):
        library.find(1)


def test_what_is_like_the_query_is_found(library, long_moves, take_file, write_move, tmp_path):
    result = library.find(write_move(tmp_path / "q.bvh", "bow", 99, n_frames=60), k=4)
    assert (result.n_takes, result.skipped) == (1, ())
    assert result.seconds == pytest.approx(9.4, abs=0.1)
    first, second = result.results[:2]
    assert {where((place.start + place.end) / 2) for place in (first, second)} == {0, 3}
    assert [place.rank for place in result.results] == list(range(1, len(result.results) + 1))
    chances = [place.probability for place in result.results]
    assert None not in chances
    assert chances == sorted(chances, reverse=True)
    assert first.score > 2 * result.results[2].score
    assert (first.take, first.mirrored) == (str(take_file), False)


def test_kept_and_given_takes_give_the_same_answer(library, take_file):
    kept = library.find(1, k=3)
    (number,) = (clip.id for clip in library.clips(take_file))
    assert library.find(1, number, k=3) == kept
    assert library.find(1, [take_file], k=3).results == kept.results
    assert library.find(1, take_file.parent, k=3).n_takes == 5  # its parts lie there too
    library.remove(take_file)
    fresh = library.find(1, take_file, k=3)
    assert [place.clip_id for place in fresh.results] == [None] * 3
    assert [place.to_json() | {"clip_id": number} for place in fresh.results] == [
        place.to_json() for place in kept.results
    ]


def test_takes_that_memory_does_not_hold_give_the_same_answers(
    library, path_with_take, write_move, monkeypatch, tmp_path
):
    """They are read once for a motion and its mirror image, and again where a place is; warm ones not at all."""
    library.add(write_move(tmp_path / "other" / "b.bvh", "bow", 70), kind="take")
    query = write_move(tmp_path / "q.bvh", "wave", 80)
    expected = library.find(query, mirror=True)
    assert expected.n_takes == 2
    read = []
    unpack = TakeWindows.from_bytes
    monkeypatch.setattr(TakeWindows, "from_bytes", lambda data: read.append(data) or unpack(data))
    assert library.find(query, mirror=True) == expected and not read
    for most, n_read in ((0, {4, 5, 6}), (1 << 29, {2})):
        monkeypatch.setitem(takes.Takes._read.__kwdefaults__, "room", most)
        with Library.open(path_with_take) as other:
            read.clear()
            assert other.find(query, mirror=True) == expected
            assert len(read) in n_read


def test_a_take_whose_file_is_gone_is_still_looked_into(library, write_move, tmp_path):
    path = write_move(tmp_path / "gone.bvh", "squat", 60, n_frames=150)
    library.add(path, kind="take")
    path.unlink()
    assert {place.take for place in library.find(1, path, k=2).results} == {str(path)}
    assert library.label(path).take == str(path)


def test_a_mirrored_motion_is_found(library, write_move, tmp_path):
    from dousa.motion import canonicalise
    from dousa.motion.canonical.canonicalise import mirror_canonical

    wave = canonicalise(compute_trajectories(read_motion(write_move(tmp_path / "w.bvh", "wave", 71, n_frames=60))))
    mirrored = mirror_canonical(wave)
    plain = library.find(mirrored, k=1).results[0]
    better = library.find(mirrored, k=1, mirror=True).results[0]
    assert (better.mirrored, where(better.start + 1)) == (True, 1)
    assert better.score > plain.score
    assert not library.find(wave, k=1, mirror=True).results[0].mirrored


def test_bad_takes_are_told_and_the_others_are_looked_into(library, take_file, tmp_path):
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY")
    result = library.find(1, [bad, tmp_path / "none.bvh", take_file])
    assert result.n_takes == 1
    assert {Path(item.path).name for item in result.skipped} == {"bad.bvh", "none.bvh"}
    assert library.find(1, [bad]).results == ()


def test_a_take_named_twice_is_looked_into_once(library, take_file):
    (number,) = (clip.id for clip in library.clips() if clip.kind == "take")
    once = library.find(1, take_file)
    twice = library.find(1, [take_file, number, str(take_file)])
    assert (twice.n_takes, twice.results) == (1, once.results)


def test_a_rate_near_zero_is_refused(library, tmp_path):
    slow = replace(one_frame(30), frame_rate=1e-6)
    path = tmp_path / "slow.npz"
    write_motion(slow, path)
    (skipped,) = library.add(path, kind="take").skipped
    assert "1 Hz or more" in str(skipped.reason)
    for ask in (library.find, library.label, library.search):
        with pytest.raises(DousaError, match="1 Hz or more"):
            ask(path)


def test_a_stored_rate_near_zero_is_damage(path_with_take):
    change(path_with_take, "UPDATE clips SET frame_rate = 1e-9")
    seal_again(path_with_take)
    with Library.open(path_with_take) as library, pytest.raises(LibraryDamagedError, match="at 1e-09 Hz"):
        library.find(1)


@pytest.mark.parametrize("number", [2**31, 10**30, 0, -(10**30)])
def test_numbers_that_no_database_holds(library, number):
    for ask in (library.find, library.label, library.search, library.trajectories):
        with pytest.raises(LibraryError, match="no clip"):
            ask(number)
    with pytest.raises(LibraryError, match="no clip"):
        library.find(1, number)


def test_bad_questions(library, long_moves, tmp_path):
    with pytest.raises(OptionError, match="got 0"):
        library.find(1, k=0)
    with pytest.raises(LibraryError, match="no clip or take 99"):
        library.find(99)
    with pytest.raises(LibraryError, match="no clip or take 99"):
        library.find(1, 99)
    with pytest.raises(LibraryError, match="no clip or take 99"):
        library.label(99)
    with pytest.raises(MotionFileError, match="no such file"):
        library.label(tmp_path / "none.bvh")
    with pytest.raises(MotionFileError, match="expected one take, found 5 files"):
        library.label(long_moves / "bow")
    with pytest.raises(OptionError, match="threshold"):
        library.label(1, threshold=2)


def one_frame(frames: int = 1) -> Trajectories:
    standing = np.zeros((frames, len(CANONICAL_JOINTS), 3))
    standing[:, :, 1] = np.linspace(0, 1.7, len(CANONICAL_JOINTS))
    standing[:, :, 0] = np.linspace(-0.3, 0.3, len(CANONICAL_JOINTS))
    return Trajectories(CANONICAL_JOINTS, standing, RATE)


def test_a_take_of_one_frame(library, write_move, tmp_path):
    path = write_move(tmp_path / "short.bvh", n_frames=1)
    assert library.add(path, kind="take").added == (str(path),)
    result = library.find(2, path)
    assert (result.n_takes, result.results) == (1, ())
    (segment,) = library.label(path).timeline.segments
    assert segment.category is None
    with pytest.raises(InvalidMotionError, match=r"at least 0.27 s"):
        library.find(path)


def test_without_a_forest_takes_wait(empty_library, long_moves, take_file, path_with_take):
    empty_library.add(take_file, kind="take")
    for ask in (lambda: empty_library.find(1), lambda: empty_library.label(1), empty_library.live):
        with pytest.raises(NotTrainedError, match="dousa train"):
            ask()
    empty_library.add(long_moves)
    calls = []
    empty_library.train(n_trees=10, progress=lambda *call: calls.append(str(call[2])))
    assert "describing takes (1 of 1)" in calls
    assert len(empty_library.find(2, k=2).results) == 2


def test_a_take_is_labelled(library, take_file):
    labelled = library.label(take_file)
    timeline = labelled.timeline
    assert labelled.take == str(take_file)
    assert timeline.segments[0].start == 0
    assert timeline.segments[-1].stop == pytest.approx(timeline.duration) == pytest.approx(9.4, abs=0.1)
    at = [timeline.category_at((74 * part + 30) / RATE) for part in range(4)]
    assert sum(a == b for a, b in zip(at, ("bow", "wave", "squat", "bow"), strict=True)) >= 3
    assert all(one.category is None for one in library.label(take_file, threshold=1).timeline.segments)


def test_what_labels_takes_is_learned_once_and_kept(path_with_take, take_file):
    calls = []
    with Library.open(path_with_take) as library:
        first = library.label(take_file, progress=lambda *call: calls.append(call))
        assert not calls
    with Library.open(path_with_take) as library:
        assert library.label(take_file, progress=lambda *call: calls.append(call)) == first
        assert not calls
    change(path_with_take, "UPDATE forests SET labeller = NULL")
    with Library.open(path_with_take) as library:
        assert library.label(take_file, progress=lambda *call: calls.append(call)) == first
        assert calls


def test_a_library_that_cannot_be_written_labels_all_the_same(path_with_take, take_file):
    with Library.open(path_with_take, read_only=True) as library:
        assert library.label(take_file).timeline.segments
        assert library.find(1, k=1).results
        with pytest.raises(LibraryError, match="read-only"):
            library.add(take_file.parent, kind="take")


def test_live_answers_are_those_of_the_take(library, take_file):
    (take,) = library.clips(take_file)
    motion = library.trajectories(take.id)
    live = library.live(height=take.height)
    answers = [live.push(pose, frame / RATE) for frame, pose in enumerate(motion.positions)]
    told = [answer for answer in answers if answer is not None]
    assert len(told) >= 40
    last = live.finish()
    stretches = [segment for answer in (*told, last) for segment in answer.settled]
    assert {segment.category for segment in stretches} & {"bow", "wave", "squat"}
    with pytest.raises(OptionError, match="height"):
        library.live(height=-1)


def test_takes_are_described_anew_when_the_forest_learns(library, path_with_take, write_move, tmp_path):
    before = library.find(1, k=3)
    for seed in range(3):
        write_move(tmp_path / "in" / "wave" / f"new{seed}.bvh", "wave", 80 + seed, n_frames=60)
    assert library.add(tmp_path / "in").n_learned == 3
    stamps = run_sql(path_with_take, "SELECT take_windows.learned, forests.learned FROM take_windows, forests")
    assert stamps[0][0] == stamps[0][1]
    after = library.find(1, k=3)
    assert [place.start for place in after.results] == [place.start for place in before.results]
    # Interrupted before that: described when they are asked for.
    change(path_with_take, "UPDATE take_windows SET learned = 0")
    with Library.open(path_with_take) as again:
        assert again.find(1, k=3) == after
    assert not is_stale(path_with_take)


def is_stale(path):
    query = "SELECT count(*) FROM take_windows, forests WHERE take_windows.learned != forests.learned"
    return bool(run_sql(path, query)[0][0])


def test_a_training_that_memory_has_no_room_for_writes_windows_one_by_one(
    library, path_with_take, write_move, tmp_path, monkeypatch
):
    for k in range(2):
        library.add(write_move(tmp_path / "other" / f"b{k}.bvh", "bow", 70 + k), kind="take")
    query = "SELECT clip_id, data FROM take_windows ORDER BY clip_id"
    steps, seen = [], []
    for most in (1 << 29, 0):
        monkeypatch.setitem(kept_windows.describe_takes.__kwdefaults__, "room", most)
        library.train(n_trees=30, progress=lambda done, total, what: steps.append((done, what.code)))
        seen.append(run_sql(path_with_take, query))
        assert library.check().is_sound
    assert len(seen[0]) == 3
    assert seen[0] == seen[1]
    assert steps[-1][0] == 6
    stale = "SELECT count(*) FROM take_windows, forests WHERE take_windows.learned != forests.learned"
    assert run_sql(path_with_take, stale) == [(0,)]


def test_windows_that_a_killed_program_left_behind_are_described_by_the_next(
    library, path_with_take, write_move, tmp_path, monkeypatch
):
    write_move(tmp_path / "in" / "wave" / "new.bvh", "wave", 80, n_frames=60)

    def kill(*args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("dousa.library.add.refresh_windows", kill)
        with pytest.raises(KeyboardInterrupt):
            library.add(tmp_path / "in")
    assert is_stale(path_with_take)
    assert library.add(tmp_path / "in").unchanged
    assert not is_stale(path_with_take)


def test_windows_are_not_kept_where_nothing_may_change(library, path_with_take):
    before = library.find(1, k=3)
    change(path_with_take, "UPDATE take_windows SET learned = 0")
    with Library.open(path_with_take, read_only=True) as again:
        assert again.find(1, k=3) == before
    assert is_stale(path_with_take)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE take_windows SET data = x'00'",
        "UPDATE take_windows SET data = substr(data, 1, 900)",
        "UPDATE forests SET window_lengths = '[3]'",
        "UPDATE forests SET window_lengths = '7'",
        "UPDATE forests SET calibration = x'00'",
        "UPDATE forests SET parameters = '{\"n_trees\": 30}'",
    ],
)
def test_damaged_windows(path_with_take, statement):
    change(path_with_take, statement)
    seal_again(path_with_take)
    with Library.open(path_with_take) as library, pytest.raises(LibraryDamagedError, match="dousa train"):
        library.find(1)


def test_a_damaged_labeller(path_with_take, take_file):
    with Library.open(path_with_take) as library:
        library.label(take_file)
    change(path_with_take, "UPDATE forests SET labeller = x'00'")
    with Library.open(path_with_take) as library, pytest.raises(LibraryDamagedError, match="train"):
        library.label(take_file)


def test_windows_of_another_forest_are_not_compared(path_with_take, take_file):
    with Library.open(path_with_take) as library:
        library.train(n_trees=7)
        ((data,),) = run_sql(path_with_take, "SELECT data FROM take_windows")
        library.train(n_trees=9)
    run_sql(path_with_take, "UPDATE take_windows SET data = ?", data)
    with Library.open(path_with_take) as library, pytest.raises(LibraryDamagedError, match="another forest"):
        library.find(1)


def test_a_joint_in_the_next_town_does_not_hinder(library, tmp_path):
    positions = one_frame(90).positions.copy()
    positions[40:45, CANONICAL_JOINTS.index("left_hand")] = 3e5
    path = tmp_path / "spike.npz"
    write_motion(Trajectories(CANONICAL_JOINTS, positions, RATE), path)
    assert library.add(path, kind="take").added == (str(path),)
    with Library.open(library.name) as again:
        assert again.find(1, path, k=1).n_takes == 1
