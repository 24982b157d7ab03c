"""Small sequences of silhouettes with their truth, drawn with a body of the package and written as npz files."""

import numpy as np

from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.motion import rotations as rot

STATURE = 1.7


def make_cameras(angles_deg=(0.0, 40.0, 100.0), width=80, height=60):
    """Cameras on a circle that look at its middle, the first from +Z."""
    cameras = []
    for k, angle in enumerate(np.deg2rad(angles_deg)):
        back = np.array([np.sin(angle), 0.0, np.cos(angle)])
        rotation = np.stack(([np.cos(angle), 0.0, -np.sin(angle)], [0.0, -1.0, 0.0], -back))
        matrix = [[90.0, 0.0, width / 2], [0.0, 90.0, height / 2], [0.0, 0.0, 1.0]]
        translation = -rotation @ (4.0 * back + [0.0, 0.9, 0.0])
        cameras.append(Camera(f"view{k + 1}", width, height, matrix, rotation, translation))
    return cameras


def make_poses(body, n_frames=6, degrees=4.0, speed=0.02):
    """Somebody who walks off sideways, turning, and bends the elbows."""
    poses = np.tile(standing_state(body), (n_frames, 1))
    steps = np.arange(n_frames)
    poses[:, 0] += speed * steps
    turns = rot.from_axis_angle(np.deg2rad(degrees) * steps[:, None] * np.array([0.0, 1.0, 0.0]))
    poses[:, 3:7] = rot.multiply(turns, poses[:, 3:7])
    for part, joint in enumerate(body.joints):
        if joint.endswith("elbow"):
            low, high = body.limits[part, 0]
            first = 7 + body.angle_starts[part]
            poses[:, first] = np.clip(poses[:, first] + np.deg2rad(degrees) * steps, low, high)
    return poses


def write_clip(path, poses=None, *, cameras=None, joints=None, **changed):
    """Write a sequence; arrays named in ``changed`` are put instead of the right ones, None leaves one out."""
    body = make_human(STATURE)
    poses = make_poses(body) if poses is None else poses
    cameras = make_cameras() if cameras is None else cameras
    names, points = point_names(body), compute_points(body, poses)
    kept = [names.index(name) for name in joints or names]
    arrays = {
        "mask_packed": np.packbits(np.stack([draw_body(body, poses, camera) for camera in cameras]), axis=3),
        "width": cameras[0].width,
        "height": cameras[0].height,
        "frame_rate": 30.0,
        "camera_matrix": np.stack([camera.matrix for camera in cameras]),
        "world_to_camera_rotation": np.stack([camera.rotation for camera in cameras]),
        "world_to_camera_translation": np.stack([camera.translation for camera in cameras]),
        "stature": STATURE,
        "joint_names": np.array([names[k] for k in kept]),
        "joint_positions": points[:, kept],
    } | changed
    np.savez_compressed(path, **{name: value for name, value in arrays.items() if value is not None})
    return path
