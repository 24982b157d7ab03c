"""What a file held counts only for the arrays that were read from it: an edit is written, whatever the format keeps."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, compute_trajectories
from dousa.motion.rotations import from_euler

SUFFIXES = ("bvh", "glb", "trc")  # of the formats whose reader keeps more than arrays
EDITS = ("rotations", "translations", "offsets", "names", "frame_rate", "order", "part", "one value")


def make_motion(seed):
    rng = np.random.default_rng(seed)
    offsets = np.array([[0, 0.9, 0], [0, 0.5, 0], [0.2, -0.1, 0], [0, -0.4, 0.01]]) + rng.normal(0, 0.01, (4, 3))
    skeleton = Skeleton(("hips", "chest", "thigh", "shank"), [-1, 0, 0, 2], offsets)
    rotations = from_euler(np.cumsum(rng.normal(0, 0.2, (7, 4, 3)), axis=0), "YXZ")
    translations = np.tile(offsets, (7, 1, 1))
    translations[:, 0] += rng.normal(0, 0.1, (7, 3))
    return Motion(skeleton, rotations, translations, 25.0)


def edit(motion, what, rng):
    """The motion with some of its fields exchanged, as a person does it with ``dataclasses.replace``."""
    order = rng.permutation(motion.n_frames)[: motion.n_frames if what == "order" else 4]
    if isinstance(motion, Trajectories):
        moved = np.array(motion.positions)
        moved[(0, 0, 0) if what == "one value" else ...] += 1e-3
        changed = {"positions": motion.positions[order] if what in ("order", "part") else moved}
        if what in ("names", "frame_rate"):
            changed = {"names": tuple(name[::-1] for name in motion.names), "frame_rate": 2 * motion.frame_rate}
        return dataclasses.replace(motion, **changed)
    skeleton, rotations, translations = motion.skeleton, np.array(motion.rotations), np.array(motion.translations)
    if what in ("rotations", "one value"):
        rotations[(slice(None), 1) if what == "rotations" else (3, 1)] = from_euler(rng.normal(0, 0.5, 3), "YXZ")
    if what == "translations":
        translations[:, 0] += rng.normal(0, 0.3, 3)
    if what == "offsets":
        skeleton = dataclasses.replace(skeleton, offsets=1.25 * skeleton.offsets)
        translations *= 1.25
    if what == "names":
        skeleton = dataclasses.replace(skeleton, names=tuple(name[::-1] for name in skeleton.names))
    if what in ("order", "part"):
        rotations, translations = rotations[order], translations[order]
    rate = motion.frame_rate * (2 if what == "frame_rate" else 1)
    return dataclasses.replace(
        motion, skeleton=skeleton, rotations=rotations, translations=translations, frame_rate=rate
    )


def places_of(motion):
    return motion if isinstance(motion, Trajectories) else compute_trajectories(motion)


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from(EDITS))
def test_an_edited_motion_is_written_as_it_is(tmp_path_factory, suffix, seed, what):
    first, second = (tmp_path_factory.getbasetemp() / f"{name}.{suffix}" for name in ("first", "second"))
    write_motion(make_motion(seed), first)
    edited = edit(read_motion(first), what, np.random.default_rng(seed))
    write_motion(edited, second)
    source = edited.provenance
    declared = {"unit": source.unit, "up": source.up} if suffix == "bvh" else {}  # which declares neither
    got, wanted = places_of(read_motion(second, **declared)), places_of(edited)
    assert got.frame_rate == pytest.approx(wanted.frame_rate)
    columns = [got.names.index(name) for name in wanted.names]
    np.testing.assert_allclose(got.positions[:, columns], wanted.positions, atol=2e-6)


@pytest.mark.parametrize("suffix", ["bvh", "trc"])
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_motion_that_nobody_changed_is_written_byte_for_byte(tmp_path_factory, suffix, seed):
    first, folder = tmp_path_factory.getbasetemp() / f"same.{suffix}", tmp_path_factory.getbasetemp() / "again"
    folder.mkdir(exist_ok=True)
    write_motion(make_motion(seed), first)
    motion = read_motion(first)
    copied = {name: np.array(getattr(motion, name)) for name in ("rotations", "positions") if hasattr(motion, name)}
    for same in (motion, dataclasses.replace(motion, **copied)):
        write_motion(same, folder / first.name)
        assert (folder / first.name).read_bytes() == first.read_bytes()
