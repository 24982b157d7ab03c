"""The plainest thing that could be done instead of dousa: BlazePose frame by frame and linear triangulation.

Nothing here comes from dousa but the model files, which `dousa keypoints --install` puts into the cache.
Lengths in metres, world Y up as in the reference TRC, pixels of the calibration (1088 x 1920).
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as Xml
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

SIDES = ("left", "right")
LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")
JOINTS = ["pelvis", "neck", "head", *(f"{side}_{limb}" for side in SIDES for limb in LIMBS)]  # 17
LANDMARKS = {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27, "toe": 31}  # left; right + 1
HALPE = {"shoulder": "Shoulder", "elbow": "Elbow", "wrist": "Wrist", "hip": "Hip", "knee": "Knee", "ankle": "Ankle"}
CACHE = Path(os.environ.get("EXAM_CACHE", Path("build/exam_film")))
MODELS = Path(os.environ.get("DOUSA_MODELS", Path.home() / ".cache/dousa/models"))


@dataclass
class Camera:
    """x_camera = R x_world + t (x right, y down, z forward), matrix and lens as in OpenCV, size (width, height)."""

    name: str
    matrix: np.ndarray
    lens: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    size: tuple[int, int]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of world points (..., 3); NaN where a point is NaN."""
        flat = np.asarray(points, float).reshape(-1, 3)
        known = np.isfinite(flat).all(axis=1)
        pixels = np.full((len(flat), 2), np.nan)
        if known.any():
            turn = cv2.Rodrigues(self.rotation)[0]
            pixels[known] = cv2.projectPoints(flat[known], turn, self.translation, self.matrix, self.lens)[0][:, 0]
        return pixels.reshape(*points.shape[:-1], 2)

    def straighten(self, pixels: np.ndarray) -> np.ndarray:
        """Coordinates (..., 2) on the plane z = 1, without the lens's distortion."""
        flat = np.ascontiguousarray(pixels, float).reshape(-1, 1, 2)
        return cv2.undistortPoints(flat, self.matrix, self.lens).reshape(pixels.shape)


def read_qualisys(path: Path) -> list[Camera]:
    """The traps: intrinsics in 1/64 pixel, millimetres, X_zup = (z, x, y), X_cam = diag(1, -1, -1) R (X - C)."""
    cameras = []
    for one in Xml.parse(path).getroot().iter("camera"):
        t, k, fov = one.find("transform").attrib, one.find("intrinsic").attrib, one.find("fov_video").attrib
        turn = np.array([[float(t[f"r{i}{j}"]) for j in (1, 2, 3)] for i in (1, 2, 3)])
        centre = np.array([float(t[axis]) for axis in "xyz"]) / 1000
        z_up = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # (x, y, z) of the TRC -> (z, x, y)
        rotation = np.diag([1, -1, -1]) @ turn @ z_up
        sixty_fourth = {name: float(value) / 64 for name, value in k.items()}
        matrix = np.array(
            [
                [sixty_fourth["focalLengthU"], 0, sixty_fourth["centerPointU"]],
                [0, sixty_fourth["focalLengthV"], sixty_fourth["centerPointV"]],
                [0, 0, 1],
            ]
        )
        lens = np.array(
            [
                float(k[name])
                for name in (
                    "radialDistortion1",
                    "radialDistortion2",
                    "tangentalDistortion1",
                    "tangentalDistortion2",
                    "radialDistortion3",
                )
            ]
        )
        size = (int(fov["right"]) + 1, int(fov["bottom"]) + 1)
        shift = -np.diag([1, -1, -1]) @ turn @ centre
        cameras.append(Camera(one.attrib["serial"], matrix, lens, rotation, shift, size))
    return cameras


def read_trc(path: Path) -> tuple[dict[str, np.ndarray], float]:
    """Markers (T, 3) in metres by name, and the rate in Hz."""
    lines = path.read_text().splitlines()
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    scale = {"m": 1.0, "cm": 0.01, "mm": 0.001}[head["Units"].strip()]
    names = [name for name in lines[3].split("\t")[2:] if name.strip()]
    rows = [line.split("\t") for line in lines[5:] if line.strip()]
    width = 2 + 3 * len(names)
    values = np.array([[float(v) if v.strip() else np.nan for v in (row + [""] * width)[2:width]] for row in rows])
    return {name: scale * values[:, 3 * k : 3 * k + 3] for k, name in enumerate(names)}, float(head["DataRate"])


def read_reference(path: Path) -> np.ndarray:
    """The 17 joints (T, 17, 3) of a HALPE reference; toe = middle of big and small toe, pelvis = middle of the hips."""
    trc, _ = read_trc(path)
    found = {"neck": trc["Neck"], "head": trc["Head"], "pelvis": (trc["LHip"] + trc["RHip"]) / 2}
    for side, letter in zip(SIDES, "LR", strict=True):
        found |= {f"{side}_{limb}": trc[letter + word] for limb, word in HALPE.items()}
        found[f"{side}_toe"] = (trc[f"{letter}BigToe"] + trc[f"{letter}SmallToe"]) / 2
    return np.stack([found[name] for name in JOINTS], axis=1)


def landmarks_to_joints(points: np.ndarray) -> np.ndarray:
    """(..., 33, D) -> (..., 17, D); BlazePose has no neck and no crown: middles of shoulders and of ears."""
    found = {
        f"{side}_{limb}": points[..., k + right, :] for limb, k in LANDMARKS.items() for right, side in enumerate(SIDES)
    }
    found["pelvis"] = (found["left_hip"] + found["right_hip"]) / 2
    found["neck"] = (found["left_shoulder"] + found["right_shoulder"]) / 2
    found["head"] = (points[..., 7, :] + points[..., 8, :]) / 2
    return np.stack([found[name] for name in JOINTS], axis=-2)


def read_frames(path: Path) -> Iterator[np.ndarray]:
    """RGB pictures of a film, as wide as the calibration of pose2sim wants them (README: 1080 -> 1088)."""
    with av.open(str(path)) as film:
        for frame in film.decode(video=0):
            picture = frame.to_ndarray(format="rgb24")
            yield cv2.resize(picture, (1088, 1920)) if picture.shape[:2] == (1920, 1080) else picture


def write_film(path: Path, order: list[int], pictures: list[np.ndarray], rate: int) -> None:
    with av.open(str(path), "w") as film:
        stream = film.add_stream("libx264", rate=rate, options={"crf": "18", "preset": "ultrafast", "g": "30"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, rate)
        for k, which in enumerate(order):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pictures[which]), format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, rate)
            film.mux(stream.encode(frame))
        film.mux(stream.encode())


def without_key_frames(source: Path, target: Path) -> Path:
    """The same packets, except the key frames."""
    with av.open(str(source)) as film, av.open(str(target), "w") as out:
        stream = out.add_stream_from_template(film.streams.video[0])
        for packet in film.demux(video=0):
            if packet.dts is not None and not packet.is_keyframe:
                packet.stream = stream
                out.mux(packet)
    return target


@dataclass
class Crop:
    """A turned square of the picture: middle and side in pixels, turn in radians (0: upright)."""

    middle: np.ndarray
    side: float
    turn: float

    @staticmethod
    def around(hips: np.ndarray, top: np.ndarray) -> Crop:
        reach = top - hips
        side = 2.25 * float(np.hypot(*reach))  # Google: 2.5; tighter is better here: 25 instead of 27 pixels.
        return Crop(hips, side, float(np.pi / 2 - np.arctan2(-reach[1], reach[0])))

    def affine(self) -> np.ndarray:
        """(2, 3): from pixels of a crop of side 1 about its middle to pixels of the picture."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.column_stack([self.side * np.array([[c, -s], [s, c]]), self.middle])


class BlazePose:
    """Detector and landmark model by LiteRT, one thread."""

    def __init__(self, model: str = "heavy") -> None:
        from ai_edge_litert.interpreter import Interpreter

        self.nets = [
            Interpreter(str(MODELS / name), num_threads=1)
            for name in ("pose_detection.tflite", f"pose_landmark_{model}.tflite")
        ]
        for net in self.nets:
            net.allocate_tensors()
        steps = [(28, 2), (14, 2), (7, 6)]  # 2254 anchors
        self.anchors = np.concatenate(
            [
                np.repeat(np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2), -1).reshape(-1, 2), k, axis=0)
                for n, k in steps
            ]
        )

    def run(self, which: int, picture: np.ndarray) -> list[np.ndarray]:
        net = self.nets[which]
        net.set_tensor(net.get_input_details()[0]["index"], picture[None].astype(np.float32))
        net.invoke()
        return [net.get_tensor(out["index"]) for out in net.get_output_details()]

    def detect(self, picture: np.ndarray, least: float = 0.5) -> list[tuple[float, Crop]]:
        """Score and crop of every person, best first, each once."""
        height, width = picture.shape[:2]
        side = max(height, width)
        square = np.zeros((side, side, 3), np.uint8)
        left, top = (side - width) // 2, (side - height) // 2
        square[top : top + height, left : left + width] = picture
        small = cv2.resize(square, (224, 224), interpolation=cv2.INTER_AREA) / 127.5 - 1
        boxes, scores = self.run(0, small)[:2]
        scores = 1 / (1 + np.exp(-np.clip(scores[0, :, 0], -50, 50)))
        found: list[tuple[float, Crop]] = []
        for k in np.argsort(-scores):
            if scores[k] < least:
                break
            ends = [(boxes[0, k, a : a + 2] / 224 + self.anchors[k]) * side - (left, top) for a in (4, 6)]
            crop = Crop.around(*ends)
            if all(np.hypot(*(crop.middle - other.middle)) > 0.15 * other.side for _, other in found):
                found.append((float(scores[k]), crop))
        return found

    def look(self, picture: np.ndarray, crop: Crop) -> tuple[float, np.ndarray, np.ndarray, Crop]:
        """Presence, landmarks (33, 3: pixels and visibility), world points (33, 3: about the hips), the next crop."""
        to_picture = crop.affine() @ np.array([[1 / 256, 0, -0.5], [0, 1 / 256, -0.5], [0, 0, 1]])
        scale = min(1.0, 256 / crop.side)  # Averaged first: sampling every fourth pixel costs 1 pixel of accuracy.
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        inside = cv2.warpAffine(small, scale * to_picture, (256, 256), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        out = self.run(1, inside / 255.0)
        points = next(o for o in out if o.size == 195).reshape(39, 5)
        world = next(o for o in out if o.size == 117).reshape(39, 3)[:33].copy()
        presence = next(float(o.ravel()[0]) for o in out if o.size == 1)
        pixels = points[:, :2] @ to_picture[:, :2].T + to_picture[:, 2]
        seen = 1 / (1 + np.exp(-points[:33, 3:4]))
        c, s = np.cos(crop.turn), np.sin(crop.turn)
        world[:, :2] = world[:, :2] @ np.array([[c, s], [-s, c]])
        return presence, np.hstack([pixels[:33], seen]), world, Crop.around(pixels[33], pixels[34])


Choice = Callable[[int, list[Crop]], Crop | None]


def follow(
    film: Path, name: str, choose: Choice, close: Callable[[int, Crop], bool] | None = None, model: str = "heavy"
) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks (T, 33, 3) and world points (T, 33, 3) of one person: the crop of the landmarks before, else `choose`
    among the detections; given up where `close` says that the crop is at somebody else. Kept under `name`."""
    kept = CACHE / f"{name}_{model}.npz"
    if kept.exists():
        with np.load(kept) as file:
            return file["landmarks"], file["world"]
    net, crop, landmarks, world = BlazePose(model), None, [], []
    for t, picture in enumerate(read_frames(film)):
        if crop is None or (close is not None and not close(t, crop)):
            crop = choose(t, [found for _, found in net.detect(picture, 0.3)])
            for _ in range(2 if crop is not None else 0):  # The second look is centred better.
                crop = net.look(picture, crop)[3]
        presence, points, depth, after = (0.0,) * 4 if crop is None else net.look(picture, crop)
        crop = after if presence > 0.5 else None
        landmarks.append(points if crop is not None else np.full((33, 3), np.nan))
        world.append(depth if crop is not None else np.full((33, 3), np.nan))
    CACHE.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(kept, landmarks=np.stack(landmarks), world=np.stack(world))
    return np.stack(landmarks), np.stack(world)


def biggest(_t: int, found: list[Crop]) -> Crop | None:
    return max(found, key=lambda crop: crop.side, default=None)


def triangulate(cameras: list[Camera], pixels: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Linear triangulation: pixels (V, ..., 2), weights (V, ...) -> world points (..., 3)."""
    rays = [camera.straighten(view) for camera, view in zip(cameras, pixels, strict=True)]
    poses = [np.column_stack([camera.rotation, camera.translation]) for camera in cameras]
    return triangulate_rays(poses, np.stack(rays), weights)


def triangulate_rays(poses: list[np.ndarray], rays: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """The same from [R t] (V, 3, 4) and coordinates on z = 1 (V, ..., 2)."""
    flat = rays.reshape(len(poses), -1, 2)
    heavy = np.ones(flat.shape[:2]) if weights is None else weights.reshape(len(poses), -1)
    heavy = np.where(np.isfinite(flat).all(axis=2), heavy, 0)
    flat = np.nan_to_num(flat)
    rows = np.concatenate(
        [heavy[v, :, None, None] * (flat[v, :, :, None] * poses[v][2] - poses[v][:2]) for v in range(len(poses))],
        axis=1,
    )
    solved = np.linalg.svd(rows)[2][:, -1]
    with np.errstate(all="ignore"):
        points = solved[:, :3] / solved[:, 3:]
    points[(heavy > 0).sum(axis=0) < 2] = np.nan
    return points.reshape(*rays.shape[1:-1], 3)


def place_cameras(rays: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """[R t] (V, 3, 4) of every view from landmarks on z = 1 (V, N, 2): essential matrix of the first pair that works,
    the others by PnP; no bundle adjustment. Scale and world are arbitrary."""
    best: tuple[float, list[np.ndarray]] = (np.inf, [])
    for a in range(len(rays)):
        for b in range(a + 1, len(rays)):
            both = np.isfinite(rays[[a, b]]).all(axis=(0, 2))
            seen = rays[a][both], rays[b][both]
            essential, used = cv2.findEssentialMat(*seen, np.eye(3), cv2.RANSAC, 0.999, tolerance)
            if essential is None or essential.shape != (3, 3):
                continue
            _, turn, shift, _ = cv2.recoverPose(essential, rays[a][both], rays[b][both], np.eye(3), mask=used)
            poses = {a: np.eye(3, 4), b: np.column_stack([turn, shift])}
            points = triangulate_rays([poses[a], poses[b]], rays[[a, b]])
            for v in (v for v in range(len(rays)) if v not in poses):
                seen = np.isfinite(points).all(axis=1) & np.isfinite(rays[v]).all(axis=1)
                _, turn, shift, _ = cv2.solvePnPRansac(
                    points[seen], rays[v][seen], np.eye(3), None, reprojectionError=3 * tolerance
                )
                poses[v] = np.column_stack([cv2.Rodrigues(turn)[0], shift])
            views = [poses[v] for v in range(len(rays))]
            points = triangulate_rays(views, rays)
            seen = np.stack([points @ p[:, :3].T + p[:, 3] for p in views])
            miss = float(np.nanmedian(np.linalg.norm(seen[..., :2] / seen[..., 2:] - rays, axis=2)))
            best = min(best, (miss, views), key=lambda one: one[0])
    return best[1]


def tally(found: np.ndarray, truth: np.ndarray, lost: set[int], far: float) -> np.ndarray:
    """Frames that are off, those of them flagged, frames that are good, those of them flagged."""
    every = np.linalg.norm(found - truth, axis=-1)
    miss = np.array([np.nanmean(row) if np.isfinite(row).any() else np.nan for row in every])
    known = np.isfinite(miss)
    flagged = np.isin(np.arange(len(miss)), list(lost))
    off, good = known & (miss > far), known & (miss <= far)
    return np.array([off.sum(), (off & flagged).sum(), good.sum(), (good & flagged).sum()])


def align(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, float]:
    """`found` (..., 3) after the best similarity onto `truth` (Umeyama), and its scale."""
    known = np.isfinite(found).all(axis=-1) & np.isfinite(truth).all(axis=-1)
    a, b = found[known], truth[known]
    middle, goal = a.mean(axis=0), b.mean(axis=0)
    u, sizes, v = np.linalg.svd((b - goal).T @ (a - middle))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    scale = float(np.trace(np.diag(sizes) @ sign) / np.sum((a - middle) ** 2))
    return scale * (found - middle) @ (u @ sign @ v).T + goal, scale
