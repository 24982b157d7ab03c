"""The search for the keypoints of the people in a film."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import OptionError
from dousa.estimation.keypoints.films import FilmFrames, read_ahead
from dousa.estimation.keypoints.keypoint_cache import KeypointCache, fingerprint_film
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES, PersonTrack, ViewKeypoints
from dousa.estimation.keypoints.people import SIGHTING, PeopleFollower, find_identities
from dousa.estimation.keypoints.pose_models import DETECTOR, LANDMARK_MODELS, LandmarkModel, find_pose_model, user_cache
from dousa.estimation.keypoints.pose_networks import N_BODY, LandmarkNetwork, PersonDetector
from dousa.messages import Message, Progress


def find_keypoints(
    film: str | os.PathLike[str],
    model: LandmarkModel = "full",
    *,
    most_people: int = 4,
    cache: bool | str | os.PathLike[str] = True,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ViewKeypoints:
    """Find the 33 points of `MEDIAPIPE_NAMES` and masks of the people in a film, most seen (long, large) first.

    Every person is followed in a crop placed by the last frame's landmarks; the detector runs for lost people and about
    twice a second. Identities are settled over the whole film (`people.find_identities`). The models must be installed
    (`dousa keypoints --install`). Results are cached, and an interrupted search continues. Without people there is a
    warning.

    Parameters
    ----------
    film : any format of FFmpeg, also turned or with an uneven frame rate.
    model : ``"lite"``, ``"full"`` or ``"heavy"``: the more precise the slower.
    most_people : followed at a time, 1 to 16.
    cache : True for the user's cache, another folder, or False for none.
    threads : for the networks; by default up to four.
    progress : called with (frames done, frames in all, what).

    Raises
    ------
    KeypointError : a model is not installed; the film is missing, damaged, or none.
    MissingExtraError : PyAV, LiteRT or OpenCV is not installed: ``pip install 'dousa[film]'``.
    OptionError : an unknown model, or an invalid number of people.

    Source: Bazarevsky and others, "BlazePose: On-device Real-time Body Pose tracking" (2020), and MediaPipe's graphs
    pose_detection and pose_landmark; but without smoothing, with a search for small people in parts of the image, and
    with other people painted over in a person's crop.
    """
    if model not in LANDMARK_MODELS:
        raise OptionError("keypoints.model", found=str(model), known=LANDMARK_MODELS)
    if not 1 <= most_people <= 16:
        raise OptionError("keypoints.most_people", most=16, found=most_people)
    report = progress or (lambda done, total, what: None)
    with FilmFrames(film) as frames:
        # version: of the method, raised when it finds other keypoints than before
        key = fingerprint_film(film, {"model": model, "people": most_people, "version": 1, "kept": SIGHTING.descr})
        folder = user_cache() / "keypoints" if cache is True else None if cache is False else Path(cache)
        kept = KeypointCache(folder, key)
        known = kept.load(frames.path)
        if known is None:
            for name in (DETECTOR, model):  # before the work, to report a missing model at once
                find_pose_model(name)
            follower = PeopleFollower(PersonDetector(threads), LandmarkNetwork(model, threads), most_people)
            known = _search(frames, follower, kept, report)
        return _with_warnings(known, frames, kept.n_damaged)


def _search(frames: FilmFrames, follower: PeopleFollower, kept: KeypointCache, report: Progress) -> ViewKeypoints:
    try:
        sightings, times = kept.open()
        n_done = len(times)
        if n_done:
            follower.resume(sightings, n_done - 1)
        del sightings
        what = Message("keypoints.finding", film=os.path.basename(frames.path))
        report(n_done, max(frames.n_stated, n_done), what)
        with read_ahead(frames.read(skip=n_done)) as pictures:
            for frame, seconds, picture in pictures:
                kept.add(seconds, follower.see(frame, picture))
                report(frame + 1, max(frames.n_stated, frame + 1), what)
        sightings, times = kept.read()
        people = find_identities(sightings, times)
        tracks = tuple(_make_track(sightings, rows, len(times)) for rows in people)
        found = ViewKeypoints(MEDIAPIPE_NAMES, tracks, times, frames.size, frames.path)
        return kept.finish(found, sightings, people, frames.n_damaged)
    finally:
        kept.leave()


def _make_track(sightings: NDArray[np.void], rows: IntArray, n_frames: int) -> PersonTrack:
    points: FloatArray = np.full((n_frames, N_BODY, 2), np.nan)
    world: FloatArray = np.full((n_frames, N_BODY, 3), np.nan)
    visibility: FloatArray = np.zeros((n_frames, N_BODY))
    frames = sightings["frame"][rows]
    points[frames] = sightings["points"][rows]
    world[frames] = sightings["world"][rows]
    visibility[frames] = np.clip(sightings["visibility"][rows], 0, 1)
    return PersonTrack(points, visibility, world)


def _with_warnings(found: ViewKeypoints, frames: FilmFrames, n_damaged: int) -> ViewKeypoints:
    warnings: list[Message] = []
    name = Path(frames.path).name
    if not found.people:
        warnings.append(Message("keypoints.nobody", film=name))
    if n_damaged:
        warnings.append(Message("keypoints.damaged", film=name, n=n_damaged))
    warnings += frames.note_lacking(name, found.n_frames)
    return replace(found, warnings=tuple(warnings))
