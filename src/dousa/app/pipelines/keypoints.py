"""From films to files of keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.targets import KEYPOINTS, check_targets
from dousa.errors import OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import KeypointRequest
    from dousa.estimation import ViewKeypoints

_VIDEO, _SHEET = "_keypoints.mp4", "_keypoints.png"  # after the names of films


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
    from dousa.estimation import find_keypoints, write_keypoints

    names = [film.stem for film in request.films]
    if len(set(names)) < len(names):
        raise OptionError("keypoints_cli.same_name", name=next(name for name in names if names.count(name) > 1))
    for package in ("cv2", "av", "ai_edge_litert"):
        require(package, "film")
    for name in names:
        for ending, wanted in ((".npz", True), (_VIDEO, request.overlay), (_SHEET, request.sheet)):
            target = request.folder / f"{name}{ending}"
            check_targets({"--output": target if wanted else None}, request.films, KEYPOINTS)
    make_folder(request.folder)
    done = []
    for film in request.films:
        view = find_keypoints(film, request.model, most_people=request.people, progress=progress)
        outputs = [request.folder / f"{film.stem}.npz"]
        write_keypoints(outputs[0], view)
        if request.overlay or request.sheet:
            outputs += _draw(view, request, film.stem, progress)
        done.append(FoundKeypoints(film, view, tuple(outputs)))
    return done


def _draw(view: ViewKeypoints, request: KeypointRequest, name: str, progress: ProgressCallback | None) -> list[Path]:
    from dousa.app.pictures.keypoint_overlay import write_keypoint_overlay, write_keypoint_sheet

    written = []
    if request.overlay:
        written.append(request.folder / f"{name}{_VIDEO}")
        write_keypoint_overlay(view, written[-1], progress)
    if request.sheet:
        written.append(request.folder / f"{name}{_SHEET}")
        write_keypoint_sheet(view, written[-1])
    return written


def describe_found(found: FoundKeypoints) -> list[Message]:
    """One line for the film, and one for each person."""
    answer = found.to_json()
    lines = [
        Message(
            "keypoints_cli.film",
            film=found.film,
            n=answer["n_frames"],
            rate=answer["frame_rate"],
            people=len(answer["people"]),
        )
    ]
    for number, person in enumerate(answer["people"], 1):
        lines.append(Message("keypoints_cli.person", number=number, n=person["n_frames"], visible=person["visible"]))
    return [*lines, *(Message("estimated.wrote", path=path) for path in found.outputs)]
