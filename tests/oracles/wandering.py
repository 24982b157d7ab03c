"""A body whose limbs wander smoothly for as long as one likes, and never come back: every moment is its own."""

from dataclasses import replace

import numpy as np

from dousa.motion import CanonicalMotion, canonicalise
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.synthetic.performers import draw_performer, make_motion


def make_wandering_motion(
    seconds: float, seed: int = 0, frame_rate: float = 30.0, reach: float = 1.5
) -> CanonicalMotion:
    """A standing body whose bones swing out and back about ever other axes; reach in rad, 0 stands still."""
    rng = np.random.default_rng(seed)
    standing = canonicalise(make_motion("squat", draw_performer(seed), seed, frame_rate))
    first = standing.positions[0]
    times = np.arange(round(seconds * frame_rate)) / frame_rate
    positions = np.empty((len(times), 20, 3))
    positions[:, 0] = first[0]
    for joint, parent in enumerate(CANONICAL_PARENTS[1:], 1):
        bone = first[joint] - first[parent]
        trunk = joint in (1, 2, 3, 4, 8, 12, 16)
        tilt = np.zeros((len(times), 3))
        for _ in range(4):
            axis, phase, hertz = rng.standard_normal(3), rng.uniform(0, 6.3), rng.uniform(0.03, 0.15)
            tilt += axis * np.sin(2 * np.pi * hertz * times + phase)[:, None]
        # All limbs go out and back together, each time another way.
        tilt *= np.sin(2 * np.pi * 0.4 * times)[:, None]
        tilt *= 0.5 * reach * (0.1 if trunk else 1.0)
        moved = bone + np.cross(tilt, bone)
        moved *= np.linalg.norm(bone) / np.linalg.norm(moved, axis=1, keepdims=True)
        positions[:, joint] = positions[:, parent] + moved
    positions[..., 1] -= positions[..., 1].min()
    positions.flags.writeable = False
    return CanonicalMotion(positions, frame_rate, standing.height, standing.height_source, standing.mapping)


def stretch(motion: CanonicalMotion, n_frames: int) -> CanonicalMotion:
    """The same motion in another number of frames at the same rate."""
    times = np.linspace(0, motion.n_frames - 1, n_frames)
    low = np.minimum(times.astype(int), motion.n_frames - 2)
    share = (times - low)[:, None, None]
    return replace(motion, positions=motion.positions[low] * (1 - share) + motion.positions[low + 1] * share)
