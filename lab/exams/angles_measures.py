"""The exam of angles: degrees from joints and from files of OpenSim's names, and the plain baselines.

Poses are (T, 14, 3) in metres, in the order of `JOINTS`. Angles are degrees (T, 2), left and right. Axes of the trunk
as the ISB's: X forward, Y up from hips to shoulders, Z right, of the hips for legs and of the shoulders for arms.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.ndimage import median_filter

from lab.exams.sides_people import SIDES, Array, Camera, unit

LIMBS = {"leg": ("hip", "knee", "ankle", "toe"), "arm": ("shoulder", "elbow", "wrist")}
JOINTS = [f"{side}_{joint}" for side in SIDES for limb in LIMBS.values() for joint in limb]
AT = {name: k for k, name in enumerate(JOINTS)}
ANGLES = ("hip", "knee", "ankle", "hip flexion", "hip adduction", "arm", "elbow", "arm flexion", "arm adduction")
# Shares of the stature: Drillis and Contini 1966, as Winter prints them; hips: Harrington 2007. A bone: parent, share.
BONES = {"hip": ("middle", 0.05), "knee": ("hip", 0.245), "ankle": ("knee", 0.246), "toe": ("ankle", 0.11)}
BONES |= {"shoulder": ("middle", 0.315), "elbow": ("shoulder", 0.186), "wrist": ("elbow", 0.146)}
LUMBAR = 0.3  # where OpenSim's lumbar joint is between hips and shoulders (Rajagopal 2016: 0.16 of 0.53 m)
STEEP = 60.0  # degrees of adduction beyond which flexion is not asked for: it turns about the limb itself


def between(a: Array, b: Array) -> Array:
    return np.rad2deg(np.arccos(np.clip(np.sum(unit(a, np.nan) * unit(b, np.nan), axis=-1), -1, 1)))


def make_axes(up: Array, right: Array) -> Array:
    """Rows X, Y, Z of the trunk's axes (T, 3, 3): Y along `up` (T, 3), Z as near to `right` as can be."""
    up = unit(up)
    right = unit(right - np.sum(right * up, axis=1, keepdims=True) * up)
    return np.stack([np.cross(up, right), up, right], axis=1)


def planes(limb: Array, sign: int) -> tuple[Array, Array, Array]:
    """Angle to the hanging limb, flexion, adduction (about Z, then the turned X) of directions in the trunk's axes."""
    adduction = np.rad2deg(np.arcsin(np.clip(-sign * limb[..., 2], -1, 1)))
    return between(limb, np.array([0, -1.0, 0])), np.rad2deg(np.arctan2(limb[..., 0], -limb[..., 1])), adduction


def find_angles(pose: Array) -> dict[str, Array]:
    """Each of `ANGLES` of poses; knee, elbow: 0 straight; ankle: toes up, against the shank's square."""
    at = {name: pose[:, k] for name, k in AT.items()}
    up = unit(sum(at[f"{side}_shoulder"] - at[f"{side}_hip"] for side in SIDES))
    found: dict[str, list[Array]] = {name: [] for name in ANGLES}
    for sign, side in ((-1, "left"), (1, "right")):
        for limb, (top, middle, end, *toe) in LIMBS.items():
            right = at[f"right_{top}"] - at[f"left_{top}"]
            upper, lower = (at[f"{side}_{b}"] - at[f"{side}_{a}"] for a, b in ((top, middle), (middle, end)))
            values = planes(unit(np.einsum("tij,tj->ti", make_axes(up, right), upper)), sign)
            name = "hip" if limb == "leg" else "arm"
            for key, value in zip((name, f"{name} flexion", f"{name} adduction"), values, strict=True):
                found[key].append(value)
            found["knee" if toe else "elbow"].append(between(upper, lower))
            if toe:
                found["ankle"].append(90 - between(lower, at[f"{side}_toe"] - at[f"{side}_ankle"]))
    return {name: np.stack(values, axis=1) for name, values in found.items()}


def differ(found: dict[str, Array], truth: dict[str, Array], level: bool = False) -> dict[str, float]:
    """Mean absolute differences, the short way round; `level`: of the ankle without the median, its zero being free."""
    miss = {}
    for name in [name for name in ANGLES if name in found]:
        gap = (found[name] - truth[name] + 180) % 360 - 180
        gap = gap - np.median(gap, axis=0) if level and name == "ankle" else gap
        asked = np.abs(truth[name.replace("flexion", "adduction")]) < STEEP if "flexion" in name else np.isfinite(gap)
        miss[name] = float(np.abs(gap)[asked].mean()) if asked.any() else np.nan
    for group, parts in (("legs", ("hip", "knee")), ("arms", ("arm", "elbow"))):
        miss[group] = float(np.mean([miss.get(part, np.nan) for part in parts]))
    return miss


def turn(about: Sequence[int], *degrees: Array) -> Array:
    """Rotations (T, 3, 3): about the first axis, then about the turned others."""
    matrices = np.eye(3)
    for axis, angle in zip(about, degrees, strict=True):
        vectors = np.deg2rad(angle)[:, None] * np.eye(3)[axis]
        matrices = matrices @ np.stack([cv2.Rodrigues(vector)[0] for vector in vectors])
    return matrices


def read_angles(columns: dict[str, Array]) -> dict[str, Array]:
    """Each of `ANGLES` that columns of OpenSim's names hold (docs/opensim.md); else bare hinges of dousa's names."""
    found: dict[str, list[Array]] = {name: [] for name in ANGLES}
    still = np.zeros(len(next(iter(columns.values()))))
    turns = (columns.get(f"lumbar_{word}", still) for word in ("extension", "bending", "rotation"))
    lumbar, up, right = turn((2, 0, 1), *turns), np.array([0, 1.0, 0]), np.array([0, 0, 1.0])
    lines = {"hip": LUMBAR * up + (1 - LUMBAR) * lumbar[:, :, 1], "arm": LUMBAR * lumbar[:, 1] + (1 - LUMBAR) * up}
    trunk = {name: make_axes(line, right) for name, line in lines.items()}  # in axes of the pelvis, of the torso
    for sign, (letter, side) in ((-1, ("l", "left")), (1, ("r", "right"))):
        hinges = {"knee": f"knee_angle_{letter}", "ankle": f"ankle_angle_{letter}", "elbow": f"elbow_flex_{letter}"}
        for name, column in hinges.items():
            for key in (column, f"{side}_{name}.1") if name != "ankle" else (column,):
                if key in columns:
                    found[name].append(columns[key])
                    break
        for name, stem in (("hip", "hip_{}_" + letter), ("arm", "arm_{}_" + letter)):
            words = ("flexion", "adduction") if name == "hip" else ("flex", "add")
            if stem.format(words[0]) in columns:
                flexion, adduction = (columns[stem.format(word)] for word in words)
                limb = turn((2, 0), flexion, sign * adduction)[:, :, 1] * -1.0
                limb = np.einsum("tij,tj->ti", trunk[name], limb)  # against the trunk, as the positions tell it
                for key, value in zip((name, f"{name} flexion", f"{name} adduction"), planes(limb, sign), strict=True):
                    found[key].append(value)
    return {name: np.stack(values, axis=1) for name, values in found.items() if len(values) == 2}


def to_rays(points: Array, camera: Camera, lens: Array) -> Array:
    """Points on the plane z = 1 of the camera, of pixels (..., 2)."""
    flat = cv2.undistortPoints(points.reshape(-1, 1, 2).astype(float), camera.matrix, lens)
    return np.concatenate([flat[:, 0], np.ones((len(flat), 1))], axis=1).reshape(*points.shape[:-1], 3)


def fill(values: Array, known: Array) -> Array:
    """Values (T, K, D), interpolated over time where they are not known (T, K)."""
    out, times = values.copy(), np.arange(len(values))
    for k in range(values.shape[1]):
        if known[:, k].any():
            for d in range(values.shape[2]):
                out[:, k, d] = np.interp(times, times[known[:, k]], values[known[:, k], k, d])
    return out


def triangulate(rays: Array, trust: Array, cameras: Sequence[Camera]) -> Array:
    """The baseline of keypoints (T, K, 3), of rays (V, T, K, 3): linear, weighted by confidence; median of 5 frames."""
    found, known = np.zeros(rays.shape[1:]), np.sum(trust > 0, axis=0) > 1
    matrices = np.stack([np.column_stack([camera.rotation, camera.translation]) for camera in cameras])
    for t, k in np.argwhere(known):
        rows = rays[:, t, k, :2, None] * matrices[:, 2:3] - matrices[:, :2]
        *_, vectors = np.linalg.svd((trust[:, t, k, None, None] * rows).reshape(-1, 4))
        found[t, k] = vectors[-1, :3] / vectors[-1, 3]
    return median_filter(fill(found, known), (5, 1, 1))


def lift(rays: Array, trust: Array, camera: Camera, stature: float, first: Array) -> Array:
    """The baseline of one view (T, 14, 3): the distance at which no bone is too long, then bone by bone.

    Of the two places of a joint that a bone's length allows, the one nearest to the frame before; `first` (14, 3) in
    the world stands before the first frame.
    """
    rays = fill(rays, trust > 0)
    places = dict(zip(JOINTS, rays.swapaxes(0, 1), strict=True))
    before = dict(zip(JOINTS, first @ camera.rotation.T + camera.translation, strict=True))
    names = [f"{side}_{joint}" for side in SIDES for joint in BONES]
    parents = {name: name.split("_")[0] + "_" + BONES[name.split("_")[1]][0] for name in names}
    for pose in (places, before):
        pose |= {f"{side}_middle": (pose["left_hip"] + pose["right_hip"]) / 2 for side in SIDES}
    long = [name for name in names if name.endswith(("knee", "ankle"))]
    spans = [np.linalg.norm(places[n] - places[parents[n]], axis=1) / BONES[n.split("_")[1]][1] for n in long]
    depths = median_filter(stature / np.max(spans, axis=0), 15)
    found = np.zeros((len(rays), len(JOINTS), 3))
    for t, depth in enumerate(depths):
        now = {f"{side}_middle": depth * places["left_middle"][t] for side in SIDES}
        for name in names:
            start, ray, length = now[parents[name]], unit(places[name][t]), stature * BONES[name.split("_")[1]][1]
            nearest = ray @ start
            half = np.sqrt(max(nearest**2 - start @ start + length**2, 0))
            ways = [(nearest + s * half) * ray - start for s in (-1, 1)]
            was = before[name] - before[parents[name]]
            now[name] = start + min(ways, key=lambda way, was=was: float(np.sum((way - was) ** 2)))
        before, found[t] = now, [now[name] for name in JOINTS]
    return median_filter((found - camera.translation) @ camera.rotation, (5, 1, 1))


def carry(first: Array, rays: Array, cameras: Sequence[Camera]) -> Array:
    """The baseline of silhouettes (T, 14, 3): the true first pose, moved as rays (V, T, 3) of the centres meet."""
    middle, points = first.mean(axis=0), []
    for t in range(rays.shape[1]):
        total, right = 1e-3 * np.eye(3), 1e-3 * middle  # one view alone keeps the distance
        for camera, ray in zip(cameras, rays[:, t], strict=True):
            way = unit(ray @ camera.rotation)
            across = np.eye(3) - np.outer(way, way)
            total, right = total + across, right - across @ camera.rotation.T @ camera.translation
        points.append(np.linalg.solve(total, right))
    return first + (np.array(points) - points[0])[:, None]
