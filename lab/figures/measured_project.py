"""A project of Pose2Sim estimated by its folder: keypoints in its JSON, its calibration, its Config.toml; a motion out.

The keypoints are those of our network on the films, written as Pose2Sim writes them. The motion is compared with the
triangulation that lies beside (``Balancing_for_IK.trc``): hips, knees, ankles, shoulders, elbows and wrists; image t is
its frame t - 1.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from dousa.app.pipelines.estimate import estimate_sources
from dousa.app.requests.estimation import EstimationRequest, Outputs
from dousa.estimation import ViewKeypoints, find_keypoints, read_keypoints
from dousa.formats.registry import read_motion
from lab.figures.measured_films import LAG, POINTS

JOINTS = [name for name in POINTS if not name.endswith(("toe", "heel", "nose"))]


def measure_project(folder: Path, model: str, kept: Path | None) -> None:
    """Print the mean distance of twelve joints in mm; films of ``pose-sync`` start together, others do not."""
    films = sorted((folder / "videos").glob("*.mp4"))
    found = [
        find_keypoints(film, model) if kept is None else read_keypoints(kept / f"{film.stem}.npz") for film in films
    ]
    raw = read_motion(folder / "Balancing_for_IK.trc")
    truth = np.stack([raw.positions[:, raw.names.index(POINTS[name])] for name in JOINTS], axis=1)
    for views, place_of in (((0, 1, 2, 3), "pose-sync"), ((0, 3), "pose-sync"), ((0, 1, 2, 3), "pose")):
        with tempfile.TemporaryDirectory() as place:
            project = Path(place) / "trial"
            for view in views:
                write_openpose(project / place_of / f"{films[view].stem}_json", found[view])
            (project / "calibration").symlink_to((folder / "calibration").absolute())
            (project / "Config.toml").write_text("[project]\nframe_rate = 60\n", encoding="utf-8")
            outputs = Outputs((Path(place) / "out.trc",))
            (done,) = estimate_sources(EstimationRequest((project,), outputs=outputs), None, print)
            made = read_motion(Path(place) / "out.trc")
        ours = np.stack([made.positions[:, made.names.index(name)] for name in JOINTS], axis=1)
        frames = np.arange(max(0, -LAG), min(len(ours), len(truth) - LAG))
        off = 1e3 * np.linalg.norm(ours[frames] - truth[frames + LAG], axis=2)
        names = ", ".join(str(view + 1) for view in views)
        print(
            f"views {names}: {np.nanmean(off):.1f} mm over {len(frames)} frames, lost {int(done.estimate.lost.sum())}"
        )


def write_openpose(folder: Path, view: ViewKeypoints) -> None:
    """Write a file for each frame, as Pose2Sim does."""
    folder.mkdir(parents=True)
    for frame in range(view.n_frames):
        people = []
        for person in view.people:
            values = np.column_stack([np.nan_to_num(person.points[frame]), person.visibility[frame]])
            if person.present[frame]:
                people.append({"person_id": [-1], "pose_keypoints_2d": np.round(values, 3).reshape(-1).tolist()})
        path = folder / f"{folder.name.removesuffix('_json')}_{frame:06d}.json"
        path.write_text(json.dumps({"version": 1.3, "people": people}), encoding="utf-8")
