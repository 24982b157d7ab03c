"""Estimate from films without preparation: find people, synchronise the films, place cameras, fit one person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.pipelines.film_sources import FilmSource, PairedSources, pair_sources, shows_masks
from dousa.app.studio.core.answers import shorten, to_message
from dousa.app.studio.jobs.lanes import Context
from dousa.errors import KeypointError, OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.pipelines.estimate import Estimation
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.app.studio.content.film_record import FilmRecordWriter, Track
    from dousa.app.studio.content.footage import FootageWriter
    from dousa.estimation import ViewKeypoints
    from dousa.estimation.multiview.people import MatchedPerson
    from dousa.estimation.tracking.settings import Estimate

CAMERAS = "cameras.toml"


def pair_films(sources: Sequence[Path], *, most: int = 8) -> PairedSources:
    """Pair the films of a batch with keypoints and masks; OptionError for two of one name, or more than ``most`` views:
    more would take hours of one processor."""
    paired = pair_sources(sources)
    if len(paired.views) > most:
        raise OptionError("studio_films.many", most=most, found=len(paired.views))
    return paired


def takes_films(request: dict[str, Any], asked: EstimationRequest, tell: Callable[[Message], object]) -> bool:
    """Whether keypoints are to be fitted: for films and their keypoints, unless masks are wanted.

    Where models are missing and there is a calibration, silhouettes will do; ``tell`` is called with that.
    """
    from dousa.app.pipelines.film_scene import has_models, is_films

    if request.get("cues") is not None:
        return request["cues"] in ("keypoints", "both")
    if not asked.sources or asked.kind == "mask" or asked.start is not None:
        return False
    views = pair_sources(asked.sources).views
    if any(view.has_keypoints for view in views):
        return True
    if not is_films(asked, views) or any(shows_masks(path) for path in asked.sources):
        return False
    if asked.cameras is None or has_models():
        return True
    tell(Message("film_estimate.models"))
    return False


def check_films(asked: EstimationRequest) -> PairedSources:
    """Return the views and masks; DousaError if a model, a package or the stature is missing."""
    from dousa.estimation.keypoints.pose_models import DETECTOR, choose_pose_model, find_pose_model

    paired = pair_films(asked.sources)
    if asked.mirrored:
        raise OptionError("film_estimate.mirrored")
    for view in paired.views:
        if view.film is not None:
            require("av", "film")
        if not view.has_keypoints:
            require("ai_edge_litert", "film")
            for name in (DETECTOR, asked.model or choose_pose_model()):
                find_pose_model(name)
    require("cv2", "film")
    if len(paired.views) > 1 and asked.cameras is None and asked.stature is None:
        raise OptionError("studio_films.no_stature")
    return paired


def estimate_from_films(
    request: dict[str, Any],
    asked: EstimationRequest,
    context: Context,
    footage: FootageWriter,
    tell: Callable[[Message], None],
) -> Estimation:
    """Estimate one person, and record everything that is found; DousaError for problems that the user can correct.

    Parameters
    ----------
    request : with ``person``, tracks of the person, and ``left_out``, tracks of nobody.
    asked : the same with real paths.
    context : of the job.
    footage : takes the motion.
    tell : called with what a person should know before the fit.
    """
    from dousa.app.pipelines.estimate import check_agreement, estimate_person, is_alone
    from dousa.app.pipelines.film_scene import place_films
    from dousa.app.studio.content.film_record import FilmRecordWriter
    from dousa.estimation.cameras.camera_files import write_cameras
    from dousa.estimation.multiview.people import match_people

    paired = check_films(asked)
    views = paired.views
    files = context.home / "files"
    named = [(view.name, None if view.film is None else view.film.relative_to(files).as_posix()) for view in views]
    left_out = [(int(view), int(track)) for view, track in request.get("left_out") or ()]
    wanted = [(int(view), int(track)) for view, track in request.get("person") or ()]
    record = FilmRecordWriter(context.folder, named, left_out)
    _show_films(views, record, context)
    found = _find_people(views, asked, context)
    record.find(found)
    kept, numbers = leave_out(found, left_out)
    heard = replace(asked, sources=paired.seen)  # films have sound, and a lens
    scene = place_films(heard, kept, context.progress, choose_who_places(kept, numbers, wanted))
    record.place(scene, found)
    people = match_people(scene.cameras, scene.list_people(), kept[0].names)
    if not people:
        raise KeypointError("multiview.nobody")
    chosen = choose_person(people, numbers, wanted)
    record.match(people, chosen, numbers)
    scene = replace(scene, warnings=(*scene.warnings, *check_agreement(scene, people)), masks=paired.masks)
    write_cameras(context.folder / CAMERAS, scene.cameras)
    asked = _without_empty_overlay(heard, paired, kept)
    watcher = _Watcher(footage, record)
    alone = is_alone(people)
    return estimate_person(asked, scene, people[chosen], context.progress, tell, watcher, alone=alone)


def _show_films(views: Sequence[FilmSource], record: FilmRecordWriter, context: Context) -> None:
    from dousa.app.studio.content.film_record import choose_stride, write_pictures
    from dousa.estimation.keypoints.films import FilmFrames

    films = [view.film for view in views if view.film is not None]
    if not films:
        return
    sizes, numbers, rates = [], [], []
    for film in films:
        with FilmFrames(film) as frames:
            sizes.append(frames.size)
            numbers.append(max(1, frames.n_stated))
            rates.append(frames.nominal_rate)
    if len(films) == len(views):
        record.begin(sizes, numbers, min(rates))
    for film in films:
        write_pictures(film, choose_stride(sum(numbers)), context.progress)
        record.show(film.relative_to(context.home / "files").as_posix())


def _find_people(views: Sequence[FilmSource], asked: EstimationRequest, context: Context) -> tuple[ViewKeypoints, ...]:
    from dousa.app.pipelines.film_scene import open_keypoints

    names = [view.name for view in views]
    found = open_keypoints([view.source for view in views], asked.model, context.progress, asked, names)
    for one in found:
        for note in one.warnings:
            context.tell(shorten(to_message(note), context.home))
    return found


def leave_out(
    found: Sequence[ViewKeypoints], left_out: Sequence[Track]
) -> tuple[tuple[ViewKeypoints, ...], list[list[int]]]:
    """Return the views without some tracks, and (V,) the earlier numbers of the remaining tracks."""
    kept, numbers = [], []
    for view, one in enumerate(found):
        own = [number for number in range(len(one.people)) if (view, number) not in left_out]
        kept.append(replace(one, people=tuple(one.people[number] for number in own)))
        numbers.append(own)
    return tuple(kept), numbers


def choose_who_places(
    kept: Sequence[ViewKeypoints], numbers: Sequence[Sequence[int]], wanted: Sequence[Track]
) -> list[int] | None:
    """Return the indices of the wanted person, whose stature is known, in all views; None if a view lacks them."""
    places = []
    for view, own in enumerate(numbers):
        mine = [place for place, number in enumerate(own) if (view, number) in wanted]
        if not mine:
            return None
        places.append(max(mine, key=lambda place: float(kept[view].people[place].visibility.sum())))
    return places


def choose_person(people: Sequence[MatchedPerson], numbers: Sequence[Sequence[int]], wanted: Sequence[Track]) -> int:
    """Return the index of the person with most of the wanted tracks; without any 0, the one seen most.

    Raises OptionError if no person has any of them.
    """
    if not wanted:
        return 0
    shared = [
        sum((view, numbers[view][own]) in wanted for view, some in enumerate(person.members) for own in some)
        for person in people
    ]
    if not any(shared):
        raise OptionError("studio_films.no_such_person")
    return shared.index(max(shared))


def _without_empty_overlay(
    asked: EstimationRequest, paired: PairedSources, found: Sequence[ViewKeypoints]
) -> EstimationRequest:
    """Return the request without overlay where there are neither films nor masks."""
    has_masks = bool(paired.masks) or any(person.masks is not None for view in found for person in view.people)
    if has_masks or all(view.film is not None for view in paired.views):
        return asked
    return replace(asked, outputs=replace(asked.outputs, overlay=None))


class _Watcher:
    """Records the motion and its doubts."""

    def __init__(self, footage: FootageWriter, record: FilmRecordWriter) -> None:
        self._footage, self._record = footage, record
        self.begin, self.see, self.follow = footage.begin, footage.see, footage.follow

    def end(self, estimate: Estimate) -> None:
        self._footage.end(estimate)
        self._record.fit(estimate)


def look_at_films(asked: EstimationRequest, context: Context, answer: dict[str, Any]) -> None:
    """Fill in the preview: the films with a picture of each, and what is missing."""
    from dousa.app.pipelines.film_scene import find_sizes
    from dousa.estimation.body.human import USUAL_STATURE

    views = pair_films(asked.sources).views
    for view, size in zip(views, find_sizes(asked.cameras, [view.name for view in views]), strict=True):
        answer["views"].append(_look_at_view(view, asked, size, answer))
    check_films(asked)
    if asked.cameras is not None:
        _match_cameras(asked, views, answer)
    elif len(views) == 1:
        answer["notes"].append(Message("studio_films.one_film"))
    answer["start"] = Message("estimate.start_keypoints")
    if asked.stature is not None:
        answer["body"] = Message("body.stature_given", stature=asked.stature)
    elif len(views) > 1:
        answer["body"] = Message("studio_films.body_of_cameras")
    else:
        answer["body"] = Message("body.assumed", stature=USUAL_STATURE)
        answer["notes"].append(Message("studio_films.one_film_stature"))


def _look_at_view(
    view: FilmSource, asked: EstimationRequest, usual: tuple[int, int] | None, answer: dict[str, Any]
) -> dict[str, Any]:
    from dousa.app.requests.estimation import parse_size
    from dousa.estimation import read_keypoints
    from dousa.estimation.keypoints.films import FilmFrames

    picture = None
    if view.film is not None:
        with FilmFrames(view.film) as film:
            size, n_frames, rate = film.size, film.n_stated, film.nominal_rate
        picture = _middle_picture(view.film, n_frames)
    if view.has_keypoints:
        given = None if asked.size is None else parse_size(asked.size)
        found = read_keypoints(view.source, size=given, frame_rate=asked.rate, usual_size=usual)
        size, n_frames, rate = found.size, found.n_frames, found.frame_rate
        answer["notes"] += found.warnings
    answer["n_frames"] = max(answer["n_frames"], n_frames)
    answer["frame_rate"] = rate if answer["frame_rate"] is None else min(answer["frame_rate"], rate)
    return {"name": view.name, "width": size[0], "height": size[1], "camera": None, "picture": picture}


def _middle_picture(film: Path, n_frames: int) -> str | None:
    from dousa.app.studio.content.film_record import to_picture_address
    from dousa.estimation.silhouettes.video import VideoFile

    file = VideoFile(film)
    try:
        image = file.read(min(n_frames, file.n_frames) // 2)
    finally:
        file.close()
    return None if image is None else to_picture_address(image, 320)  # px of a picture before the work


def _match_cameras(asked: EstimationRequest, views: Sequence[FilmSource], answer: dict[str, Any]) -> None:
    from dousa.estimation.cameras.camera import match_cameras
    from dousa.estimation.cameras.camera_files import read_cameras

    assert asked.cameras is not None
    matched, notes = match_cameras(read_cameras(asked.cameras), [view.name for view in views])
    answer["notes"] += notes
    for shown, camera in zip(answer["views"], matched, strict=True):
        shown["camera"] = camera.name
