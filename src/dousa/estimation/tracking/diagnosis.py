"""The diagnosis of settled poses: overlap with the silhouettes, hidden parts, expected error.

The expected error of a frame is a product of powers of patches and overhang; its logarithm is normally distributed.
The constants are those of a regression, see docs/estimation.md. Joints share the error by how far each can move
unnoticed. Pixels within a narrow rim of the outline do not count, as bodies and segmentations differ by that much.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from math import erf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.body.human import USUAL_STATURE
from dousa.estimation.body.kinematics import compute_points, place_parts, step_poses
from dousa.estimation.raster.rasteriser import Bits, draw_placed
from dousa.estimation.tracking.search_setup import Frame, SearchSetup, erode, measure_rim

LOST_ERROR = 0.15
"""m, by definition the mean error of the joints of a frame that is lost (of a person of usual stature)."""

# A regression over made-up films of two people, see lab/notes/estimation.md ("What is said to be lost"): powers of
# patches and overhang, what is added to both, and the logarithm of the error (m) where they are one.
_PATCHES, _OVERHANG, _LEAST, _SCALE = 0.495, 0.128, 0.004, 0.119
# Likewise: shift and spread of the logarithm by whether lines of sight meet.
_SHIFT, _SPREAD = {True: 0.0, False: 1.5}, {True: 0.387, False: 0.671}


class PatchMeasure:
    """Measure patches and overhang without rims; ``area`` (px) is the mean area of a silhouette at the working size."""

    def __init__(self, area: float) -> None:
        self.area, self.steps = max(area, 1.0), measure_rim(area)

    def measure(self, drawn: Bits, frame: Frame) -> FloatArray:
        """Compute patches and overhang (2,) of the drawn body (V, H, words) as shares of a usual silhouette.

        Patches are silhouette pixels that no part covers, overhang is body outside; NaN if no view sees a person.
        """
        seen = frame.seen
        if not seen.any():
            return np.full(2, np.nan)
        silhouettes, body = frame.bits[seen], drawn[seen]
        both = (erode(silhouettes & ~body, self.steps), erode(body & ~silhouettes, self.steps))
        counts = np.array([np.bitwise_count(deep).sum() for deep in both], np.float64)
        return np.asarray(counts / (self.area * seen.sum()))


class Doubt(NamedTuple):
    """The expected errors (T, P + K) m of joints and tips, and the frames (T,) that are probably lost or unseen."""

    errors: FloatArray
    lost: BoolArray


class ErrorModel:
    """Estimate the error of poses.

    Parameters
    ----------
    setup : body and frame rate.
    meet : whether the lines of sight of the views meet, so that depth is known.
    window : s to either side that are averaged, as tracks are lost and found in more than a frame.
    unlikely : probability of an error above `LOST_ERROR` from which a frame is lost.
    rigid : m, error of a joint without any movement of its own.
    usual : m, stature to which `LOST_ERROR` applies; errors grow with the body.
    """

    def __init__(
        self, setup: SearchSetup, meet: bool, *, window: float = 0.13, unlikely: float = 0.2, rigid: float = 0.03,
        usual: float = USUAL_STATURE,
    ) -> None:  # fmt: skip
        self.scale, self.reach = setup.body.stature / usual, round(window * setup.frame_rate)
        self.shift, self.spread, self.unlikely, self.rigid = _SHIFT[meet], _SPREAD[meet], unlikely, rigid

    def judge(self, patches: FloatArray, widths: FloatArray, habit: float | None = None) -> Doubt:
        """Compute the doubt of consecutive frames.

        Parameters
        ----------
        patches : (T, 2) patches and overhang, nan if no person is seen.
        widths : (T, P + K) m, how far each point can move unnoticed.
        habit : see `find_habit`; of these frames by default.
        """
        seen = np.asarray(np.isfinite(patches).all(axis=1))
        found = np.where(seen[:, None], _average(patches, seen, self.reach), 1.0)
        found[:, 0] = np.maximum(found[:, 0] - (find_habit(patches) if habit is None else habit), 0.0)
        middle = _SCALE + self.shift + np.log(found + _LEAST) @ (_PATCHES, _OVERHANG)
        expected = np.exp(middle + 0.5 * self.spread**2)
        above = np.array([0.5 * (1.0 + erf(z)) for z in (middle - np.log(LOST_ERROR)) / (self.spread * np.sqrt(2.0))])
        own = np.hypot(widths, self.rigid * self.scale)
        errors = self.scale * expected[:, None] * own / own.mean(axis=1, keepdims=True)
        return Doubt(errors, np.asarray((above > self.unlikely) | ~seen))


def find_habit(patches: FloatArray, *, rarely: float = 0.1, share: float = 0.7, enough: int = 10) -> float:
    """Compute the share of patches (T, 2) present in nearly every frame: shadows or clothes, no error.

    It is ``share`` of what all but ``rarely`` of the frames leave; 0 for fewer frames than ``enough``.
    """
    seen = patches[np.isfinite(patches[:, 0]), 0]
    return share * float(np.quantile(seen, rarely)) if len(seen) >= enough else 0.0


def _average(values: FloatArray, known: BoolArray, reach: int) -> FloatArray:
    """Average (T, n) over the known frames within ``reach``; 0 where there is none."""
    window = np.ones(2 * reach + 1)
    count = np.convolve(known, window)[reach : reach + len(known)]
    columns = [np.convolve(np.where(known, column, 0.0), window)[reach : reach + len(known)] for column in values.T]
    return np.asarray(np.stack(columns, axis=1) / np.maximum(count, 1.0)[:, None])


class Note(NamedTuple):
    """The measurements of one pose.

    Parameters
    ----------
    overlap : (V,) intersection over union; nan where nothing is seen.
    widths : (P + K,) m, how far each point can move while the image score stays nearly the same.
    occluded : (P,) parts hidden in every view.
    patches : (2,) see `PatchMeasure`.
    """

    overlap: FloatArray
    widths: FloatArray
    occluded: NDArray[np.bool_]
    patches: FloatArray


def _count_bits(bits: Bits) -> NDArray[np.int64]:
    """Count the bits set in images (..., H, words)."""
    counts = np.bitwise_count(bits).reshape(*bits.shape[:-2], -1)
    return np.asarray(np.add.reduce(counts, axis=-1, dtype=np.int32).astype(np.int64))


def draw_views(setup: SearchSetup, pose: FloatArray, frame: Frame) -> Bits:
    """Draw a pose into the views (V, H, words) that are seen."""
    placed, together = place_parts(setup.body, pose[None]), np.zeros(setup.body.n_parts, np.intp)
    drawn = np.zeros_like(frame.bits)
    for view in np.flatnonzero(frame.seen):
        found = draw_placed(setup.body, placed, setup.rows[view], setup.sizes[view], together, 1)[0, 0]
        drawn[view, : found.shape[0], : found.shape[1]] = found
    return drawn


def compare_views(drawn: Bits, silhouettes: Bits) -> FloatArray:
    """Compute intersection over union (V,) of bits (V, H, words); nan where both are empty."""
    both, either = _count_bits(drawn & silhouettes), _count_bits(drawn | silhouettes)
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def find_visible(setup: SearchSetup, pose: FloatArray, frame: Frame) -> FloatArray:
    """Compute the share (P,) of each part's pixels that no other part covers, in the view where it is greatest."""
    body, visible = setup.body, np.zeros(setup.body.n_parts)
    placed, apart = place_parts(body, pose[None]), np.arange(body.n_parts)
    for view in np.flatnonzero(frame.seen):
        (parts,) = draw_placed(body, placed, setup.rows[view], setup.sizes[view], apart, body.n_parts)
        before = np.bitwise_or.accumulate(parts)  # what each part and those before it cover
        shared = np.bitwise_or.reduce(before[:-1] & parts[1:])
        whole, own = _count_bits(parts), _count_bits(parts & ~shared)
        visible = np.maximum(visible, own / np.maximum(whole, 1))
    return visible


def _await(note: Note | Future[Note]) -> Note:
    return note.result() if isinstance(note, Future) else note


class Diagnosis:
    """Notes on settled poses, frame by frame.

    Parameters
    ----------
    setup : body, cameras and settings.
    area : px, mean area of a silhouette at the size of the setup's cameras.
    meet : whether the lines of sight of the views meet, so that depth is known.
    pool : threads that take the notes during the search; None takes them at once.
    hidden : share of a part's own pixels below which the image does not determine its place.
    """

    def __init__(
        self, setup: SearchSetup, area: float, meet: bool, pool: Executor | None = None, hidden: float = 0.1
    ) -> None:
        self.setup, self.pool, self._hidden = setup, pool, hidden
        self._patch_measure, self._model = PatchMeasure(area), ErrorModel(setup, meet)
        self._notes: list[Note | Future[Note]] = []

    def cover(self, pose: FloatArray, frame: Frame) -> tuple[float, float]:
        """Return mean overlap and share of patches over the views that see a person; 0 and 1 if none does."""
        overlap, patches = self._cover(pose, frame)
        seen = overlap[np.isfinite(overlap)]
        return (float(seen.mean()), float(patches[0])) if len(seen) else (0.0, 1.0)

    def _cover(self, pose: FloatArray, frame: Frame) -> tuple[FloatArray, FloatArray]:
        """Compute overlap (V,) and patches (2,)."""
        drawn = draw_views(self.setup, pose, frame)
        return compare_views(drawn, frame.bits), self._patch_measure.measure(drawn, frame)

    def look(self, pose: FloatArray, frame: Frame) -> Note:
        """Measure a pose."""
        overlap, patches = self._cover(pose, frame)
        occluded = find_visible(self.setup, pose, frame) < self._hidden
        return Note(overlap, self._measure_spread(pose, frame), occluded, patches)

    @property
    def latest(self) -> Note:
        """The note of the last pose."""
        return _await(self._notes[-1])

    def write(self, pose: FloatArray, frame: Frame) -> None:
        """Add the note of a settled pose."""
        self._notes.append(self.look(pose, frame) if self.pool is None else self.pool.submit(self.look, pose, frame))

    def finish(self) -> None:
        """Wait for the notes in progress."""
        self._notes = [_await(note) for note in self._notes]

    def is_lost(self, note: Note, recent: int = 300) -> bool:
        """Return whether a frame by itself is probably lost, with the habit of ``recent`` frames before it."""
        before = np.array([_await(old).patches for old in self._notes[-recent:]]).reshape(-1, 2)
        return bool(self._model.judge(note.patches[None], note.widths[None], find_habit(before)).lost[0])

    def judge(self) -> Doubt:
        """Compute the doubt of all noted poses."""
        notes = self.arrays()
        return self._model.judge(notes.patches, notes.widths)

    def _measure_spread(self, pose: FloatArray, frame: Frame) -> FloatArray:
        """Compute how far (P + K,) m each point moves while the image score stays nearly the same.

        Each degree of freedom moves by itself, at most dR, until the image score drops by one; effects add in squares.
        """
        setup = self.setup
        half = 0.5 * setup.measure_widths(pose, frame, setup.own_scratch()).sum(axis=1)
        axes = np.flatnonzero(half)
        if not len(axes):
            return np.zeros(setup.body.n_parts + len(setup.body.tips))
        moved = np.tile(pose, (len(axes), 1))
        for row, axis in zip(moved, axes, strict=True):
            if 3 <= axis < 6:
                row[:] = step_poses(pose, half[axis] * np.eye(setup.n_axes)[axis])
            else:
                row[axis + (axis >= 6)] += half[axis]
        points = compute_points(setup.body, np.concatenate((pose[None], moved)))
        away = np.linalg.norm(points[1:] - points[0], axis=-1)
        return np.asarray(np.sqrt((away * away).sum(axis=0)))

    def arrays(self) -> Note:
        """Return all notes, with the frames (T,) along the first axis of each array."""
        self.finish()
        body = self.setup.body
        sizes = (len(self.setup.cameras), body.n_parts + len(body.tips), body.n_parts, 2)
        columns = zip(*map(_await, self._notes), strict=True) if self._notes else [()] * 4
        kinds = (np.float64, np.float64, np.bool_, np.float64)
        return Note(*(np.array(column, kind).reshape(-1, size)
                      for column, kind, size in zip(columns, kinds, sizes, strict=True)))  # fmt: skip

    def load(self, notes: Note) -> None:
        """Load the notes of an earlier run, as `arrays` returns them."""
        self._notes = [Note(*row) for row in zip(*notes, strict=True)]
