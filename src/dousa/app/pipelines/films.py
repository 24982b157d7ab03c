"""From films to their time offsets, to the cameras that took them and to files of keypoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pipelines.estimation_views import read_view_cameras
from dousa.app.pipelines.film_scene import open_keypoints, read_sounds
from dousa.app.pipelines.film_sources import name_films
from dousa.app.pipelines.projects import take_project
from dousa.app.targets import KEYPOINTS, check_targets
from dousa.errors import OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import CalibrationRequest, KeypointRequest, SynchronisationRequest
    from dousa.estimation import Calibration, Camera, Synchronisation, ViewKeypoints


def calibrate_films(
    request: CalibrationRequest, progress: ProgressCallback, tell: Callable[[Message], None] | None = None
) -> tuple[Calibration, Synchronisation | None]:
    """Find where the cameras of films, or of those of a project's folder, stand; ``tell`` takes what was taken of it.

    Returns
    -------
    The cameras, and the time offsets where they were found on the way.

    Raises
    ------
    DousaError : a source that cannot be read; options that contradict each other; cameras that cannot be found.
    """
    from dousa.estimation import calibrate_from_board, calibrate_from_person, find_board, parse_board
    from dousa.estimation.keypoints.keypoint_files import count_views

    request = take_project(request, tell)
    if (request.stature is None) == (request.board is None):
        raise OptionError("calibration.person_or_board")
    if sum(map(count_views, request.films)) < 2:
        raise OptionError("calibration.one_view")
    board = None if request.board is None else parse_board(request.board)
    if board is None:
        views = open_keypoints(request.films, None, progress, request)
    else:
        names = name_films(request.films)
        found_boards = [find_board(film, board, progress) for film in request.films]
        views = tuple(replace(view, source=name) for view, name in zip(found_boards, names, strict=True))
    lenses = _find_lenses(request, views)
    offsets, found = _find_offsets(request, views, progress)
    focals = None if request.focal is None else [request.focal] * len(views)
    if board is not None:
        return calibrate_from_board(views, board, cameras=lenses, focals=focals, offsets=offsets), found
    assert request.stature is not None
    people = None if found is None else found.people
    made = calibrate_from_person(views, request.stature, cameras=lenses, focals=focals, offsets=offsets, people=people)
    return made, found


def _find_lenses(request: CalibrationRequest, views: Sequence[ViewKeypoints]) -> tuple[Camera, ...] | None:
    if request.cameras is None:
        return None
    if request.focal is not None:
        raise OptionError("calibration.focal_and_cameras")
    return read_view_cameras(request.cameras, [view.source for view in views], [view.size for view in views])[0]


def _find_offsets(
    request: CalibrationRequest, views: Sequence[ViewKeypoints], progress: ProgressCallback
) -> tuple[Sequence[float], Synchronisation | None]:
    from dousa.estimation import read_offsets, sync

    if request.offsets == "none":
        return [0.0] * len(views), None
    if request.offsets != "auto":
        return read_offsets(request.offsets, [view.source for view in views]), None
    found = sync(views, sounds=read_sounds(request.films), progress=progress)
    return found.offsets.tolist(), found


def sync_films(
    request: SynchronisationRequest, progress: ProgressCallback, tell: Callable[[Message], None] | None = None
) -> tuple[tuple[str, ...], Synchronisation]:
    """Find the time offsets of films, or of those of a project's folder; ``tell`` takes what was taken of it.

    Returns
    -------
    The names of the films, and their offsets.

    Raises
    ------
    DousaError : a source that cannot be read; nothing tells the time.
    """
    from dousa.estimation import sync
    from dousa.estimation.keypoints.keypoint_files import count_views

    request = take_project(request, tell)
    if sum(map(count_views, request.films)) < 2:
        raise OptionError("sync.one_film")
    views = open_keypoints(request.films, None, progress, request)
    names, calibrated = tuple(view.source for view in views), None
    if request.cameras is not None:
        calibrated = read_view_cameras(request.cameras, names, [view.size for view in views])[0]
    return names, sync(views, cameras=calibrated, sounds=read_sounds(request.films), progress=progress)


@dataclass(frozen=True, slots=True, eq=False)
class FoundKeypoints:
    """What was found in one film, and the files that were written of it."""

    film: Path
    keypoints: ViewKeypoints
    outputs: tuple[Path, ...]

    def to_json(self) -> dict[str, Any]:
        """What a program wants to know of it."""
        view = self.keypoints
        return {
            "film": str(self.film),
            "n_frames": view.n_frames,
            "frame_rate": view.frame_rate,
            "duration_s": float(view.times[-1]),
            "width": view.size[0],
            "height": view.size[1],
            "people": [
                {
                    "n_frames": int(person.present.sum()),
                    "first_frame": int(np.argmax(person.present)),
                    "mean_visibility": float(person.visibility[person.present].mean()),
                    "visible": float((person.visibility[person.present] > 0.5).mean()),
                }
                for person in view.people
            ],
            "outputs": [str(path) for path in self.outputs],
            "warnings": [str(warning) for warning in view.warnings],
        }


def find_in_films(request: KeypointRequest, progress: ProgressCallback | None = None) -> list[FoundKeypoints]:
    """Find the keypoints in films, and write them.

    Raises
    ------
    OptionError : films of the same name.
    KeypointError : a film that cannot be read, models that are not installed.
    MotionWriteError : the disk refuses.
    """
    from dousa.app.output import make_folder
    from dousa.app.pictures.keypoint_overlay import write_keypoint_overlay
    from dousa.estimation import find_keypoints, write_keypoints

    names = [film.stem for film in request.films]
    if len(set(names)) < len(names):
        raise OptionError("keypoints_cli.same_name", name=next(name for name in names if names.count(name) > 1))
    for package in ("cv2", "av", "ai_edge_litert"):
        require(package, "film")
    wanted = {".npz": True, "_keypoints.mp4": request.overlay}
    targets = {
        name: [request.folder / f"{name}{end}" for end, is_wanted in wanted.items() if is_wanted] for name in names
    }
    for path in (path for paths in targets.values() for path in paths):
        check_targets({"--output": path}, request.films, KEYPOINTS)
    make_folder(request.folder)
    done = []
    for film in request.films:
        view = find_keypoints(film, request.model, progress=progress)
        for path in targets[film.stem]:
            if path.suffix == ".npz":
                write_keypoints(path, view)
            else:
                write_keypoint_overlay(view, path, progress)
        done.append(FoundKeypoints(film, view, tuple(targets[film.stem])))
    return done


def describe_found(found: FoundKeypoints) -> list[Message]:
    """One line for the film, and one for each person."""
    answer = found.to_json()
    people, shape = answer["people"], {"n": answer["n_frames"], "rate": answer["frame_rate"]}
    lines = [Message("keypoints_cli.film", film=found.film, people=len(people), **shape)]
    for number, person in enumerate(people, 1):
        lines.append(Message("keypoints_cli.person", number=number, n=person["n_frames"], visible=person["visible"]))
    return [*lines, *(Message("estimated.wrote", path=path) for path in found.outputs)]
