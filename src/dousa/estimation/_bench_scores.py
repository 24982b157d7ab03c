"""What both experiments do with a clip: fit the first poses, score poses, share out the work."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.estimation._bench_clips import BenchClip
from dousa.estimation._bench_result import Score
from dousa.estimation._types import Estimate
from dousa.estimation.metrics import compare_in_images, compare_with_truth

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel

__all__ = ["Progress", "Track", "fit_first_poses", "mark_points", "score_poses", "spread_tasks"]

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]
Track = Callable[..., Estimate]

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


def fit_first_poses(body: BodyModel, clip: BenchClip, frame: int = 0) -> tuple[FloatArray, FloatArray]:
    """The poses of a body that come nearest to the true joints of a frame and of the next."""
    from dousa.estimation.posing import fit_pose

    first, _ = fit_pose(body, clip.joints_at(frame))
    if frame + 1 >= len(clip.truth):
        return first, first
    second, _ = fit_pose(body, clip.joints_at(frame + 1), first)
    return first, second


def score_poses(
    clip: BenchClip,
    views: Sequence[int],
    body: BodyModel,
    poses: FloatArray,
    hidden: NDArray[np.bool_] | None = None,
) -> Score:
    """Compare poses of a body with the truth of a clip, in space and in some of its views."""
    from dousa.estimation.kinematics import compute_points, point_names

    names, points = point_names(body), compute_points(body, poses)
    rate = clip.silhouettes.frame_rate
    accuracy = compare_with_truth(names, points, clip.joints, clip.truth, frame_rate=rate, occluded=hidden)
    cameras = [clip.cameras[view] for view in views]
    image = compare_in_images(names, points, clip.joints, clip.truth, cameras, clip.stature)
    return Score(accuracy, image)


def mark_points(body: BodyModel, parts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Flags of parts (T, P) as flags of joints and tips (T, P + K): a joint lies where the part above it ends."""
    above = np.maximum(body.parents, 0)
    return np.asarray(parts, bool)[:, np.concatenate((above, body.tip_parts))]


def spread_tasks(
    work: Callable[[_Task], _Answer],
    tasks: Sequence[tuple[str, _Task]],
    n_jobs: int | None,
    progress: Progress | None,
) -> Iterator[_Answer]:
    """Answers in the order of the tasks, each of which has a name.

    Parameters
    ----------
    work : what is done to each.
    tasks : names and tasks.
    n_jobs : threads; None for one. Compiled kernels let go of Python's lock, so that threads help.
    progress : called with (done, total, name).
    """
    if n_jobs == 0:
        raise OptionError("expected a number of threads other than 0, such as 2, or -1 for every core")
    answers: Iterable[_Answer]
    if n_jobs in (None, 1) or len(tasks) < 2:
        answers = (work(task) for _, task in tasks)
    else:
        import joblib

        parallel = joblib.Parallel(n_jobs=n_jobs, prefer="threads", return_as="generator", batch_size=1)
        answers = parallel(joblib.delayed(work)(task) for _, task in tasks)
    if progress is not None:
        progress(0, len(tasks), tasks[0][0])
    for done, answer in enumerate(answers, 1):
        if progress is not None:
            progress(done, len(tasks), tasks[done - 1][0])
        yield answer
