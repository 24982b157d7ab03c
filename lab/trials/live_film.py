"""Films played to the studio's Live as a camera: the labels, and how far the place in the picture is to be trusted.

    python -m lab.trials.live_film ../shared/data [--model full]

A library of ten kinds of made motion labels the film `one_view_walk`: as it is, where the surest person is a man on a
roof (jumping jacks, then a somersault), and from 1.5 to 6.5 s with the roof's part of each picture grey, where only the
woman who walks is left. *On the spot* the hips stay in one place, as before the picture told it. Then the speed of the
hips of Pose2Sim's man, smoothed as the labeller does, beside the reference: across, up, and along the line of sight,
where the depth is the usual focal length over the scale. Needs the models (``dousa keypoints --install``).
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from dousa.app.demo import PERFORMER_RULE, write_library
from dousa.app.studio.content import live
from dousa.estimation import read_cameras
from dousa.formats.registry import read_motion
from dousa.library import Library
from dousa.retrieval.features.channels import smooth_positions

KINDS = "walk march arm_circles bow clap jump jumping_jack kick_left kick_right lunge".split()
ROOF, WOMAN = 420, slice(45, 196)  # px, frames of `one_view_walk`


def play(film, roof=0, frames=slice(None)):
    """Return the size of the pictures and the time and person of each in which one is seen; ``roof`` px are grey."""
    capture, find, seen = cv2.VideoCapture(str(film)), live.open_finder(), []
    rate, size = capture.get(cv2.CAP_PROP_FPS), (capture.get(3), capture.get(4))
    for number in range(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))[frames]:
        while capture.get(cv2.CAP_PROP_POS_FRAMES) <= number:
            picture = capture.read()[1]
        picture[:roof] = 128
        person = find(picture[..., ::-1].copy())
        if person is not None:
            seen.append((number / rate, person))
    return size, seen


def label(library, size, seen, *, placed):
    labeller, told = library.live(), Counter()
    for time, person in seen:
        points = live.to_canonical(person, size)
        if not placed:  # hips in one place, the lower foot on the floor
            points -= (points[0, 0], points[:, 1].min(), 0.0)
        answer = labeller.push(points, time)
        told[answer.category if answer is not None else "none"] += answer is not None
    return ", ".join(f"{name or 'unknown'} {many}" for name, many in told.most_common() if many)


def measure_places(data, film, usual=0.85):
    """Print the RMS of the hips' true speed and of the error of the seen one (m/s): across, up, along the sight."""
    truth = read_motion(data / "Balancing_for_IK.trc")
    hips = truth.positions[:, [truth.names.index(name) for name in ("RHip", "LHip")]].mean(axis=1)
    camera = next(one for one in read_cameras(data / "calibration" / "Calib.qca.txt") if one.name == film.stem)
    size, seen = play(film)
    places = []
    for _, person in seen:
        place = live.to_canonical(person, size)[0]
        scale = np.std(person.points, axis=0).sum() / np.std(person.world[:, :2], axis=0).sum()
        places.append((place[0], place[1], -usual * max(size) / scale))
    count = min(len(places), len(hips))  # image t is the reference's frame t - 1
    there = hips[: count - 1] @ np.asarray(camera.rotation).T * (1.0, -1.0, -1.0)
    speeds = [np.diff(smooth_positions(some[:, None], 4.0)[:, 0], axis=0) * 60.0
              for some in (there, np.array(places)[1:count])]  # fmt: skip
    rows = speeds[0], speeds[1] - speeds[0]
    print(f"| {film.stem} | " + " | ".join(f"{np.sqrt((row**2).mean(axis=0)).round(2)}" for row in rows) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--model", default="full")
    asked = parser.parse_args()
    live.choose_model = lambda: asked.model
    film = asked.data / "films" / "one_view_walk" / "demo.mp4"
    with tempfile.TemporaryDirectory() as folder:
        write_library(Path(folder) / "motions", n_performers=6, categories=KINDS)
        with Library.open(Path(folder) / "made.dousa", create=True) as library:
            library.add([Path(folder) / "motions"], performer_from=PERFORMER_RULE)
            library.train(n_trees=100)
            for name, how in (("whole film", {}), ("woman alone", {"roof": ROOF, "frames": WOMAN})):
                size, seen = play(film, **how)
                for word, placed in (("on the spot", False), ("placed", True)):
                    print(f"| {name} | {word} | {label(library, size, seen, placed=placed)} |", flush=True)
    for film in sorted((asked.data / "pose2sim" / "videos").glob("*.mp4")):
        measure_places(asked.data / "pose2sim", film)


if __name__ == "__main__":
    main()
