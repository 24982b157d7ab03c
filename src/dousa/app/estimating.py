"""From silhouettes on the disk to a motion on the disk: ``dousa estimate`` without its options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app._estimation_body import choose_body, measure_body
from dousa.app._estimation_doubts import describe_doubts
from dousa.app._estimation_output import Outputs, check_outputs, write_outputs
from dousa.app._estimation_start import StartPose, check_start, read_start
from dousa.app._estimation_views import choose_cameras, open_views, read_known_stature
from dousa.app._estimation_watch import Scene, Watcher
from dousa.app._partial_track import PartialFile, describe_files, fingerprint
from dousa.app._video_pictures import pictures_of
from dousa.app._watched_silhouettes import WatchedSilhouettes, parse_frames
from dousa.errors import SilhouetteError
from dousa.library import ReadOptions

if TYPE_CHECKING:
    from dousa.app._output import ProgressCallback
    from dousa.estimation import BodyModel, Camera, Silhouettes
    from dousa.estimation._types import Estimate, TrackerSettings
    from dousa.estimation.tracker import PartialTrack

__all__ = ["Estimation", "Request", "estimate_files"]

FloatArray = NDArray[np.float64]

_KEPT_BYTES = (
    200_000_000  # of masks for the drawings; to find those of a video again costs as much as tracking
)
_WATCHED_EVERY_S = 0.5  # between two states kept: who looks on stops the work when they have seen enough


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be estimated from what.

    Parameters
    ----------
    sources : npz of silhouettes, or folders of masks, or videos; a view each, except for an npz of several.
    settings : of the tracker.
    outputs : files to write.
    cameras : calibration; None where the npz has the cameras in it.
    backgrounds : plates of the videos, in their order.
    background_method : ``"plate"``, ``"median"`` or ``"mog2"``; None lets the sources decide.
    kind : ``"mask"`` or ``"video"``: what videos and folders show; None lets the sources decide.
    rate : Hz of folders of images, and of videos that say it wrong.
    frames : ``A:B``, all by default.
    mirrored : the images are mirror images: left and right are exchanged before anything else, and the calibration
        is that of the images so exchanged.
    body, stature, sex : see `choose_body`.
    start : ``FILE:FRAME``; found by itself by default.
    bones : ``"tables"``; ``"start"``: as long as the joints of the start say; ``"auto"``, see `choose_body`.
    options : how motion files are read.
    """

    sources: tuple[Path, ...]
    settings: TrackerSettings
    outputs: Outputs = field(default_factory=Outputs)
    cameras: Path | None = None
    backgrounds: tuple[Path, ...] = ()
    background_method: str | None = None
    kind: str | None = None
    rate: float | None = None
    frames: str | None = None
    mirrored: bool = False
    body: Path | None = None
    stature: float | None = None
    sex: str = "average"
    start: str | None = None
    bones: str = "auto"
    options: ReadOptions = field(default_factory=ReadOptions)

    @property
    def inputs(self) -> tuple[Path, ...]:
        """All files that are read, of the start without its frame."""
        from dousa.app._estimation_start import parse_start

        start = () if self.start is None else (parse_start(self.start)[0],)
        optional = (self.cameras, self.body)
        return (*self.sources, *self.backgrounds, *(path for path in optional if path is not None), *start)


@dataclass(frozen=True, slots=True, eq=False)
class Estimation:
    """An estimate and what was written of it.

    Parameters
    ----------
    estimate : the answer.
    views : (V,) names.
    body, start : where they came from, in words.
    first_frame : of the sources, the estimate's first.
    resumed : frames that an interrupted run had done.
    outputs : files written.
    warnings : what a person should know, in sentences.
    """

    estimate: Estimate
    views: tuple[str, ...]
    body: str
    start: str
    first_frame: int
    resumed: int
    outputs: tuple[Path, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """What ``dousa estimate --json`` prints."""
        answer = self.estimate.to_json()
        keys = ("n_frames", "frame_rate", "iou", "lost_frames", "frames_per_second")
        trusted = ~self.estimate.lost
        uncertainty = self.estimate.uncertainty[trusted] if trusted.any() else self.estimate.uncertainty
        return {
            **{key: answer[key] for key in keys},
            "views": list(self.views),
            "first_frame": self.first_frame,
            "body": self.body,
            "stature_m": self.estimate.body.stature,
            "start": self.start,
            "resumed_frames": self.resumed,
            "uncertainty_m": dict(
                zip(self.estimate.points.names, np.nanmean(uncertainty, axis=0).tolist(), strict=True)
            ),
            "outputs": [str(path) for path in self.outputs],
            "warnings": list(self.warnings),
        }


def estimate_files(
    request: Request,
    progress: ProgressCallback | None = None,
    tell: Callable[[str], None] | None = None,
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
    report(0, 1, "opening")
    with open_views(request, report) as opened:
        first, last = parse_frames(request.frames, opened.n_frames, "the recording")
        views = WatchedSilhouettes(opened, first, last, _KEPT_BYTES if request.outputs.has_drawings else 0)
        cameras, notes = choose_cameras(request, views)
        said = None if request.start is None else read_start(request.start, request.options)
        known = read_known_stature(request.sources)
        if known is None and said is None and request.body is None and request.stature is None:
            body, body_words, more = measure_body(request.sex, cameras, views.read(0), report)
        else:
            body, body_words, more = choose_body(request, said, known)
        start, start_words, start_notes = _choose_start(said, body, views, cameras)
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
            raise SilhouetteError(f"{', '.join(map(str, request.sources))}: {error}") from error
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
    said: StartPose | None, body: BodyModel, views: Silhouettes, cameras: Sequence[Camera]
) -> tuple[FloatArray | None, str, list[str]]:
    """The pose of ``--start`` for this body; None where it is to be found."""
    if said is None:
        return None, "found", []
    from dousa.estimation.posing import fit_pose

    pose, residual = fit_pose(body, said.positions)
    notes = list(said.warnings)
    doubt = check_start(body, pose, cameras, views.read(0), f"{said.file}:{said.frame}")
    if doubt is not None:
        notes.append(doubt)
    return pose, f"{said.file}, frame {said.frame}, {1000 * residual:.0f} mm off its joints", notes


def _fingerprint(
    request: Request, cameras: Sequence[Camera], body: BodyModel, start: FloatArray | None
) -> str:
    """What tells whether a partial track is of this very work."""
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
    kept: PartialFile, views: WatchedSilhouettes, tell: Callable[[str], None] | None
) -> PartialTrack | None:
    """What an earlier run left of the same work; says so."""
    from dousa.estimation.tracker import PartialTrack

    done, note = kept.load(PartialTrack)
    if done is not None:
        note = f"going on at frame {done.n_tracked} of {views.n_frames}, where an earlier run was interrupted"
    if note is not None and tell is not None:
        tell(note)
    return done


def _track(
    request: Request,
    views: WatchedSilhouettes,
    cameras: Sequence[Camera],
    body: BodyModel,
    start: FloatArray | None,
    kept: PartialFile,
    done: PartialTrack | None,
    report: ProgressCallback,
    watcher: Watcher | None,
) -> Estimate:
    """Track, keeping now and then what is done."""
    from dousa.estimation.tracker import estimate

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
