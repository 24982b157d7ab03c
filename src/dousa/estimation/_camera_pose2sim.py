"""Pose2Sim (and Anipose): TOML, one section for each camera.

``size``, ``matrix``, ``distortions`` (k1, k2, p1, p2), ``rotation`` (Rodrigues vector) and ``translation`` (m), from a
world with Z up to OpenCV's camera axes. Sections without a matrix (``metadata``) are not cameras. An orthographic
camera, which Pose2Sim does not know, carries ``kind = "orthographic"``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from dousa.errors import CalibrationError
from dousa.estimation._camera_raw import (
    CameraFormat,
    RawCamera,
    read_distortion,
    read_numbers,
    rotation_from_vector,
    to_y_up,
)
from dousa.estimation._safe_toml import parse_toml
from dousa.estimation.camera import Camera
from dousa.motion.rotations import from_matrix, to_axis_angle

__all__ = ["POSE2SIM", "format_cameras"]

_LIKE_TOML = re.compile(rb"^[ \t]*(matrix|rotation|translation)[ \t]*=", re.MULTILINE)


def _parse(content: bytes, _stem: str) -> list[RawCamera] | None:
    try:
        tree = parse_toml(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        if _LIKE_TOML.search(content):
            raise CalibrationError(f"not whole TOML ({error}); is the file truncated?") from error
        return None
    sections = {
        key: value
        for key, value in tree.items()
        if isinstance(value, dict) and {"matrix", "rotation", "translation"} & value.keys()
    }
    if not sections:
        return None
    return [_read_camera(key, section) for key, section in sections.items()]


def _read_camera(key: str, section: dict[str, Any]) -> RawCamera:
    where = f"section [{key}]"
    if section.get("fisheye", False):
        raise CalibrationError(
            f"{where}: fisheye = true; calibrate with the ordinary lens model, fisheye lenses cannot be read"
        )
    for needed in ("matrix", "rotation", "translation"):
        if needed not in section:
            raise CalibrationError(f"{where}: expected {needed}, got none")
    size = None
    if "size" in section:
        width, height = read_numbers(section["size"], (2,), f"{where}: size")
        size = (round(width), round(height))
    return RawCamera(
        str(section.get("name", key)),
        size,
        read_numbers(section["matrix"], (3, 3), f"{where}: matrix"),
        rotation_from_vector(read_numbers(section["rotation"], (3,), f"{where}: rotation")),
        read_numbers(section["translation"], (3,), f"{where}: translation"),
        read_distortion(section.get("distortions", [0.0] * 4), f"{where}: distortions"),
        str(section.get("kind", "pinhole")),
    )


POSE2SIM = CameraFormat("Pose2Sim TOML", _parse, unit=1.0, up="z")


def format_cameras(cameras: Sequence[Camera]) -> bytes:
    """The file's content, in metres with Z up; the numbers are written to the last digit."""
    lines: list[str] = []
    for number, camera in enumerate(cameras, 1):
        rotation = camera.rotation @ to_y_up("z")
        distortion = camera.distortion if camera.distortion[4] else camera.distortion[:4]
        lines += [
            f"[cam_{number:02d}]",
            f"name = {_quote(camera.name)}",
            f"size = {_list((camera.width, camera.height))}",
            f"matrix = [ {', '.join(_list(row) for row in camera.matrix)}]",
            f"distortions = {_list(distortion)}",
            f"rotation = {_list(to_axis_angle(from_matrix(rotation)))}",
            f"translation = {_list(camera.translation)}",
            "fisheye = false",
            *(['kind = "orthographic"'] if camera.kind == "orthographic" else []),
            "",
        ]
    lines += ["[metadata]", "adjusted = false", "error = 0.0", ""]
    try:
        return "\n".join(lines).encode("utf-8")
    except UnicodeEncodeError as error:
        raise CalibrationError(f"the name of a camera cannot be written as text: {error}") from error


def _list(values: Sequence[float] | np.ndarray) -> str:
    return f"[ {', '.join(repr(float(value)) for value in values)}]"


def _quote(name: str) -> str:
    # TOML's basic strings are JSON's, but for one control character
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
