"""From silhouettes on the disk to a motion on the disk: ``dousa estimate`` without its options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pipelines.doubts import WatchedSilhouettes, describe_doubts, parse_frames
from dousa.app.pipelines.estimation_body import StartPose, check_start, choose_body, measure_body, read_start
from dousa.app.pipelines.estimation_output import check_outputs, write_outputs
from dousa.app.pipelines.estimation_views import (
    Scene,
    Watcher,
    choose_cameras,
    open_views,
    pictures_of,
    read_known_stature,
)
from dousa.app.pipelines.track_log import PartialFile, describe_files, fingerprint
from dousa.arrays import FloatArray
from dousa.errors import SilhouetteError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.estimation import BodyModel, Camera, Silhouettes
    from dousa.estimation.tracking.settings import Estimate
    from dousa.estimation.tracking.tracker import PartialTrack

_KEPT_BYTES = 200_000_000  # of masks for the drawings; to find those of a video again costs as much as tracking
_WATCHED_EVERY_S = 0.5  # between two states kept: who looks on stops the work when they have seen enough


@dataclass(frozen=True, slots=True, eq=False)
class Estimation:
    """An estimate and what was written of it.

    Parameters
    ----------
    estimate : the answer.
    views : (V,) names.
    body, start : where they came from.
    first_frame : of the sources, the estimate's first.
    resumed : frames that an interrupted run had done.
    outputs : files written.
    warnings : what a person should know.
    """

    estimate: Estimate
    views: tuple[str, ...]
    body: Message
    start: Message
    first_frame: int
    resumed: int
    outputs: tuple[Path, ...]
    warnings: tuple[Message, ...]

    def to_json(self) -> dict[str, Any]:
        """What ``dousa estimate --json`` prints."""
        answer = self.estimate.to_json()
        keys = ("n_frames", "frame_rate", "iou", "lost_frames", "frames_per_second", "expected_error_m")
        trusted = ~self.estimate.lost
        uncertainty = self.estimate.uncertainty[trusted] if trusted.any() else self.estimate.uncertainty
        return {
            **{key: answer[key] for key in keys},
            "views": list(self.views),
            "first_frame": self.first_frame,
            "body": str(self.body),
            "stature_m": self.estimate.body.stature,
            "start": str(self.start),
            "resumed_frames": self.resumed,
            "uncertainty_m": dict(
                zip(self.estimate.points.names, np.nanmean(uncertainty, axis=0).tolist(), strict=True)
            ),
            "outputs": [str(path) for path in self.outputs],
            "warnings": [str(warning) for warning in self.warnings],
        }


def estimate_files(
    request: EstimationRequest,
    progress: ProgressCallback | None = None,
    tell: Callable[[Message], None] | None = None,
    watcher: Watcher | None = None,
) -> Estimation:
    """Read silhouettes, cameras, body and start, track, and write what was asked for.

    Parameters
    ----------
    request : from what, how, and where to.
    progress : called with (done, total, what is being done).
    tell : called with what a person should know before the work begins, such as that it goes on where it stopped.
    watcher : is shown every frame as soon as it has a pose.

    Raises
    ------
    DousaError : what can be put right by the person who reads it; before the work where that can be known.
    """
    report = progress or (lambda done, total, what: None)
    check_outputs(request.outputs, request.inputs)
    require("cv2", "film")
    report(0, 1, Message("progress.opening"))
    with open_views(request, report) as opened:
        first, last = parse_frames(request.frames, opened.n_frames, Message("frames.recording"))
        views = WatchedSilhouettes(opened, first, last, _KEPT_BYTES if request.outputs.has_drawings else 0)
        cameras, notes = choose_cameras(request, views)
        given = None if request.start is None else read_start(request.start, request.options)
        known = read_known_stature(request.sources)
        if known is None and given is None and request.body is None and request.stature is None:
            body, body_words, more = measure_body(request.sex, cameras, views.read(0), report)
        else:
            body, body_words, more = choose_body(request, given, known)
        start, start_words, start_notes = _choose_start(given, body, views, cameras)
        notes = [*notes, *more, *start_notes]
        every = None if watcher is None else _WATCHED_EVERY_S
        kept = PartialFile(request.outputs.first, _fingerprint(request, cameras, body, start), every)
        try:
            done = _take_up(kept, views, tell)
            if watcher is not None:
                n_done = 0 if done is None else done.n_tracked
                watcher.begin(Scene(views.names, cameras, views.frame_rate, views.n_frames, n_done))
                views.show(watcher.see)
            estimate = _track(request, views, cameras, body, start, kept, done, report, watcher)
        except SilhouetteError as error:
            if not views.is_blank:
                raise  # an unreadable image, whose file is named
            raise SilhouetteError("estimate.sources", sources=request.sources, problem=error.located) from error
        notes += [
            *([kept.problem] if kept.problem else []),
            *views.warnings,
            *views.describe(),
            *estimate.warnings,
        ]
        notes += describe_doubts(estimate, body, views.names, cameras)
        written = write_outputs(
            request.outputs,
            estimate,
            views,
            cameras,
            lambda: pictures_of(request.sources, views, first, request.mirrored),
            report,
        )
    kept.remove()
    return Estimation(
        estimate,
        views.names,
        body_words,
        start_words,
        first,
        0 if done is None else len(done.poses),
        written,
        tuple(dict.fromkeys(notes)),
    )


def _choose_start(
    given: StartPose | None, body: BodyModel, views: Silhouettes, cameras: Sequence[Camera]
) -> tuple[FloatArray | None, Message, list[Message]]:
    if given is None:
        return None, Message("estimate.start_found"), []
    from dousa.estimation.body.posing import fit_pose

    pose, residual = fit_pose(body, given.positions)
    notes = list(given.warnings)
    doubt = check_start(body, pose, cameras, views.read(0), f"{given.file}:{given.frame}")
    if doubt is not None:
        notes.append(doubt)
    words = Message("estimate.start_given", path=given.file, frame=given.frame, off=1000 * residual)
    return pose, words, notes


def _fingerprint(
    request: EstimationRequest, cameras: Sequence[Camera], body: BodyModel, start: FloatArray | None
) -> str:
    import dousa

    return fingerprint(
        {
            "version": dousa.__version__,
            "files": describe_files((*request.sources, *request.backgrounds)),
            "method": [
                request.background_method,
                request.kind,
                request.rate,
                request.frames,
                request.mirrored,
            ],
            "cameras": [[camera.to_row(), camera.width, camera.height] for camera in cameras],
            "body": body,
            "start": start,
            "settings": request.settings,
        }
    )


def _take_up(
    kept: PartialFile, views: WatchedSilhouettes, tell: Callable[[Message], None] | None
) -> PartialTrack | None:
    """What an earlier run left of the same work; says so."""
    from dousa.estimation.tracking.tracker import PartialTrack

    done, note = kept.load(PartialTrack)
    if done is not None:
        note = Message("estimate.resumed", frame=done.n_tracked, total=views.n_frames)
    if note is not None and tell is not None:
        tell(note)
    return done


def _track(
    request: EstimationRequest,
    views: WatchedSilhouettes,
    cameras: Sequence[Camera],
    body: BodyModel,
    start: FloatArray | None,
    kept: PartialFile,
    done: PartialTrack | None,
    report: ProgressCallback,
    watcher: Watcher | None,
) -> Estimate:
    from dousa.estimation.tracking.tracker import estimate

    answer = estimate(
        views,
        cameras,
        body,
        start,
        settings=request.settings,
        resume=done,
        on_checkpoint=kept.save,
        progress=report,
        on_frame=None if watcher is None else watcher.follow,
    )
    if watcher is not None:
        views.show(None)
        watcher.end(answer)
    return answer
