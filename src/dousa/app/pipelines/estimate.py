"""From silhouettes or films on the disk to motions on the disk: ``dousa estimate`` without its options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pipelines.doubts import WatchedSilhouettes, describe_doubts, parse_frames
from dousa.app.pipelines.estimation_body import (
    StartPose,
    check_start,
    choose_body,
    load_given_body,
    measure_body,
    read_start,
)
from dousa.app.pipelines.estimation_output import check_outputs, write_outputs
from dousa.app.pipelines.estimation_views import Scene, Watcher, choose_cameras, open_views, read_known_stature
from dousa.app.pipelines.film_scene import (
    FilmScene,
    PersonSilhouettes,
    check_scenes,
    has_models,
    has_plates,
    is_films,
    open_films,
    open_plates,
    with_outputs,
)
from dousa.app.pipelines.film_sources import FilmSource, PairedSources, is_motion, pair_sources, shows_masks
from dousa.app.pipelines.projects import take_project
from dousa.app.pipelines.track_log import PartialFile, describe_files, fingerprint
from dousa.arrays import FloatArray
from dousa.errors import KeypointError, OptionError, SilhouetteError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.estimation import BodyModel, Camera, Silhouettes
    from dousa.estimation.multiview.keypoint_fit import KeypointFit, PartialFit
    from dousa.estimation.multiview.people import MatchedPerson
    from dousa.estimation.tracking.settings import Estimate
    from dousa.estimation.tracking.tracker import PartialTrack


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
        keys = "n_frames frame_rate iou lost_frames frames_per_second expected_error_m depth_spread_m lengths_m".split()
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
    kept_bytes: int = 200_000_000,
) -> Estimation:
    """Read silhouettes, cameras, body and start, track, and write what was asked for.

    Parameters
    ----------
    request : from what, how, and where to.
    progress : called with (done, total, what is being done).
    tell : called with what a person should know before the work begins, such as that it goes on where it stopped.
    watcher : is shown every frame as soon as it has a pose.
    kept_bytes : of masks for the drawings; to find those of a video again costs as much as tracking.

    Raises
    ------
    DousaError : what can be put right by the person who reads it; before the work where that can be known.
    """
    from dousa.estimation.tracking.tracker import PartialTrack

    report = progress or (lambda done, total, what: None)
    check_outputs(request.outputs, request.inputs)
    require("cv2", "film")
    report(0, 1, Message("progress.opening"))
    check_scenes(() if request.kind == "mask" else request.sources, report)
    with open_views(request, report) as opened:
        first, last = parse_frames(request.frames, opened.n_frames, Message("frames.recording"))
        views = WatchedSilhouettes(opened, first, last, kept_bytes if request.outputs.has_drawings else 0)
        cameras, notes = choose_cameras(request, views)
        given = None if request.start is None else read_start(request.start, request.options)
        known = read_known_stature(request.sources)
        if known is None and given is None and request.body is None and request.stature is None:
            body, body_words, more = measure_body(request.sex, cameras, views.read(0), report)
        else:
            body, body_words, more = choose_body(request, given, known)
        start, start_words, start_notes = _choose_start(given, body, views, cameras)
        notes = [*notes, *more, *start_notes]
        every = None if watcher is None else 0.5  # s: who looks on stops the work when they have seen enough
        kept = PartialFile(request.outputs.first, _fingerprint(request, cameras, body, start), every)
        try:
            done, note = kept.load(PartialTrack)
            if done is not None:
                note = Message("estimate.resumed", frame=done.n_tracked, total=views.n_frames)
            if note is not None and tell is not None:
                tell(note)
            estimate = _track(request, views, cameras, body, start, kept, done, report, watcher)
        except SilhouetteError as error:
            if not views.is_blank:
                raise  # an unreadable image, whose file is named
            raise SilhouetteError("estimate.sources", sources=request.sources, problem=error.located) from error
        notes += [*([kept.problem] if kept.problem else []), *views.warnings, *views.describe(), *estimate.warnings]
        notes += describe_doubts(estimate, body, views.names, cameras)
        written = write_outputs(request.outputs, estimate, views, cameras, report)
    kept.remove()
    resumed, warnings = 0 if done is None else len(done.poses), tuple(dict.fromkeys(notes))
    return Estimation(estimate, views.names, body_words, start_words, first, resumed, written, warnings)


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
            "method": [request.background_method, request.kind, request.rate, request.frames, request.mirrored],
            "cameras": [[camera.to_row(), camera.width, camera.height] for camera in cameras],
            "body": body,
            "start": start,
            "settings": request.settings,
        }
    )


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

    if watcher is not None:
        n_done = 0 if done is None else done.n_tracked
        watcher.begin(Scene(views.names, cameras, views.frame_rate, views.n_frames, n_done))
        views.show(watcher.see)
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


def estimate_sources(
    request: EstimationRequest,
    progress: ProgressCallback | None = None,
    tell: Callable[[Message], None] | None = None,
) -> tuple[Estimation, ...]:
    """Estimate from keypoints of films where that can be done, else from silhouettes.

    Parameters
    ----------
    request : from what, how, and where to; its ``cues`` choose, None takes keypoints for films.
    progress, tell : see `estimate_files`.

    Returns
    -------
    One estimate, or with ``everybody`` one for each person, the most seen first.

    Raises
    ------
    DousaError : what can be put right by the person who reads it.
    """
    for path in request.sources:
        if is_motion(path):
            raise OptionError("film_estimate.motion", path=path)
    request = take_project(request, tell)
    sources = pair_sources(request.sources)
    if _takes_keypoints(request, sources.views, tell):
        return estimate_films(request, sources, progress, tell)
    if sources.masks:
        request = replace(request, sources=sources.masks)
    for option, given in (("--person", request.person != 1), ("--everybody", request.everybody)):
        if given:
            raise OptionError("film_estimate.needs_keypoints", option=option)
    return (estimate_files(request, progress, tell),)


def _takes_keypoints(
    request: EstimationRequest, views: Sequence[FilmSource], tell: Callable[[Message], None] | None
) -> bool:
    films = is_films(request, views)
    if request.cues in ("keypoints", "both"):
        if not films:
            raise OptionError("film_estimate.no_films", cues=request.cues)
        return True
    if request.cues is None and films and any(view.has_keypoints for view in views):
        return True
    installed = has_models()
    if request.cues is None and films and not installed and request.cameras is None:
        raise OptionError("film_estimate.nothing_known")
    if request.cues is not None or not films or not (installed or (request.cameras and not has_plates(request))):
        return False
    if any(shows_masks(view.source) for view in views):
        return False
    if installed:
        return True
    if tell is not None:
        tell(Message("film_estimate.models"))
    return False


def estimate_films(
    request: EstimationRequest,
    sources: PairedSources,
    progress: ProgressCallback | None = None,
    tell: Callable[[Message], None] | None = None,
) -> tuple[Estimation, ...]:
    """Estimate the motions of people in films from their keypoints; ``sources`` are those of the request.

    Raises
    ------
    DousaError : what can be put right by the person who reads it.
    """
    from dousa.estimation.multiview.people import match_people

    report = progress or (lambda done, total, what: None)
    check_outputs(request.outputs, request.inputs)
    if request.mirrored:
        raise OptionError("film_estimate.mirrored")
    require("cv2", "film")
    films = open_films(request, sources, report)
    names = films.found[0].names
    people = match_people(films.cameras, films.list_people(), names)
    if not people:
        raise KeypointError("multiview.nobody")
    films = replace(films, warnings=(*films.warnings, *check_agreement(films, people)))
    aside: list[Message] = []
    if request.everybody:
        chosen, aside = list_everybody(people)
    else:
        if not 1 <= request.person <= len(people):
            raise OptionError("film_estimate.no_such_person", number=request.person, people=len(people))
        chosen = [(request.person, people[request.person - 1])]
        if len(people) > 1:
            aside = [Message("film_estimate.others", number=request.person, people=len(people))]
    answers = []
    for number, person in chosen:
        numbered = with_outputs(request, number) if request.everybody else request
        if numbered is not request:
            check_outputs(numbered.outputs, numbered.inputs)
        try:
            seen = replace(numbered, sources=sources.seen)
            answers.append(estimate_person(seen, films, person, report, tell, alone=is_alone(people)))
        except KeypointError:
            if not answers:
                raise
            # of people in the background too little is seen
    answers[0] = replace(answers[0], warnings=(*answers[0].warnings, *aside))
    return tuple(answers)


def list_everybody(
    people: Sequence[MatchedPerson], often: float = 0.55
) -> tuple[list[tuple[int, MatchedPerson]], list[Message]]:
    """List the people seen about as often as the most seen one, with their numbers; and a message on each other.

    Those seen in less than the share ``often`` of the pictures of the most seen one are in the background.
    """
    shares = [float(np.mean([0.0 if track is None else track.present.mean() for track in person.tracks]))
              for person in people]  # fmt: skip
    chosen, aside = [], []
    for number, (person, share) in enumerate(zip(people, shares, strict=True), 1):
        if share >= often * max(shares):
            chosen.append((number, person))
        else:
            aside.append(Message("film_estimate.aside", number=number, share=share))
    return chosen, aside


def is_alone(people: Sequence[MatchedPerson]) -> bool:
    """Whether at most one person is seen often."""
    return len(list_everybody(people)[0]) < 2


def check_agreement(films: FilmScene, people: Sequence[MatchedPerson], long: float = 0.5) -> list[Message]:
    """Find views that show a person for long where the other views see no person.

    ``long`` is the share of the film from which a person takes part and does not only walk past.

    Raises
    ------
    KeypointError : no two views agree, though several show a person.
    """
    agreed = [person for person in people if sum(track is not None for track in person.tracks) > 1]
    alone = []
    for view, (name, tracks) in enumerate(zip(films.names, films.list_people(), strict=True)):
        claimed = any(person.tracks[view] is not None for person in agreed)
        if not claimed and any(track.present.mean() > long for track in tracks):
            alone.append(name)
    if not agreed and len(alone) > 1:
        raise KeypointError("film_estimate.disagree", views=alone)
    return [Message("film_estimate.left_out", views=alone, n=len(alone))] if agreed and alone else []


def estimate_person(
    request: EstimationRequest,
    films: FilmScene,
    person: MatchedPerson,
    report: ProgressCallback,
    tell: Callable[[Message], None] | None = None,
    watcher: Watcher | None = None,
    *,
    alone: bool = True,
) -> Estimation:
    """Estimate the motion of one person of films, and write its files.

    Parameters
    ----------
    request : its body, stature and outputs.
    films : on one clock.
    person : of `match_people`.
    report, tell : see `estimate_files`; ``report`` is not None.
    watcher : sees the scene and the estimate.
    alone : whether the films show nobody else: what is not background is then the person.

    Raises
    ------
    KeypointError : too little is seen of the person.
    """
    from dousa.estimation.multiview.keypoint_fit import PartialFit, fit_some_girths

    if request.body is not None and request.stature is not None:
        raise OptionError("estimate.body_and_stature")
    given, notes = (None, ()) if request.body is None else load_given_body(request.body, request.options)
    plates = open_plates(request, films, report) if alone else ()
    silhouettes = PersonSilhouettes(films, person.members, request.sources, plates)
    if request.cues == "both" and not silhouettes.has_masks:
        raise OptionError("film_estimate.no_masks")
    kept = PartialFile(request.outputs.first, _fingerprint_person(request, films, person, given))
    done, note = kept.load(PartialFit)
    resumed = 0 if done is None else len(done.poses)
    if tell is not None and done is not None:
        tell(Message("estimate.resumed", frame=resumed, total=len(films.moments)))
    fit = _fit_person(request, films, person, given, silhouettes, report, kept, done)
    cameras, estimate = silhouettes.fit_cameras(films.cameras), fit.estimate
    if silhouettes.has_masks:
        if request.cues == "keypoints":
            body = fit_some_girths(estimate.body, estimate.poses, silhouettes, films.cameras)
            estimate = replace(estimate, body=body)
        estimate = measure_overlap(estimate, silhouettes, cameras)
    warnings = [*films.warnings, *silhouettes.warnings, *notes, *(text for text in (note, kept.problem) if text)]
    if (has_plates(request) or films.masks) and not plates:
        warnings.append(Message("film_estimate.plates_unused"))
    warnings += describe_fit(fit, films.cameras, request.stature is not None)
    warnings += describe_doubts(estimate, estimate.body, films.names, cameras)
    if watcher is not None:
        watcher.begin(Scene(films.names, cameras, films.frame_rate, estimate.n_frames, 0))
        watcher.end(estimate)
    with silhouettes:
        written = write_outputs(request.outputs, estimate, silhouettes, cameras, report)
    kept.remove()
    words = _body_words(request, estimate)
    return Estimation(estimate, films.names, words, Message("estimate.start_keypoints"), films.first_frame, resumed,
                      written, tuple(dict.fromkeys(warnings)))  # fmt: skip


def _fit_person(
    request: EstimationRequest,
    films: FilmScene,
    person: MatchedPerson,
    body: BodyModel | None,
    silhouettes: PersonSilhouettes,
    report: ProgressCallback,
    kept: PartialFile,
    done: PartialFit | None,
) -> KeypointFit:
    from dousa.estimation.multiview.keypoint_fit import fit_keypoints

    return fit_keypoints(
        films.cameras,
        person.tracks,
        films.found[0].names,
        films.frame_rate,
        body=body,
        stature=request.stature,
        sex=request.sex,
        silhouettes=silhouettes if silhouettes.has_masks and request.cues != "keypoints" else None,
        progress=report,
        resume=done,
        on_checkpoint=kept.save,
    )


def _fingerprint_person(
    request: EstimationRequest, films: FilmScene, person: MatchedPerson, body: BodyModel | None
) -> str:
    import dousa

    tracks = [[] if track is None else [track.points, track.visibility, track.world] for track in person.tracks]
    return fingerprint(
        {
            "version": dousa.__version__,
            "files": describe_files((*request.sources, *request.backgrounds, *films.masks)),
            "cameras": [[camera.to_row(), camera.width, camera.height] for camera in films.cameras],
            "keypoints": [list(films.found[0].names), films.moments, films.offsets, tracks],
            "body": [request.stature, request.sex, request.cues, request.background_method, request.kind, request.rate],
            "given": [] if body is None else [body],
        }
    )


def _body_words(request: EstimationRequest, estimate: Estimate) -> Message:
    if request.body is not None:
        return Message("text.verbatim", text=request.body)
    if request.stature is not None:
        return Message("body.stature_given", stature=request.stature)
    if len(request.sources) == 1:
        return Message("body.assumed", stature=round(estimate.body.stature, 2))
    stature, spread = estimate.lengths["stature"]
    return Message("body.of_keypoints", stature=stature, spread=spread)


def measure_overlap(
    estimate: Estimate, silhouettes: PersonSilhouettes, cameras: Sequence[Camera], count: int = 600
) -> Estimate:
    """Measure the overlap of the body and the person's masks in ``count`` frames spread over the film."""
    from dousa.estimation.raster.rasteriser import draw_body

    overlap = np.full((estimate.n_frames, silhouettes.n_views), np.nan)
    for frame in np.unique(np.linspace(0, estimate.n_frames - 1, count).astype(int)):
        for view, mask in enumerate(silhouettes.read(int(frame))):
            if mask is not None and mask.any():
                drawn = draw_body(estimate.body, estimate.poses[frame][None], cameras[view])[0]
                overlap[frame, view] = (drawn & mask).sum() / max(1, (drawn | mask).sum())
    return replace(estimate, iou=overlap)


def describe_fit(
    fit: KeypointFit,
    cameras: Sequence[Camera],
    stature_given: bool,
    poor: float = 0.025,
    far: float = 0.085,
) -> list[Message]:
    """Describe doubts about the fit.

    Parameters
    ----------
    fit, cameras : what was found, from what.
    stature_given : whether the scale is known.
    poor : of a person's height in the picture, median reprojection that tells of a wrong calibration.
    far : the same of the worst tenth of its points; 0.01 to 0.08 with right cameras (docs/estimation.md).
    """
    from dousa.estimation.body.human import USUAL_STATURE

    warnings = []
    n_views = int(fit.seen.seen.any(axis=(1, 2)).sum())
    exchanged = int(fit.exchanged.any(axis=(0, 2)).sum())
    if exchanged:
        warnings.append(Message("film_estimate.exchanged", frames=exchanged, total=fit.estimate.n_frames))
    heights = [np.ptp(points[np.isfinite(points[:, :, 1]).all(axis=1)][..., 1], axis=1).mean()
               if np.isfinite(points[:, :, 1]).all(axis=1).any() else np.nan for points in fit.seen.points]  # fmt: skip
    for camera, errors, height in zip(cameras, fit.errors, heights, strict=True):
        if np.isfinite(errors).any() and np.nanmedian(errors) > poor * height:
            warnings.append(Message("film_estimate.off", view=camera.name, error=float(np.nanmedian(errors)),
                                share=float(np.nanmedian(errors) / height)))  # fmt: skip
        elif np.isfinite(errors).any() and (worst := float(np.nanpercentile(errors, 90))) > far * height:
            warnings.append(Message("film_estimate.far_off", view=camera.name, error=worst, share=worst / height))
    stature = fit.estimate.body.stature
    if n_views > 1 and not stature_given and not 1.4 < stature < 2.05:
        warnings.append(Message("film_estimate.odd_stature", stature=stature))
    if n_views == 1:
        spread = fit.estimate.depth_spread
        assert spread is not None
        warnings.append(Message("film_estimate.one_view", doubt=float(np.median(spread))))
        if not stature_given:
            warnings.append(Message("body.stature_assumed", stature=USUAL_STATURE))
    absent = ~fit.seen.seen.any(axis=(0, 2))
    if absent.any():
        warnings.append(Message("film_estimate.absent", frames=int(absent.sum()), total=fit.estimate.n_frames))
    lost = int((fit.estimate.lost & ~absent).sum())
    if lost:
        warnings.append(Message("film_estimate.lost", lost=lost, frames=fit.estimate.n_frames))
    return warnings
