"""Find the roles of uploaded files in an estimation by their content: silhouettes, calibration, background, body."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from dousa.app.pipelines.projects import Project, Take, find_project
from dousa.app.studio.core.uploads import CALIBRATIONS, PICTURES, VIDEOS
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.keypoints.keypoint_files import holds_keypoints
from dousa.files.frame_files import natural_key

ROLES = ("source", "cameras", "background", "body", "start", "unused")
_CALIBRATIONS = frozenset({".toml", ".xml", ".yaml", ".yml", ".json", ".txt", *CALIBRATIONS})
_MOTIONS = frozenset({".bvh", ".amc", ".c3d", ".trc"})
_PLATE = re.compile(r"background|backdrop|plate|empty|(^|[/_ -])bg([/_ .-]|$)|背景", re.IGNORECASE)
_PERSON = re.compile(rb"^\s*(stature\s*=|\[\[part\]\]|\[measures\])", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Material:
    """A file, or a folder of images.

    Parameters
    ----------
    name : in its batch; of a folder without a slash at the end, ``"."`` is the batch itself.
    role : one of `ROLES`.
    kind : ``npz``, ``video``, ``keypoints``, ``images``, ``picture``, ``table``, ``motion``, ``other``.
    n_files : of a folder of images or keypoints; else 1.
    """

    name: str
    role: str
    kind: str
    n_files: int = 1


def sort_materials(folder: Path, names: Iterable[str]) -> tuple[Material, ...]:
    """Find the role of each file of a batch; ``names`` are relative to its folder, with slashes."""
    files = sorted(names, key=natural_key)
    pictures: dict[str, list[str]] = {}
    found: list[Material] = []
    for name in files:
        suffix = Path(name).suffix.lower()
        if suffix in PICTURES:
            pictures.setdefault(str(Path(name).parent.as_posix()), []).append(name)
        else:
            found.append(_look_at(folder, name, suffix))
    found = _gather_frames(found)
    has_videos = any(item.kind == "video" for item in found)
    for place, inside in pictures.items():
        found += _sort_pictures(place, inside, has_videos)
    order = {role: number for number, role in enumerate(ROLES)}
    return tuple(sorted(_settle(found), key=lambda item: (order[item.role], natural_key(item.name))))


def open_batch(folder: Path) -> tuple[Project, Take] | None:
    """Find the project of a known program that was uploaded, or is the one folder of the batch, and its first take."""
    inside = [path for path in folder.iterdir() if not path.name.startswith(".")]
    for place in (*(inside if len(inside) == 1 and inside[0].is_dir() else ()), folder):
        try:
            project = find_project(place)
        except OptionError:  # settings that cannot be read
            continue
        if project is not None and project.program:
            return project, project.takes[0]
    return None


def sort_project(folder: Path, names: Iterable[str], project: Project, take: Take) -> tuple[Material, ...]:
    """Give the files of a project their roles: one take is estimated, of keypoints if there are any."""
    sources = take.keypoints or take.films
    roles = dict.fromkeys(sources, "source") | ({project.calibration: "cameras"} if project.calibration else {})
    used = {path.relative_to(folder).as_posix(): role for path, role in roles.items()}
    rest = [name for name in names if not any(name == one or name.startswith(f"{one}/") for one in used)]
    kinds = {"cameras": "table", "source": "keypoints" if take.keypoints else "video"}
    found = [
        Material(name, role, kinds[role], sum(1 for _ in path.iterdir()) if (path := folder / name).is_dir() else 1)
        for name, role in used.items()
    ]
    return (*found, *(replace(item, role="unused") for item in sort_materials(folder, rest)))


def _look_at(folder: Path, name: str, suffix: str) -> Material:
    if suffix in VIDEOS:
        return Material(name, "background" if _PLATE.search(name) else "source", "video")
    if suffix == ".npz":
        return _look_into_npz(folder / name, name)
    if suffix in (".json", ".csv", ".tsv", ".trc") and holds_keypoints(folder / name):
        return Material(name, "source", "keypoints")
    if suffix in _MOTIONS or suffix == ".asf":
        return Material(name, "unused" if suffix == ".asf" else "start", "motion")
    if suffix in _CALIBRATIONS:
        is_body = suffix == ".toml" and _shows(_PERSON, folder / name, 200_000)
        return Material(name, "body" if is_body else "cameras", "table")
    return Material(name, "unused", "other")


def _shows(pattern: re.Pattern[bytes], path: Path, n_bytes: int) -> bool:
    """Whether the first bytes of a file have a pattern."""
    with open(path, "rb") as file:
        return pattern.search(file.read(n_bytes)) is not None


def _gather_frames(found: list[Material]) -> list[Material]:
    """Make a folder of many files of keypoints one view, of which each file is a frame."""
    places: dict[str, list[Material]] = {}
    for item in found:
        if item.kind == "keypoints" and item.name.lower().endswith(".json"):
            places.setdefault(Path(item.name).parent.as_posix(), []).append(item)
    # files of keypoints in a folder; of more, each is a frame
    many = {place: items for place, items in places.items() if len(items) > 8}
    frames = {item.name for items in many.values() for item in items}
    whole = [Material(place, "source", "keypoints", len(items)) for place, items in many.items()]
    return [item for item in found if item.name not in frames] + whole


def _look_into_npz(path: Path, name: str, *, most_members: int = 1000) -> Material:
    """Find the role of an npz by its arrays; other files count as silhouettes, whose reader tells what is wrong."""
    # most_members: names of an npz looked at
    try:
        with zipfile.ZipFile(path) as file:
            inside = {member.removesuffix(".npy") for member in file.namelist()[:most_members]}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return Material(name, "source", "npz")
    if {"points", "visibility", "names"} <= inside:
        return Material(name, "source", "keypoints")
    if inside & {"mask_packed", "mask", "masks"}:
        return Material(name, "source", "npz")
    if "camera_matrix" in inside:
        return Material(name, "cameras", "npz")
    return Material(name, "start" if inside & {"positions", "rotations", "joint_positions"} else "source", "npz")


def _sort_pictures(place: str, names: list[str], has_videos: bool) -> list[Material]:
    """Make a folder of masks one view; pictures beside videos, or with such a name, show the empty scene."""
    plates = [name for name in names if has_videos or _PLATE.search(name)]
    others = [name for name in names if name not in plates]
    found = [Material(name, "background", "picture") for name in plates]
    if others:
        found.append(Material(place, "source", "images", len(others)))
    return found


def _settle(found: list[Material]) -> list[Material]:
    taken: set[str] = set()
    settled = []
    for item in found:
        role = item.role
        if role in ("cameras", "body", "start"):
            if role in taken:
                role = "unused"
            taken.add(role)
        if role == "background" and item.kind == "video":
            role = "unused"
        settled.append(Material(item.name, role, item.kind, item.n_files))
    return settled


def pair_backgrounds(sources: list[Path], backgrounds: list[Path]) -> list[Path]:
    """Order backgrounds like the sources if their names tell which belong together."""
    from dousa.estimation.cameras.camera import find_views

    if len(sources) != len(backgrounds):
        return backgrounds
    try:
        order = find_views([path.stem for path in backgrounds], [path.stem for path in sources])
    except CalibrationError:
        return backgrounds
    return [backgrounds[index] for index in order]
