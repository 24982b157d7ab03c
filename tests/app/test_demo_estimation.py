"""The demonstration's third act."""

import io
import re

import numpy as np
import pytest
from rich.console import Console

import dousa.app.pictures.overlay
import dousa.app.pictures.overlay_sheet
from dousa.app.demo import run_estimation_demo, write_performance
from dousa.estimation.body.human import make_human
from dousa.estimation.silhouettes.mask_npz import read_silhouettes, read_stature, read_true_joints
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise


@pytest.fixture
def undrawn(monkeypatch):
    """Drawings that are made in no time."""

    def write(estimate, views, cameras, path, **options):
        path.write_bytes(b"drawn")

    monkeypatch.setattr(dousa.app.pictures.overlay, "write_overlay", write)
    monkeypatch.setattr(dousa.app.pictures.overlay_sheet, "draw_overlay_sheet", write)


@pytest.mark.slow
def test_the_tracker_itself_does_it(undrawn, tmp_path):
    console = Console(file=io.StringIO(), width=300)
    run_estimation_demo(console, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names >= {"performed.bvh", "seen.npz", "estimated.bvh", "estimated.mp4", "estimated.png", "report_estimated"}
    assert not [name for name in names if name.startswith(".")]
    assert read_motion(tmp_path / "estimated.bvh").n_frames == read_silhouettes(tmp_path / "seen.npz").n_frames
    told = console.file.getvalue()
    off, held = re.search(r"mean joint error (\d+) mm \(holding the true first pose: (\d+) mm", told).groups()
    assert int(off) < 60 < int(held) and "0 frames lost" in told
    grades = re.search(r"teacher: grade (\d+) .*really was: (\d+)", told).groups()
    assert abs(int(grades[0]) - int(grades[1])) < 25


def test_the_performer_is_not_the_model(tmp_path):
    stature = write_performance(tmp_path / "performed.bvh", tmp_path / "seen.npz", 3)
    assert read_stature(tmp_path / "seen.npz") == stature
    model = make_human(stature)
    places = dict(zip(*map(list, _by_joint(tmp_path / "seen.npz")), strict=True))
    lengths = {
        "arm": (("left_shoulder", "left_elbow"), model.joints.index("left_elbow")),
        "leg": (("left_hip", "left_knee"), model.joints.index("left_knee")),
    }
    for (first, second), joint in lengths.values():
        own = np.linalg.norm(places[first] - places[second], axis=1).mean()
        assert abs(own / np.linalg.norm(model.offsets[joint]) - 1.0) > 0.02
    moved = canonicalise(read_motion(tmp_path / "performed.bvh")).positions
    assert np.ptp(moved[:, :, 1], axis=0).max() > 0.3  # a kick


def _by_joint(path):
    names, positions = read_true_joints(path)
    return names, np.moveaxis(positions, 1, 0)
