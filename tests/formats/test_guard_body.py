"""What a body can be, in every format that can break it: sizes, the tree, lengths of bones, left and right."""

import dataclasses

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa import read_motion, write_motion
from dousa.formats.guard import check_body, keep_offsets
from dousa.motion import Motion, Skeleton, Trajectories, canonicalise, fit_motion
from dousa.motion.canonical.reference_frame import infer_reference_frame

POINTS, TREES = ("trc", "c3d", "csv"), ("bvh", "glb", "csv")


def _codes(motion: Motion | Trajectories) -> list[str]:
    return [note.code for note in motion.provenance.notes if note.code.startswith("guard.")]


def _exchange(names: tuple[str, ...], *parts: str) -> tuple[str, ...]:
    """Names with left and right exchanged where a part of the name is among these."""
    other = {"left": "right", "right": "left"}
    return tuple(
        f"{other[name.partition('_')[0]]}_{name.partition('_')[2]}" if name.partition("_")[2] in parts else name
        for name in names
    )


def _body() -> Motion:
    """The walking body as a rig of the 20 joints."""
    return fit_motion(walking_body())


@pytest.mark.parametrize("suffix", POINTS)
@pytest.mark.parametrize(
    ("parts", "code"),
    [
        ((), []),
        (("shoulder", "elbow", "wrist", "hand"), ["guard.crossed"]),
        (("hip", "knee", "ankle", "toe"), ["guard.crossed"]),
        (("knee",), ["guard.exchanged"]),
        (("knee", "ankle", "toe"), ["guard.exchanged"]),
        (("shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "toe"), []),  # said as mirrored, see below
    ],
)
@pytest.mark.parametrize("still", [False, True])
def test_left_and_right_of_points(suffix, parts, code, still, tmp_path) -> None:
    body = canonicalise(walking_body()).to_trajectories()
    if still:
        body = body.replace(positions=np.repeat(body.positions[:1], 12, axis=0))
    path = tmp_path / f"walk.{suffix}"
    write_motion(Trajectories(_exchange(body.names, *parts), body.positions, 30.0), path)
    assert _codes(read_motion(path)) == code
    if len(parts) > 4:
        assert "canonical.mirrored" in [note.code for note in canonicalise(read_motion(path)).warnings]


@pytest.mark.parametrize("suffix", TREES)
@pytest.mark.parametrize("share", [0.0, 0.004, 0.3])
def test_a_bone_that_stretches(suffix, share, tmp_path) -> None:
    body = _body()
    knee = body.skeleton.names.index("left_knee")
    places = body.translations.copy()
    places[7, knee] *= 1 + share
    path = tmp_path / f"walk.{suffix}"
    write_motion(dataclasses.replace(body, translations=places, provenance=None), path)
    read = read_motion(path)
    assert _codes(read) == (["guard.stretched"] if share > 0.01 else [])
    if share > 0.01:
        assert "left_knee" in str(read.provenance.notes[-1]) and "frame 8" in str(read.provenance.notes[-1])


@pytest.mark.parametrize("suffix", TREES)
@pytest.mark.parametrize("every", [True, False])
def test_joints_that_hang_on_nothing(suffix, every, tmp_path) -> None:
    """All joints on the root, or only the knees: the places are right, the tree is not."""
    body = walking_body()
    parents = np.where(body.parents < 0, -1, 0) if every else body.parents.copy()
    names = body.names
    if not every:
        parents[[names.index("LeftLeg"), names.index("RightLeg")]] = 0
    rest = body.positions[0]
    local = np.stack([body.positions[:, j] - (body.positions[:, p] if p >= 0 else 0) for j, p in enumerate(parents)], 1)
    offsets = rest - np.where(parents[:, None] >= 0, rest[parents], 0.0)
    turns = np.zeros((body.n_frames, len(names), 4))
    turns[..., 0] = 1.0
    path = tmp_path / f"flat.{suffix}"
    write_motion(Motion(Skeleton(names, parents, offsets), turns, local, 30.0), path)
    read = read_motion(path)
    assert "guard.loose" in _codes(read)
    assert canonicalise(read).stature == pytest.approx(canonicalise(body).stature, rel=0.05)


@pytest.mark.parametrize("suffix", TREES)
def test_places_that_were_left_empty(suffix, tmp_path) -> None:
    body = _body()
    places = body.translations.copy()
    places[:, 1:] = 0.0
    path = tmp_path / f"empty.{suffix}"
    write_motion(dataclasses.replace(body, translations=places, provenance=None), path)
    read = read_motion(path)
    if suffix == "csv":  # holds no offsets: nothing is left of the body
        assert _codes(read) == ["guard.no_size"]
        return
    assert _codes(read) == ["guard.empty_places"]
    assert canonicalise(read).height == pytest.approx(canonicalise(body).height, rel=1e-3)


def test_zero_places_of_reported_files(shared_data) -> None:
    read = read_motion(shared_data("reported") / "bvh_positions_all_zero" / "zero.bvh")
    assert _codes(read) == ["guard.empty_places"]
    assert 1.7 < canonicalise(read).stature < 2.0


@pytest.mark.parametrize("suffix", POINTS)
def test_a_body_in_one_point(suffix, tmp_path) -> None:
    body = canonicalise(walking_body()).to_trajectories()
    path = tmp_path / f"point.{suffix}"
    write_motion(Trajectories(body.names, np.repeat(body.positions[:, :1], 20, axis=1), 30.0), path)
    assert "guard.no_size" in _codes(read_motion(path))


def test_places_that_move_are_kept() -> None:
    body = _body()
    places = body.translations.copy()
    places[:-1, 3] = 0.0
    kept, notes = keep_offsets(body.skeleton, places, np.arange(4))
    assert not notes and not kept[0, 3].any()


def test_recorded_people_have_nothing_to_be_said(shared_data) -> None:
    for path in sorted(shared_data("hdm05").rglob("*.amc"))[::20]:
        read = read_motion(path)
        frame = infer_reference_frame(canonicalise(read).to_trajectories())
        assert not check_body(read.skeleton.names, frame.body)
        assert not _codes(read)
