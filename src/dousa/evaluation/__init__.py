"""Evaluation: what differs between a dance and its model, where, and by how much.

Postures -> yaw -> time-series correlation matrix -> correspondence -> furi -> eigenspaces -> the four errors
(Yamane and Shakunaga); errors injected into real motion measure how well that works. Loaded name by name when
first used.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "AdjustableAssessment": "adjusting",
    "Assessment": "_types",
    "Eigenspace": "eigenspace",
    "ErrorEvent": "_types",
    "FrameState": "streaming",
    "Furi": "furi",
    "FuriAssessment": "_types",
    "IncrementalAssessor": "streaming",
    "LIMBS": "posture",
    "Lapse": "_types",
    "Line": "correspondence",
    "MIRRORED_SEGMENTS": "posture",
    "PostureSequence": "_types",
    "SEGMENTS": "posture",
    "SEGMENT_JOINTS": "posture",
    "assess": "assessment",
    "compute_complex_correlation": "yaw",
    "compute_correlation_matrix": "correlation",
    "compute_distance_from_space": "eigenspace",
    "compute_distance_to_path": "eigenspace",
    "compute_distance_within": "eigenspace",
    "compute_postures": "posture",
    "compute_segment_residuals": "eigenspace",
    "compute_segments": "posture",
    "describe_assessment": "_to_json",
    "describe_event": "words",
    "describe_lapse": "words",
    "describe_segments": "words",
    "estimate_robust_yaw": "yaw",
    "estimate_yaw": "yaw",
    "find_furi": "furi",
    "format_furi": "furi_file",
    "find_lines": "correspondence",
    "find_path": "correspondence",
    "fit_eigenspace": "eigenspace",
    "fit_furi_eigenspaces": "furi",
    "inject": "injection",
    "inject_many": "injection",
    "is_held_out": "experiment",
    "measure_false_alarms": "experiment",
    "mirror_postures": "posture",
    "read_furi": "furi_file",
    "read_weights": "weights_file",
    "rotate_yaw": "yaw",
    "run_error_experiment": "experiment",
    "run_severity_sweep": "experiment",
    "simulate_performer": "injection",
    "write_furi": "furi_file",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
