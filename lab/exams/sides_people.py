"""The exam of sides: people made of ellipsoids and tapered limbs, moved by recordings, drawn with OpenCV.

Nothing here knows the tracker's body: lengths are shares of the stature (Drillis and Contini 1966; arms and shoulders
halfway to the recorded people's), each person's off by some percent. Metres, world Y up; pixel centres are whole.
"""

from collections import namedtuple
from pathlib import Path

import cv2
import numpy as np

import dousa

Array = np.ndarray
SIDES, RATE, WIDTH, HEIGHT, FOCAL, FINER = ("left", "right"), 30.0, 320, 240, 320.0, 3
_TILT, _TURN = np.arccos(1 - (np.arange(80) + 0.5) / 40), np.arange(80) * np.pi * (1 + 5**0.5)
BALL = np.stack([np.sin(_TILT) * np.cos(_TURN), np.sin(_TILT) * np.sin(_TURN), np.cos(_TILT)], axis=1)
# Stature in metres; factors of lengths and girths, of loose sleeves and trousers.
Person = namedtuple("Person", "stature leg arm wide girth sleeves trousers", defaults=6 * (1.0,))
Camera = namedtuple("Camera", "matrix rotation translation")  # x_camera = R x_world + t: x right, y down, z forward
# Frames of a recording from `start` (30 Hz); the first camera stands `turned` degrees from the person's side.
Clip = namedtuple("Clip", "name file person start turned folds mirrored", defaults=(0, 0.0, False, False))
SMALL, TALL = Person(1.62, 0.97, 0.98, 0.94, 0.9), Person(1.88, 1.03, 1.04, 1.05, 0.95, trousers=1.2)
STOUT, PLAIN = Person(1.74, 0.98, 1.0, 1.08, 1.2, 1.2), Person(1.80, arm=1.03)
LOOSE = Person(1.69, 1.02, 0.96, 0.97, 1.05, 1.3, 1.15)
WALK, HDM05, VICON = "cmu86/86_01.amc", "hdm05/{0}/HDM_{1}_{0}_{2}_120.amc", "uiprmd/vicon/{0}/correct/{0}_{1}.trc"
ELBOW, KICK, JOG = "elbowToKnee1RepsLelbowStart", "kickLFront1Reps", "jogLeftCircle4StepsRstart"
CLIPS = (  # crossings on purpose; silhouette_bench shows none of these recordings
    Clip("walk, side", WALK, SMALL, 665),
    Clip("elbow to knee", HDM05.format(ELBOW, "bd", "001"), TALL),
    Clip("kick, side", HDM05.format(KICK, "bk", "007"), STOUT, 28),
    Clip("jog in a circle", HDM05.format(JOG, "dg", "008"), LOOSE, 2, 20),
    Clip("squat, arms folded", VICON.format("m01", "s03_e02"), PLAIN, 10, 60, folds=True),
    Clip("sneak, side", HDM05.format("sneak2StepsLStart", "dg", "007"), SMALL, 5),
    Clip("hurdle step", VICON.format("m02", "s04_e04"), TALL, 12, 10),
    Clip("kick, mirrored", HDM05.format(KICK, "bd", "003"), LOOSE, 0, -15, mirrored=True),
    Clip("leg kick", WALK, PLAIN, 905, 10),
    Clip("jog, mirrored", HDM05.format(JOG, "bk", "004"), SMALL, 0, 45, mirrored=True),
    Clip("elbow to knee, mirrored", HDM05.format(ELBOW, "dg", "015"), STOUT, 0, 35, mirrored=True),
    Clip("throw", HDM05.format("throwBasketball", "bk", "005"), LOOSE, 20, 75),
    Clip("walk, arms folded", WALK, TALL, 340, 20, folds=True),
    Clip("inline lunge", VICON.format("m03", "s02_e03"), STOUT, 30, 5),
    Clip("leg raise", VICON.format("m06", "s05_e02"), PLAIN, 15, 15),
    Clip("walk, mirrored", WALK, LOOSE, 665, -10, mirrored=True),
)


def project(camera: Camera, points: Array) -> Array:
    seen = (points @ camera.rotation.T + camera.translation) @ camera.matrix.T
    return seen[..., :2] / seen[..., 2:]


def unit(vectors: Array, otherwise: Array | None = None) -> Array:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / size if otherwise is None else np.where(size > 1e-6, vectors / np.maximum(size, 1e-6), otherwise)


def make_joints(data: Path, clip: Clip, n_frames: int) -> dict[str, Array]:
    """Joints (T, 3) of the made person: directions of the recording, lengths of the person, steps of its legs."""
    read, who = dousa.canonicalise(dousa.read_motion(data / clip.file)), clip.person
    there = read.positions[:: round(read.frame_rate / RATE)][clip.start : clip.start + n_frames]
    old = {name: np.nan_to_num(there[:, k]) for k, name in enumerate(dousa.CANONICAL_JOINTS)}
    if clip.mirrored:
        other = {"left": "right", "right": "left"}
        old = {"_".join(other.get(w, w) for w in name.split("_")): p * [-1, 1, 1] for name, p in old.items()}
    hips = (old["left_hip"] + old["right_hip"]) / 2
    left, up = unit(old["left_shoulder"] - old["right_shoulder"]), unit(old["neck"] - hips)
    forward, tall = unit(np.cross(left, up)), who.stature
    thigh, shank, ankle = (share * tall * who.leg for share in (0.245, 0.246, 0.039))
    above = tall - thigh - shank - ankle  # trunk, neck and head
    steps = [old[f"{s}_{a}"] - old[f"{s}_knee"] for s in SIDES for a in ("hip", "ankle")]
    new = {"pelvis": hips * (thigh + shank) / (2 * np.mean(np.linalg.norm(steps, axis=-1)))}
    new["spine"] = new["pelvis"] + 0.306 * above * unit(old["spine"] - hips, up)
    new["neck"] = new["spine"] + 0.306 * above * unit(old["neck"] - old["spine"], up)
    new["head"] = new["neck"] + 0.245 * above * unit(old["head"] - old["neck"], up)
    along = np.linspace(0, 1, len(hips))[:, None]  # arms are folded in the middle of the clip
    fold = clip.folds * np.clip(np.minimum(along / 0.35, (1 - along) / 0.3), 0, 1)
    for sign, s in ((1, "left"), (-1, "right")):
        folded = {"elbow": 0.35 * forward - up + 0.1 * sign * left}
        folded["wrist"] = folded["hand"] = 0.4 * forward - sign * left + (0.35 - 0.1 * sign) * up
        new[f"{s}_shoulder"] = new["neck"] + 0.115 * tall * who.wide * unit(old[f"{s}_shoulder"] - old["neck"])
        new[f"{s}_hip"] = new["pelvis"] + 0.048 * tall * who.wide * unit(old[f"{s}_hip"] - hips)
        arm = (("shoulder", "elbow", 0.172 * who.arm * tall), ("elbow", "wrist", 0.152 * who.arm * tall))
        leg = (("hip", "knee", thigh), ("knee", "ankle", shank), ("ankle", "toe", 0.095 * tall))
        for begin, end, length in (*arm, ("wrist", "hand", 0.055 * tall), *leg):
            recorded = unit(old[f"{s}_{end}"] - old[f"{s}_{begin}"], forward)
            way = unit((1 - fold) * recorded + fold * folded[end]) if end in folded else recorded
            new[f"{s}_{end}"] = new[f"{s}_{begin}"] + length * way
    lowest = min(new[f"{s}_ankle"][:, 1].min() for s in SIDES) - ankle
    room = cv2.Rodrigues(np.array([0, 0.65 * len(clip.name), 0]))[0]  # it lies anyhow
    return {name: (points - [0, lowest, 0]) @ room.T for name, points in new.items()}


def cone(a: Array, b: Array, ra: float, rb: float) -> Array:
    return np.concatenate([a + ra * BALL, b + rb * BALL])


def egg(middle: Array, side: Array, up: Array, *radii: float) -> Array:
    up = unit(up)
    side = unit(side - (side @ up) * up)
    return middle + (BALL * radii) @ np.stack([side, up, np.cross(side, up)])


def make_parts(at: dict[str, Array], who: Person) -> list[Array]:
    """Points whose hulls are the body's convex parts."""
    size, fat, broad = who.stature, who.stature * who.girth, who.stature * who.wide * who.girth**0.5
    sleeve, loose = fat * who.sleeves, fat * who.trousers
    across, hips = at["left_shoulder"] - at["right_shoulder"], at["left_hip"] - at["right_hip"]
    chest, waist, skull = at["neck"] - at["spine"], at["spine"] - at["pelvis"], at["head"] - at["neck"]
    parts = [egg(at["head"], across, skull, 0.045 * size, 0.59 * np.linalg.norm(skull), 0.055 * size)]
    parts += [egg(at["spine"] + 0.55 * chest, across, chest, 0.092 * broad, 0.9 * np.linalg.norm(chest), 0.064 * fat)]
    parts += [egg(at["spine"], hips, waist, 0.08 * broad, 0.085 * size, 0.062 * fat)]
    parts += [egg(at["pelvis"], hips, waist, 0.095 * broad, 0.07 * size, 0.066 * fat)]
    neck = cone(at["neck"], at["head"], 0.033 * fat, 0.03 * fat)
    parts += [neck, cone(at["left_shoulder"], at["right_shoulder"], 0.03 * fat, 0.03 * fat)]
    for s in SIDES:
        hip, knee, ankle, toe = (at[f"{s}_{j}"] for j in ("hip", "knee", "ankle", "toe"))
        shoulder, elbow, wrist, hand = (at[f"{s}_{j}"] for j in ("shoulder", "elbow", "wrist", "hand"))
        ahead, down = unit(toe - ankle), unit(ankle - knee)
        sole = unit(down - (down @ ahead) * ahead, down) * (0.039 * who.leg - 0.016) * size
        foot = cone(ankle + sole - 0.03 * size * ahead, ankle + sole + 0.095 * size * ahead, *2 * (0.016 * size,))
        parts += [np.concatenate([ankle + 0.02 * size * BALL, foot]), cone(wrist, hand, 0.014 * size, 0.022 * size)]
        parts += [cone(hip, knee, 0.05 * loose, 0.032 * loose), cone(knee, ankle, 0.031 * loose, 0.021 * loose)]
        parts += [egg(0.7 * knee + 0.3 * ankle, hips, knee - ankle, 0.031 * loose, 0.07 * size, 0.034 * loose)]
        parts += [
            cone(shoulder, elbow, 0.029 * sleeve, 0.024 * sleeve),
            cone(elbow, wrist, 0.024 * sleeve, 0.016 * fat),
        ]
    return parts


def place_cameras(joints: dict[str, Array], turned: float, luck: np.random.Generator) -> list[Camera]:
    """Four cameras around the clip: the first at the person's side, the others some 70, 160 and 250 degrees on."""
    cloud, cameras = np.concatenate(list(joints.values())), []
    middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    left = np.mean(unit(joints["left_hip"] - joints["right_hip"]), axis=0)
    for around in (0, 70, 160, 250):
        turn = np.arctan2(left[2], left[0]) + np.deg2rad(turned + around + luck.uniform(-8, 8))
        (cx, cy), height, roll = luck.uniform(-4, 4, 2), luck.uniform(0.9, 2.3), np.deg2rad(luck.uniform(-3, 3))
        matrix = np.array([[FOCAL, 0, WIDTH / 2 + cx], [0, FOCAL, HEIGHT / 2 + cy], [0, 0, 1]])
        for away in np.arange(2.4, 9, 0.1):  # as near as the whole clip allows
            place = np.array([middle[0] + away * np.cos(turn), height, middle[2] + away * np.sin(turn)])
            ahead = unit(middle - place)
            right = unit(np.cross(ahead, [0, 1, 0]))
            rotation = cv2.Rodrigues(np.array([0, 0, roll]))[0] @ [right, np.cross(ahead, right), ahead]
            camera = Camera(matrix, rotation, -rotation @ place)
            if np.all(np.abs(project(camera, cloud) - [WIDTH / 2, HEIGHT / 2]) < [WIDTH / 2 - 14, HEIGHT / 2 - 14]):
                break
        cameras.append(camera)
    return cameras


def spoil(mask: Array, luck: np.random.Generator) -> Array:
    """Ragged edges, three holes or bites, four specks."""
    field = cv2.GaussianBlur(luck.normal(size=mask.shape), (0, 0), 2.5)
    out = (cv2.GaussianBlur(mask.astype(float), (0, 0), 1.6) + 0.17 * field / field.std() > 0.5).astype(np.uint8)
    for value, places in ((0, luck.choice(np.argwhere(mask), 3)), (1, luck.integers(0, mask.shape, (4, 2)))):
        for row, column in places:
            cv2.circle(out, (int(column), int(row)), int(luck.integers(2 - value, 5)), value, -1)
    return out.astype(bool)


def film(joints: dict[str, Array], who: Person, cameras: list[Camera], noisy: bool, seed: int) -> Array:
    """Masks (V, T, H, W); in noisy ones the legs cast a short shadow on the floor, and the cameras tremble, too."""
    luck, masks = np.random.default_rng(seed), np.zeros((len(cameras), len(joints["pelvis"]), HEIGHT, WIDTH), bool)
    for t in range(masks.shape[1]):
        parts = make_parts({name: points[t] for name, points in joints.items()}, who)
        parts += [p * [1, 0, 1] + p[:, 1:2] * [0.3, 0, 0.15] for p in parts if noisy and p[:, 1].max() < 0.6]
        for camera, view in zip(cameras, masks, strict=True):
            fine, shift = np.zeros(FINER * np.array(view.shape[1:]), np.uint8), 0.5 * noisy * luck.normal(size=2)
            for points in parts:
                pixels = (project(camera, points) + shift + 0.5) * FINER - 0.5
                cv2.fillConvexPoly(fine, cv2.convexHull(np.round(8 * pixels).astype(np.int32)), 255, shift=3)
            shot = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) > 127
            view[t] = spoil(shot, luck) if noisy else shot
    return masks
