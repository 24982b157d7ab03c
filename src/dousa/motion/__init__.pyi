from .canonical.canonicalise import (
    CanonicalMotion,
    JointMapping,
    canonicalise,
    mirror_canonical,
    mirror_positions,
)
from .canonical.fitting import fit_motion
from .canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS, JOINT_INDEX, MIRRORED_JOINTS
from .canonical.recipes import read_joint_map
from .canonical.reference_frame import ReferenceFrame
from .kinematics import compute_rest_positions, compute_trajectories, forward_kinematics
from .repetitions import RepetitionCount, count_repetitions
from .resampling import fill_gaps, resample, thin
from .retargeting.retarget import Retargeted, retarget
from .types import Motion, Provenance, Skeleton, Trajectories

__all__ = [
    "CANONICAL_JOINTS",
    "CANONICAL_PARENTS",
    "JOINT_INDEX",
    "MIRRORED_JOINTS",
    "CanonicalMotion",
    "JointMapping",
    "Motion",
    "Provenance",
    "ReferenceFrame",
    "RepetitionCount",
    "Retargeted",
    "Skeleton",
    "Trajectories",
    "canonicalise",
    "compute_rest_positions",
    "compute_trajectories",
    "count_repetitions",
    "fill_gaps",
    "fit_motion",
    "forward_kinematics",
    "mirror_canonical",
    "mirror_positions",
    "read_joint_map",
    "resample",
    "retarget",
    "thin",
]
