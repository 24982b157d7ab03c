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
