"""Keypoints of made-up films for tests of the studio: two people before three cameras, with plain films beside them."""

from pathlib import Path

import numpy as np

from app.made_landmarks import NAMES, OWN
from dousa.estimation import (
    PersonTrack,
    ViewKeypoints,
    make_human,
    make_ring,
    poses_from_motion,
    write_cameras,
    write_keypoints,
)
from dousa.estimation.multiview.landmarks import place_landmarks
from dousa.estimation.multiview.pose_residuals import place_points
from dousa.motion.synthetic.performers import draw_performer, make_motion

RATE, N_FRAMES, LATE = 30.0, 80, 12
SIZE = (320, 240)


def write_film_scene(folder: Path, *, with_films: bool = True) -> list[Path]:
    """Write ``view1.npz``, ... of three films, of which the third begins `LATE` frames late, ``cameras.toml``, and
    films of the same names in which the people are discs.

    Two people move; in the first view the other one is the first track. The keypoint files are returned.
    """
    cameras = make_ring(3, size=SIZE, focal=250.0)
    body = make_human(1.75)
    poses = poses_from_motion(body, make_motion("throw", draw_performer(3), frame_rate=RATE))[:N_FRAMES]
    other = poses[::-1].copy()
    other[:, 0] += 1.2
    rng = np.random.default_rng(0)
    paths = []
    for number, camera in enumerate(cameras):
        first = LATE if number == 2 else 0
        people = []
        for rows, sure in ((poses, 0.9), (other, 0.8)):
            places = place_points(body, rows, place_landmarks(body, OWN))[first:]
            points = camera.project(places) + rng.normal(0, 0.5, (*places.shape[:2], 2))
            people.append(PersonTrack(points, np.full(points.shape[:2], sure)))
        people = people if number else people[::-1]
        view = ViewKeypoints(NAMES, tuple(people), np.arange(len(people[0].points)) / RATE, camera.size)
        paths.append(folder / f"{camera.name}.npz")
        write_keypoints(paths[-1], view)
        if with_films:
            _write_film(paths[-1].with_suffix(".mp4"), view)
    write_cameras(folder / "cameras.toml", cameras)
    return paths


def _write_film(path: Path, view: ViewKeypoints) -> None:
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE, view.size)
    colours = ((60, 60, 200), (200, 120, 40))
    for frame in range(view.n_frames):
        canvas = np.full((view.size[1], view.size[0], 3), (190, 200, 205), np.uint8)
        for person, colour in zip(view.people, colours, strict=True):
            for point in person.points[frame]:
                cv2.circle(canvas, (int(point[0]), int(point[1])), 5, colour, -1)
        writer.write(canvas)
    writer.release()
