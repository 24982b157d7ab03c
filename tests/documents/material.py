"""Files for the commands of the documents that name a reader's own: all of them made by dousa itself.

`MATERIAL` and `RECORDED` are the whole list. What is not in it must come from an earlier command of the page or from
../shared/data.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.demo import write_dance
from dousa.app.pipelines.render import ring_around
from dousa.estimation import write_cameras
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_poses
from dousa.estimation.body.skeleton_body import body_from_motion
from dousa.estimation.raster.rendering import render
from dousa.estimation.silhouettes.mask_npz import write_silhouettes
from dousa.formats.registry import write_motion
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.trials.exercise_sets import join_repetitions

_CATEGORIES = ("bow", "clap", "kick_left", "walk")
_PERFORMERS = ("aa", "bb", "cc")
_SIZE, _N_FILMED, _GREY, _DARK = ((160, 120), 8, 150, 40)  # px, frames, grey levels of the room and of the person
_FILM_STATURE = 1.75


def _recordings(folder: Path) -> None:
    for category in _CATEGORIES:
        for number, name in enumerate(_PERFORMERS):
            path = folder / category / f"HDM_{name}_{category}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(category, draw_performer(number)), path)


def _motion(category: str, seed: int) -> Callable[[Path], None]:
    return lambda path: write_motion(make_motion(category, draw_performer(seed)), path)


def _points(category: str, seed: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        write_motion(compute_trajectories(make_motion(category, draw_performer(seed))), path)

    return write


def _exercise(n: int) -> Callable[[Path], None]:
    """So many squats in one recording, the third broken off where there are more than one."""

    def write(path: Path) -> None:
        performer = draw_performer(302)
        takes = [canonicalise(compute_trajectories(make_motion("squat", performer, take))) for take in range(24)]
        single = [take for take in takes if take.duration * performer.tempo < 3.6]
        chosen = [single[1 + number % (len(single) - 1)] for number in range(n)] if n > 1 else single[:1]
        several = join_repetitions(chosen, np.random.default_rng(5), broken_off=[2] if n > 1 else [])
        write_motion(several.motion.to_trajectories(), path)

    return write


def _annotated(folder: Path) -> None:
    """Takes of three people with tables of labels beside them."""
    folder.mkdir()
    for number in range(3):
        lines, parts, at = ["start_s,end_s,category"], [], 0.0
        for take, category in enumerate((*_CATEGORIES, *_CATEGORIES)):
            motion = canonicalise(compute_trajectories(make_motion(category, draw_performer(number), take)))
            parts.append(motion.positions)
            lines.append(f"{at:.3f},{at + motion.duration:.3f},{category if take else ''}")
            at += motion.duration
        write_motion(Trajectories(CANONICAL_JOINTS, np.concatenate(parts), 30.0), folder / f"p{number + 1}_day.trc")
        (folder / f"p{number + 1}_day.labels.csv").write_text("\n".join(lines), encoding="utf-8")


def _dances(folder: Path) -> None:
    folder.mkdir()
    write_dance(folder)


def _text(text: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(text, encoding="utf-8") and None


def _tracker(path: Path) -> None:
    """A program that says the frames of a walk, as the module `dousa.retrieval.takes.live` wants them."""
    motion = canonicalise(make_motion("walk", draw_performer(7)))
    lines = [
        json.dumps({"time": number / motion.frame_rate, "positions": frame.round(4).tolist()})
        for number, frame in enumerate(motion.positions)
    ]
    path.write_text("#!/bin/sh\ncat <<'END'\n" + "\n".join(lines) + "\nEND\n", encoding="utf-8")
    path.chmod(0o755)


@dataclasses.dataclass(frozen=True, slots=True)
class _Seen:
    """Two views of eight frames of a walk."""

    masks: tuple[Any, ...]
    cameras: tuple[Any, ...]
    truth: Any


def _see() -> _Seen:
    canonical = canonicalise(make_motion("walk", draw_performer(5)))
    body = body_from_motion(canonical)
    poses, _ = fit_poses(body, canonical.positions[:_N_FILMED])
    points = compute_points(body, poses)
    ring = ring_around(points, 4, _SIZE)
    cameras = tuple(
        dataclasses.replace(camera, name=name) for camera, name in zip(ring, ("left", "front"), strict=False)
    )
    truth = points[:, [point_names(body).index(name) for name in CANONICAL_JOINTS]]
    return _Seen(tuple(np.asarray(view) for view in render(body, poses, cameras)), cameras, truth)


def _silhouettes(path: Path) -> None:
    seen = _see()
    write_silhouettes(path, seen.masks, seen.cameras, 30.0, stature=_FILM_STATURE, truth=(CANONICAL_JOINTS, seen.truth))


def _calibration(path: Path) -> None:
    write_cameras(path, _see().cameras)


def _masks(view: int) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        import cv2

        folder.mkdir()
        for number, mask in enumerate(_see().masks[view]):
            cv2.imwrite(str(folder / f"{number:03d}.png"), 255 * mask.astype(np.uint8))

    return write


def _room() -> Any:
    """(H, W, 3) an empty room that is not the same everywhere."""
    rows, columns = np.mgrid[: _SIZE[1], : _SIZE[0]]
    grey = _GREY + 30 * np.sin(rows / 9.0) * np.cos(columns / 13.0)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def _plate(path: Path) -> None:
    import cv2

    cv2.imwrite(str(path), _room())


def _film(view: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import cv2

        video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, _SIZE)
        for mask in _see().masks[view]:
            frame = _room()
            frame[mask] = (_DARK, _DARK, 2 * _DARK)
            video.write(frame)
        video.release()

    return write


MATERIAL: dict[str, Callable[[Path], None]] = {
    # a library of one's own
    "recordings": _recordings,
    "annotated": _annotated,
    "query.c3d": _points("kick_left", 7),
    "new/a.bvh": _motion("kick_left", 8),
    "new/b.bvh": _motion("bow", 8),
    "sessions/01.npz": _motion("walk", 9),
    "sessions/a.bvh": _motion("kick_left", 9),
    "other/session.bvh": _motion("clap", 9),
    "serve.c3d": _points("kick_left", 10),
    "bin/tracker": _tracker,
    # single files
    "walk.bvh": _motion("walk", 5),
    "character.bvh": _motion("walk", 9),
    "kick.bvh": _motion("kick_left", 5),
    "jumping_jack.bvh": _motion("jumping_jack", 4),
    "take.c3d": _points("squat", 5),
    "squat.trc": _exercise(1),
    "squats.trc": _exercise(7),
    # a teacher and a pupil
    **{f"teacher_{take}.bvh": _motion("kick_left", 20) for take in (1, 2, 3)},
    "teacher.bvh": _motion("kick_left", 20),
    "teacher.c3d": _points("kick_left", 20),
    "pupil.bvh": _motion("kick_left", 21),
    "pupil.trc": _points("kick_left", 21),
    "pupil_later.bvh": _motion("kick_left", 22),
    "dance.furi": _text("1-40 kick\n41-60 rest\n"),
    "arms.toml": _text("arms = 2\nlegs = 1\n"),
    "demo-output": _dances,  # only what the second act of `dousa demo` starts from
    # films, masks and cameras
    "clip.npz": _silhouettes,
    "dance.npz": _silhouettes,
    "standing.bvh": _motion("walk", 5),
    "calib.toml": _calibration,
    "left.png": _plate,
    "front.png": _plate,
    "left.mp4": _film(0),
    "front.mp4": _film(1),
    "left_masks": _masks(0),
    "front_masks": _masks(1),
}


RECORDED = {
    "take.amc": "hdm05/squat1Reps/HDM_bd_squat1Reps_001_120.amc",
    "take.asf": "hdm05/HDM_bd.asf",
    "calibration": "pose2sim/calibration",
}
"""Likewise, but links into ../shared/data; commands that name them are passed over where there is none."""

DONE_BEFORE: dict[tuple[str, str], tuple[str, ...]] = {
    ("docs/takes.md", "dousa add moves.dousa sessions/"): (
        "dousa add moves.dousa recordings --performer-from 'name:HDM_(..)_'",
        "dousa train moves.dousa",
    ),
    ("docs/ranking.md", "dousa search moves.dousa query.c3d --rank fused"): (
        "dousa add moves.dousa recordings --performer-from 'name:HDM_(..)_'",
        "dousa train moves.dousa",
    ),
    ("docs/formats.md", "dousa export moves.dousa --category walk"): ("dousa add moves.dousa recordings",),
    ("docs/libraries.md", "dousa check moves.dousa"): ("dousa add moves.dousa recordings",),
    ("docs/reliability.md", "dousa backup moves.dousa"): ("dousa add moves.dousa recordings",),
    ("docs/evaluation.md", "from dousa.evaluation import IncrementalAssessor"): (
        "teacher_1, teacher_2 = (read(f'teacher_{take}.bvh') for take in (1, 2))",
        "frames = read('pupil.bvh').positions",
    ),
}
"""What a page takes for done before the command that begins so: commands, or lines of Python."""


def make_material(folder: Path, data: Path) -> None:
    """Write all of `MATERIAL` into a folder, and link to what was recorded, if it is there."""
    for name, write in MATERIAL.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write(folder / name)
    for name, source in RECORDED.items():
        if data.exists():
            (folder / name).symlink_to(data / source)


def make_readme_libraries(folder: Path, data: Path) -> tuple[str, ...]:
    """The recordings of the README's answers, as links; returns the command that makes the library of them.

    ``moves.dousa`` gets ten categories of HDM05 by two people.
    """
    for path in (data / "hdm05").glob("*/HDM_b*.amc"):
        where = "kicks" if path.parent.name.startswith("kick") else "ten"
        _link(path, folder / where / path.parent.name / path.name)
    for path in (*(data / "hdm05").glob("*.asf"), *(data / "hdm05").glob("*/HDM_dg_kickLFront1Reps_013_120.amc")):
        _link(path, folder / path.name)
    return ("dousa add moves.dousa ten --performer-from 'name:HDM_(..)_'",)


def _link(source: Path, link: Path) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(source)
