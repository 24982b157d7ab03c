"""The films of a scene: their keypoints, found or read, their names and their sound."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.estimation import ViewKeypoints
    from dousa.estimation.keypoints.pose_models import LandmarkModel
    from dousa.estimation.sync.sound import Sound

_KEYPOINT_SUFFIXES = (".npz", ".json")
_FOCAL_35 = ("focal_length.35mm", "focallengthin35mm")
_FRAME_35 = 36.0  # mm, the longer side of the picture that lenses are compared by


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

    from dousa.estimation import find_keypoints, read_keypoints
    from dousa.estimation.keypoints.pose_models import choose_pose_model

    views = []
    for path, name in zip(paths, name_films(paths), strict=True):
        if is_keypoints(path):
            found = read_keypoints(path)
        else:
            found = find_keypoints(path, model or choose_pose_model(), progress=progress)
        views.append(dataclasses.replace(found, source=name))
    return tuple(views)


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
