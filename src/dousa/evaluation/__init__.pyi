from .advice.advice import Advice, advise, describe_advice, praise
from .advice.directions import Correction
from .advice.progress import Attempt, Progress, compare_attempts, read_attempt
from .alignment.correlation import compute_correlation_matrix
from .alignment.correspondence import Line, find_lines, find_path
from .beats.accents import ACCENTS, Accent, find_accents
from .beats.beat_times import Beats, read_beats, to_beats
from .beats.music import find_beats
from .beats.timing import BeatTiming, TimedAccent, assess_timing
from .errors.lapses import Lapse
from .exercises.range_of_motion import (
    ANGLE_NAMES,
    ANGLES,
    PAIRED_ANGLES,
    RangeOfMotion,
    compute_joint_angles,
    compute_symmetry_index,
)
from .exercises.repetitions import AssessedRepetition, RepetitionsAssessment, assess_repetitions
from .exercises.split import Repetition, RepetitionSplit, find_repetitions
from .exercises.summary import describe_exercise, describe_trends
from .exercises.trend import Trend, estimate_trend
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
    "ACCENTS",
    "ANGLES",
    "ANGLE_NAMES",
    "LIMBS",
    "MIRRORED_SEGMENTS",
    "PAIRED_ANGLES",
    "SEGMENTS",
    "SEGMENT_JOINTS",
    "Accent",
    "AdjustableAssessment",
    "Advice",
    "AssessedRepetition",
    "Assessment",
    "Attempt",
    "BeatTiming",
    "Beats",
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
    "Progress",
    "RangeOfMotion",
    "Repetition",
    "RepetitionSplit",
    "RepetitionsAssessment",
    "TimedAccent",
    "Trend",
    "advise",
    "assess",
    "assess_repetitions",
    "assess_timing",
    "compare_attempts",
    "compute_complex_correlation",
    "compute_correlation_matrix",
    "compute_distance_from_space",
    "compute_distance_to_path",
    "compute_distance_within",
    "compute_joint_angles",
    "compute_postures",
    "compute_segment_residuals",
    "compute_segments",
    "compute_symmetry_index",
    "describe_advice",
    "describe_assessment",
    "describe_event",
    "describe_exercise",
    "describe_heading",
    "describe_lapse",
    "describe_segments",
    "describe_trends",
    "estimate_robust_yaw",
    "estimate_trend",
    "estimate_yaw",
    "find_accents",
    "find_beats",
    "find_furi",
    "find_lines",
    "find_path",
    "find_repetitions",
    "fit_eigenspace",
    "fit_furi_eigenspaces",
    "format_furi",
    "mirror_postures",
    "praise",
    "read_attempt",
    "read_beats",
    "read_furi",
    "read_weights",
    "rotate_yaw",
    "to_beats",
    "write_furi",
]
