"""From films with nothing prepared to motions: keypoints, who is who, and a motion of each person wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.pipelines.doubts import describe_doubts
from dousa.app.pipelines.estimate import Estimation, estimate_files
from dousa.app.pipelines.estimation_output import check_outputs, write_outputs
from dousa.app.pipelines.estimation_views import Scene, Watcher
from dousa.app.pipelines.film_scene import (
    FilmScene,
    PersonSilhouettes,
    has_models,
    is_films,
    open_films,
    open_pictures,
    shows_masks,
    with_outputs,
)
from dousa.errors import KeypointError, OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.estimation import BodyModel, Camera
    from dousa.estimation.multiview.keypoint_fit import KeypointFit
    from dousa.estimation.multiview.people import MatchedPerson
    from dousa.estimation.tracking.settings import Estimate

_GIRTH_FRAMES, _OVERLAP_FRAMES = 12, 600
_POOR_PIXELS = 0.025  # of a person's height in the picture: reprojection that tells of a wrong calibration
_FAR_PIXELS = 0.085  # the same of the worst tenth of its points; 0.01 to 0.08 with right cameras (docs/estimation.md)
_USUAL_STATURES = (1.4, 2.05)  # m
_DEPTH_DOUBT = 0.08  # m
_OFTEN = 0.55  # of the pictures in which the most seen person is seen: those seen less often are in the background
_LONG = 0.5  # share of the film from which a person takes part and does not only walk past

Tell = Callable[[Message], None]


def estimate_sources(
    request: EstimationRequest,
    progress: ProgressCallback | None = None,
    tell: Tell | None = None,
    watcher: Watcher | None = None,
) -> tuple[Estimation, ...]:
    """Estimate from keypoints of films where that can be done, else from silhouettes.

    Parameters
    ----------
    request : from what, how, and where to; its ``cues`` choose, None takes keypoints for films.
    progress, tell, watcher : see `estimate_files`.

    Returns
    -------
    One estimate, or with ``everybody`` one for each person, the most seen first.

    Raises
    ------
    DousaError : what can be put right by the person who reads it.
    """
    if _takes_keypoints(request, tell):
        return estimate_films(request, progress, watcher)
    for option, given in (("--person", request.person != 1), ("--everybody", request.everybody)):
        if given:
            raise OptionError("film_estimate.needs_keypoints", option=option)
    return (estimate_files(request, progress, tell, watcher),)


def _takes_keypoints(request: EstimationRequest, tell: Tell | None) -> bool:
    films = is_films(request)
    if request.cues == "keypoints":
        if not films:
            raise OptionError("film_estimate.no_films")
        return True
    installed = has_models()
    if request.cues is not None or not films or (request.cameras is None and not installed):
        return False
    if any(shows_masks(path) for path in request.sources):
        return False
    if installed:
        return True
    if tell is not None:
        tell(Message("film_estimate.models"))
    return False


def estimate_films(
    request: EstimationRequest, progress: ProgressCallback | None = None, watcher: Watcher | None = None
) -> tuple[Estimation, ...]:
    """Estimate the motions of people in films from their keypoints.

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
    films = open_films(request, report)
    names = films.found[0].names
    people = match_people(films.cameras, films.list_people(), names)
    if not people:
        raise KeypointError("multiview.nobody")
    films = replace(films, warnings=(*films.warnings, *check_agreement(films, people)))
    aside: list[Message] = []
    if request.everybody:
        chosen, aside = list_everybody(people)
    else:
        chosen = [(request.person, _pick(people, request.person))]
    answers = []
    for number, person in chosen:
        numbered = with_outputs(request, number) if request.everybody else request
        if numbered is not request:
            check_outputs(numbered.outputs, numbered.inputs)
        try:
            answers.append(estimate_person(numbered, films, person, report, watcher))
        except KeypointError:
            if not answers:
                raise
            # of people in the background too little is seen
    answers[0] = replace(answers[0], warnings=(*answers[0].warnings, *aside))
    return tuple(answers)


def list_everybody(people: Sequence[MatchedPerson]) -> tuple[list[tuple[int, MatchedPerson]], list[Message]]:
    """List the people seen about as often as the most seen one, with their numbers; and a message on each other."""
    shares = [float(np.mean([0.0 if track is None else track.present.mean() for track in person.tracks]))
              for person in people]  # fmt: skip
    chosen, aside = [], []
    for number, (person, share) in enumerate(zip(people, shares, strict=True), 1):
        if share >= _OFTEN * max(shares):
            chosen.append((number, person))
        else:
            aside.append(Message("film_estimate.aside", number=number, share=share))
    return chosen, aside


def check_agreement(films: FilmScene, people: Sequence[MatchedPerson]) -> list[Message]:
    """Find views that show a person for long where the other views see no person.

    Raises
    ------
    KeypointError : no two views agree, though several show a person.
    """
    agreed = [person for person in people if sum(track is not None for track in person.tracks) > 1]
    alone = []
    for view, (name, tracks) in enumerate(zip(films.names, films.list_people(), strict=True)):
        claimed = any(person.tracks[view] is not None for person in agreed)
        if not claimed and any(track.present.mean() > _LONG for track in tracks):
            alone.append(name)
    if not agreed and len(alone) > 1:
        raise KeypointError("film_estimate.disagree", views=alone)
    return [Message("film_estimate.left_out", views=alone, n=len(alone))] if agreed and alone else []


def _pick(people: Sequence[MatchedPerson], number: int) -> MatchedPerson:
    if not 1 <= number <= len(people):
        raise OptionError("film_estimate.no_such_person", number=number, people=len(people))
    return people[number - 1]


def estimate_person(
    request: EstimationRequest,
    films: FilmScene,
    person: MatchedPerson,
    report: ProgressCallback,
    watcher: Watcher | None,
) -> Estimation:
    """Estimate the motion of one person of films, and write its files.

    Parameters
    ----------
    request : its body, stature and outputs.
    films : on one clock.
    person : of `match_people`.
    report : called with (done, total, what).
    watcher : sees the scene and the estimate.

    Raises
    ------
    KeypointError : too little is seen of the person.
    """
    from dousa.app.pipelines.estimation_body import load_given_body
    from dousa.estimation.multiview.keypoint_fit import fit_keypoints

    if request.body is not None and request.stature is not None:
        raise OptionError("estimate.body_and_stature")
    given, notes = (None, ()) if request.body is None else load_given_body(request.body, request.options)
    fit = fit_keypoints(
        films.cameras,
        person.tracks,
        films.found[0].names,
        films.frame_rate,
        body=given,
        stature=request.stature,
        sex=request.sex,
        progress=report,
    )
    silhouettes = PersonSilhouettes(films, person.members)
    cameras = silhouettes.fit_cameras(films.cameras)
    estimate = add_overlap(fit.estimate, silhouettes, cameras)
    warnings = [*films.warnings, *notes, *describe_fit(fit, films.cameras, request.stature is not None)]
    warnings += describe_doubts(estimate, estimate.body, films.names, cameras)
    if watcher is not None:
        watcher.begin(Scene(films.names, cameras, films.frame_rate, estimate.n_frames, 0))
        watcher.end(estimate)
    written = write_outputs(
        request.outputs,
        estimate,
        silhouettes,
        cameras,
        lambda: open_pictures(request.sources, silhouettes),
        report,
    )
    words = _body_words(request, estimate.body)
    return Estimation(estimate, films.names, words, Message("estimate.start_keypoints"), films.first_frame, 0, written,
                      tuple(dict.fromkeys(warnings)))  # fmt: skip


def _body_words(request: EstimationRequest, body: BodyModel) -> Message:
    from dousa.estimation.multiview.keypoint_fit import STATURE_SHARE

    if request.body is not None:
        return Message("text.verbatim", text=request.body)
    if request.stature is not None:
        return Message("body.stature_given", stature=request.stature)
    if len(request.sources) == 1:
        return Message("body.assumed", stature=round(body.stature, 2))
    return Message("body.of_keypoints", stature=body.stature, spread=STATURE_SHARE * body.stature)


def add_overlap(estimate: Estimate, silhouettes: PersonSilhouettes, cameras: Sequence[Camera]) -> Estimate:
    """Fit the body's girths to the person's masks, and measure the overlap in frames spread over the film."""
    from dousa.errors import DousaError
    from dousa.estimation.raster.rasteriser import draw_body
    from dousa.estimation.tracking.measures import fit_girths

    if not silhouettes.has_masks:
        return estimate
    good = np.flatnonzero(~estimate.lost)
    body = estimate.body
    if len(good):
        frames = good[np.unique(np.linspace(0, len(good) - 1, _GIRTH_FRAMES).astype(int))]
        read = [silhouettes.read(int(frame)) for frame in frames]
        shown = [view for view in range(silhouettes.n_views) if all(masks[view] is not None for masks in read)]
        if shown:
            stacked = [np.stack([masks[view] for masks in read]) for view in shown]  # type: ignore[misc]
            try:
                body = fit_girths(body, estimate.poses[frames], stacked, [cameras[view] for view in shown])
            except DousaError:
                body = estimate.body
    overlap = np.full((estimate.n_frames, silhouettes.n_views), np.nan)
    for frame in np.unique(np.linspace(0, estimate.n_frames - 1, _OVERLAP_FRAMES).astype(int)):
        for view, mask in enumerate(silhouettes.read(int(frame))):
            if mask is not None and mask.any():
                drawn = draw_body(body, estimate.poses[frame][None], cameras[view])[0]
                overlap[frame, view] = (drawn & mask).sum() / max(1, (drawn | mask).sum())
    return replace(estimate, body=body, iou=overlap)


def describe_fit(fit: KeypointFit, cameras: Sequence[Camera], stature_given: bool) -> list[Message]:
    """Describe doubts about the fit."""
    warnings = []
    n_views = int(fit.seen.seen.any(axis=(1, 2)).sum())
    exchanged = int(fit.exchanged.any(axis=(0, 2)).sum())
    if exchanged:
        warnings.append(Message("film_estimate.exchanged", frames=exchanged, total=fit.estimate.n_frames))
    heights = [np.ptp(points[np.isfinite(points[:, :, 1]).all(axis=1)][..., 1], axis=1).mean()
               if np.isfinite(points[:, :, 1]).all(axis=1).any() else np.nan for points in fit.seen.points]  # fmt: skip
    for camera, errors, height in zip(cameras, fit.errors, heights, strict=True):
        if np.isfinite(errors).any() and np.nanmedian(errors) > _POOR_PIXELS * height:
            warnings.append(Message("film_estimate.off", view=camera.name, error=float(np.nanmedian(errors)),
                                share=float(np.nanmedian(errors) / height)))  # fmt: skip
        elif np.isfinite(errors).any() and (far := float(np.nanpercentile(errors, 90))) > _FAR_PIXELS * height:
            warnings.append(Message("film_estimate.far_off", view=camera.name, error=far, share=far / height))
    stature = fit.estimate.body.stature
    if n_views > 1 and not stature_given and not _USUAL_STATURES[0] < stature < _USUAL_STATURES[1]:
        warnings.append(Message("film_estimate.odd_stature", stature=stature))
    if n_views == 1:
        unsure = int((fit.depth_doubt > _DEPTH_DOUBT).sum())
        doubt = float(np.median(fit.depth_doubt))
        warnings.append(Message("film_estimate.one_view", doubt=doubt, frames=unsure, total=fit.estimate.n_frames))
        if not stature_given:
            warnings.append(Message("body.stature_assumed", stature=1.72))
    absent = ~fit.seen.seen.any(axis=(0, 2))
    if absent.any():
        warnings.append(Message("film_estimate.absent", frames=int(absent.sum()), total=fit.estimate.n_frames))
    lost = int((fit.estimate.lost & ~absent).sum())
    if lost:
        warnings.append(Message("film_estimate.lost", lost=lost, frames=fit.estimate.n_frames))
    return warnings
