"""Plain loops over frames, lags and segments: the turn that most of a window agrees on, and what is left after it."""

import cmath

import numpy as np


def interpolate(segments: np.ndarray, frame: float) -> np.ndarray:
    """(9, 3) unit vectors between two frames; the first and last pose go on for ever."""
    frame = min(max(frame, 0.0), len(segments) - 1.0)
    low = int(frame)
    high = min(low + 1, len(segments) - 1)
    mixed = segments[low] * (1.0 - (frame - low)) + segments[high] * (frame - low)
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def measure(
    reference: tuple[np.ndarray, np.ndarray],
    performance: tuple[np.ndarray, np.ndarray],
    frames: np.ndarray,
    weights: np.ndarray,
    *,
    reach: int,
    half: int,
    scale: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Squared chords (T, 2 reach + 1, 9) and yaw (T, 2 reach + 1).

    Parameters
    ----------
    reference, performance : segments (., 9, 3) and seen (., 9).
    frames : (T,) reference frame of each frame of the performance.
    weights : (9,).
    reach : lags to both sides.
    half : the yaw is common to ``2 half + 1`` frames at equal lag.
    scale : chord at which a segment has a quarter of its say.
    """
    count, lags = len(frames), 2 * reach + 1
    clock = [frames[0] - reach + i for i in range(reach)]
    clock += list(frames) + [frames[-1] + 1 + i for i in range(reach)]
    squared = np.zeros((count, lags, 9))
    yaw = np.zeros((count, lags))
    for k in range(lags):
        pairs = []
        for t in range(count):
            frame = clock[t + k]
            near = min(max(round(frame), 0), len(reference[0]) - 1)
            pairs.append((performance[0][t], interpolate(reference[0], frame), reference[1][near]))
        trust = np.zeros((count, 9))
        for t in range(count):
            for s in range(9):
                trust[t, s] = weights[s] * performance[1][t, s] * pairs[t][2][s]
        start = trust.copy()
        for _ in range(4):
            turns = []
            for t in range(count):
                total = 0j
                for other in range(max(0, t - half), min(count, t + half + 1)):
                    ours, theirs, _ = pairs[other]
                    for s in range(9):
                        a = complex(ours[s, 2], ours[s, 0])
                        b = complex(theirs[s, 2], theirs[s, 0])
                        total += trust[other, s] * a * b.conjugate()
                turns.append(cmath.phase(total))
            for t in range(count):
                ours, theirs, seen = pairs[t]
                cosine, sine = np.cos(turns[t]), np.sin(turns[t])
                for s in range(9):
                    x, y, z = theirs[s]
                    turned = np.array([x * cosine + z * sine, y, z * cosine - x * sine])
                    far = float(((ours[s] - turned) ** 2).sum())
                    squared[t, k, s] = far if seen[s] and performance[1][t, s] else 0.0
                    trust[t, s] = start[t, s] / (1.0 + far / scale**2) ** 2
                yaw[t, k] = turns[t]
    return squared, yaw
