"""The diagnosis of settled poses: overlap with the silhouettes, hidden parts, and how far off each joint may be.

Pixels within a narrow rim of the outline do not count: bodies and segmentations differ so much.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import NamedTuple

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.body import doubt
from dousa.estimation.body.doubt import Doubt
from dousa.estimation.body.kinematics import compute_points, place_parts, step_poses
from dousa.estimation.raster.rasteriser import draw_placed
from dousa.estimation.tracking.search_setup import (
    Frame,
    SearchSetup,
    compare_views,
    count_bits,
    draw_views,
    erode,
    measure_rim,
)
from dousa.estimation.tracking.start import StartSearch, exchange_pair, find_pairs

HIDDEN = 0.1
"""Share of a part's own pixels below which the image does not determine its place: by definition of `occluded`."""


class Note(NamedTuple):
    """The measurements of one pose.

    Parameters
    ----------
    overlap : (V,) intersection over union; nan where nothing is seen.
    widths : (P + K,) m, how far each point can move while the image score stays nearly the same.
    visible : (P,) share of a part that no other part covers, in the view where it is greatest.
    outside : (P,) share of a part that lies outside the silhouettes.
    swap : (P + K,) m, how far each point goes with limbs exchanged, as far as the image allows; nan if not looked at.
    """

    overlap: FloatArray
    widths: FloatArray
    visible: FloatArray
    outside: FloatArray
    swap: FloatArray


def list_signs(setup: SearchSetup, poses: FloatArray, notes: Note) -> FloatArray:
    """Compute the signs of doubt (T, P + K, S) of `doubt`."""
    body = setup.body
    own = np.concatenate((np.arange(body.n_parts), body.tip_parts))
    above = np.concatenate((np.maximum(body.parents, 0), body.tip_parts))
    hidden = 1.0 - np.minimum(notes.visible[:, above], notes.visible[:, own])
    outside = notes.outside[:, above] + notes.outside[:, own]
    found = doubt.Evidence(_is_seen(notes), notes.widths, outside, hidden, _fill(notes.swap))
    return doubt.list_signs(body, poses, setup.frame_rate, setup.cameras[0].rotation[2], found)


def judge(setup: SearchSetup, poses: FloatArray, notes: Note, meet: bool) -> Doubt:
    """Compute the doubt of consecutive poses (T, 7 + A); depth is known where the lines of sight ``meet``."""
    return doubt.judge(list_signs(setup, poses, notes), _is_seen(notes), "silhouettes", 1 + meet, setup.body.stature)


def _is_seen(notes: Note) -> BoolArray:
    return np.asarray(np.isfinite(notes.overlap).any(axis=1))


def _fill(values: FloatArray) -> FloatArray:
    """Interpolate (T, n) between the frames that are known; 0 where none is."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(known):
        return np.zeros_like(values)
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, known, column[known]) for column in values.T], axis=1)


def look_at_parts(setup: SearchSetup, pose: FloatArray, frame: Frame, steps: int) -> tuple[FloatArray, FloatArray]:
    """Compute ``visible`` and ``outside`` (P,) of `Note`; ``steps`` px at the outline do not count."""
    body, visible = setup.body, np.zeros(setup.body.n_parts)
    wholes, beyond = np.zeros(body.n_parts), np.zeros(body.n_parts)
    placed, apart = place_parts(body, pose[None]), np.arange(body.n_parts)
    for view in np.flatnonzero(frame.seen):
        (parts,) = draw_placed(body, placed, setup.rows[view], setup.sizes[view], apart, body.n_parts)
        before = np.bitwise_or.accumulate(parts)  # what each part and those before it cover
        shared = np.bitwise_or.reduce(before[:-1] & parts[1:])
        deep = erode(before[-1] & ~frame.bits[view, : parts.shape[1], : parts.shape[2]], steps)
        whole, own = count_bits(parts), count_bits(parts & ~shared)
        visible = np.maximum(visible, own / np.maximum(whole, 1))
        wholes += whole
        beyond += count_bits(parts & deep)
    return visible, beyond / np.maximum(wholes, 1.0)


def measure_swap(setup: SearchSetup, pose: FloatArray, frame: Frame) -> FloatArray:
    """Compute ``swap`` (P + K,) m of `Note`: each pair of limbs is exchanged, fitted, and weighed by the image."""
    search, points = StartSearch(setup, frame), np.zeros(setup.body.n_parts + len(setup.body.tips))
    for pair in find_pairs(setup.body):
        own, other = pose.copy(), exchange_pair(setup.body, pose, pair)
        search.sweep_parts(own, pair.parts, (0.5,))
        search.sweep_parts(other, pair.parts, (1.0, 0.5))
        likely = 1.0 / (1.0 + np.exp(np.clip(search.score(own) - search.score(other), -50.0, 50.0)))
        away = np.diff(compute_points(setup.body, np.stack((own, other))), axis=0)[0]
        points += likely * (away * away).sum(axis=-1)
    return np.asarray(np.sqrt(points))


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
    every : frames from one look at exchanged limbs to the next, as they stay exchanged for longer.
    """

    def __init__(
        self, setup: SearchSetup, area: float, meet: bool, pool: Executor | None = None, every: int = 5
    ) -> None:
        self.setup, self.pool, self._every = setup, pool, every
        self._area, self._steps, self._meet = max(area, 1.0), measure_rim(area), meet
        self._notes: list[Note | Future[Note]] = []
        self._given: list[tuple[FloatArray, Frame, bool]] = []

    def cover(self, pose: FloatArray, frame: Frame) -> tuple[float, float]:
        """Return mean overlap, and share of the silhouettes that no part covers, of the views that see a person.

        0 and 1 if none does.
        """
        if not frame.seen.any():
            return 0.0, 1.0
        drawn, silhouettes = draw_views(self.setup, pose, frame)[frame.seen], frame.bits[frame.seen]
        patches = np.bitwise_count(erode(silhouettes & ~drawn, self._steps)).sum()
        return float(compare_views(drawn, silhouettes).mean()), float(patches / (self._area * len(drawn)))

    def look(self, pose: FloatArray, frame: Frame, swap: bool = False) -> Note:
        """Measure a pose, with limbs exchanged if ``swap``."""
        overlap = compare_views(draw_views(self.setup, pose, frame), frame.bits)
        visible, outside = look_at_parts(self.setup, pose, frame, self._steps)
        widths = self._measure_spread(pose, frame)
        swapped = measure_swap(self.setup, pose, frame) if swap and frame.seen.any() else np.full(len(widths), np.nan)
        return Note(overlap, widths, visible, outside, swapped)

    @property
    def latest(self) -> Note:
        """The note of the last pose."""
        self.start()
        return _await(self._notes[-1])

    def write(self, pose: FloatArray, frame: Frame) -> None:
        """Add the note of a settled pose; threads take it with the next ``start``."""
        self._given.append((pose, frame, (len(self._notes) + len(self._given)) % self._every == 0))
        if self.pool is None:
            self.start()

    def start(self) -> None:
        """Start the notes of the poses written since the last start."""
        for given in self._given:
            self._notes.append(self.look(*given) if self.pool is None else self.pool.submit(self.look, *given))
        self._given.clear()

    def finish(self) -> None:
        """Wait for the notes in progress."""
        self.start()
        self._notes = [_await(note) for note in self._notes]

    def is_lost(self, pose: FloatArray, note: Note) -> bool:
        """Return whether a frame by itself is probably lost."""
        one = Note(*(values[None] for values in note))
        return bool(judge(self.setup, pose[None], one, self._meet).lost[0])

    def judge(self, poses: FloatArray) -> Doubt:
        """Compute the doubt of all noted poses (T, 7 + A)."""
        return judge(self.setup, poses, self.arrays(), self._meet)

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
        n_points = body.n_parts + len(body.tips)
        sizes = (len(self.setup.cameras), n_points, body.n_parts, body.n_parts, n_points)
        columns = zip(*map(_await, self._notes), strict=True) if self._notes else [()] * len(sizes)
        return Note(*(np.array(column, np.float64).reshape(-1, size)
                      for column, size in zip(columns, sizes, strict=True)))  # fmt: skip

    def load(self, notes: Note) -> None:
        """Load the notes of an earlier run, as `arrays` returns them."""
        self._notes = [Note(*row) for row in zip(*notes, strict=True)]
