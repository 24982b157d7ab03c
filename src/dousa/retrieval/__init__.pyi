from .explain.explanation import Explainer, Explanation, Likeness, Reason, SharedReason, explain, explain_pair
from .features.channels import CHANNELS, compute_channels
from .features.feature_sets import (
    DEFAULT_FEATURE_SET,
    FEATURE_SETS,
    FeatureSet,
    FeatureTrack,
    compute_interval_means,
    compute_track,
    get_feature_set,
    integrate,
    list_tests,
)
from .features.pose_features import (
    FEATURE_NAMES,
    FEATURES,
    Feature,
    compute_clip_features,
    compute_pose_features,
)
from .features.posed_motion import LabelledClip
from .features.sensor_noise import reduce_noise
from .forest.calibration import Assessor, Calibration, Verdicts, guess_performers, learn_calibration
from .forest.forest import Decision, MotionForest
from .forest.growth import Growth, StandingClips, grow_forest
from .ranking.ranking import (
    DEFAULT_RANKING,
    RANKINGS,
    RankedClips,
    Ranking,
    RankingQuery,
    compute_pose_sequence,
    compute_window_poses,
    rank_by_fusion,
    rank_by_histogram,
    rank_by_leaves,
    rank_by_pose,
    rank_clips,
)
from .ranking.templates import RELATIONAL_FEATURES, MotionTemplates, compute_relational_features
from .takes.find import Found, TakeQuery, describe_query, find_in_takes
from .takes.label import Segment, TakeLabeller, Timeline, label_take, write_timeline_csv
from .takes.labeller_training import train_labeller
from .takes.live import LiveAnswer, LiveLabeller, read_live_frames
from .takes.repetitions import count_clip
from .takes.windows import TakeWindows, WindowGrid, choose_grid, describe_take

__all__ = [
    "CHANNELS",
    "DEFAULT_FEATURE_SET",
    "DEFAULT_RANKING",
    "FEATURES",
    "FEATURE_NAMES",
    "FEATURE_SETS",
    "RANKINGS",
    "RELATIONAL_FEATURES",
    "Assessor",
    "Calibration",
    "Decision",
    "Explainer",
    "Explanation",
    "Feature",
    "FeatureSet",
    "FeatureTrack",
    "Found",
    "Growth",
    "LabelledClip",
    "Likeness",
    "LiveAnswer",
    "LiveLabeller",
    "MotionForest",
    "MotionTemplates",
    "RankedClips",
    "Ranking",
    "RankingQuery",
    "Reason",
    "Segment",
    "SharedReason",
    "StandingClips",
    "TakeLabeller",
    "TakeQuery",
    "TakeWindows",
    "Timeline",
    "Verdicts",
    "WindowGrid",
    "choose_grid",
    "compute_channels",
    "compute_clip_features",
    "compute_interval_means",
    "compute_pose_features",
    "compute_pose_sequence",
    "compute_relational_features",
    "compute_track",
    "compute_window_poses",
    "count_clip",
    "describe_query",
    "describe_take",
    "explain",
    "explain_pair",
    "find_in_takes",
    "get_feature_set",
    "grow_forest",
    "guess_performers",
    "integrate",
    "label_take",
    "learn_calibration",
    "list_tests",
    "rank_by_fusion",
    "rank_by_histogram",
    "rank_by_leaves",
    "rank_by_pose",
    "rank_clips",
    "read_live_frames",
    "reduce_noise",
    "train_labeller",
    "write_timeline_csv",
]
