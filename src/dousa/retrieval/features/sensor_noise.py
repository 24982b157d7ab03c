"""Sensor noise: measured in the recording itself, and reduced before features are computed.

The spline through a joint's places with the least generalised cross-validation (Craven and Wahba, Numerische Mathematik
31, 1979) gives the size of its errors; the median of all joints is reliable. Each joint then gets the spline of least
expected error given that size (Mallows, "Some comments on C_p", Technometrics 15, 1973). Splines penalise the third
derivative. Places far beyond the errors are glitches, replaced by the spline.

A recording with errors below half a millimetre, such as optical motion capture, is returned unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray, read_only
from dousa.motion.canonical.anthropometry import stature_of_parts
from dousa.motion.canonical.geometry import CHAIN_BONES, CHAIN_SHARES, chain_height
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features import noise_kernels as kernels
from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions
from dousa.retrieval.features.posed_motion import PosedMotion, check_frame_rate, check_shape

_NO_NOISE = 5e-4  # m (docs/noise.md)
_GLITCH = 8.0  # standard deviations: a fast movement is no glitch; 5 was a little worse (measured)
_BONES = [
    (f"{side}_{near}", f"{side}_{far}")
    for side in ("left", "right")
    for near, far in (("shoulder", "elbow"), ("elbow", "hand"), ("hip", "knee"), ("knee", "ankle"))
]
_BONE_ENDS = np.array([[JOINT_INDEX[joint] for joint in bone] for bone in _BONES])


@dataclass(frozen=True, slots=True, eq=False)
class QuietMotion:
    """A motion with reduced noise; ``noise`` is the standard deviation of what was removed, m."""

    positions: FloatArray
    frame_rate: float
    height: float
    noise: float


def reduce_noise(motion: PosedMotion) -> PosedMotion:
    """Reduce a motion's sensor noise; return the motion itself where there is hardly any.

    ``motion`` has any frame rate; joints may be absent (NaN in all frames). Returns a motion at ``CHANNEL_RATE`` if it
    was faster, else at its own rate, with the height of the smoothed bones. Raises InvalidMotionError: another shape
    than (n, 20, 3), no frame, no body height, a frame rate below 1 Hz.
    """
    return reduce_noise_of_all([motion])[0]


def reduce_noise_of_all(
    motions: Sequence[PosedMotion], fewest: int = 8, most_together: int = 1024
) -> list[PosedMotion]:
    """Do the same for several motions, faster: those of equal length and joints go together.

    Fewer frames than ``fewest`` do not separate noise from movement (docs/noise.md). ``most_together`` frames of
    recordings are smoothed together: the size of a core's cache.
    """
    quiet, points = list(motions), [_thin(motion) for motion in motions]
    groups: dict[tuple[int, bytes], list[int]] = {}
    for number, places in enumerate(points):
        finite: BoolArray = np.isfinite(places)
        there: BoolArray = np.ones(places.shape[1], np.bool_) if finite.all() else np.all(finite, axis=(0, 2))
        if len(places) >= fewest and there.any():
            groups.setdefault((len(places), there.tobytes()), []).append(number)
    for (n_frames, kept), numbers in groups.items():
        there, at_once = np.frombuffer(kept, np.bool_), max(most_together // n_frames, 1)
        for first in range(0, len(numbers), at_once):
            some = numbers[first : first + at_once]
            together = np.stack([points[k] for k in some]) if len(some) > 1 else points[some[0]][None]
            smooth, noise = smooth_together(together if there.all() else together[:, :, there])
            for number, found, size in zip(some, smooth, noise.tolist(), strict=True):
                if found is not None:
                    quiet[number] = _put_back(motions[number], points[number], there, found, size)
    return quiet


def _thin(motion: PosedMotion) -> FloatArray:
    points = check_shape(motion.positions, motion.height)
    check_frame_rate(motion.frame_rate)
    return sample_positions(points, motion.frame_rate) if motion.frame_rate > CHANNEL_RATE else points


def _put_back(
    motion: PosedMotion, points: FloatArray, there: BoolArray, smooth: FloatArray, noise: float
) -> QuietMotion:
    """Return a motion of ``points`` (n, 20, 3) with the joints ``there`` smoothed."""
    quiet = smooth
    if not there.all():
        quiet = points.copy()
        quiet[:, there] = smooth
    before, after = _measure_bones(points), _measure_bones(quiet)
    share = after / before if before > 0 and after > 0 else 1.0
    return QuietMotion(quiet, min(motion.frame_rate, CHANNEL_RATE), motion.height * share, noise)


def measure_unsteadiness(motion: PosedMotion) -> float:
    """Return the standard deviation of a limb bone's length as a share of its median, the median over the bones; 0 for
    none.

    ``motion`` has any frame rate; joints may be absent. Lasting errors of places count, too.
    """
    points = np.ascontiguousarray(motion.positions, np.float64)
    return float(kernels.measure_unsteadiness(points, _BONE_ENDS, np.empty((2, max(len(points), len(_BONE_ENDS))))))


def smooth_together(
    points: FloatArray, n_rounds: int = 3, at_once: int = 1 << 18
) -> tuple[list[FloatArray | None], FloatArray]:
    """Smooth the places of R recordings of the same length (R, n, J, 3), finite, n at least 3, each independently.

    Glitches are looked for ``n_rounds`` times. ``at_once`` frames of joints are transformed, so that an hour does not
    fill the memory.

    Returns
    -------
    points : (n, J, 3) of each; None where there is neither noise nor a glitch.
    noise : (R,) standard deviation of the errors, in the unit of the points, along each axis.
    """
    n_recordings, n_frames, n_joints, _ = points.shape
    courses: FloatArray = np.ascontiguousarray(points.transpose(0, 2, 3, 1)).reshape(-1, 3, n_frames)
    believed, limit = courses, _GLITCH**2 / 2.366  # the median of chi-squared with three degrees of freedom
    changed, room = np.zeros((n_recordings, n_joints), np.bool_), np.empty((2, n_frames))
    splines = _Splines(courses, n_recordings, at_once)
    noise = splines.choose(np.arange(n_recordings))
    noisy = np.flatnonzero(noise >= _NO_NOISE)
    for _ in range(n_rounds):
        if not len(noisy):
            break
        believed = courses.copy() if believed is courses else believed
        glitches, rows = np.zeros(n_recordings, np.int64), splines.list_joints(noisy)
        kernels.believe(courses, splines.draw(noisy), limit, rows, room, changed.ravel(), believed, glitches)
        noisy = np.flatnonzero(glitches)
        splines.read(believed, splines.list_joints(noisy)[changed[noisy].ravel()])
        noise[noisy] = splines.choose(noisy)
        noisy = noisy[noise[noisy] >= _NO_NOISE]
    smooth = splines.draw(np.flatnonzero(noise >= _NO_NOISE)), believed
    found: list[FloatArray | None] = []
    for number, size in enumerate(noise.tolist()):
        own = smooth[0 if size >= _NO_NOISE else 1].reshape(n_recordings, n_joints, 3, n_frames)[number]
        same = size < _NO_NOISE and not changed[number].any()
        found.append(None if same else np.ascontiguousarray(own.transpose(2, 0, 1)))
    return found, noise


class _Splines:
    """The splines of all weights through the courses of the joints of recordings, one of them chosen for each.

    In the frequencies of a recording reflected at its ends, its cosine transform, the penalty of a spline is diagonal
    (Garcia, "Robust smoothing of gridded data", Computational Statistics and Data Analysis 54, 2010).

    courses : (R J, 3, n), recording after recording.
    n_recordings : R.
    at_once : frames of joints that are transformed at once.
    """

    def __init__(self, courses: FloatArray, n_recordings: int, at_once: int) -> None:
        n_courses, _, self._count = courses.shape
        self._at_once = at_once
        self._n_joints = n_courses // n_recordings
        self._list = _list_splines(self._count)
        self._lines, self._smooth, self._waves = (np.empty_like(courses) for _ in range(3))
        self._left, self._room = np.empty((n_courses, len(self._list.freedom))), np.empty((2, self._n_joints))
        self._fitted, self._chosen = np.full((2, n_courses), -1)
        self.read(courses, np.arange(n_courses))

    def list_joints(self, recordings: IndexArray) -> IndexArray:
        rows: IndexArray = (recordings[:, None] * self._n_joints + np.arange(self._n_joints)).ravel()
        return rows

    def _portions(self, rows: IndexArray) -> Iterator[IndexArray]:
        some = max(self._at_once // self._count, 1)
        return (rows[first : first + some] for first in range(0, len(rows), some))

    def read(self, courses: FloatArray, rows: IndexArray, n_end: int = 3) -> None:
        """Read the courses of some joints again; the mean of ``n_end`` frames is where a joint begins, or ends."""
        from scipy.fft import dct

        ends = min(n_end, self._count // 2)
        for some in self._portions(rows):
            own = courses[some]
            rise = own[..., -ends:].sum(axis=2) - own[..., :ends].sum(axis=2)
            lines = (rise / ends * (self._count / (self._count - ends)))[..., None] * self._list.ramp
            own -= lines
            self._lines[some], self._waves[some] = lines, dct(own, overwrite_x=True)
            kernels.measure(self._waves, some, self._list.lost, self._left)
        self._fitted[rows] = -1

    def choose(self, recordings: IndexArray) -> FloatArray:
        """Choose the spline of each joint of some recordings; return the standard deviation of the errors in each."""
        variances = np.empty(len(recordings))
        kernels.choose_all(
            self._left, self._list.freedom, self._count, recordings, self._n_joints, self._room, self._chosen, variances
        )
        return np.sqrt(variances)

    def draw(self, recordings: IndexArray) -> FloatArray:
        """Return the splines (R J, 3, n), with those of some recordings updated to the current choice."""
        from scipy.fft import idct

        rows = self.list_joints(recordings)
        rows = rows[self._chosen[rows] != self._fitted[rows]]
        for some in self._portions(rows):
            waves = self._waves[some]
            waves *= self._list.kept[self._chosen[some], None]
            smooth = idct(waves, overwrite_x=True)
            smooth += self._lines[some]
            self._smooth[some] = smooth
        self._fitted[rows] = self._chosen[rows]
        return self._smooth


@dataclass(frozen=True, slots=True, eq=False)
class _SplineList:
    """Splines of all weights through n frames.

    ``kept`` (L, n) is the share of each wave that each keeps, ``lost`` (n, L) that of the power it removes, ``freedom``
    (L,) its degrees of freedom; ``ramp`` (n,) from -0.5 to 0.5.
    """

    kept: FloatArray
    lost: FloatArray
    freedom: FloatArray
    ramp: FloatArray


def _list_splines(count: int, most_kept: int = 300) -> _SplineList:
    """List the splines through ``count`` frames; those of up to ``most_kept`` stay in memory, at most 34 MB of them."""
    return _keep_list(count) if count <= most_kept else _make_list(count)


def _make_list(count: int) -> _SplineList:
    stiffness = (2.0 - 2.0 * np.cos(np.pi * np.arange(count) / count)) ** 3  # of the third derivative
    weights = np.logspace(-3.0, 6.0, 28)  # of the penalty; the last one leaves movements of some seconds
    kept: FloatArray = 1.0 / (1.0 + weights[:, None] * stiffness)
    lost: FloatArray = np.ascontiguousarray(((1.0 - kept) ** 2).T)
    return _SplineList(kept, lost, kept.sum(axis=1), np.linspace(-0.5, 0.5, count))


_keep_list = lru_cache(maxsize=256)(_make_list)


def _measure_bones(points: FloatArray) -> float:
    if np.isnan(points[0]).any():  # a missing joint is missing in all frames
        height = chain_height(points)
    else:
        placed = read_only(np.ascontiguousarray(points))
        height = kernels.measure_chain(placed, CHAIN_BONES, CHAIN_SHARES, np.empty(len(points)))
    return height if height > 0 else stature_of_parts(points)
