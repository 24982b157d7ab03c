"""Random damage to cameras, masks, keypoints, bodies and offsets: every outcome is an answer or a DousaError.

In bounded time and memory; ``DOUSA_FUZZ_SECONDS`` seconds over all kinds, 1 by default.
"""

from pathlib import Path

import numpy as np
import pytest
from oracles.calibration_files import POSE2SIM, QUALISYS, ROS, turned_view, write, write_opencv

from dousa.estimation import make_human
from dousa.estimation.body.body_file import read_body, write_body
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.cameras.camera_files import read_cameras, write_cameras
from dousa.estimation.cameras.camera_formats import cameras_to_arrays
from dousa.estimation.keypoints.keypoint_files import read_keypoint_npz, write_keypoints
from dousa.estimation.keypoints.keypoints import PersonTrack, ViewKeypoints
from dousa.estimation.silhouettes.mask_npz import read_silhouettes, read_stature, read_true_joints, write_silhouettes
from dousa.estimation.sync.synchronise import Synchronisation, read_offsets, write_offsets
from fuzzing import fuzz

pytestmark = pytest.mark.fuzz


def read_masks(path: Path) -> None:
    """All that an npz of silhouettes holds."""
    silhouettes = read_silhouettes(path)
    for frame in range(silhouettes.n_frames):
        silhouettes.read(frame)
    read_stature(path)
    read_true_joints(path)
    read_cameras(path)


def read_finite_cameras(path: Path) -> None:
    assert all(np.isfinite(view.to_row()).all() for view in read_cameras(path))


def make_track() -> PersonTrack:
    """A person in three frames."""
    points = np.random.default_rng(0).uniform(0, 100, (3, 2, 2))
    return PersonTrack(points=points, visibility=np.ones((3, 2)))


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """Sound files by kind, and what reads each."""
    folder = tmp_path_factory.mktemp("sound")
    ring = make_ring(2, size=(32, 24))
    write_cameras(folder / "cameras.toml", ring)
    for suffix in ("yml", "xml", "json"):
        write_opencv(folder / f"cameras.{suffix}", turned_view())
    np.savez(folder / "cameras.npz", **cameras_to_arrays(ring))
    others = {"qualisys.txt": QUALISYS, "pose2sim.toml": POSE2SIM, "ros.yaml": ROS}
    cameras = [write(folder, text, name) for name, text in others.items()]
    cameras += [folder / f"cameras.{suffix}" for suffix in ("toml", "yml", "xml", "json", "npz")]
    masks = np.random.default_rng(1).random((2, 3, 24, 32)) > 0.5
    write_silhouettes(folder / "masks.npz", masks, ring, 30.0, stature=1.7)
    np.savez(folder / "plain.npz", mask=masks)
    keypoints = ViewKeypoints(names=("nose", "left_hip"), people=(make_track(),), times=[0, 0.1, 0.2], size=(100, 80))
    write_keypoints(folder / "points.npz", keypoints)
    write_body(make_human(), folder / "body.toml")
    found = Synchronisation(
        np.array([0.0, 0.2]), np.array([0.0, 0.01]), ("reference", "sound"), (0, 0), np.zeros(2), 0.1
    )
    write_offsets(folder / "offsets.toml", ["a", "b"], found)
    return {
        "cameras": (cameras, read_finite_cameras),
        "masks": ([folder / "masks.npz"], read_masks),
        "plain masks": ([folder / "plain.npz"], lambda path: read_silhouettes(path, 30.0)),
        "keypoints": ([folder / "points.npz"], read_keypoint_npz),
        "body": ([folder / "body.toml"], read_body),
        "offsets": ([folder / "offsets.toml"], lambda path: read_offsets(path, ["a", "b"])),
    }


KINDS = ("cameras", "masks", "plain masks", "keypoints", "body", "offsets")


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_of_estimation(tmp_path, seeds, kind):
    files, read = seeds[kind]
    fuzz(tmp_path, files, read, share=1 / len(KINDS))
