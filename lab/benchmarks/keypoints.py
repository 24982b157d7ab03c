"""Keypoints of films: milliseconds a frame, and how far they are from the reference of Pose2Sim's four films.

    python -m lab.benchmarks.keypoints [--films FOLDER] [--threads N] [--models full,heavy] [--no-reprojection]

Needs the models (``dousa keypoints --install``); without them it says so and ends. Prints

- the networks alone on a picture of 1088 x 1920 pixels, with the crop's sampling and masks: the median of many runs;
- decoding, turning and converting a frame of a film;
- pixels between the keypoints of the man and the projected joints of the reference, which is itself some 3 cm off
  (about 10 px), by camera; the millimetres that these are at his distance; and the share of frames in which left and
  right of the legs or arms are exchanged. Image t belongs to frame t - 1 of the reference.

The peer would be MediaPipe itself, which runs the same networks; its package needs NumPy 1 and cannot be installed
beside dousa.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dousa.errors import KeypointError
from dousa.estimation import MEDIAPIPE_NAMES, Camera, ViewKeypoints, find_keypoints, read_cameras
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.pose_networks import LandmarkNetwork, PersonCrop, PersonDetector, Shrinker
from dousa.formats import read_motion
from dousa.motion import Trajectories
from lab.benchmarks.timing import take_turns
from lab.places import SHARED_DATA

_PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_JOINTS = [(f"{side}_{part}", f"{side[0].upper()}{part.capitalize()}") for part in _PARTS for side in ("left", "right")]
_SHARED = SHARED_DATA / "pose2sim"


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=Path, default=_SHARED, help="the folder pose2sim of the recordings")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--models", default="full,heavy")
    parser.add_argument("--no-reprojection", action="store_true")
    given = parser.parse_args()
    try:
        time_networks(given.threads)
    except KeypointError as error:
        print(error)
        return
    if not given.films.is_dir():
        print(f"no recordings at {given.films}: nothing more is measured")
        return
    time_decoding(given.films / "videos" / "cam03.mp4")
    if not given.no_reprojection:
        for model in given.models.split(","):
            measure_reprojection(given.films, model, given.threads)


def _measure(run: Callable[[], object]) -> float:
    """The median of several runs, in ms."""
    return 1000 * take_turns({"": run}, 30)[""].wall


def time_networks(threads: int) -> None:
    """Print the time of each network on a picture."""
    picture = np.random.default_rng(0).integers(0, 255, (1920, 1088, 3), dtype=np.uint8)
    crop = PersonCrop(540.0, 960.0, 1100.0, 0.1)
    detector = PersonDetector(threads)
    print(f"ms a picture of 1088 x 1920, {threads} threads, median of 30")
    print(f"  detector {_measure(lambda: detector.find(Shrinker(picture))):6.1f}")
    for model in ("lite", "full", "heavy"):
        network = LandmarkNetwork(model, threads)
        print(f"  {model:<8} {_measure(lambda network=network: network.find(Shrinker(picture), crop)):6.1f}")


def time_decoding(film: Path) -> None:
    """Print the time of reading a frame."""
    found = []
    with FilmFrames(film) as frames:
        start = time.perf_counter()
        for _ in frames.read():
            found.append(time.perf_counter() - start)
            start = time.perf_counter()
    print(f"  decoding {1000 * float(np.median(found)):6.1f}  (median of {len(found)} frames)")


def measure_reprojection(folder: Path, model: str, threads: int) -> None:
    """Print the distances of the keypoints of the man from the projected reference."""
    reference = read_motion(folder / "Balancing_for_IK.trc")
    assert isinstance(reference, Trajectories)
    print(f"{model}: mean, median px; mean mm; seen %; frames with sides exchanged %")
    means = []
    for camera in read_cameras(folder / "calibration" / "Calib.qca.txt"):
        view = find_keypoints(folder / "videos" / f"{camera.name}.mp4", model, threads=threads)
        off, exchanged, seen, millimetres = compare(view, camera, reference)
        means.append((off.mean(), millimetres.mean()))
        numbers = f"{off.mean():6.1f} {np.median(off):6.1f} {millimetres.mean():6.1f} {100 * seen:6.1f}"
        print(f"  {camera.name} {numbers} {100 * exchanged:6.1f}")
    mean = np.mean(means, axis=0)
    print(f"  mean  {mean[0]:6.1f}        {mean[1]:6.1f}")


def compare(
    view: ViewKeypoints, camera: Camera, reference: Trajectories
) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Distances (N,) in px of the calibration, share of frames with exchanged sides, share seen, distances in mm."""
    person = view.people[0]
    frames = [frame for frame in range(1, view.n_frames) if frame - 1 < reference.n_frames and person.present[frame]]
    joints = reference.positions[[frame - 1 for frame in frames]][
        :, [reference.names.index(name) for _, name in _JOINTS]
    ]
    projected = np.stack([camera.project(pose) for pose in joints])
    scale = np.array([camera.width, camera.height]) / np.array(view.size)
    points = (person.points[frames][:, [MEDIAPIPE_NAMES.index(name) for name, _ in _JOINTS]] + 0.5) * scale - 0.5
    off = np.linalg.norm(points - projected, axis=2)
    other = np.linalg.norm(points[:, [place ^ 1 for place in range(len(_JOINTS))]] - projected, axis=2)
    limbs = [[2, 3, 4, 5], [8, 9, 10, 11]]  # elbows and wrists, knees and ankles
    exchanged = np.any([other[:, limb].mean(axis=1) + 20 < off[:, limb].mean(axis=1) for limb in limbs], axis=0)
    depth = np.stack([camera.compute_depths(pose) for pose in joints])
    millimetres = 1000 * off * depth / float(camera.matrix[0, 0])
    return off.reshape(-1), float(exchanged.mean()), len(frames) / (view.n_frames - 1), millimetres.reshape(-1)


if __name__ == "__main__":
    main()
