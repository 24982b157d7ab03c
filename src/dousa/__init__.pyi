from .app.player.notebook import plot as plot
from .formats.registry import read_motion as read_motion
from .formats.registry import write_motion as write_motion
from .library import Library as Library
from .motion import CANONICAL_JOINTS as CANONICAL_JOINTS
from .motion import CanonicalMotion as CanonicalMotion
from .motion import Motion as Motion
from .motion import Skeleton as Skeleton
from .motion import Trajectories as Trajectories
from .motion import canonicalise as canonicalise
from .motion import compute_trajectories as compute_trajectories
from .notebooks import to_frame as to_frame
from .retrieval import MotionForest as MotionForest
from .retrieval import compute_clip_features as compute_clip_features

__version__: str
