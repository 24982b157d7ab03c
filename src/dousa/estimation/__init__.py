"""Estimation: from silhouettes to joint angles, with a body model and inertia.

Masks or video -> silhouettes; a body of rigid parts and calibrated cameras; each frame the joint angles whose
projection fits the silhouettes are searched part by part within what inertia allows (Kameda, Minoh and Ikeda).
Loaded name by name when first used.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "Accuracy": "metrics",
    "BodyModel": "body",
    "Camera": "camera",
    "Estimate": "_types",
    "EVIDENCES": "_types",
    "PAPER": "_types",
    "PackedSilhouettes": "silhouettes",
    "PartialTrack": "tracker",
    "READINGS": "_types",
    "Silhouettes": "silhouettes",
    "TrackedFrame": "_types",
    "TrackerSettings": "_types",
    "body_from_motion": "_body_from_skeleton",
    "cameras_to_arrays": "camera_files",
    "clean_mask": "cleaning",
    "compare_in_images": "metrics",
    "compare_with_truth": "metrics",
    "compute_iou": "metrics",
    "describe_mask": "cleaning",
    "estimate": "tracker",
    "find_start": "start",
    "fit_body": "_body_from_skeleton",
    "fit_cameras": "camera_sets",
    "fit_girths": "girths",
    "fit_pose": "posing",
    "fit_poses": "posing",
    "make_human": "human",
    "make_ring": "camera_sets",
    "make_view": "camera_sets",
    "match_cameras": "camera_sets",
    "open_silhouettes": "silhouette_files",
    "poses_from_motion": "rendering",
    "read_body": "body_file",
    "read_cameras": "camera_files",
    "read_silhouettes": "mask_npz",
    "render": "rendering",
    "run_bench": "experiment",
    "run_reading_table": "experiment",
    "spoil": "rendering",
    "standing_state": "posing",
    "write_body": "body_file",
    "write_cameras": "camera_files",
    "write_silhouettes": "mask_npz",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
