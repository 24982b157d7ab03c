"""How far to trust `lost` and `uncertainty`: frames that are off and frames that are said to be, on known truth.

A frame is off where the mean error of its joints is above 150 mm. Clips are tracked as `dousa estimate` does, with the
stature alone or with the true first pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.estimation import Estimate, estimate, make_human
from dousa.estimation.body.doubt import LOST_ERROR
from dousa.estimation.body.kinematics import compute_points, point_names
from lab.estimation.clips import BenchClip, choose_views, find_clips, fit_first_poses, read_clip, take_part


def measure_doubt(folder: Path, n_views: Sequence[int], start: str, variants: Sequence[str]) -> None:
    """Print a row for each number of views and variant."""
    print("| views | clips | frames | off | said of these | said of the others | expected, mm | actual, mm |")
    print("| --- " * 8 + "|")
    for variant in variants:
        clips = [read_clip(path) for path in find_clips([folder], [variant])]
        for count in n_views:
            rows = [track_clip(clip, count, start) for clip in clips]
            errors, expected, lost = (np.concatenate(column) for column in zip(*rows, strict=True))
            off = errors > LOST_ERROR
            said = f"{100 * lost[off].mean():.0f} %" if off.any() else ""
            print(f"| {variant}, {count} | {len(clips)} | {len(errors)} | {off.sum()} | {said} | "
                  f"{100 * lost[~off].mean():.1f} % | {1e3 * expected.mean():.0f} | {1e3 * errors.mean():.0f} |",
                  flush=True)  # fmt: skip


def track_clip(
    clip: BenchClip, count: int, start: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Errors (T,) m, expected errors (T,) m, and what is said to be lost (T,)."""
    views = choose_views(clip.cameras, count)
    body = make_human(clip.stature)
    first = fit_first_poses(body, clip)[0] if start == "truth" else None
    cameras = [clip.cameras[view] for view in views]
    found: Estimate = estimate(take_part(clip.silhouettes, views), cameras, body, first, n_threads=1)
    names, points = point_names(found.body), compute_points(found.body, found.poses)
    common = [name for name in clip.joints if name in names]
    ours = points[:, [names.index(name) for name in common]]
    truth = clip.truth[:, [clip.joints.index(name) for name in common]]
    return np.linalg.norm(ours - truth, axis=-1).mean(axis=1), found.expected_error, found.lost
