"""Folders of projects as other programs lay them out: what is in them, and what `dousa estimate` takes of them.

Pose2Sim: ``videos/``, ``pose/CAM_json/``, ``calibration/`` (also above the trial), ``pose-3d/``, and ``Config.toml``
with the rate. FreeMoCap: ``synchronized_videos/``, ``*calibration.toml``, ``output_data/`` with the points of all
cameras in ``raw_data/*2dData*.npy``. OpenCap: ``Videos/CAM/`` with the calibration of a camera and
``InputMedia/TRIAL/``, ``MarkerData/``, ``sessionMetadata.yaml`` with the person's height. EasyMocap: ``videos/``,
``annots/CAM/``, ``intri.yml`` and ``extri.yml``. A folder of films or keypoints beside their calibration is a project
too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from dousa.errors import CalibrationError, OptionError
from dousa.files.frame_files import natural_key
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.requests.estimation import CalibrationRequest, EstimationRequest, SynchronisationRequest

_FILM = r"[^/]+\.(?:mp4|avi|mov|mkv|m4v|webm)"
_POINTS = r"[^/]+(?:\.json|\.csv|\.npz|/)"  # a folder ends in a slash
_MOTION = r"[^/]+\.(?:trc|c3d|bvh|mot|csv|npy)"
_TABLE = r"[^/]+\.(?:toml|txt|xml|xcp|yml|yaml|json|calib)"


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where a program puts its files: patterns of whole paths below the folder; letters may be large or small.

    A take is what the group ``take`` finds. Of several patterns for one thing the first that fits counts. ``needs``
    must fit something too.
    """

    program: str
    films: tuple[str, ...]
    keypoints: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    calibrations: tuple[str, ...] = ()
    needs: str = ""


# Films that the program has cut to one start, by what it calls them.
_SYNCHRONISED = re.compile(r"/(?:pose-sync|synchronized_videos|raw_data)/|_sync\.\w+$", re.IGNORECASE)
_TAKE = r"(?:(?P<take>[^/]+)/)?"
_LAYOUTS = (
    _Layout(
        "OpenCap",
        films=(
            r"videos/cam[^/]*/inputmedia/(?P<take>[^/]+)/[^/]+_sync\.(?:mp4|avi|mov)",
            rf"videos/cam[^/]*/inputmedia/(?P<take>[^/]+)/{_FILM}",
        ),
        results=(r"markerdata/(?:[^/]+/)*(?P<take>[^/]+)\.trc", r"opensimdata/kinematics/(?P<take>[^/]+)\.mot"),
        calibrations=(r"videos/cam[^/]*/[^/]+\.pickle",),
    ),
    _Layout(
        "FreeMoCap",
        films=(rf"{_TAKE}synchronized_videos/{_FILM}",),
        keypoints=(rf"{_TAKE}output_data/(?:[^/]+/)*[^/]*2ddata[^/]*\.npy",),
        results=(rf"{_TAKE}output_data/(?!raw_data/)(?:[^/]+/)?{_MOTION}",),
        calibrations=(r"(?:[^/]+/)?[^/]*calibration[^/]*\.toml",),
    ),
    _Layout(
        "EasyMocap",
        films=(rf"videos/{_FILM}",),
        keypoints=(r"(?:annots|openpose)/[^/]+/",),
        calibrations=(r"(?:intri|extri)\.yml",),
        needs=r"extri\.yml",
    ),
    _Layout(
        "Pose2Sim",
        films=(rf"{_TAKE}videos/{_FILM}",),
        keypoints=(rf"{_TAKE}pose-sync/{_POINTS}", rf"{_TAKE}pose/{_POINTS}", rf"{_TAKE}pose-2d/{_POINTS}"),
        results=(rf"{_TAKE}(?:pose-3d|kinematics)/{_MOTION}", r"[^/]+\.trc"),
        calibrations=(rf"(?:[^/]+/)?calib[^/]*/{_TABLE}",),
    ),
    _Layout(
        "",
        films=(_FILM,),
        keypoints=(_POINTS,),
        results=(r"[^/]+\.(?:trc|c3d|bvh|mot)",),
        calibrations=(_TABLE, rf"calib[^/]*/{_TABLE}"),
    ),
)


@dataclass(frozen=True, slots=True)
class Take:
    """What cameras saw at one time, and what was made of it: films, keypoints of each view, motions."""

    name: str
    films: tuple[Path, ...] = ()
    keypoints: tuple[Path, ...] = ()
    results: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class Project:
    """A folder with films or keypoints of calibrated cameras.

    Parameters
    ----------
    folder, program : where, and whose layout; "" for no known program's.
    takes : in the order of their names.
    calibration : file or folder; None without.
    cameras : their names.
    rate : Hz, as the settings say; None without.
    stature : m, as the settings say; None without.
    problem : why no calibration could be read, where one seems to be there.
    """

    folder: Path
    program: str
    takes: tuple[Take, ...]
    calibration: Path | None = None
    cameras: tuple[str, ...] = ()
    rate: float | None = None
    stature: float | None = None
    problem: Message | None = None

    def to_json(self) -> dict[str, Any]:
        """What a program wants to know of it."""
        takes = [
            {
                "name": take.name,
                **{kind: [str(path) for path in getattr(take, kind)] for kind in ("films", "keypoints", "results")},
                "command": write_command(self, take),
            }
            for take in self.takes
        ]
        calibration = None if self.calibration is None else str(self.calibration)
        known = {"cameras": list(self.cameras), "rate": self.rate, "stature_m": self.stature}
        return {"path": str(self.folder), "program": self.program or None, "calibration": calibration, **known,
                "takes": takes}  # fmt: skip


@dataclass(slots=True)
class _Tree:
    """The files, and the folders of many JSON files, below a folder by their paths from there."""

    folder: Path
    paths: dict[str, Path] = field(default_factory=dict)

    def match(self, patterns: Sequence[str]) -> dict[str, list[Path]]:
        """By take, what the first pattern finds that finds anything in it."""
        found: dict[str, list[Path]] = {}
        for pattern in patterns:
            fits = re.compile(pattern, re.IGNORECASE)
            more: dict[str, list[Path]] = {}
            for name in sorted(self.paths, key=natural_key):
                if (hit := fits.fullmatch(name)) is not None:
                    more.setdefault(hit.groupdict().get("take") or "", []).append(self.paths[name])
            found = {**more, **found}
        return found


def _walk(folder: Path, *, deepest: int = 5, most: int = 50_000) -> _Tree:
    """List files, ``deepest`` folders down and ``most`` at most; of many JSON files in a folder, the folder."""
    tree = _Tree(folder)
    for place, folders, names in os.walk(folder, followlinks=True):  # a link upwards ends with the depth
        here = Path(place).relative_to(folder)
        folders[:] = sorted(name for name in folders if not name.startswith(".")) if len(here.parts) < deepest else []
        many = sum(name.lower().endswith(".json") for name in names) > 1
        for name in names:
            if not name.startswith(".") and not (many and name.lower().endswith(".json")):
                tree.paths[(here / name).as_posix()] = Path(place) / name
        if many and here.parts:
            tree.paths[f"{here.as_posix()}/"] = Path(place)
        if len(tree.paths) > most:
            break
    return tree


def find_project(folder: Path) -> Project | None:
    """Find what is in a folder; None if it is no project: no films or keypoints, or nothing that goes with them.

    Raises
    ------
    OptionError : settings that cannot be read.
    """
    from dousa.estimation.keypoints.keypoint_files import holds_keypoints

    if not folder.is_dir() or holds_keypoints(folder):
        return None
    tree = _walk(folder)
    for layout in _LAYOUTS:
        if layout.needs and not tree.match([layout.needs]):
            continue
        films = tree.match(layout.films)
        points = {
            take: [path for path in paths if holds_keypoints(path)]
            for take, paths in tree.match(layout.keypoints).items()
        }
        names = sorted({*films, *(take for take, paths in points.items() if paths)}, key=natural_key)
        if not names:
            continue
        calibration, cameras, problem = _find_calibration(tree, layout)
        results = _match_results(tree, layout, names)
        if calibration is None and problem is None and not layout.program:
            return None
        takes = tuple(
            Take(name or folder.resolve().name, tuple(films.get(name, ())), tuple(points.get(name, ())), results[name])
            for name in names
        )
        rate, stature = _read_settings(tree)
        return Project(folder, layout.program, takes, calibration, cameras, rate, stature, problem)
    return None


def _match_results(tree: _Tree, layout: _Layout, names: Sequence[str]) -> dict[str, tuple[Path, ...]]:
    found: dict[str, list[Path]] = {name: [] for name in names}
    for pattern in layout.results:
        for take, paths in tree.match([pattern]).items():
            owner = take if take in found else names[0] if len(names) == 1 else None
            if owner is not None:
                found[owner] += [path for path in paths if path not in found[owner]]
    return {name: tuple(paths) for name, paths in found.items()}


_NO_CALIBRATION = ("camera_files.unknown", "camera_files.too_large", "opencv.no_mapping")


def _find_calibration(tree: _Tree, layout: _Layout) -> tuple[Path | None, tuple[str, ...], Message | None]:
    """The file with most cameras, TOML first; the folder where each camera has a file; else why there is none."""
    from dousa.estimation.cameras.camera_files import read_cameras

    files = [path for paths in tree.match(layout.calibrations).values() for path in paths]
    if not files and layout.program == "Pose2Sim":
        above = [tree.folder.absolute().parent, tree.folder.absolute().parent.parent]
        folders = [path for place in above for path in sorted(place.glob("[cC]alib*")) if path.is_dir()]
        files = [path for place in folders[:1] for path in sorted(place.iterdir()) if path.is_file()]
    files.sort(key=lambda path: path.suffix.lower() != ".toml")
    problem, found = None, []
    for path in files[:200]:
        try:
            found.append((path, tuple(camera.name for camera in read_cameras(path))))
        except CalibrationError as error:
            if error.code not in _NO_CALIBRATION:
                problem = problem or error.located
    if not found:
        return None, (), problem
    best, names = max(found, key=lambda pair: len(pair[1]))
    if len(names) > 1 or len(found) == 1:
        return best, names, None
    whole = best.parent if len({path.parent for path, _ in found}) == 1 else best.parent.parent
    try:
        return whole, tuple(camera.name for camera in read_cameras(whole)), None
    except CalibrationError as error:
        return None, (), error.located


def _read_settings(tree: _Tree) -> tuple[float | None, float | None]:
    """The rate in Hz and the person's stature in m of Pose2Sim's and OpenCap's settings."""
    import tomllib

    rate = stature = None
    settings = {name.lower(): path for name, path in tree.paths.items()}
    if (path := settings.get("config.toml")) is not None:
        try:
            about = tomllib.loads(path.read_text(encoding="utf-8")).get("project", {})
        except (OSError, ValueError) as error:
            raise OptionError("project.settings", path=path, reason=error) from error
        about = about if isinstance(about, dict) else {}
        rate = _positive(about.get("frame_rate"), 5000.0)
        stature = _positive(about.get("participant_height"), 2.6)
    if (path := settings.get("sessionmetadata.yaml")) is not None:
        found = re.search(
            r"^height_m:\s*([\d.]+)\s*$", path.read_text(encoding="utf-8", errors="replace"), re.MULTILINE
        )
        stature = _positive(float(found[1]) if found and found[1].count(".") < 2 else None, 2.6)
    return rate, stature


def _positive(value: Any, most: float) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and 0 < value <= most else None


def write_command(project: Project, take: Take) -> str:
    """The command that goes on with a take."""
    where = str(project.folder)
    if len(project.takes) > 1:
        where = " ".join(map(_quote, take.keypoints or take.films))
        where += "" if project.calibration is None else f" --cameras {_quote(project.calibration)}"
    else:
        where = _quote(project.folder)
    stature = "" if project.calibration is not None or project.stature is not None else " --stature 1.75"
    return f"dousa estimate {where}{stature} -o {_quote(f'{take.name}.bvh')}"


def _quote(path: object) -> str:
    import shlex

    return shlex.quote(str(path))


_Request = TypeVar("_Request", bound="EstimationRequest | CalibrationRequest | SynchronisationRequest")


def take_project(request: _Request, tell: Callable[[Message], None] | None = None) -> _Request:
    """Replace the folder of a project by what is in it; what was given goes before, other requests stay as they are.

    Keypoints come before films, whose rate they have; ``tell`` is called with what was taken.

    Raises
    ------
    OptionError : several takes, or settings that cannot be read.
    CalibrationError : a calibration that cannot be read.
    """
    from dousa.estimation.keypoints.keypoint_files import count_views

    given: tuple[Path, ...] = getattr(request, "sources" if hasattr(request, "sources") else "films")
    if len(given) != 1 or getattr(request, "kind", None) == "mask" or getattr(request, "backgrounds", ()):
        return request
    project = find_project(given[0])
    if project is None and count_views(given[0]) > 1 and getattr(request, "offsets", "") == "auto":
        return replace(request, **{"offsets": "none"})  # type: ignore[arg-type]  # frames of one array are of one time
    if project is None:
        return request
    if len(project.takes) > 1:
        names = tuple(take.name for take in project.takes)
        raise OptionError("project.takes", path=project.folder, takes=names)
    (take,) = project.takes
    by_film = getattr(request, "cues", None) == "silhouettes" or getattr(request, "board", None)
    request, notes = complete_request(request, project, take, () if by_film else take.keypoints)
    for note in notes if tell is not None else ():
        tell(note)  # type: ignore[misc]
    return request


def complete_request(
    request: _Request, project: Project, take: Take, sources: tuple[Path, ...]
) -> tuple[_Request, list[Message]]:
    """Complete a request by what a project knows of some sources of a take, by default its films.

    That is the calibration, the rate, the person's stature, and that they start together.

    Raises
    ------
    CalibrationError : a calibration that cannot be read.
    """
    if project.problem is not None and request.cameras is None:
        raise CalibrationError("text.verbatim", text=project.problem)
    sources = sources or take.films
    by_points = sources[0] in take.keypoints
    values: dict[str, Any] = {"sources": sources, "films": sources}
    values["rate"] = request.rate or (project.rate or _read_rate(take.films) if by_points else None)
    together = getattr(request, "offsets", "") == "auto" and all(
        _SYNCHRONISED.search(path.as_posix()) for path in sources
    )
    if together:
        values["offsets"] = "none"
    if getattr(request, "board", None) is None:
        values["stature"] = getattr(request, "stature", None)
        if values["stature"] is None and getattr(request, "body", None) is None:
            values["stature"] = project.stature
        if getattr(request, "focal", None) is None:
            values["cameras"] = request.cameras or project.calibration
    fields = {key: value for key, value in values.items() if hasattr(request, key)}
    changed = replace(request, **fields)
    return changed, list(_describe_taken(project, changed, sources, by_points, together))


def _read_rate(films: Sequence[Path]) -> float | None:
    """The rate of the film that keypoints were found in; None without, or without what reads it."""
    from importlib.util import find_spec

    if not films or find_spec("av") is None:
        return None
    from dousa.errors import KeypointError
    from dousa.estimation.keypoints.films import FilmFrames

    try:
        with FilmFrames(films[0]) as film:
            return film.nominal_rate
    except KeypointError:
        return None


def _describe_taken(
    project: Project, request: Any, sources: tuple[Path, ...], by_points: bool, together: bool
) -> Iterator[Message]:
    code = "project.takes_keypoints" if by_points else "project.takes_films"
    yield Message(code, path=project.folder, n=len(sources), place=sources[0].parent)
    if by_points and request.rate is not None:
        yield Message("project.takes_rate", rate=request.rate)
    if together and len(sources) > 1:
        yield Message("project.takes_times")
    if request.cameras is not None:
        yield Message("project.takes_calibration", path=request.cameras)
    stature = getattr(request, "stature", None)
    if stature is not None and stature == project.stature:
        yield Message("project.takes_stature", stature=stature)
