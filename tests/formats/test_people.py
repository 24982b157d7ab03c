"""Several people, or several animations, in one file: one is taken and the others named, in every format."""

import dataclasses
import pickle

import numpy as np
import pytest

from dousa.errors import MotionFileError, OptionError
from dousa.formats.parts import choose, distinguish, file_of, join_address, split_address
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, canonicalise, compute_trajectories
from dousa.motion.canonical.naming import group_owners
from formats import made_people as made


def write_two_pickled(path):
    names = made.write_points(path.with_suffix(".npz"), ":")
    with np.load(path.with_suffix(".npz")) as arrays:
        write_pickle(Trajectories(tuple(map(str, arrays["names"])), arrays["positions"], 30.0), path)
    return names


WRITERS = {
    "bvh": ("x.bvh", made.write_bvh),
    "bvh, equal names": ("x.bvh", made.write_equal_names),
    "c3d": ("x.c3d", lambda path: made.write_points(path, ":")),
    "c3d, underscores": ("x.c3d", lambda path: made.write_points(path, "_")),
    "trc": ("x.trc", lambda path: made.write_points(path, ":")),
    "npz": ("x.npz", lambda path: made.write_points(path, ":")),
    "pkl": ("x.pkl", write_two_pickled),
    "motive": ("x.csv", made.write_motive),
    "mvnx": ("x.mvnx", made.write_mvnx),
    "glb": ("x.glb", made.write_glb),
    "json": ("x.json", made.write_json),
    "json, numbered": ("x.json", lambda path: made.write_json(path, (4, 7))),
}


def place(motion):
    """Where the pelvis is on average, m: each person is elsewhere, and of another height."""
    return canonicalise(motion).positions[:, 0].mean(axis=0)


@pytest.mark.parametrize("form", WRITERS)
def test_one_of_several_people_is_taken_and_all_are_named(tmp_path, form):
    name, write = WRITERS[form]
    path = tmp_path / name
    names = write(path)
    first = read_motion(path)
    (note,) = [note for note in first.provenance.notes if note.code.startswith("parts.")]
    assert (note.code, note.values) == ("parts.person", {"read": names[0], "others": (names[1],)})
    np.testing.assert_allclose(place(first), place(made.ANNA), atol=2e-3)
    for chosen in (names[1], names[1].upper(), "2", 2):
        second = read_motion(path, person=chosen)
        (note,) = [note for note in second.provenance.notes if note.code.startswith("parts.")]
        assert (note.code, note.values) == ("parts.person_asked", {"read": names[1], "others": (names[0],)})
        np.testing.assert_allclose(place(second), place(made.BEN), atol=2e-3)
    address = join_address(path, {"person": names[1]})
    again = read_motion(address)
    np.testing.assert_array_equal(canonicalise(again).positions, canonicalise(second).positions)
    assert not canonicalise(again).absent
    with pytest.raises(MotionFileError) as caught:
        read_motion(path, person="Carol")
    assert caught.value.code == "parts.no_person" and caught.value.message.values["known"] == tuple(names)


def write_titles(motion, path):
    """A table with a header."""
    titles = ["time", *(f"{name}_{axis}" for name in motion.names for axis in "xyz")]
    rows = np.column_stack((np.arange(motion.n_frames) / 30, motion.positions.reshape(motion.n_frames, -1)))
    path.write_text("\n".join(",".join(map(str, row)) for row in (titles, *rows.tolist())))


def write_pickle(motion, path):
    path.write_bytes(pickle.dumps({"joints": motion.positions, "joint_names": list(motion.names), "fps": 30}))


def write_qualisys(motion, path):
    """Markers in mm, Z up."""
    points = (1000 * motion.positions[..., [0, 2, 1]] * (1, -1, 1)).reshape(motion.n_frames, -1)
    head = ("NO_OF_FRAMES\t20", "FREQUENCY\t30", "MARKER_NAMES\t" + "\t".join(motion.names))
    path.write_text("\n".join((*head, *("\t".join(map(str, row)) for row in points.tolist()))))


@pytest.mark.parametrize("mark", [":", "_"])
@pytest.mark.parametrize("form", ["trc", "c3d", "npz", "csv", "bones", "titles", "tsv", "bvh", "pkl"])
def test_the_owner_of_all_names_is_the_person(tmp_path, form, mark):
    """Names stay as they are, and are mapped as those without an owner."""
    path = tmp_path / f"x.{ {'titles': 'csv', 'bones': 'csv'}.get(form, form) }"
    skeleton = dataclasses.replace(
        made.BEN.skeleton, names=tuple(f"Ben{mark}{name}" for name in made.BEN.skeleton.names)
    )
    motion = dataclasses.replace(made.BEN, skeleton=skeleton)
    points = compute_trajectories(motion)
    write = {"titles": write_titles, "tsv": write_qualisys, "pkl": write_pickle}.get(form, write_motion)
    write(motion if form in ("bvh", "bones") else points, path)
    for asked in (None, "Ben", "1"):
        found = read_motion(path, person=asked)
        names = found.skeleton.names if isinstance(found, Motion) else found.names
        assert set(names) >= {name for name in skeleton.names if "_end" not in name}
        np.testing.assert_allclose(place(found), place(made.BEN), atol=2e-3)
    with pytest.raises(MotionFileError) as caught:
        read_motion(path, person="Ann")
    assert (caught.value.code, caught.value.message.values["known"]) == ("parts.no_person", ("Ben",))


@pytest.mark.parametrize("form", ["bvh", "glb"])
def test_who_was_taken_is_written_alone(tmp_path, form):
    name, write = WRITERS[form]
    write(tmp_path / name)
    ben = read_motion(tmp_path / name, person=2)
    assert (ben.skeleton.parents < 0).sum() == 1
    write_motion(ben, tmp_path / f"ben.{name}")
    again = read_motion(tmp_path / f"ben.{name}")
    np.testing.assert_allclose(
        compute_trajectories(again).positions[:, :3], compute_trajectories(ben).positions[:, :3], atol=2e-3
    )


def test_what_is_no_second_person_stays(tmp_path):
    """A prop, fingers with prefixes, a foot with a root of its own, markers of one person."""
    prop = Skeleton([f"stick{n}" for n in range(9)], [-1, *range(8)], np.tile([0, 0.1, 0], (9, 1)))
    stick = Motion(prop, np.tile([1.0, 0, 0, 0], (made.FRAMES, 9, 1)), np.tile(prop.offsets, (made.FRAMES, 1, 1)), 30.0)
    both = made.join([made.ANNA, stick], [str, str])
    write_motion(both, tmp_path / "x.bvh")
    assert read_motion(tmp_path / "x.bvh").skeleton.n_joints >= both.skeleton.n_joints
    points = compute_trajectories(made.ANNA)
    fingers = [f"{finger}_0{n}_{side}" for finger in ("thumb", "index") for n in range(1, 6) for side in "lr"]
    extra = np.tile(points.positions[:, :1], (1, len(fingers), 1))
    hand = Trajectories((*points.names, *fingers), np.concatenate([points.positions, extra], axis=1), 30.0)
    write_motion(hand, tmp_path / "x.trc")
    found = read_motion(tmp_path / "x.trc")
    assert found.names == hand.names and not any(note.code.startswith("parts.") for note in found.provenance.notes)


def test_a_part_that_an_array_cannot_have_is_refused(tmp_path):
    np.save(tmp_path / "x.npy", np.random.default_rng(1).normal(size=(9, 22, 3)))
    assert read_motion(tmp_path / "x.npy", person=1, animation="1").n_frames == 9
    for kind in ("person", "animation"):
        with pytest.raises(MotionFileError) as caught:
            read_motion(tmp_path / "x.npy", **{kind: "Walk"})
        assert caught.value.code == f"parts.one_{kind}"


@pytest.mark.parametrize("owners", [("A.", "B."), ("1_", "2_"), ("S1_", "S2_")])
def test_owners_of_one_letter_are_people(owners):
    names = compute_trajectories(made.ANNA).names
    assert list(group_owners(tuple(owner + name for owner in owners for name in names))) == [o[:-1] for o in owners]
    assert not group_owners(tuple(side + name for side in ("L_", "R_") for name in names))


@pytest.mark.parametrize("form", WRITERS)
def test_the_rate_of_any_format_can_be_given(tmp_path, form):
    name, write = WRITERS[form]
    write(tmp_path / name)
    motion = read_motion(tmp_path / name, frame_rate=120)
    assert (motion.frame_rate, motion.n_frames) == (120, made.FRAMES)
    with pytest.raises(OptionError):
        read_motion(tmp_path / name, frame_rate=0)


def test_addresses():
    for name in ("Walk", "Armature|Walk", "a/b#c&d=e%20 ü 歩く", "100%", " "):
        address = join_address("/tmp/moves.glb", {"animation": name, "person": "Anna"})
        assert split_address(address) == ("/tmp/moves.glb", {"animation": name, "person": "Anna"})
        assert file_of(address) == file_of(f"{address}#t=1.0,2.0") == "/tmp/moves.glb"
        assert address.rpartition("/")[0] == "/tmp"
    for plain in ("walk#3.bvh", "a.bvh", "take.bvh#t=1.0,2.0", "#person.bvh"):
        assert split_address(plain) == (plain, {})


def test_choosing():
    assert distinguish(["Walk", "Idle", "Walk", "Walk 2"]) == ["Walk", "Idle", "Walk 2", "Walk 2 2"]
    assert choose("x", "animation", ["a", "b", "c"], None, [1, 3, 3])[0] == 1
    assert choose("x", "animation", ["2", "1"], "1")[0] == 1  # a name before a number
    assert choose("x", "animation", ["only"], None) == (0, ())
