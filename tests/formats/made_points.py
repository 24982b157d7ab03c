"""Points of a person as pose estimators write them to JSON, made from a synthetic motion."""

import io
import json
import zipfile

import numpy as np

from dousa.formats.arrays.joints import list_layouts
from dousa.motion import JOINT_INDEX, canonicalise
from dousa.motion.canonical.naming import match_names
from dousa.motion.synthetic import draw_performer, make_motion

OPENPOSE, MEDIAPIPE, COCO, H36M = "OpenPose BODY_25", "MediaPipe (33)", "COCO (17)", "Human3.6M (17)"


def make_points(title, n_frames=40):
    """(T, K, 3) m, Y up: the points of a layout on a walking body, and the positions of its canonical joints."""
    walk = canonicalise(make_motion("walk", draw_performer(3)))
    places = walk.positions[:n_frames]
    layout = next(y for y in list_layouts() if y.title == title)
    found = match_names(layout.names).sources
    head, toe = places[:, JOINT_INDEX["head"]], places[:, JOINT_INDEX["left_toe"]]
    points = np.repeat(head[:, None], len(layout.names), axis=1)
    points += np.random.default_rng(0).normal(scale=0.02, size=(1, len(layout.names), 3))
    for index, name in enumerate(layout.names):
        if "heel" in name.lower() or "toe" in name.lower():
            points[:, index] = toe
    for joint, sources in found.items():
        if len(sources) == 1:
            points[:, sources[0]] = places[:, JOINT_INDEX[joint]]
    return points, {joint: places[:, JOINT_INDEX[joint]] for joint, sources in found.items() if len(sources) == 1}


def openpose_frames(points, *, missing=()):
    """The text of each frame; a point in ``missing`` (frame, index) was not seen."""
    texts = []
    for frame, rows in enumerate(points):
        flat = []
        for index, row in enumerate(rows):
            flat += [0, 0, 0, 0] if (frame, index) in missing else [*np.round(row, 6).tolist(), 0.9]
        person = {"person_id": [-1], "pose_keypoints_2d": [], "pose_keypoints_3d": flat, "hand_left_keypoints_3d": []}
        texts.append(json.dumps({"version": 1.3, "people": [person]}))
    return texts


def zip_frames(texts, folder="take1"):
    """A zip archive of a folder of frames."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for number, text in enumerate(texts):
            target.writestr(f"{folder}/take1_{number:012d}_keypoints.json", text)
    return packed.getvalue()


def mediapipe_list(points):
    """Frames of 33 landmarks, y down, about the middle of the hips."""
    places = (points - points[:, (23, 24)].mean(axis=1, keepdims=True)) * (1, -1, -1)
    return [[{"x": x, "y": y, "z": z, "visibility": 0.99} for x, y, z in frame] for frame in places.tolist()]


def mmpose(points):
    """Results of the 3D inference of MMPose: z up, scores beside the points."""
    places = (points[..., (0, 2, 1)] * (1, -1, 1)).tolist()
    infos = [
        {"frame_id": n, "instances": [{"keypoints": frame, "keypoint_scores": [1.0] * len(frame)}]}
        for n, frame in enumerate(places)
    ]
    return {"meta_info": {"dataset_name": "made"}, "instance_info": infos}
