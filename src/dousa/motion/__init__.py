"""What motion is: skeletons, joint rotations, trajectories, canonical joints.

Loaded name by name when first used: the types cost nothing, the kernels load numba.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "CANONICAL_JOINTS": "joints",
    "CANONICAL_PARENTS": "joints",
    "JOINT_INDEX": "joints",
    "MIRRORED_JOINTS": "joints",
    "CanonicalMotion": "canonical",
    "JointMapping": "canonical",
    "Motion": "_types",
    "Provenance": "_types",
    "ReferenceFrame": "reference_frame",
    "Skeleton": "_types",
    "Trajectories": "_types",
    "canonicalise": "canonical",
    "compute_rest_positions": "kinematics",
    "compute_trajectories": "kinematics",
    "fill_gaps": "resampling",
    "fit_motion": "fitting",
    "forward_kinematics": "kinematics",
    "mirror_canonical": "mirroring",
    "mirror_positions": "mirroring",
    "read_joint_map": "joint_map",
    "resample": "resampling",
    "thin": "resampling",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
