from .advice.advice import Advice, advise, describe_advice, praise
from .advice.directions import Correction
from .alignment.correlation import compute_correlation_matrix
from .alignment.correspondence import Line, find_lines, find_path
from .errors.lapses import Lapse
from .figures.eigenspace import (
    Eigenspace,
    compute_distance_from_space,
    compute_distance_to_path,
    compute_distance_within,
    compute_segment_residuals,
    fit_eigenspace,
)
from .figures.furi import Furi, find_furi, fit_furi_eigenspaces, format_furi, read_furi, write_furi
from .grade.adjustable import AdjustableAssessment
from .grade.assessment import ABOUT_REFERENCES, assess
from .grade.result import Assessment, ErrorEvent, FuriAssessment, describe_assessment
from .live.assessor import FrameState, IncrementalAssessor
from .posture.posture import (
    LIMBS,
    MIRRORED_SEGMENTS,
    SEGMENT_JOINTS,
    SEGMENTS,
    PostureSequence,
    compute_postures,
    compute_segments,
    mirror_postures,
)
from .posture.weights import read_weights
from .posture.yaw import compute_complex_correlation, estimate_robust_yaw, estimate_yaw, rotate_yaw
from .words import describe_event, describe_heading, describe_lapse, describe_segments

__all__ = [
    "ABOUT_REFERENCES",
    "LIMBS",
    "MIRRORED_SEGMENTS",
    "SEGMENTS",
    "SEGMENT_JOINTS",
    "AdjustableAssessment",
    "Advice",
    "Assessment",
    "Correction",
    "Eigenspace",
    "ErrorEvent",
    "FrameState",
    "Furi",
    "FuriAssessment",
    "IncrementalAssessor",
    "Lapse",
    "Line",
    "PostureSequence",
    "advise",
    "assess",
    "compute_complex_correlation",
    "compute_correlation_matrix",
    "compute_distance_from_space",
    "compute_distance_to_path",
    "compute_distance_within",
    "compute_postures",
    "compute_segment_residuals",
    "compute_segments",
    "describe_advice",
    "describe_assessment",
    "describe_event",
    "describe_heading",
    "describe_lapse",
    "describe_segments",
    "estimate_robust_yaw",
    "estimate_yaw",
    "find_furi",
    "find_lines",
    "find_path",
    "fit_eigenspace",
    "fit_furi_eigenspaces",
    "format_furi",
    "mirror_postures",
    "praise",
    "read_furi",
    "read_weights",
    "rotate_yaw",
    "write_furi",
]
