"""The tracker: estimates a motion from silhouettes, frame by frame.

The search of Kameda, Minoh and Ikeda ("A Human Motion Estimation Method Using a Model - Introduction of Inertia"), from
the root part to the leaves, one axis at a time, each within dR of its prediction (eq. 1), scored by eqs. 2 and 3.
`PAPER` is their method. The defaults add several views, subtrees judged as a whole, finer revisits, a beam of poses,
dR by joint, fitted girths, a restart where the track is lost, and smoothing.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, Mask
from dousa.errors import OptionError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.doubt import LOST_ERROR
from dousa.estimation.cameras.camera import Camera, check_cameras
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.estimation.tracking.beam import Beam, BeamState, Replay, choose_switch, choose_track, replay, score_frames
from dousa.estimation.tracking.diagnosis import HIDDEN, Diagnosis, Note
from dousa.estimation.tracking.outlines import do_meet
from dousa.estimation.tracking.person_size import fit_girths
from dousa.estimation.tracking.search_setup import Frame, SearchSetup, Shrinker
from dousa.estimation.tracking.settings import PAPER, Estimate, TrackedFrame, TrackerSettings
from dousa.estimation.tracking.start import StartSearch, checked_start, find_first, find_start
from dousa.messages import Message, Progress
from dousa.motion.resampling import smooth_gaussian

__all__ = ["PAPER", "PartialTrack", "TrackerSettings", "estimate", "smooth_poses"]


@dataclass(frozen=True, slots=True)
class RestartSettings:
    """When a track counts as lost, and what replaces it.

    Parameters
    ----------
    overlap : share of the usual overlap; below, a frame is poor.
    patches : share of the silhouettes that no part covers; above, a frame is poor, if it is also above
    more : times the usual share.
    frames : poor ones in a row, or ones without a person, after which the pose is searched again.
    gain : log score by which another pose must fit better.
    repaired : frames, at most, that are tracked back from it.
    look : frames after which limbs are looked at again; fewer than the settings' ``lag``, or all would be settled.
    """

    overlap: float = 0.7
    patches: float = 0.02
    more: float = 1.5
    frames: int = 5
    gain: float = 4.0
    repaired: int = 60
    look: int = 15


@dataclass(frozen=True, slots=True, eq=False)
class PartialTrack(BeamState):
    """An interrupted track: the beam and the settled frames, as arrays that a file can keep.

    Parameters
    ----------
    poses : (n, 7 + A) of the settled frames; the frames before the first person hold its pose.
    overlap, widths, visible, outside, swap : of these frames, see `Note`.
    restarts : of these frames, where another track was taken.
    spheres : (S, 4) of the body, with fitted girths.
    first : the first frame with a person in it.
    usual, usual_patches : usual overlap in this recording, and share of its silhouettes in patches.
    area : px, mean area of a silhouette.
    poor, unseen : number of newest frames in a row with poor cover, and without a person.
    """

    poses: FloatArray
    overlap: FloatArray
    widths: FloatArray
    visible: FloatArray
    outside: FloatArray
    swap: FloatArray
    restarts: NDArray[np.int64]
    spheres: FloatArray
    first: int
    usual: float
    usual_patches: float
    area: float
    poor: int
    unseen: int

    @property
    def n_tracked(self) -> int:
        """Number of frames tracked so far, settled or not."""
        return len(self.poses) + len(self.pending_poses)


def estimate(
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    body: BodyModel,
    start: ArrayLike | None = None,
    *,
    settings: TrackerSettings | None = None,
    girths: Literal["fit", "keep"] = "fit",
    n_threads: int | None = None,
    resume: PartialTrack | None = None,
    on_checkpoint: Callable[[Callable[[], PartialTrack]], None] | None = None,
    progress: Progress | None = None,
    on_frame: Callable[[TrackedFrame], None] | None = None,
    checkpoint_every: int = 32,
    restart: RestartSettings = RestartSettings(),
) -> Estimate:
    """Estimate a motion from silhouettes.

    Parameters
    ----------
    silhouettes : V views over T frames.
    cameras : (V,) one for each view, of the size of its masks.
    body : the model, with P parts, K tips and A joint angles.
    start : (7 + A,) pose in the first frame that shows the person well (see `find_first`); None searches for it.
    settings : how to search; the defaults, or `PAPER`.
    girths : ``"fit"`` fits the girths of the parts to the first silhouettes, ``"keep"`` does not.
    n_threads : by default two, or one on a machine of one core; the result does not depend on it.
    resume : the state of an interrupted call with the same arguments.
    on_checkpoint : called with a function that returns the state so far, at the cost of a copy of the whole track.
    progress : called with frames done, frames in all and the current step.
    on_frame : called with every frame as soon as it has a pose, and again when that is settled.
    checkpoint_every : frames from one call of ``on_checkpoint`` to the next.
    restart : when the track counts as lost.

    Raises
    ------
    CalibrationError : not one camera for each view, or of another size than the masks.
    BodyModelError : a start that is no pose of this body.
    SilhouetteError : no person is seen in the first frames, or every mask is full.
    OptionError : unknown ``girths``.
    """
    settings = TrackerSettings() if settings is None else settings
    if girths not in ("fit", "keep"):
        raise OptionError("tracker.choice", option="girths", known=("fit", "keep"), found=str(girths))
    check_cameras(cameras, silhouettes.names, silhouettes.sizes)
    n_threads = n_threads or min(2, os.cpu_count() or 1)
    tell = progress or (lambda done, total, what: None)
    job = _Job(silhouettes, tuple(cameras), body, settings, restart, n_threads, tell, on_frame)
    try:
        if resume is None:
            job.begin(start, girths)
        else:
            job.resume(resume)
        job.run(on_checkpoint, checkpoint_every)
    finally:
        job.close()
    return job.finish()


@dataclass(eq=False)
class _Job:
    silhouettes: Silhouettes
    cameras: tuple[Camera, ...]
    body: BodyModel
    settings: TrackerSettings
    restart: RestartSettings
    n_threads: int
    progress: Progress
    on_frame: Callable[[TrackedFrame], None] | None
    poses: list[FloatArray] = field(default_factory=list)
    restarts: list[int] = field(default_factory=list)
    notes: list[Message] = field(default_factory=list)
    ahead: deque[Frame] = field(default_factory=deque)
    poor: int = 0
    unseen: int = 0
    searched: int = 0
    patience: int = 1
    began: int = 0

    def begin(self, start: ArrayLike | None, girths: Literal["fit", "keep"]) -> None:
        """Find the first frame, shrink the views to the working size, find or take the start, fit the girths."""
        self.progress(0, self.silhouettes.n_frames, Message("tracker.getting_ready"))
        self.first, masks = find_first(self.silhouettes)
        self.area = float(np.mean([mask.sum() for mask in masks if mask is not None and mask.any()]))
        self._set_up()
        small = self.shrinker.shrink(masks)
        frame = self.setup.pack(small)
        if start is None:
            self.progress(0, self.silhouettes.n_frames, Message("tracker.first_pose"))
            pose = self._find_first_pose(frame, small)
        else:
            pose = checked_start(self.body, start)
        if girths == "fit":
            seen = [(mask, camera) for mask, camera in zip(small, self.shrinker.cameras, strict=True)
                    if mask is not None and mask.any()]  # fmt: skip
            self.body = fit_girths(self.body, pose, [mask for mask, _ in seen], [camera for _, camera in seen])
            self._set_up()
        self._start_beam(pose)
        self.beam.begin(frame)
        self.at = self.first + 1
        covered, patches = self.diagnosis.cover(pose, frame)
        self.usual, self.usual_patches = max(0.3, covered), min(self.restart.patches, patches)
        if start is not None and self.settings.candidates == "subtree":
            self._doubt_start(frame, small, covered)
        for _ in range(self.first):
            self._keep(pose, self.setup.pack([None] * len(self.cameras)))
        self._show_newest(frame)

    def _find_first_pose(
        self, frame: Frame, masks: Sequence[Mask | None], count: int = 4, behind: float = 8.0, seconds: float = 0.7
    ) -> FloatArray:
        """Return the pose that tracks best through the ``seconds`` after the first frame.

        Tries the ``count`` poses that fit that frame best, by at most the log score ``behind`` worse than the first.
        """
        found = find_start(self.setup, frame, masks, n_best=count)
        poses = [start.pose for start in found if start.score > found[0].score - behind]
        if len(poses) < 2 or self.settings.candidates != "subtree":
            return poses[0]
        frames = [frame, *self._look_ahead(round(seconds * self.silhouettes.frame_rate))]
        tracks = []
        for pose in poses:
            self.progress(0, self.silhouettes.n_frames, Message("tracker.first_pose"))
            tracks.append(replay(self.setup, pose, frames, self.n_threads))
        return poses[choose_track(tracks)]

    def _look_ahead(self, count: int) -> list[Frame]:
        last = min(self.silhouettes.n_frames, self.first + 1 + count)
        for number in range(self.first + 1 + len(self.ahead), last):
            self.ahead.append(self.setup.pack(self.shrinker.shrink(self.silhouettes.read(number))))
        return list(self.ahead)

    def _doubt_start(
        self, frame: Frame, masks: Sequence[Mask | None], covered: float, good: float = 0.75, clearly: float = 0.08
    ) -> None:
        """Add a note if a start with less than a ``good`` overlap is ``clearly`` beaten by a pose found without it."""
        if covered < good and (found := find_start(self.setup, frame, masks)[0]).iou > covered + clearly:
            self.notes.append(Message("tracker.start_doubtful", covered=covered, found=found.iou))

    def _set_up(self) -> None:
        self.shrinker = Shrinker(self.cameras, self.area, self.settings.height)
        self.setup = self._make_setup(self.settings)
        meet = do_meet(np.array([camera.rotation[2] for camera in self.cameras]))
        self.diagnosis = Diagnosis(self.setup, self.area * self.shrinker.area_share, meet)

    def _make_setup(self, settings: TrackerSettings) -> SearchSetup:
        area = self.area * self.shrinker.area_share
        return SearchSetup(self.body, self.shrinker.cameras, settings, self.silhouettes.frame_rate, area)

    def _start_beam(self, pose: FloatArray) -> None:
        self.beam = Beam(self.setup, pose, self.n_threads)
        self.diagnosis.pool = self.beam.pool

    def resume(self, partial: PartialTrack) -> None:
        """Continue from a saved state."""
        self.body = replace(self.body, spheres=partial.spheres)
        self.first, self.poor, self.unseen = int(partial.first), int(partial.poor), int(partial.unseen)
        self.area, self.usual = float(partial.area), float(partial.usual)
        self.usual_patches = float(partial.usual_patches)
        self._set_up()
        self.diagnosis.load(Note(*(getattr(partial, name) for name in Note._fields)))
        self.poses = list(partial.poses)
        self.restarts = [int(frame) for frame in partial.restarts]
        self._start_beam(partial.beam_poses[0])
        self.at = len(self.poses)
        frames = [self._read() for _ in range(len(partial.pending_poses))]
        self.beam.load(partial, frames)
        self.began = self.at

    def _read(self) -> Frame:
        self.at += 1
        if self.ahead:
            return self.ahead.popleft()
        return self.setup.pack(self.shrinker.shrink(self.silhouettes.read(self.at - 1)))

    def run(self, on_checkpoint: Callable[[Callable[[], PartialTrack]], None] | None, checkpoint_every: int) -> None:
        """Track to the end."""
        n_frames = self.silhouettes.n_frames
        self.clock = time.perf_counter()
        self.began = max(self.began, self.at)
        while self.at < n_frames:
            frame = self._read()
            self.beam.step(frame, self.diagnosis.start)
            self._watch(frame)
            self._show_newest(frame)
            for settled in self.beam.settle(self.settings.lag):
                self._keep(settled.pose, settled.frame)
            self.progress(self.at, n_frames, Message("tracker.tracking"))
            if on_checkpoint is not None and self.at % checkpoint_every == 0:
                on_checkpoint(self._save)
        for settled in self.beam.settle(0):
            self._keep(settled.pose, settled.frame)
        self.diagnosis.finish()
        self.seconds = time.perf_counter() - self.clock

    def _watch(self, frame: Frame) -> None:
        """Search for the person again after several frames with poor cover or without a person."""
        if not frame.seen.any():
            self.unseen += 1
            return
        rule = self.restart
        returned, self.unseen = self.unseen >= rule.frames, 0
        covered, patches = self.diagnosis.cover(self.beam.best, frame)
        poor = covered < rule.overlap * self.usual or patches > max(rule.patches, rule.more * self.usual_patches)
        self.poor = self.poor + 1 if poor else 0
        if not poor:
            self.usual += 0.05 * (covered - self.usual)
            self.usual_patches += 0.05 * (patches - self.usual_patches)
            self.patience = max(1, self.patience // 2)
        if self.settings.candidates != "subtree":
            return
        if returned or (self.poor >= rule.frames and self.at - self.searched >= self.patience):
            self._search_again(frame)
        elif self.at % rule.look == 0 or self.at == self.silhouettes.n_frames:
            self._look_again(frame)

    def _search_again(self, frame: Frame) -> None:
        """Search for the pose without the track."""
        rule, masks = self.restart, self.shrinker.unpack(frame)
        found = find_start(self.setup, frame, masks, near=self.beam.best)[0].pose
        self.searched = self.at
        if self._repair(frame, found, sure=True):
            self.poor, self.patience = 0, 1
            return
        self.patience = min(2 * self.patience + rule.frames, 10 * rule.frames)
        patches = self.diagnosis.cover(self.beam.line[-1].pose, frame)[1]
        self.usual_patches = max(self.usual_patches, patches / rule.more)

    def _look_again(self, frame: Frame) -> None:
        """Try the limbs of the best pose exchanged and elsewhere."""
        found = StartSearch(self.setup, frame, pool=self.beam.pool).look_again(self.beam.best)
        self._repair(frame, found, sure=False)

    def _repair(self, frame: Frame, found: FloatArray, *, sure: bool) -> bool:
        """Track back from a pose of the newest frame that fits clearly better, and take its track where it is better.

        Unless ``sure``, only if it fits as clearly in the mean of the last few frames. Returns whether it was taken.
        """
        rule, line = self.restart, self.beam.line[-self.restart.repaired :]
        gain = score_frames(self.setup, np.stack((found, line[-1].pose)), [frame, frame])
        if gain[0] - gain[1] < rule.gain:
            return False
        setup = self._make_setup(replace(self.settings, beam=1))
        frames = [settled.frame for settled in line]
        poses = np.array([settled.pose for settled in line])
        own = Replay(poses, score_frames(self.setup, poses, frames))
        if not sure:
            glance = replay(setup, found, frames[::-1][: rule.frames])
            if np.mean(glance.scores - own.scores[::-1][: rule.frames]) < rule.gain:
                return False
        back = replay(setup, found, frames[::-1])
        new = Replay(back.poses[::-1], back.scores[::-1])
        switch = min(choose_switch(self.setup, own, new), len(line) - 1)
        self.beam.replace_newest(new.poses[switch:])
        self.restarts.append(self.at - len(line) + switch)
        return True

    def _keep(self, pose: FloatArray, frame: Frame) -> None:
        self.poses.append(pose)
        self.diagnosis.write(pose, frame)
        if self.on_frame is not None:
            self._show(len(self.poses) - 1, pose, self.diagnosis.latest, settled=True)

    def _show_newest(self, frame: Frame) -> None:
        """Report the newest frame with its best pose, which may still change."""
        if self.on_frame is not None:
            pose = self.beam.best
            self._show(self.at - 1, pose, self.diagnosis.look(pose, frame), settled=False)

    def _show(self, number: int, pose: FloatArray, note: Note, *, settled: bool) -> None:
        assert self.on_frame is not None
        lost, occluded = self.diagnosis.is_lost(pose, note), note.visible < HIDDEN
        self.on_frame(TrackedFrame(number, pose, note.overlap, occluded, lost, settled, self.body))

    def _save(self) -> PartialTrack:
        state = self.beam.save()
        return PartialTrack(
            poses=np.array(self.poses).reshape(-1, 7 + self.body.n_angles),
            **self.diagnosis.arrays()._asdict(),
            restarts=np.array(self.restarts, np.int64),
            spheres=self.body.spheres,
            **{name: getattr(self, name) for name in ("first", "usual", "usual_patches", "area", "poor", "unseen")},
            **{field.name: getattr(state, field.name) for field in fields(state)},
        )

    def close(self) -> None:
        if hasattr(self, "beam"):
            self.beam.close()

    def finish(self) -> Estimate:
        """Smooth the poses and return the estimate."""
        rate = self.silhouettes.frame_rate
        poses = np.array(self.poses)
        notes, doubt = self.diagnosis.arrays(), self.diagnosis.judge(poses)
        if self.settings.smoothing > 0:
            poses = smooth_poses(poses, rate, self.settings.smoothing, breaks=self.restarts)
        return Estimate(
            body=self.body,
            poses=poses,
            frame_rate=rate,
            iou=notes.overlap,
            uncertainty=doubt.errors,
            occluded=notes.visible < HIDDEN,
            lost=doubt.lost,
            warnings=tuple(self._describe(doubt.lost)),
            frames_per_second=(self.at - self.began) / max(self.seconds, 1e-9),
        )

    def _describe(self, lost: NDArray[np.bool_]) -> list[Message]:
        notes = [*self.silhouettes.warnings, *self.notes]
        if self.first:
            notes.append(Message("tracker.first_frame", frame=self.first))
        if self.restarts:
            notes.append(Message("tracker.restarted", frames=self.restarts[:8]))
        if lost.any():
            notes.append(Message("tracker.lost", lost=int(lost.sum()), frames=len(lost), bound=1000 * LOST_ERROR))
        return notes


def smooth_poses(poses: FloatArray, frame_rate: float, cutoff: float, breaks: Sequence[int] = ()) -> FloatArray:
    """Smooth poses (T, 7 + A) with a Gaussian, orientations by the mean of quaternions of one sign.

    Parameters
    ----------
    poses : (T, 7 + A), see `BodyModel`.
    frame_rate : Hz.
    cutoff : Hz, where half of the power is left; ends are repeated.
    breaks : frames where the track was restarted; no smoothing across them.
    """
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff) * frame_rate
    smooth = np.array(poses, np.float64)
    quaternions = smooth[:, 3:7]
    for t in range(1, len(smooth)):
        if quaternions[t] @ quaternions[t - 1] < 0:
            quaternions[t] *= -1.0
    edges = [0, *sorted({int(frame) for frame in breaks if 0 < frame < len(smooth)}), len(smooth)]
    for start, stop in pairwise(edges):
        smooth[start:stop] = smooth_gaussian(smooth[start:stop], sigma)
    smooth[:, 3:7] /= np.linalg.norm(smooth[:, 3:7], axis=1, keepdims=True)
    return smooth
