"""Qualisys Track Manager: the calibration that QTM exports as XML (``.qca.txt``, ``.xml``).

Intrinsic numbers are in 1/64 pixel, from the middle of the sensor's first pixel; the image is the cut-out
``fov_video`` of the sensor. Places are in mm, Z up. The camera's own axes are x right, y up, z backwards:
x_camera = diag(1, -1, -1) R (X - C). The distortion is OpenCV's; it belongs to normalised coordinates and is no pixel
number (some converters divide it by 64 too).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from dousa.errors import CalibrationError
from dousa.estimation._camera_raw import CameraFormat, RawCamera, parse_number
from dousa.estimation._safe_xml import parse_xml

__all__ = ["QUALISYS"]

_PER_PIXEL = 64.0
_FLIP = np.diag([1.0, -1.0, -1.0])


def _parse(content: bytes, _stem: str) -> list[RawCamera] | None:
    if not content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return None
    root = parse_xml(content)
    if root.tag != "calibration":
        return None
    if "fisheye" in (root.get("type") or "").lower():
        raise CalibrationError("expected a calibration of ordinary lenses, got fisheye lenses")
    elements = [element for element in root.findall("cameras/camera") if element.get("active", "1") != "0"]
    if not elements:
        raise CalibrationError("expected active cameras in <cameras>, got none")
    return [_read_camera(element, f"camera{number}") for number, element in enumerate(elements, 1)]


def _read_camera(element: ET.Element, otherwise: str) -> RawCamera:
    name = (element.get("serial") or "").strip() or otherwise
    where = f"camera '{name}'"
    transform, intrinsic = _child(element, "transform", where), _child(element, "intrinsic", where)
    size, corner = _read_view(element, intrinsic, where)
    pixels = {
        key: _value(intrinsic, key, where) / _PER_PIXEL
        for key in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    }
    skew = _value(intrinsic, "skew", where, 0.0)
    if abs(skew) > 1e-6:  # its unit is not told, and no camera of today has any
        raise CalibrationError(f"{where}: intrinsic skew: expected 0, got {skew:g}")
    matrix = np.array(
        [
            [pixels["focalLengthU"], 0.0, pixels["centerPointU"] - corner[0]],
            [0.0, pixels["focalLengthV"], pixels["centerPointV"] - corner[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    radial = [_value(intrinsic, f"radialDistortion{k}", where, 0.0) for k in (1, 2, 3)]
    tangential = [_value(intrinsic, f"tangentalDistortion{k}", where, 0.0) for k in (1, 2)]
    turned = [[_value(transform, f"r{row}{column}", where) for column in (1, 2, 3)] for row in (1, 2, 3)]
    rotation = _FLIP @ np.array(turned)
    centre = np.array([_value(transform, axis, where) for axis in "xyz"])
    distortion = np.array([*radial[:2], *tangential, radial[2]])
    return RawCamera(name, size, matrix, rotation, -rotation @ centre, distortion)


def _child(element: ET.Element, tag: str, where: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise CalibrationError(f"{where}: expected an element <{tag}>, got none; was the camera calibrated?")
    return child


def _value(element: ET.Element, key: str, where: str, otherwise: float | None = None) -> float:
    text = element.get(key)
    if text is None:
        if otherwise is None:
            raise CalibrationError(f"{where}: {element.tag}: expected {key}, got none")
        return otherwise
    return parse_number(text, f"{where}: {element.tag} {key}")


def _read_view(
    element: ET.Element, intrinsic: ET.Element, where: str
) -> tuple[tuple[int, int], tuple[float, float]]:
    """Size of the image in pixels, and the sensor's pixel at its upper left corner."""
    first = [_value(intrinsic, f"sensorMin{axis}", where, 0.0) / _PER_PIXEL for axis in "UV"]
    last = [_value(intrinsic, f"sensorMax{axis}", where, 0.0) / _PER_PIXEL for axis in "UV"]
    sensor = all(high > low for low, high in zip(first, last, strict=True))
    view = element.find("fov_video")
    if view is None:
        if not sensor:
            raise CalibrationError(f"{where}: expected the size of the image in fov_video, got none")
        corner, end = first, last
    else:
        corner = [_value(view, side, where) for side in ("left", "top")]
        end = [_value(view, side, where) for side in ("right", "bottom")]
        if sensor and any(high > limit + 1.0 for high, limit in zip(end, last, strict=True)):
            raise CalibrationError(
                f"{where}: fov_video ends at pixel {end[0]:g}, {end[1]:g}, "
                f"beyond the sensor's last, {last[0]:g}, {last[1]:g}"
            )
    width, height = (round(high - low) + 1 for low, high in zip(corner, end, strict=True))
    return (width, height), (corner[0], corner[1])


QUALISYS = CameraFormat("Qualisys XML", _parse, unit=0.001, up="z", unit_is_sure=True)
