"""UsdSkel: a stage by hand through usd-core where it is installed, and what comes of its process without."""

import importlib.util

import numpy as np
import pytest

from dousa.errors import MotionFileError
from dousa.formats.exchange.usd import build_usd
from dousa.formats.registry import read_motion
from dousa.motion import compute_trajectories
from formats import made_usd as made
from formats.made_files import code_of, save

has_usd = importlib.util.find_spec("pxr") is not None
needs_usd = pytest.mark.skipif(not has_usd, reason="usd-core is not installed: pip install 'dousa[usd]'")


def arrays(n_frames=4):
    """What the process writes of a stage of two joints, the child 0.5 above its parent and turned in the frames."""
    eye = np.tile(np.eye(4), (n_frames, 2, 1, 1))
    eye[:, 0, 3, :3] = np.arange(3 * n_frames).reshape(n_frames, 3)
    eye[:, 1, 3, :3] = eye[:, 0, 3, :3] + (0, 0.5, 0)
    eye[1:, 1, :2, :2] = [[0, 1], [-1, 0]]  # for row vectors: x to y
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[1, 3, :3] = 0, 0.5, 0
    return {
        "names": np.array(["A", "A/B"]), "parents": np.array([-1, 0]), "rest": rest, "frames": eye,
        "rate": np.array([25.0]), "unit": np.array([1.0]), "up": np.array(["Z"]),
    }  # fmt: skip


def build(tmp_path, **changed):
    np.savez(tmp_path / "made.npz", **(arrays() | changed))
    return build_usd(tmp_path / "x.usda", tmp_path / "made.npz", unit=None, up="y")


def test_arrays_of_the_process(tmp_path):
    motion = build(tmp_path)
    assert (motion.skeleton.names, motion.frame_rate, motion.provenance.format) == (("A", "B"), 25.0, "usd")
    np.testing.assert_allclose(motion.skeleton.offsets, [[0, 0, 0], [0, 0.5, 0]], atol=1e-12)
    np.testing.assert_allclose(motion.rotations[0], [[1, 0, 0, 0]] * 2, atol=1e-12)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(motion.rotations[1, 1], [half, 0, 0, half], atol=1e-12)
    np.testing.assert_allclose(motion.translations[2], [[6, 7, 8], [0, 0.5, 0]], atol=1e-12)
    same = build(tmp_path, names=np.array(["A/X", "B/X"]))
    assert same.skeleton.names == ("A/X", "B/X")


def test_arrays_that_make_no_motion(tmp_path):
    for changed, code in (
        ({"parents": np.array([1, 0])}, "usd.tree"),
        ({"rate": np.array([0.0])}, "usd.finite"),
        ({"frames": np.full((2, 2, 4, 4), np.nan)}, "usd.finite"),
    ):
        with pytest.raises(MotionFileError) as caught:
            build(tmp_path, **changed)
        assert caught.value.code == code


def test_what_is_no_usd(tmp_path):
    assert code_of(save(tmp_path / "x.usda", b"hello")) == "exchange.other_content"


@pytest.mark.skipif(has_usd, reason="usd-core is installed")
def test_without_usd_core_the_extra_is_named(tmp_path):
    with pytest.raises(MotionFileError, match=r"pip install 'dousa\[usd\]'"):
        read_motion(save(tmp_path / "x.usda", made.make_usda()))


@needs_usd
@pytest.mark.parametrize("suffix", [".usda", ".usd"])
def test_a_stage_by_hand(tmp_path, suffix):
    motion = read_motion(save(tmp_path / f"x{suffix}", made.make_usda(moved=2, codes=30)))
    assert (motion.skeleton.names, motion.frame_rate) == (tuple(made.PLACES), 30.0)
    assert (motion.provenance.up, motion.provenance.up_source) == ("y", "declared")
    points = compute_trajectories(motion)
    at = {name: points.positions[:, points.names.index(name)] for name in points.names}
    np.testing.assert_allclose(at["Hips"], [[2, 1, 0], [2, 1.1, 0], [2, 1.2, 0]], atol=1e-6)
    np.testing.assert_allclose(at["LeftLeg"], [[2.1, 0.6, 0], [2.1, 1.5, 0], [2.1, 1.6, 0]], atol=1e-6)
    np.testing.assert_allclose(at["Spine"] - at["Hips"], [[0, 0.3, 0]] * 3, atol=1e-6)
    slow = read_motion(save(tmp_path / f"y{suffix}", made.make_usda(step=2, codes=60, up="Z", metres=0.01)), unit="cm")
    assert (slow.n_frames, slow.frame_rate, slow.provenance.up) == (3, 30.0, "z")
    np.testing.assert_allclose(compute_trajectories(slow).positions[0, 0], [0, 0, -0.01], atol=1e-8)


@needs_usd
def test_stages_without_motion(tmp_path):
    assert code_of(save(tmp_path / "a.usda", made.make_usda(animated=False))) == "usd.no_animation"
    assert code_of(save(tmp_path / "b.usda", b"#usda 1.0\n")) == "usd.no_skeleton"
    assert code_of(save(tmp_path / "c.usda", made.make_usda()[:900])) == "exchange.failed"
    assert code_of(save(tmp_path / "d.usdc", b"PXR-USDC" + bytes(100))) == "exchange.failed"
