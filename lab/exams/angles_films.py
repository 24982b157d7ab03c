"""The exam of angles: its clips, what phones with lenses see of them, and the files that are given.

Keypoints are true joints in 1440 x 1080: clean with 5 px of noise that wanders (some 12 mm) and 2 px that does not;
noisy with 7 and 3 px, wrong points, limbs missing, and in half of the views sides exchanged for some frames. Masks are
those of the exam of sides, bent by the lens.
"""

import json
from pathlib import Path

import cv2
import numpy as np

from lab.exams.angles_measures import JOINTS, to_rays
from lab.exams.sides_people import HDM05, LOOSE, PLAIN, RATE, SMALL, STOUT, TALL, VICON, Array, Camera, Clip, unit

WIDTH, HEIGHT = 320, 240  # of the exam of sides
FINE = 4.5  # the keypoints' picture is so many times that of the silhouettes
CLIPS = (  # none of those of the exam of sides
    Clip("squat", VICON.format("m01", "s01_e05"), STOUT, 14, 30),
    Clip("grab high", HDM05.format("grabHighR", "bk", "008"), TALL, 4, 70),
    Clip("side lunge", VICON.format("m04", "s02_e04"), LOOSE, 22, 60),
    Clip("sneak", HDM05.format("sneak2StepsLStart", "bk", "005"), SMALL, 20, 20),
    Clip("scaption", VICON.format("m10", "s02_e07"), PLAIN, 10, 55),
    Clip("kick", HDM05.format("kickLFront1Reps", "dg", "016"), SMALL, 0, 40),
    Clip("sit to stand", VICON.format("m05", "s04_e06"), TALL, 30, 35),
    Clip("throw", HDM05.format("throwBasketball", "bd", "002"), STOUT, 20, 45),
    Clip("abduction", VICON.format("m07", "s01_e06"), LOOSE, 20, 80),
    Clip("lunge", VICON.format("m03", "s04_e05"), SMALL, 15, 10),
    Clip("put on the floor", HDM05.format("depositFloorR", "bk", "009"), PLAIN, 20, 30),
    Clip("deep squat", HDM05.format("squat1Reps", "dg", "030"), LOOSE, 4, 25),
)
BODY_25 = "nose neck Rshoulder Relbow Rwrist Lshoulder Lelbow Lwrist hips Rhip Rknee Rankle Lhip Lknee Lankle Reye Leye"
BODY_25 += " Rear Lear Ltoe Lsmall Lheel Rtoe Rsmall Rheel"
SCHEMES = {"BODY_25": BODY_25.split(), "COCO": [name for name in BODY_25.split()[:19] if name != "hips"]}
LETTERS = {"left": "L", "right": "R"}


def draw_lenses(n_views: int, luck: np.random.Generator) -> Array:
    """OpenCV's k1, k2, p1, p2 of each phone."""
    return luck.uniform([-0.12, -0.02, -0.001, -0.001], [0.06, 0.03, 0.001, 0.001], (n_views, 4))


def bend(masks: Array, camera: Camera, lens: Array) -> Array:
    """Masks (T, H, W) as the lens shows them."""
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).astype(float)
    straight = (to_rays(grid, camera, lens) @ camera.matrix.T)[..., :2].astype(np.float32)
    return np.stack([cv2.remap(m.astype(np.float32), straight, None, cv2.INTER_LINEAR) > 0.5 for m in masks])


def enlarge(camera: Camera) -> Camera:
    """The same camera with the keypoints' pixels, whose centres are whole."""
    scale = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    return camera._replace(matrix=scale @ camera.matrix)


def choose_scheme(number: int) -> tuple[list[str], list[int | None]]:
    """Names of the points of BODY_25 or of COCO, in turns, and where each of `JOINTS` is among them."""
    names = list(SCHEMES.values())[number % 2]
    wanted = [LETTERS[side] + joint for side, joint in (name.split("_") for name in JOINTS)]
    return names, [names.index(name) if name in names else None for name in wanted]


def make_points(joints: dict[str, Array], stature: float, names: list[str]) -> Array:
    """Where a network's points lie on the body (T, K, 3)."""
    points = {LETTERS[name.split("_")[0]] + name.split("_")[1]: joints[name] for name in JOINTS}
    left = unit(joints["left_shoulder"] - joints["right_shoulder"])
    ahead = unit(np.cross(left, joints["head"] - joints["neck"]))
    points |= {"neck": (points["Lshoulder"] + points["Rshoulder"]) / 2, "hips": (points["Lhip"] + points["Rhip"]) / 2}
    points["nose"] = joints["head"] + 0.055 * stature * ahead
    for sign, s in ((1, "L"), (-1, "R")):
        points[s + "eye"] = points["nose"] + 0.018 * stature * (sign * left + unit(joints["head"] - joints["neck"]))
        points[s + "ear"] = joints["head"] + sign * 0.045 * stature * left
        foot = unit(points[s + "toe"] - points[s + "ankle"])
        down = unit(points[s + "ankle"] - points[s + "knee"])
        points[s + "heel"] = points[s + "ankle"] + 0.03 * stature * (down - foot)
        points[s + "small"] = points[s + "toe"] + 0.03 * stature * (sign * left - 0.5 * foot)
    return np.stack([points[name] for name in names], axis=1)


def see(points: Array, names: list[str], camera: Camera, lens: Array, noisy: bool, luck: np.random.Generator) -> Array:
    """One view's x, y, confidence (T, K, 3) of points in the world (T, K, 3)."""
    n_frames, n_points = points.shape[:2]
    turned = cv2.Rodrigues(camera.rotation)[0], camera.translation
    pixels = cv2.projectPoints(points.reshape(-1, 1, 3), *turned, camera.matrix, lens)[0].reshape(n_frames, n_points, 2)
    slow, quick = (7.0, 3.0) if noisy else (5.0, 2.0)
    shift = luck.normal(0, quick, pixels.shape)
    wander, steps = slow * luck.normal(size=pixels.shape[1:]), luck.normal(0, slow * (1 - 0.9**2) ** 0.5, pixels.shape)
    for t in range(n_frames):
        shift[t] += wander
        wander = 0.9 * wander + steps[t]
    if noisy:
        wrong = luck.random((n_frames, n_points)) < 0.02
        shift[wrong] += luck.normal(0, 60, (wrong.sum(), 2))
    sure = 0.95 - np.linalg.norm(shift, axis=-1) / 80 + 0.04 * luck.normal(size=(n_frames, n_points))
    seen = np.concatenate([pixels + shift, np.clip(sure, 0.15, 1)[..., None]], axis=-1)
    if noisy:  # sides exchanged, and limbs missing, for some frames each
        other = [names.index({"L": "R", "R": "L"}.get(name[0], name[0]) + name[1:]) for name in names]
        begin, many, moved = luck.integers(0, n_frames), luck.integers(4, 11), luck.integers(4)
        legs = "hip knee ankle toe small heel".split()
        index = [k for k, name in enumerate(names) if name[0] in "LR" and (name[1:] in legs or moved)]
        if moved < 2:
            seen[begin : begin + many, index] = seen[begin : begin + many][:, [other[k] for k in index]]
        for limb in ("knee ankle toe small heel".split(), "elbow wrist".split()):
            begin, many, side = luck.integers(0, n_frames), luck.integers(4, 13), "LR"[luck.integers(2)]
            seen[begin : begin + many, [k for k, n in enumerate(names) if n[0] == side and n[1:] in limb]] = 0
    return seen


def write_calibration(path: Path, cameras: list[Camera], lenses: Array, fine: float) -> None:
    """As Pose2Sim writes it, whose world has Z up."""
    lines = []
    for number, (camera, lens) in enumerate(zip(cameras, lenses, strict=True), start=1):
        turned = cv2.Rodrigues(camera.rotation @ np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]))[0][:, 0]
        values = {
            "size": [fine * WIDTH, fine * HEIGHT],
            "matrix": camera.matrix.tolist(),
            "distortions": lens.tolist(),
        }
        values |= {"rotation": turned.tolist(), "translation": camera.translation.tolist()}
        lines += [f"[cam_{number:02d}]", f'name = "cam{number:02d}"', "fisheye = false"]
        lines += [*(f"{key} = {value}" for key, value in values.items()), ""]
    path.write_text("\n".join(lines))


def write_keypoints(folder: Path, seen: list[Array]) -> list[str]:
    for number, view in enumerate(seen, start=1):
        (place := folder / f"cam{number:02d}_json").mkdir()
        for t, points in enumerate(view.round(3)):
            person = {"person_id": [-1], "pose_keypoints_2d": points.ravel().tolist()}
            text = json.dumps({"version": 1.3, "people": [person]})
            (place / f"cam{number:02d}_{t:012d}_keypoints.json").write_text(text)
    return [str(folder / f"cam{number:02d}_json") for number in range(1, len(seen) + 1)]


def write_masks(folder: Path, masks: Array, pictures: bool) -> list[str]:
    """A packed npz without cameras, or a folder of pictures for each view."""
    if not pictures:
        packed = np.packbits(masks, axis=3)
        np.savez(folder / "clip.npz", mask_packed=packed, width=WIDTH, height=HEIGHT, frame_rate=RATE)
        return [str(folder / "clip.npz")]
    for number, view in enumerate(masks, start=1):
        (place := folder / f"cam{number:02d}").mkdir()
        for t, mask in enumerate(view):
            cv2.imwrite(str(place / f"{t:05d}.png"), 255 * mask.astype(np.uint8))
    return [str(folder / f"cam{number:02d}") for number in range(1, len(masks) + 1)]
