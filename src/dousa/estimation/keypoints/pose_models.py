"""The models that find people and their keypoints: which there are, where they are kept, whether they are whole.

They are Google's BlazePose models (Bazarevsky and others, 2020), Apache-2.0, and lie inside published packages of
MediaPipe. dousa ships none of them and takes none without being asked: `model_archives.install_models` takes them
out of a package, here they are only looked for. ``DOUSA_MODELS`` names another folder than the user's cache.
"""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dousa.errors import KeypointError, OptionError

ModelState = Literal["installed", "missing", "damaged"]

FOLDER_VARIABLE = "DOUSA_MODELS"
DETECTOR = "detector"
LandmarkModel = Literal["lite", "full", "heavy"]
LANDMARK_MODELS: tuple[LandmarkModel, ...] = ("lite", "full", "heavy")
"""From the quickest to the most precise."""


@dataclass(frozen=True, slots=True)
class ModelFile:
    """One published form of a model.

    Parameters
    ----------
    n_bytes : of the file.
    sha256 : of its content, in hexadecimal.
    """

    n_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A model.

    Parameters
    ----------
    name : ``"detector"``, or one of `LANDMARK_MODELS`.
    file_name : in the folder of the models.
    forms : published files that are this model, any of which will do.
    """

    name: str
    file_name: str
    forms: tuple[ModelFile, ...]


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
    """The folder of this user's cache that is dousa's."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        return base / "dousa" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "dousa"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dousa"


def models_folder() -> Path:
    """Where models are kept: ``DOUSA_MODELS``, else a folder of the user's cache."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else user_cache() / "models"


def get_pose_model(name: str) -> PoseModel:
    """The model of a name.

    Raises
    ------
    OptionError : there is none.
    """
    for model in POSE_MODELS:
        if model.name == name:
            return model
    raise OptionError("models.unknown", found=name, known=tuple(model.name for model in POSE_MODELS))


def is_model(model: PoseModel, data: bytes) -> bool:
    """Whether bytes are one of the published forms of a model."""
    sizes = [form.n_bytes for form in model.forms]
    return len(data) in sizes and hashlib.sha256(data).hexdigest() in [form.sha256 for form in model.forms]


def choose_pose_model() -> LandmarkModel:
    """The most precise landmark model that is installed; ``"full"`` where none is, so that its error is said."""
    for name in reversed(LANDMARK_MODELS):
        if check_pose_model(get_pose_model(name)) == "installed":
            return name
    return "full"


def check_pose_model(model: PoseModel) -> ModelState:
    """Whether a model is there, and whole."""
    path = models_folder() / model.file_name
    try:
        if path.stat().st_size not in [form.n_bytes for form in model.forms]:
            return "damaged"
        return "installed" if is_model(model, path.read_bytes()) else "damaged"
    except OSError:
        return "missing"


def find_pose_model(name: str) -> Path:
    """The file of a model that is installed.

    Parameters
    ----------
    name : ``"detector"``, ``"lite"``, ``"full"`` or ``"heavy"``.

    Raises
    ------
    OptionError : there is no such model.
    KeypointError : it is not installed, or its file is damaged; the message has the command that installs it.
    """
    model = get_pose_model(name)
    state = check_pose_model(model)
    if state == "missing":
        raise KeypointError("models.missing", model=name)
    if state == "damaged":
        raise KeypointError("models.damaged", model=name, path=models_folder() / model.file_name)
    return models_folder() / model.file_name
