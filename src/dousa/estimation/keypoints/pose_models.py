"""The pose models: their names, folder, checks and installation.

They are Google's BlazePose models (Bazarevsky and others, 2020), Apache-2.0, from published packages of MediaPipe.
`install_models` takes them from a local archive or from a package fetched by ``npm pack``, else ``pip download``. No
package is run or unpacked to the disk: members are read within limits, and only bytes with the SHA-256 of a known model
are written. ``DOUSA_MODELS`` sets another folder than the user's cache.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any, Literal, NamedTuple

from dousa.errors import KeypointError, OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message, Progress

ModelState = Literal["installed", "missing", "damaged"]

FOLDER_VARIABLE = "DOUSA_MODELS"
DETECTOR = "detector"
LandmarkModel = Literal["lite", "full", "heavy"]
LANDMARK_MODELS: tuple[LandmarkModel, ...] = ("lite", "full", "heavy")
"""From the quickest to the most precise."""


class ModelFile(NamedTuple):
    """One published form of a model: its size, and the hash of its content in hexadecimal."""

    n_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A model.

    Parameters
    ----------
    name : ``"detector"``, or one of `LANDMARK_MODELS`.
    file_name : in the folder of the models.
    forms : published files of this model; each is accepted.
    """

    name: str
    file_name: str
    forms: tuple[ModelFile, ...]


# The files in the packages that docs/keypoints.md names.
POSE_MODELS = (
    PoseModel(
        DETECTOR,
        "pose_detection.tflite",
        (
            ModelFile(2_962_288, "a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85"),
            ModelFile(2_959_046, "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c"),
        ),
    ),
    PoseModel(
        "lite",
        "pose_landmark_lite.tflite",
        (ModelFile(2_819_824, "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61"),),
    ),
    PoseModel(
        "full",
        "pose_landmark_full.tflite",
        (ModelFile(6_440_512, "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f"),),
    ),
    PoseModel(
        "heavy",
        "pose_landmark_heavy.tflite",
        (ModelFile(27_709_200, "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe"),),
    ),
)


def user_cache() -> Path:
    """Return dousa's folder in the user's cache."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        return base / "dousa" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "dousa"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dousa"


def models_folder() -> Path:
    """Return the folder of the models: ``DOUSA_MODELS``, else a folder of the user's cache."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else user_cache() / "models"


def get_pose_model(name: str) -> PoseModel:
    """Return the model of a name; OptionError if it is unknown."""
    models = {model.name: model for model in POSE_MODELS}
    if name not in models:
        raise OptionError("models.unknown", found=name, known=tuple(models))
    return models[name]


def is_model(model: PoseModel, data: bytes) -> bool:
    """Return whether bytes are one of the published forms of a model."""
    return any(len(data) == size and hashlib.sha256(data).hexdigest() == sha256 for size, sha256 in model.forms)


def choose_pose_model() -> LandmarkModel:
    """Return the most precise installed landmark model; ``"full"`` if none is."""
    for name in reversed(LANDMARK_MODELS):
        if check_pose_model(get_pose_model(name)) == "installed":
            return name
    return "full"


def check_pose_model(model: PoseModel) -> ModelState:
    """Return whether a model is installed, missing or damaged."""
    path = models_folder() / model.file_name
    try:
        if path.stat().st_size not in [form.n_bytes for form in model.forms]:
            return "damaged"
        return "installed" if is_model(model, path.read_bytes()) else "damaged"
    except OSError:
        return "missing"


def find_pose_model(name: str) -> Path:
    """Return the file of an installed model.

    Parameters
    ----------
    name : ``"detector"``, ``"lite"``, ``"full"`` or ``"heavy"``.

    Raises
    ------
    OptionError : an unknown model.
    KeypointError : it is missing or damaged; the message has the command that installs it.
    """
    model = get_pose_model(name)
    state, path = check_pose_model(model), models_folder() / model.file_name
    if state == "missing":
        raise KeypointError("models.missing", model=name)
    if state == "damaged":
        raise KeypointError("models.damaged", model=name, path=path)
    return path


NPM_PACKAGE = "@mediapipe/pose@0.5.1675469404"
"""All four models, 41 MB."""
PIP_PACKAGE = "mediapipe==0.10.21"
"""The detector and ``full``, 36 MB."""

_IN_PIP = ("detector", "full")
_MOST_ARCHIVE, _MOST_UNPACKED, _MOST_MEMBERS = 400_000_000, 1_500_000_000, 50_000
_LARGEST = max(form.n_bytes for model in POSE_MODELS for form in model.forms)
_SIZES = {form.n_bytes for model in POSE_MODELS for form in model.forms}
_DAMAGE = (tarfile.TarError, zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError, NotImplementedError)
_PIP_OPTIONS = (  # a wheel is only opened here, so that of any platform will do
    "--no-deps", "--only-binary=:all:", "--python-version", "3.11", "--platform", "manylinux_2_28_x86_64",
    "--disable-pip-version-check", "--quiet",
)  # fmt: skip


def install_models(
    names: Sequence[str] = (), source: str | os.PathLike[str] | None = None, progress: Progress | None = None
) -> tuple[Path, ...]:
    """Install models and return their files, also those already there.

    Parameters
    ----------
    names : of the models wanted; by default all in the source.
    source : an archive (.tgz, .tar.gz, .whl, .zip) or a model itself (.tflite); by default a package is fetched.
    progress : called with (done, total, what).

    Raises
    ------
    OptionError : an unknown model.
    KeypointError : no package client, one that fails, an archive that is damaged, hostile, or without models.
    MotionWriteError : the folder cannot be written to.
    """
    report = progress or (lambda done, total, what: None)
    wanted = [get_pose_model(name) for name in names] or list(POSE_MODELS)
    if source is not None:
        found = _take(Path(source), wanted, report)
        _check_found([model for model in wanted if names and model.name not in found], source)
        return tuple(found.values())
    there = {
        model.name: models_folder() / model.file_name for model in wanted if check_pose_model(model) == "installed"
    }
    missing = [model for model in wanted if model.name not in there]
    if missing:
        with tempfile.TemporaryDirectory(prefix="dousa-models-") as folder:
            package = _fetch(missing, bool(names), Path(folder), report)
            found = _take(package, missing, report)
            needed = names or ([model.name for model in missing] if package.suffix == ".tgz" else _IN_PIP)
            _check_found([model for model in missing if model.name in needed and model.name not in found], package)
            there |= found
    return tuple(there.values())


def _check_found(lacking: Sequence[PoseModel], source: str | os.PathLike[str]) -> None:
    if lacking:
        raise KeypointError("models.not_in_archive", models=[model.name for model in lacking]).at(source)


def _fetch(missing: Sequence[PoseModel], named: bool, folder: Path, report: Progress, patience: int = 1800) -> Path:
    """Fetch a package into a folder with npm or pip, within ``patience`` s, and return its file."""
    npm = shutil.which("npm")
    if npm is not None:
        words, package = [npm, "pack", "--silent", "--pack-destination", str(folder), NPM_PACKAGE], NPM_PACKAGE
    elif named and any(model.name not in _IN_PIP for model in missing):
        raise KeypointError("models.no_npm", models=[model.name for model in missing], package=NPM_PACKAGE)
    else:
        words = [sys.executable, "-m", "pip", "download", *_PIP_OPTIONS, "-d", str(folder), PIP_PACKAGE]
        package = PIP_PACKAGE
    report(0, 1, Message("models.fetching", package=package))
    try:
        done = subprocess.run(
            words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, timeout=patience, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KeypointError("models.client", command=" ".join(words[:4]), reason=str(error)) from error
    files = [path for path in folder.iterdir() if path.suffix in (".tgz", ".whl")]
    if done.returncode or len(files) != 1:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()
        reason = " ".join(line.strip() for line in said[-3:])[:400] or str(done.returncode)
        raise KeypointError("models.client", command=f"{Path(words[0]).name} {package}", reason=reason)
    return files[0]


def _take(source: Path, wanted: Sequence[PoseModel], report: Progress) -> dict[str, Path]:
    """Write the wanted models of an archive and return their files by name."""
    found: dict[str, Path] = {}
    report(0, len(wanted), Message("models.unpacking", path=source.name))
    try:
        if not source.is_file():
            raise KeypointError("models.no_archive")
        if source.stat().st_size > _MOST_ARCHIVE:
            raise KeypointError("models.large_archive", most=_MOST_ARCHIVE // 1_000_000)
        for data in _list_candidates(source):
            for model in wanted:
                if model.name not in found and is_model(model, data):
                    found[model.name] = _write(model, data)
                    report(len(found), len(wanted), Message("models.unpacking", path=source.name))
        if not found:
            raise KeypointError("models.none_in_archive", models=[model.name for model in wanted])
    except KeypointError as error:
        raise error.at(source) from None
    except _DAMAGE as error:
        raise KeypointError("models.broken_archive", reason=str(error)).at(source) from error
    except OSError as error:
        raise KeypointError("models.unreadable_archive", reason=error).at(source) from error
    return found


def _write(model: PoseModel, data: bytes) -> Path:
    folder = models_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise KeypointError("models.no_folder", reason=error).at(folder) from error
    with atomic_write(folder / model.file_name) as file:
        file.write(data)
    return folder / model.file_name


def _list_candidates(source: Path) -> Iterator[bytes]:
    """Yield the members of an archive that have the size of a model; or the file itself."""
    with open(source, "rb") as file:
        is_tar = file.read(2) == b"\x1f\x8b"
    if not is_tar and not zipfile.is_zipfile(source):
        if source.stat().st_size not in _SIZES:
            raise KeypointError("models.unknown_archive")
        yield source.read_bytes()
        return
    with ExitStack() as opened:
        members: Iterator[tuple[str, int, Callable[[], IO[bytes] | None]]]
        if is_tar:
            limited: Any = _Limited(opened.enter_context(gzip.open(source, "rb")))
            tar = opened.enter_context(tarfile.open(fileobj=limited, mode="r|"))
            members = ((one.name, one.size if one.isfile() else -1, partial(tar.extractfile, one)) for one in tar)
        else:
            archive = opened.enter_context(zipfile.ZipFile(source))
            members = ((one.filename, one.file_size, partial(archive.open, one)) for one in archive.infolist())
        for count, (name, size, open_member) in enumerate(members):
            _check_member(count, name)
            if size in _SIZES and (inside := open_member()) is not None:
                with inside:
                    yield inside.read(_LARGEST)


class _Limited:
    """A stream that raises KeypointError beyond a limit of bytes."""

    def __init__(self, stream: gzip.GzipFile) -> None:
        self._stream, self._left = stream, _MOST_UNPACKED

    def read(self, size: int) -> bytes:
        data = self._stream.read(size)
        self._left -= len(data)
        if self._left < 0:
            raise KeypointError("models.bomb", most=_MOST_UNPACKED // 1_000_000)
        return data


def _check_member(count: int, name: str) -> None:
    """Raise KeypointError for too many members, or a name outside the package."""
    path = PurePosixPath(name.replace("\\", "/"))
    if count >= _MOST_MEMBERS:
        raise KeypointError("models.many_members", most=_MOST_MEMBERS)
    if path.is_absolute() or ".." in path.parts or (path.parts and ":" in path.parts[0]):
        raise KeypointError("models.escape", name=name[:80])
