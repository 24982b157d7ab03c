"""The films of a scene: their keypoints, found or read, their names and their sound."""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import OptionError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from dousa.app.output import ProgressCallback
    from dousa.estimation import ViewKeypoints
    from dousa.estimation.keypoints.pose_models import LandmarkModel
    from dousa.estimation.sync.sound import Sound
    from dousa.messages import Message

_KEYPOINT_SUFFIXES = (".npz", ".json")
_FOCAL_35 = ("focal_length.35mm", "focallengthin35mm")
_FRAME_35 = 36.0  # mm, the longer side of the picture that lenses are compared by
_GLANCE = 0.1  # s between two reports


def is_keypoints(path: Path) -> bool:
    """Whether a source holds keypoints, and is not a film."""
    return path.is_dir() or path.suffix.lower() in _KEYPOINT_SUFFIXES


def name_films(paths: Sequence[Path]) -> tuple[str, ...]:
    """Different names for films: without folder and suffix, with the folder where two are alike.

    Raises
    ------
    OptionError : one film is given twice.
    """
    count = Counter(path.stem for path in paths)
    names = [path.stem if count[path.stem] == 1 else f"{path.parent.name}_{path.stem}" for path in paths]
    if len(set(names)) < len(names):
        twice = next(name for name, times in Counter(names).items() if times > 1)
        raise OptionError("films.twice", name=twice)
    return tuple(names)


def open_keypoints(
    paths: Sequence[Path], model: LandmarkModel | None, progress: ProgressCallback
) -> tuple[ViewKeypoints, ...]:
    """The keypoints of films, and of files of keypoints as they are; of each the source is its name.

    Parameters
    ----------
    paths : films, or files of keypoints (npz of dousa, or what other programs write).
    model : by which keypoints are found in films; None for the most precise that is installed.
    progress : called with (done, total, what).

    Raises
    ------
    KeypointError : a source that is missing or damaged, a model that is not installed.
    OptionError : one film is given twice.
    """
    import dataclasses

    from dousa.estimation import read_keypoints

    names = name_films(paths)
    films = _find_all([path for path in paths if not is_keypoints(path)], model, progress)
    views = [next(films) if not is_keypoints(path) else read_keypoints(path) for path in paths]
    return tuple(dataclasses.replace(found, source=name) for found, name in zip(views, names, strict=True))


class _GivenUpError(Exception):
    """Another film has failed, or the work was interrupted."""


def _find_all(
    films: Sequence[Path], model: LandmarkModel | None, progress: ProgressCallback
) -> Iterator[ViewKeypoints]:
    """The keypoints of films, several at a time: one is decoded while the networks look at another."""
    from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

    from dousa.estimation import find_keypoints
    from dousa.estimation.keypoints.pose_models import choose_pose_model

    chosen, cores = (model or choose_pose_model()) if films else "full", os.cpu_count() or 1
    if len(films) < 2:
        return iter([find_keypoints(film, chosen, progress=progress) for film in films])
    at_a_time = min(len(films), cores)
    counts, stop = [(0, 0)] * len(films), threading.Event()
    said: list[Message | str] = [""] * len(films)

    def find(place: int) -> ViewKeypoints:
        def note(done: int, total: int, what: Message | str) -> None:
            if stop.is_set():
                raise _GivenUpError
            counts[place], said[place] = (done, total), what

        return find_keypoints(films[place], chosen, threads=max(1, cores // at_a_time), progress=note)

    with ThreadPoolExecutor(at_a_time) as pool:
        jobs = [pool.submit(find, place) for place in range(len(films))]
        try:
            while wait(jobs, _GLANCE, FIRST_EXCEPTION).not_done and not _find_failed(jobs):
                busy = next((place for place, (done, total) in enumerate(counts) if done < total), None)
                if busy is not None:  # told by the thread that asked, which may be stopped by what it tells
                    progress(sum(done for done, _ in counts), sum(total for _, total in counts), said[busy])
        finally:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
    return iter([job.result() for job in _find_failed(jobs) or jobs])


def _find_failed(jobs: Sequence[Future[ViewKeypoints]]) -> list[Future[ViewKeypoints]]:
    """Those that ended by an error of their own."""
    ended = [job for job in jobs if job.done() and not job.cancelled() and job.exception() is not None]
    return [job for job in ended if not isinstance(job.exception(), _GivenUpError)]


def read_sounds(paths: Sequence[Path]) -> list[Sound | None]:
    """The sound of each film; None for files of keypoints and films without."""
    from dousa.estimation.sync.sound import read_sound

    return [None if is_keypoints(path) else read_sound(path) for path in paths]


def read_focal_length(path: Path, size: tuple[int, int]) -> float | None:
    """The focal length (px) that a film states as that of a 35 mm camera, as some phones do; None where it does not.

    Parameters
    ----------
    path : a film, or keypoints, which state nothing.
    size : px, of its pictures.
    """
    from importlib.util import find_spec

    if is_keypoints(path) or find_spec("av") is None:
        return None
    import av

    try:
        with av.open(str(path)) as container:
            tags = [container.metadata, *(stream.metadata for stream in container.streams)]
    except (av.error.FFmpegError, OSError, ValueError):
        return None
    for key, value in (item for some in tags for item in some.items()):
        if any(word in key.lower() for word in _FOCAL_35):
            try:
                focal = float(value)
            except ValueError:
                continue
            if 5.0 < focal < 1000.0:
                return focal / _FRAME_35 * max(size)
    return None
