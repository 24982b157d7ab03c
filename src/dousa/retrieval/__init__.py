"""Retrieval: find the motions that mean the same.

Pose features -> integral features -> random forest -> histograms -> ranking (Hamada, Kuriyama, Mukai), the
motion template baseline, and the experiment that compares them. Loaded name by name when first used.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "EXTRA_FEATURE_NAMES": "extra_features",
    "Decision": "forest",
    "ExperimentResult": "experiment",
    "FEATURES": "features",
    "FEATURE_NAMES": "features",
    "FEATURE_SETS": "feature_sets",
    "Feature": "features",
    "LabelledClip": "experiment",
    "MotionForest": "forest",
    "MotionTemplates": "templates",
    "RELATIONAL_FEATURES": "relational",
    "Scores": "metrics",
    "compute_clip_features": "features",
    "compute_extra_features": "extra_features",
    "compute_interval_means": "integral",
    "compute_pose_features": "features",
    "compute_relational_features": "relational",
    "compute_scores": "metrics",
    "integrate": "integral",
    "list_tests": "integral",
    "leave_performer_out": "splits",
    "rank_by_histogram": "ranking",
    "run_experiment": "experiment",
    "split_half": "splits",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
