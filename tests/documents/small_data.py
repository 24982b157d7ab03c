"""A few files of each kind of ../shared/data, in folders of the same names: what long measurements are tried on.

Pages that are followed have all of them, with less of the films.
"""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Trajectories

_BENCH_FRAMES, _MASK_FRAMES = 12, 20
_FILM_FRAMES = 20  # of films and of what they are compared with
_TRC_HEAD = 5  # lines before the first frame
_DANCE_FRAMES = 600  # of the dance, at 30 Hz

_HDM05 = ("grabHighR", "hopBothLegs1hops", "rotateArmsBothBackward1Reps", "throwBasketball")
_BANDAI = ("raise-up-both-hands", "run", "walk", "wave-left-hand")
_TAKES = (("bd", 6), ("bk", 2), ("dg", 1))
_FILMED = ("clap", "lunge")
_UTD_MHAD = ("boxing", "clap", "lunge", "squat", "throw", "wave")

# Of each folder the files that match, at most so many of each pattern.
_CHOSEN = {
    "hdm05": (
        *((f"{what}/HDM_{who}_*", 2) for what in _HDM05 for who in ("bd", "bk", "dg")),
        # Judging a take by several of the same person needs five and more.
        *((f"{what}1Reps/HDM_{who}_*", most) for what in ("squat", "kickLFront") for who, most in _TAKES),
        ("*.asf", 3),
    ),
    "bandai": tuple((f"{what}/{style}/*", 6) for what in _BANDAI for style in ("active", "normal")),
    "cmu86": (("*", 3),),
    "utkinect": (("s0[12]_e0[12].*", 8),),
    "pose2sim": (("Standing*.trc", 1), ("background/*", 4), ("calibration/*", 1)),
    "utd_mhad": tuple((f"skeleton/{what}/*_s{who}_*", 2) for what in _UTD_MHAD for who in (1, 3, 7)),
    "silhouette_bench": (("cmu86_walk_clean.npz", 1),),
    "uiprmd": (("kinect/m0[17]/*/*_e10.trc", 20),),
    "irds": (("g[38]/*/*", 40),),
    "foreign": (("addbiomechanics/DJ1.trc", 1), ("pybvh/bvh_test2.bvh", 1), ("opensim/arm26*.trc", 1)),
}


def make_small_data(data: Path, folder: Path) -> None:
    """Make the folder: copies, cut to their beginning where they are long.

    Parameters
    ----------
    data : the recordings.
    folder : to make.
    """
    for name, choices in _CHOSEN.items():
        for path in _choose(data / name, choices):
            shutil.copyfile(path, _place(path, data, folder))
    for path in (data / "silhouette_bench").glob("bd_squat_*.npz"):
        _cut_bench(path, _place(path, data, folder))
    for path in (data / "utd_mhad/silhouette").glob("*/*_s[13]_t1.npz"):
        if path.parent.name in _FILMED:
            _cut_masks(path, _place(path, data, folder))
    for path in (data / "pose2sim/videos").glob("cam0[34].mp4"):
        _cut_film(path, _place(path, data, folder))
    for path in (data / "utd_mhad/skeleton").glob("*/*_s[13]_t1.c3d"):
        if path.parent.name in _FILMED:
            _cut_skeleton(path, _place(path, data, folder / "filmed"))
    shutil.copytree(folder / "utd_mhad/silhouette", folder / "filmed/utd_mhad/silhouette")
    reference = data / "pose2sim/Balancing_for_IK.trc"
    lines = reference.read_text(encoding="utf-8").splitlines()[: _TRC_HEAD + _FILM_FRAMES]
    _place(reference, data, folder).write_text("\n".join(lines) + "\n", encoding="utf-8")
    for path in (data / "bandai_dance").iterdir():
        _cut_dance(path, _place(path, data, folder))


def link_data(data: Path, folder: Path) -> None:
    """Make the folder: links to all files, and the beginnings of the films that pages estimate."""
    shutil.copytree(data, folder, copy_function=os.symlink)
    for path in (data / "pose2sim/videos").glob("cam0[14].mp4"):
        place = _place(path, data, folder)
        place.unlink()
        _cut_film(path, place, smaller=1)


def _place(path: Path, data: Path, folder: Path) -> Path:
    place = folder / path.relative_to(data)
    place.parent.mkdir(parents=True, exist_ok=True)
    return place


def _choose(folder: Path, choices: tuple[tuple[str, int], ...]) -> Iterator[Path]:
    for pattern, most in choices:
        yield from sorted(path for path in folder.glob(pattern) if path.is_file())[:most]


def _cut_arrays(source: Path, target: Path, axes: dict[str, int], n_frames: int) -> None:
    """The first frames of the arrays that are named, each with its axis of frames."""
    with np.load(source) as arrays:
        kept = {name: arrays[name] for name in arrays.files}
    for name, axis in axes.items():
        kept[name] = kept[name].take(range(n_frames), axis)
    np.savez_compressed(target, **kept)


def _cut_bench(source: Path, target: Path) -> None:
    _cut_arrays(source, target, {"mask_packed": 1, "joint_positions": 0}, _BENCH_FRAMES)


def _cut_masks(source: Path, target: Path) -> None:
    _cut_arrays(source, target, {"mask_packed": 0}, _MASK_FRAMES)


def _cut_skeleton(source: Path, target: Path) -> None:
    points = read_motion(source)
    write_motion(Trajectories(points.names, points.positions[:_MASK_FRAMES], points.frame_rate), target)


def _cut_film(source: Path, target: Path, smaller: int = 4) -> None:
    """The first frames, so many times less wide and high."""
    import cv2

    film = cv2.VideoCapture(str(source))
    size = tuple(int(film.get(side)) // smaller for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    copy = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*"mp4v"), film.get(cv2.CAP_PROP_FPS), size)
    for _ in range(_FILM_FRAMES):
        copy.write(cv2.resize(film.read()[1], size, interpolation=cv2.INTER_AREA))
    copy.release()


def _cut_dance(source: Path, target: Path) -> None:
    head, motion = re.split(r"(?<=MOTION)", source.read_text(encoding="utf-8"))
    count, step, *frames = motion.strip().splitlines()
    assert count.startswith("Frames:") and len(frames) > _DANCE_FRAMES
    lines = (head, f"Frames: {_DANCE_FRAMES}", step, *frames[:_DANCE_FRAMES])
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")
