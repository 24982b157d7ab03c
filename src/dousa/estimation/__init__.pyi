from .body.body import BodyModel
from .body.body_file import read_body, write_body
from .body.human import make_human
from .body.posing import fit_pose, fit_poses, standing_state
from .body.skeleton_body import body_from_motion, fit_body
from .calibration.board import Board, calibrate_from_board, calibrate_lens, find_board, parse_board
from .calibration.person import CalibratedView, Calibration, calibrate_from_person
from .cameras.camera import Camera, fit_cameras, make_ring, make_view, match_cameras
from .cameras.camera_files import read_cameras, write_cameras
from .cameras.camera_formats import cameras_to_arrays
from .keypoints.keypoint_files import read_keypoints, write_keypoints
from .keypoints.keypoint_search import find_keypoints
from .keypoints.keypoints import MEDIAPIPE_NAMES, PersonMasks, PersonTrack, ViewKeypoints
from .multiview.keypoint_fit import KeypointFit, fit_keypoints
from .multiview.people import MatchedPerson, match_people, repair_sides
from .multiview.triangulation import Triangulated, triangulate
from .raster.rendering import poses_from_motion, render, spoil
from .silhouettes.cleaning import clean_mask, describe_mask
from .silhouettes.mask_npz import read_silhouettes, write_silhouettes
from .silhouettes.repairs import (
    ExcludedPart,
    MaskStroke,
    RepairedSilhouettes,
    find_part,
    follow_part,
)
from .silhouettes.silhouette_files import open_silhouettes
from .silhouettes.silhouettes import PackedSilhouettes, Silhouettes
from .sync.sound import Sound, read_sound
from .sync.synchronise import Synchronisation, read_offsets, sync, write_offsets
from .tracking.person_size import fit_girths
from .tracking.settings import EVIDENCES, PAPER, READINGS, Estimate, TrackedFrame, TrackerSettings
from .tracking.start import find_start
from .tracking.tracker import PartialTrack, estimate

__all__ = [
    "EVIDENCES",
    "MEDIAPIPE_NAMES",
    "PAPER",
    "READINGS",
    "Board",
    "BodyModel",
    "CalibratedView",
    "Calibration",
    "Camera",
    "Estimate",
    "ExcludedPart",
    "KeypointFit",
    "MaskStroke",
    "MatchedPerson",
    "PackedSilhouettes",
    "PartialTrack",
    "PersonMasks",
    "PersonTrack",
    "RepairedSilhouettes",
    "Silhouettes",
    "Sound",
    "Synchronisation",
    "TrackedFrame",
    "TrackerSettings",
    "Triangulated",
    "ViewKeypoints",
    "body_from_motion",
    "calibrate_from_board",
    "calibrate_from_person",
    "calibrate_lens",
    "cameras_to_arrays",
    "clean_mask",
    "describe_mask",
    "estimate",
    "find_board",
    "find_keypoints",
    "find_part",
    "find_start",
    "fit_body",
    "fit_cameras",
    "fit_girths",
    "fit_keypoints",
    "fit_pose",
    "fit_poses",
    "follow_part",
    "make_human",
    "make_ring",
    "make_view",
    "match_cameras",
    "match_people",
    "open_silhouettes",
    "parse_board",
    "poses_from_motion",
    "read_body",
    "read_cameras",
    "read_keypoints",
    "read_offsets",
    "read_silhouettes",
    "read_sound",
    "render",
    "repair_sides",
    "spoil",
    "standing_state",
    "sync",
    "triangulate",
    "write_body",
    "write_cameras",
    "write_keypoints",
    "write_offsets",
    "write_silhouettes",
]
