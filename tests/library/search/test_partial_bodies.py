"""Bodies that lack joints: added, searched, classified, found and labelled by the joints that are there."""

import json
import math

import numpy as np
import pytest

from dousa.errors import InvalidMotionError, JointMappingError, LibraryDamagedError
from dousa.formats import write_motion
from dousa.formats.motion_files import read_canonical
from dousa.library import Library, take_labellers
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.retrieval.forest.calibration import Calibration
from library.database_server import run_sql, seal_again

SIDES = ("left", "right")
ARMS = tuple(f"{side}_{joint}" for side in SIDES for joint in ("elbow", "wrist", "hand"))
LEGS = tuple(f"{side}_{joint}" for side in SIDES for joint in ("knee", "ankle", "toe"))
UPPER = ("spine", "neck", "head", "left_shoulder", "right_shoulder", *ARMS)
LOWER = ("pelvis", "spine", "left_hip", "right_hip", *LEGS)


def cut(path, absent):
    """The motion of a file as points of which some are never seen."""
    points = read_canonical(path)[0].to_trajectories()
    positions = np.array(points.positions)
    positions[:, [CANONICAL_JOINTS.index(joint) for joint in absent]] = np.nan
    return points.replace(positions=positions, rest_positions=None)


def names_of(result):
    return [hit.path for hit in result.results]


@pytest.fixture
def squat(moves):
    return moves / "squat" / "squat_p1.bvh"


@pytest.mark.parametrize(("absent", "missing"), [(UPPER, "the head and the arms"), (ARMS, "the arms")])
def test_legs_alone_find_whole_bodies_that_do_the_same(library, squat, absent, missing):
    result = library.search(cut(squat, absent), 5)
    assert result.category == "squat"
    assert names_of(result)[0] == str(squat)
    assert [hit.category for hit in result.results] == ["squat"] * 5
    assert {"left_elbow", "left_hand"} <= set(result.results[0].hidden) <= set(absent)
    assert [str(note) for note in result.notes] == [f"compared without {missing}: this body lacks them"]
    written = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert written["notes"] == [str(note) for note in result.notes]
    assert "left_hand" in written["results"][0]["compared_without"]


def test_an_upper_body_without_a_pelvis_is_recognised(library, moves):
    for move in ("wave", "bow"):
        assert library.search(cut(moves / move / f"{move}_p2.bvh", LOWER), 3).verdict.guess == move


def test_clips_of_parts_are_kept_and_found(library, moves, squat):
    before = library.search(squat, 20)
    report = library.add_motion(cut(squat, UPPER), "legs", "squat")
    assert report.added == ("legs",)
    assert [message.code for _, message in report.warnings if message.code.startswith("canonical.part")]
    clip = next(clip for clip in library.clips() if clip.path == "legs")
    assert set(clip.absent) == set(UPPER)
    stored = library.trajectories(clip.id)
    assert set(canonicalise(stored).absent) == set(UPPER)
    assert np.isnan(stored.positions[:, 2:4]).all()
    # A whole body finds it, behind whole ones that do the same, and it finds whole ones.
    after = library.search(squat, 20)
    assert "legs" in names_of(after)
    assert [name for name in names_of(after) if name != "legs"] == names_of(before)
    assert names_of(after)[0] == str(squat)
    hit = next(hit for hit in after.results if hit.path == "legs")
    assert set(hit.hidden) <= set(UPPER)
    assert all(not other.hidden for other in after.results if other is not hit)
    assert [note.code for note in after.notes] == ["partial.some_hits"]
    again = library.search(clip.id, 3)
    assert set(names_of(again)[:2]) == {"legs", str(squat)}
    assert again.verdict.guess == "squat"
    explained = library.search(clip.id, 2, explain=True, mirror=True)
    assert explained.verdict.explanation is not None
    assert explained.results[0].likeness is not None


def test_parts_that_share_nothing_are_left_out(library, squat):
    library.add_motion(cut(squat, ARMS + LEGS[:3]), "one leg", "squat")
    library.add_motion(cut(squat, LEGS), "no legs", "squat")
    result = library.search(cut(squat, UPPER), 30)
    assert "no legs" not in names_of(result)
    assert "one leg" in names_of(result)
    assert [note.code for note in result.notes] == ["partial.query", "partial.some_hits", "partial.left_out"]


def test_too_little_of_a_body_is_told(library, squat):
    lone = [joint for joint in CANONICAL_JOINTS if joint not in ("right_shoulder", "right_elbow", "right_wrist")]
    with pytest.raises(InvalidMotionError, match="which way it faces"):
        library.search(cut(squat, lone))
    with pytest.raises(JointMappingError):
        library.search(cut(squat, CANONICAL_JOINTS[1:]))


def test_the_forest_of_a_part_is_kept_until_clips_change(library_file, library, moves, squat):
    query = cut(squat, UPPER)
    with Library.open(library_file, read_only=True) as other:  # which cannot keep it
        assert other.search(query).category == "squat"
    answer = library.search(query).to_json()

    def read():
        return run_sql(library_file, "SELECT feature_set, learned_from FROM part_forests")

    (kept,) = read()
    assert kept[0].startswith("extended without neck head left_shoulder")
    ((calibration,),) = run_sql(library_file, "SELECT calibration FROM part_forests")
    # It learns from disturbed copies too: the space of the poses is one of the clips and of a copy of each.
    assert Calibration.from_bytes(calibration).poses.counts.sum() == 2 * len(library.clips())
    with Library.open(library_file, read_only=True) as other:
        assert other.search(query).to_json() == answer
    library.add_motion(cut(squat, UPPER), "legs")  # without a category nothing is learned anew
    assert library.search(query).results[0].path in ("legs", str(squat))
    assert read() == [kept]
    library.relabel(["legs"], category="squat")
    library.search(query)
    (again,) = read()
    assert again[0] == kept[0]
    assert again[1] != kept[1]


def test_the_forest_that_incomplete_clips_need_is_learned_with_the_training(library_file, library, moves, squat):
    library.add_motion(cut(squat, UPPER), "legs 1", "squat")
    library.add_motion(cut(moves / "squat" / "squat_p2.bvh", UPPER), "legs 2", "squat")
    library.add_motion(cut(squat, LEGS), "no legs", "squat")
    library.train(n_trees=10, random_state=0)

    def read():
        return run_sql(library_file, "SELECT feature_set, learned_from FROM part_forests")

    (kept,) = read()
    query = cut(moves / "wave" / "wave_p2.bvh", UPPER)
    answer = library.search(query)
    assert [hit.hidden for hit in answer.results][:1] == [tuple(kept[0].partition(" without ")[2].split())]
    assert kept in read()
    # Without it the answer is the same: only somebody waits for it.
    run_sql(library_file, "DELETE FROM part_forests")
    with Library.open(library_file) as other:
        assert other.search(query).to_json() == answer.to_json()


@pytest.mark.slow
def test_a_library_of_legs_alone(empty_library, moves):
    for path in sorted(moves.rglob("*.bvh")):
        empty_library.add_motion(cut(path, UPPER), path.stem, path.parent.name)
    report = empty_library.train(n_trees=10)
    assert (report.n_partial, report.n_clips) == (0, 15)
    assert {"left_hand", "head"} <= set(report.hidden)
    squats = [clip for clip in empty_library.clips() if clip.category == "squat"]
    assert all(clip.predicted_category == "squat" for clip in squats)
    whole = moves / "squat" / "squat_p3.bvh"
    result = empty_library.search(whole, 3)
    assert names_of(result)[0] == "squat_p3"
    assert result.verdict.guess == "squat"
    # Another one is learned at once, as with whole bodies.
    assert empty_library.add_motion(cut(whole, (*UPPER, "left_toe")), "more", "squat").n_learned == 1


def test_few_parts_do_not_teach_the_forest_of_whole_bodies(library, moves):
    library.add_motion(cut(moves / "bow" / "bow_p0.bvh", LEGS), "no legs", "bow")
    report = library.train(n_trees=10)
    assert (report.n_partial, report.hidden, report.n_clips) == (1, (), 15)
    assert library.search(cut(moves / "bow" / "bow_p1.bvh", LEGS), 5).category == "bow"


def test_files_of_parts_are_classified(library, squat, tmp_path):
    path = tmp_path / "legs.trc"
    points = cut(squat, UPPER)
    kept = [row for row, name in enumerate(points.names) if name not in UPPER]
    names, positions = [points.names[row] for row in kept], points.positions[:, kept]
    write_motion(points.replace(names=names, positions=positions, parents=None), path)
    (answer,) = library.classify(path)
    assert answer.category == "squat"
    assert [note.code for note in answer.notes] == ["partial.query"]
    assert library.add(path, category_from=None).added == (str(path),)
    assert set(names_of(library.search(path, 2))) == {str(path), str(squat)}


def test_takes_of_parts_are_searched_and_labelled(library, moves, squat):
    take = [cut(moves / move / f"{move}_p0.bvh", UPPER) for move in ("wave", "squat", "bow", "squat")]
    joined = take[0].replace(positions=np.concatenate([part.positions for part in take]))
    library.add_motion(joined, "legs take", kind="take")
    (number,) = [clip.id for clip in library.clips() if clip.kind == "take"]
    found = library.find(squat, k=3)
    assert [note.code for note in found.notes] == ["partial.some_takes"]
    best = found.results[0]
    assert (best.take, best.clip_id) == ("legs take", number)
    assert min(abs(best.start - start) for start in (0.8, 2.4)) < 0.25
    assert all(math.isfinite(place.score) for place in found.results)
    assert library.find(cut(squat, ARMS), [joined], k=1).results[0].score > 0
    labelled = library.label(number)
    assert [note.code for note in labelled.notes] == ["partial.query"]
    json.dumps(labelled.to_json(), allow_nan=False)
    nothing = library.find(cut(squat, LEGS), k=3)
    assert [item.path for item in nothing.skipped] == ["legs take"]
    assert nothing.results == ()


@pytest.fixture
def learned(library, squat, monkeypatch):
    """The labellers of parts that were learned: all are the one of legs, as that takes seconds."""
    known, given = [], []
    learn = take_labellers.learn_labeller

    def learn_once(*arguments):
        if not known:
            known.append(learn(*arguments))
        given.append(known[0])
        return known[0]

    monkeypatch.setattr(take_labellers, "learn_labeller", learn_once)
    return given


def test_what_takes_of_parts_are_labelled_with_is_kept(library_file, library, squat, learned):
    take = cut(squat, UPPER)
    answer = library.label(take).to_json()
    assert library.label(take).to_json() == answer and len(learned) == 1
    with Library.open(library_file, read_only=True) as other:
        assert other.label(take).to_json() == answer and len(learned) == 1
    library.add_motion(cut(squat, UPPER), "legs")  # without a category nothing is learned anew
    with Library.open(library_file) as other:
        assert other.label(take).to_json() == answer and len(learned) == 1
    ((labeller,),) = run_sql(library_file, "SELECT labeller FROM part_forests")
    run_sql(library_file, "UPDATE part_forests SET labeller = NULL")
    with Library.open(library_file, read_only=True) as other:
        assert other.label(take).to_json() == answer and len(learned) == 2
    assert run_sql(library_file, "SELECT labeller FROM part_forests") == [(None,)]
    torn = bytes(labeller[:200]) + bytes([labeller[200] ^ 1]) + bytes(labeller[201:])
    run_sql(library_file, "UPDATE part_forests SET labeller = ?", torn)
    assert not library.check().is_sound
    with Library.open(library_file) as other, pytest.raises(LibraryDamagedError):
        other.label(take)
    assert library.check(repair=True).is_sound
    library.relabel(["legs"], category="squat")
    library.label(take)
    assert len(learned) == 3


def test_damaged_joints_are_told(library_file, library, squat):
    library.add_motion(cut(squat, UPPER), "legs")
    run_sql(library_file, "UPDATE clips SET absent = 'tail' WHERE path = 'legs'")
    seal_again(library_file)
    number = next(clip.id for clip in library.clips() if clip.path == "legs")
    with pytest.raises(LibraryDamagedError, match="legs"):
        library.trajectories(number)


def read_part(library_file):
    columns = "learned_from, forest, calibration, clip_ids, leaves, poses"
    (row,) = run_sql(library_file, f"SELECT {columns} FROM part_forests")
    return row


def add_later(library, moves, names):
    for name in names:
        move = name.partition("_")[0]
        library.add_motion(cut(moves / move / f"{name}.bvh", ("left_hand",)), f"{name} later", f"later {move}")


@pytest.mark.slow
def test_the_forest_of_a_part_grows_by_clips_that_are_added(library_file, library, moves, squat, monkeypatch):
    """Nothing is trained again, what it knew it still knows, and in whatever portions it learns the same."""
    query, before = cut(squat, UPPER), read_canonical(moves / "wave" / "wave_p1.bvh")[0]
    library.search(query)
    names = ["squat_p1", "squat_p3", "wave_p0", "bow_p2"]
    with monkeypatch.context() as patch:
        patch.setattr("dousa.library.search.part_forests.fit_forest", None)
        add_later(library, moves, names[:2])
        library.add_motion(cut(squat, ("right_hand",)), "nobody knows")
        assert library.search(cut(squat, UPPER), 3).category in ("squat", "later squat")
        add_later(library, moves, names[2:])
        answer = library.search(query, 20).to_json()
    assert {f"later {move}" for move in ("squat", "wave", "bow")} <= {one["category"] for one in answer["results"]}
    assert library.search(before.to_trajectories(), 1).results[0].category in ("wave", "later wave")
    grown = read_part(library_file)
    # Asked for after all of them had come, it is trained with those of the training and grows by the others at once.
    run_sql(library_file, "DELETE FROM part_forests")
    with Library.open(library_file) as other:
        assert other.search(query, 20).to_json() == answer
    again = read_part(library_file)
    assert (again[0], again[3]) == (grown[0], grown[3])
    # A training teaches it all of them alike.
    library.train(n_trees=10, random_state=0)
    library.search(query)
    assert read_part(library_file)[0] != grown[0]


def test_the_forest_of_a_part_knows_nothing_of_clips_that_went(library_file, library, moves, squat):
    query = cut(squat, UPPER)
    library.search(query)
    first = read_part(library_file)[0]
    add_later(library, moves, ["bow_p2", "bow_p3"])
    library.search(query)
    assert read_part(library_file)[0] != first
    library.remove(["bow_p2 later", "bow_p3 later"])
    library.search(query)
    assert read_part(library_file)[0] == first
    assert not any(hit.category == "later bow" for hit in library.search(query, 30).results)
