"""The films of an estimate: keypoints of each, on one clock, a camera each; people's masks as silhouettes."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from dousa.app.pipelines.doubts import parse_frames
from dousa.app.pipelines.estimation_views import check_count, read_view_cameras
from dousa.app.pipelines.film_sources import FilmSource, PairedSources, is_keypoints, name_films, shows_masks
from dousa.arrays import FloatArray, Image, IndexArray, Mask, nearest_frames
from dousa.errors import CalibrationError, KeypointError, OptionError
from dousa.estimation.silhouettes.silhouettes import Silhouettes, View
from dousa.messages import Message

if TYPE_CHECKING:
    from concurrent.futures import Future

    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.estimation import Camera, PersonMasks, PersonTrack, ViewKeypoints
    from dousa.estimation.keypoints.pose_models import LandmarkModel
    from dousa.estimation.silhouettes.video import VideoFile
    from dousa.estimation.sync.sound import Sound


_FOCAL_35 = ("focal_length.35mm", "focallengthin35mm")
_FRAME_35 = 36.0  # mm, by definition the longer side of a 35 mm picture


class PictureFacts(Protocol):
    """What is known of the pictures of keypoints: Hz, size as ``WxH`` px, and a calibration whose sizes are theirs."""

    @property
    def rate(self) -> float | None: ...
    @property
    def size(self) -> str | None: ...
    @property
    def cameras(self) -> Path | None: ...


def open_keypoints(
    paths: Sequence[Path],
    model: LandmarkModel | None,
    progress: ProgressCallback,
    known: PictureFacts | None = None,
    names: Sequence[str] | None = None,
) -> tuple[ViewKeypoints, ...]:
    """Find the keypoints of films, or read files of keypoints; of each the source is its name.

    Parameters
    ----------
    paths : films, or files of keypoints (npz of dousa, or what other programs write).
    model : by which keypoints are found in films; None for the most precise that is installed.
    progress : called with (done, total, what).
    known : what files of keypoints do not state.
    names : of the films; by default those of `name_films`.

    Raises
    ------
    KeypointError : a source that is missing or damaged, a model that is not installed, no size of the pictures.
    CalibrationError : no calibration, or no camera for a view; a film with a cut, or of a camera that moves.
    OptionError : one film is given twice, a rate or size that is none.
    """
    from dousa.app.requests.estimation import parse_size
    from dousa.estimation import read_keypoints
    from dousa.estimation.cameras.steadiness import check_steady
    from dousa.estimation.keypoints.keypoint_files import count_views

    rate, size, cameras = (None, None, None) if known is None else (known.rate, known.size, known.cameras)
    if rate is not None and not 0 < rate < np.inf:
        raise OptionError("films.rate", found=rate)
    given = None if size is None else parse_size(size)
    counts = list(map(count_views, paths))
    names = _name_views(names or name_films(paths), counts, cameras)
    usual = find_sizes(cameras if any(map(is_keypoints, paths)) else None, names)
    filmed = [path for path in paths if not is_keypoints(path)]
    for path in filmed:
        check_steady(path, progress)
    films = _find_all(filmed, model, progress)
    places = [(path, view) for path, count in zip(paths, counts, strict=True) for view in range(count)]
    views = [
        read_keypoints(path, size=given, frame_rate=rate, usual_size=own, view=view)
        if is_keypoints(path)
        else next(films)
        for (path, view), own in zip(places, usual, strict=True)
    ]
    return tuple(replace(found, source=name) for found, name in zip(views, names, strict=True))


def _name_views(names: Sequence[str], counts: Sequence[int], cameras: Path | None) -> tuple[str, ...]:
    """Name the views: by their files; those of one file by the cameras, in whose order they are, else by numbers."""
    from dousa.estimation.cameras.camera_files import read_cameras

    if len(names) == 1 and counts[0] > 1 and cameras is not None:
        found = tuple(camera.name for camera in read_cameras(cameras))
        if len(found) == counts[0]:
            return found
    return tuple(
        name if count == 1 else f"{name}_{number}"
        for name, count in zip(names, counts, strict=True)
        for number in range(1, count + 1)
    )


def find_sizes(cameras: Path | None, names: Sequence[str]) -> list[tuple[int, int] | None]:
    """The size (px) of the pictures of each view's camera (V,); None without a calibration.

    Raises
    ------
    CalibrationError : no calibration, or no camera for a view.
    """
    from dousa.estimation.cameras.camera import match_cameras
    from dousa.estimation.cameras.camera_files import read_cameras

    if cameras is None:
        return [None] * len(names)
    found = read_cameras(cameras)
    check_count(cameras, found, names)
    return [camera.size for camera in match_cameras(found, names)[0]]


class _GivenUpError(Exception):
    """Another film has failed, or the work was interrupted."""


def _find_all(
    films: Sequence[Path], model: LandmarkModel | None, progress: ProgressCallback
) -> Iterator[ViewKeypoints]:
    """The keypoints of films, several at a time: one is decoded while the networks look at another."""
    from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

    from dousa.estimation import find_keypoints
    from dousa.estimation.keypoints.pose_models import choose_pose_model

    chosen, cores = (model or choose_pose_model()) if films else "full", os.cpu_count() or 1
    if len(films) < 2:
        return iter([find_keypoints(film, chosen, progress=progress) for film in films])
    at_a_time = min(len(films), cores)
    counts, stop = [(0, 0)] * len(films), threading.Event()
    texts: list[Message | str] = [""] * len(films)

    def find(place: int) -> ViewKeypoints:
        def note(done: int, total: int, what: Message | str) -> None:
            if stop.is_set():
                raise _GivenUpError
            counts[place], texts[place] = (done, total), what

        return find_keypoints(films[place], chosen, threads=max(1, cores // at_a_time), progress=note)

    with ThreadPoolExecutor(at_a_time) as pool:
        jobs = [pool.submit(find, place) for place in range(len(films))]
        try:
            while wait(jobs, 0.1, FIRST_EXCEPTION).not_done and not _find_failed(jobs):
                busy = next((place for place, (done, total) in enumerate(counts) if done < total), None)
                if busy is not None:  # from the thread that asked, which its progress callback may stop
                    progress(sum(done for done, _ in counts), sum(total for _, total in counts), texts[busy])
        finally:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
    return iter([job.result() for job in _find_failed(jobs) or jobs])


def _find_failed(jobs: Sequence[Future[ViewKeypoints]]) -> list[Future[ViewKeypoints]]:
    ended = [job for job in jobs if job.done() and not job.cancelled() and job.exception() is not None]
    return [job for job in ended if not isinstance(job.exception(), _GivenUpError)]


def read_sounds(paths: Sequence[Path]) -> list[Sound | None]:
    """The sound of each film; None for files of keypoints and films without."""
    from dousa.estimation.keypoints.keypoint_files import count_views
    from dousa.estimation.sync.sound import read_sound

    return [None if is_keypoints(path) else read_sound(path) for path in paths for _ in range(count_views(path))]


def read_focal_length(path: Path, size: tuple[int, int]) -> float | None:
    """Read the focal length (px) that a film states for a 35 mm camera, as phones do; None where it does not.

    Parameters
    ----------
    path : a film, or keypoints, which state nothing.
    size : px, of its pictures.
    """
    from importlib.util import find_spec

    if is_keypoints(path) or find_spec("av") is None:
        return None
    import av

    try:
        with av.open(str(path)) as container:
            tags = [container.metadata, *(stream.metadata for stream in container.streams)]
    except (av.error.FFmpegError, OSError, ValueError):
        return None
    for key, value in (item for tag in tags for item in tag.items()):
        if any(word in key.lower() for word in _FOCAL_35):
            try:
                focal = float(value)
            except ValueError:
                continue
            if 5.0 < focal < 1000.0:
                return focal / _FRAME_35 * max(size)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class FilmScene:
    """Films on one clock.

    Parameters
    ----------
    names : (V,) of the views.
    found : (V,) keypoints of each film.
    cameras : (V,) of the size of the films' pictures.
    frame_rate : Hz of the common clock.
    moments : (T,) s on the common clock.
    offsets : (V,) s, what each film's own clock shows at moment 0.
    first_frame : number of the first moment.
    warnings : what a person should know.
    masks : files or folders of masks of the person, given beside keypoints.
    """

    names: tuple[str, ...]
    found: tuple[ViewKeypoints, ...]
    cameras: tuple[Camera, ...]
    frame_rate: float
    moments: FloatArray
    offsets: FloatArray
    first_frame: int
    warnings: tuple[Message, ...]
    masks: tuple[Path, ...] = ()

    def list_people(self) -> list[list[PersonTrack]]:
        """(V,) the people of each view at the common moments, where they are seen."""
        from dousa.estimation.multiview.people import resample_track

        return [
            [resample_track(person, view.times, self.moments + offset) for person in view.people]
            for view, offset in zip(self.found, self.offsets, strict=True)
        ]


def open_films(request: EstimationRequest, sources: PairedSources, report: ProgressCallback) -> FilmScene:
    """Keypoints and cameras of all films.

    Raises
    ------
    DousaError : a film or calibration that cannot be used, or models that are not installed.
    """
    names = [view.name for view in sources.views]
    found = open_keypoints([view.source for view in sources.views], request.model, report, request, names)
    scene = place_films(replace(request, sources=sources.seen), found, report)
    return replace(scene, masks=sources.masks)


def place_films(
    request: EstimationRequest,
    found: tuple[ViewKeypoints, ...],
    report: ProgressCallback,
    people: Sequence[int] | None = None,
) -> FilmScene:
    """Put films whose keypoints are known on one clock, with a camera each.

    Parameters
    ----------
    request : its cameras, offsets, stature, rate and frames.
    found : (V,) keypoints of each film, whose name is the source.
    report : called with (done, total, what).
    people : (V,) by whom films are synchronised and cameras placed, their places among the people of each view; None
        for those who move the same way.

    Raises
    ------
    DousaError : calibration or films that cannot be used.
    """
    names = tuple(view.source for view in found)
    if request.focal is not None and request.cameras is not None:
        raise OptionError("calibration.focal_and_cameras")
    if request.cameras is None:
        return _place_cameras(request, names, found, _choose(found, people), report)
    cameras, notes = read_view_cameras(request.cameras, names, [view.size for view in found])
    offsets, more = find_offsets(request, names, _choose(found, people), cameras, report)
    return _put_together(request, names, found, cameras, offsets, [*notes, *more])


def _choose(found: tuple[ViewKeypoints, ...], people: Sequence[int] | None) -> tuple[ViewKeypoints, ...]:
    """Keep one person of each film; all of them where none was chosen."""
    if people is None:
        return found
    return tuple(replace(view, people=(view.people[place],)) for view, place in zip(found, people, strict=True))


def _place_cameras(
    request: EstimationRequest,
    names: tuple[str, ...],
    found: tuple[ViewKeypoints, ...],
    chosen: tuple[ViewKeypoints, ...],
    report: ProgressCallback,
) -> FilmScene:
    """Place unknown cameras: several by the person, a single one upright at a usual height."""
    from dousa.estimation.calibration.person import calibrate_from_person, guess_lenses
    from dousa.estimation.sync.synchronise import read_offsets, sync

    focals = _find_focals(request, found)
    if len(found) == 1:
        word = "film_estimate.lens_assumed" if focals is None else "film_estimate.upright_assumed"
        return _put_together(request, names, found, guess_lenses(found, focals), np.zeros(1), [Message(word)])
    if request.stature is None:
        raise OptionError("film_estimate.no_scale")
    people: tuple[int, ...] | None = None
    notes: list[Message] = []
    if request.offsets == "auto":
        answer = sync(chosen, sounds=read_sounds(request.sources), progress=report)
        offsets, people, notes = answer.offsets, answer.people, list(answer.warnings)
    elif request.offsets == "none":
        offsets = np.zeros(len(found))
    else:
        offsets = np.array(read_offsets(request.offsets, names))
    report(0, 1, Message("film_estimate.calibrating"))
    made = calibrate_from_person(chosen, request.stature, focals=focals, offsets=offsets.tolist(), people=people)
    notes += [*made.warnings, Message("film_estimate.calibrated", views=len(found))]
    clocks = np.zeros(len(found)) if start_together(found, offsets) else offsets.max() - offsets
    return _put_together(request, names, found, made.cameras, clocks, notes)


def start_together(
    found: Sequence[ViewKeypoints], offsets: FloatArray, spreads: FloatArray | float = 0.0, *, frames: float = 0.75
) -> bool:
    """Whether films start so nearly together that they are taken as they are.

    Parameters
    ----------
    found, offsets : the films, and when they begin, (V,) s.
    spreads : standard errors of the offsets, (V,) s; three of them are no difference.
    frames : of the slowest film, by which starts may differ; more leaves films unsynchronised, less shifts by noise.
    """
    frame = 1.0 / min(view.frame_rate for view in found)
    return bool((np.abs(offsets) < np.maximum(frames * frame, 3.0 * np.asarray(spreads))).all())


def _find_focals(request: EstimationRequest, found: Sequence[ViewKeypoints]) -> list[float] | None:
    """Focal lengths (V,) px: as given, else as all films state them; None where neither."""
    if request.focal is not None:
        if not (np.isfinite(request.focal) and request.focal > 10.0):
            raise OptionError("calibration.focal", found=request.focal)
        return [request.focal] * len(found)
    stated = [read_focal_length(path, view.size) for path, view in zip(request.sources, found, strict=False)]
    known = [focal for focal in stated if focal is not None]
    return known if len(known) == len(found) else None


def _put_together(
    request: EstimationRequest,
    names: tuple[str, ...],
    found: tuple[ViewKeypoints, ...],
    cameras: tuple[Camera, ...],
    offsets: FloatArray,
    notes: list[Message],
) -> FilmScene:
    rates = [view.frame_rate for view in found]
    rate = request.rate or min(rates)
    if max(rates) > min(rates) * 1.002:
        notes.append(Message("masks.rates", rates=rates, rate=rate))
    length = min(view.times[-1] - offset for view, offset in zip(found, offsets, strict=True))
    if length < 0:
        raise KeypointError("film_estimate.no_common_moment")
    n_frames = int(length * rate + 0.25) + 1  # a quarter of a frame beyond the end is the last frame
    first, stop = parse_frames(request.frames, n_frames, Message("frames.recording"))
    notes += [note for view in found for note in view.warnings]
    return FilmScene(names, found, cameras, rate, np.arange(first, stop) / rate, offsets, first, tuple(notes))


def find_offsets(
    request: EstimationRequest,
    names: Sequence[str],
    found: Sequence[ViewKeypoints],
    cameras: Sequence[Camera],
    report: ProgressCallback,
) -> tuple[FloatArray, list[Message]]:
    """What each film's own clock shows (V,) s when the last of them begins, and what a person should know."""
    from dousa.estimation.sync.synchronise import read_offsets, sync

    together = np.zeros(len(found))
    if request.offsets == "none" or len(found) < 2:
        return together, []
    if request.offsets != "auto":
        clocks = -np.array(read_offsets(request.offsets, names))
        return clocks - clocks.min(), []
    try:
        answer = sync(found, cameras=cameras, sounds=read_sounds(request.sources), progress=report)
    except CalibrationError as error:  # without movement it does not matter much either
        return together, [Message("film_estimate.not_synchronised", reason=error.message)]
    if start_together(found, answer.offsets, answer.spreads):
        return together, list(answer.warnings)
    clocks = -answer.offsets
    pairs = tuple(f"{name} {offset:+.3f} s" for name, offset in zip(names, answer.offsets, strict=True))
    return clocks - clocks.min(), [*answer.warnings, Message("film_estimate.synchronised", offsets=pairs)]


def has_models() -> bool:
    """Whether keypoints can be found: models and the packages that run them are installed."""
    from importlib.util import find_spec

    from dousa.estimation.keypoints.pose_models import DETECTOR, check_pose_model, choose_pose_model, get_pose_model

    packages = all(find_spec(name) is not None for name in ("ai_edge_litert", "av", "cv2"))
    names = (DETECTOR, choose_pose_model()) if packages else ()
    return packages and all(check_pose_model(get_pose_model(name)) == "installed" for name in names)


class PersonSilhouettes(Silhouettes):
    """The masks that a network found of one person, at the common moments and of a moderate size.

    Parameters
    ----------
    films : on one clock.
    members : (V,) numbers of the people of each view who are the person.
    sources : (V,) films, whose pictures lie behind the masks; there are none if any of them holds keypoints.
    plates : (V,) masks of each film by its background, or given, which are taken instead; None for a view without.
    """

    def __init__(
        self,
        films: FilmScene,
        members: Sequence[Sequence[int]],
        sources: Sequence[Path] = (),
        plates: Sequence[View | None] = (),
    ) -> None:
        from dousa.estimation.silhouettes.video import reduce_size

        self.names, self.frame_rate = films.names, films.frame_rate
        self.n_frames = len(films.moments)
        self._found, self._plates = films.found, plates
        given = plates or (None,) * len(films.found)
        self.sizes = tuple(reduce_size(view.size) if plate is None else plate.size
                           for view, plate in zip(films.found, given, strict=True))  # fmt: skip
        self._sources = () if any(map(is_keypoints, sources)) else tuple(sources)
        self._files: list[VideoFile] = []
        moments = films.moments + films.offsets[:, None]
        self._shown = [nearest_frames(view.times, own) for view, own in zip(films.found, moments, strict=True)]
        self._frames = [shown if plate is None else _find_frames(plate, own)
                        for shown, plate, own in zip(self._shown, given, moments, strict=True)]  # fmt: skip
        self._looks = bool(plates) and not films.masks  # masks alone have no pictures
        self._masks: list[list[PersonMasks]] = [
            [masks for number in numbers if (masks := view.people[number].masks) is not None]
            for view, numbers in zip(films.found, members, strict=True)
        ]

    @property
    def has_masks(self) -> bool:
        """Whether any view has masks."""
        return bool(self._plates) or any(self._masks)

    @property
    def warnings(self) -> tuple[Message, ...]:  # type: ignore[override]
        """What is said of the backgrounds."""
        return tuple(note for plate in self._plates if plate is not None for note in plate.warnings)

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        if self._plates:
            own_frames = zip(self._plates, self._frames, strict=True)
            return tuple(None if plate is None or places[frame] < 0 else plate.read(int(places[frame]))
                         for plate, places in own_frames)  # fmt: skip
        masks: list[Mask | None] = []
        for view, found in enumerate(self._found):
            place = int(self._frames[view][frame])
            drawn = (person.read(place, self.sizes[view], of=found.size) for person in self._masks[view])
            masks.append(next((mask for mask in drawn if mask is not None), None))
        return tuple(masks)

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The films' pictures (height, width, 3), as large as the masks; None where there is none."""
        from dousa.estimation.silhouettes.video import VideoFile
        from dousa.extras import cv2

        if not self._sources:
            return super().look(frame)
        if self._looks:
            own_frames = zip(self._plates, self._frames, strict=True)
            return tuple(None if plate is None else plate.look(int(places[frame])) for plate, places in own_frames)
        self._files = self._files or [VideoFile(path) for path in self._sources]
        pictures: list[Image | None] = []
        for file, places, size in zip(self._files, self._shown, self.sizes, strict=True):
            image = file.read(min(int(places[frame]), file.n_frames - 1))
            small = None if image is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            pictures.append(None if small is None else np.asarray(small))
        return tuple(pictures)

    def close(self) -> None:
        """Close the films; looking opens them again."""
        for file in self._files:
            file.close()
        for plate in self._plates:
            if plate is not None:
                plate.close()

    def fit_cameras(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """Cameras (V,) of the films' pictures for pictures of the masks' size."""
        return tuple(camera.resized(*size) for camera, size in zip(cameras, self.sizes, strict=True))


def _find_frames(view: View, moments: FloatArray) -> IndexArray:
    """Frames (T,) of a view at moments, s since its first frame; -1 before it begins and after it ends."""
    times = np.arange(view.n_frames) / view.frame_rate if view.times is None else view.times
    apart = 1.0 / view.frame_rate
    inside = (moments > times[0] - apart) & (moments < times[-1] + apart)
    return np.where(inside, nearest_frames(times, moments), -1)


def open_plates(request: EstimationRequest, films: FilmScene, report: ProgressCallback) -> list[View | None]:
    """Masks (V,) that are given, or those of films by their backgrounds; an empty list without either.

    Raises
    ------
    CalibrationError : given masks belong to no view, or two of them to one.
    SilhouetteError : masks or a background that cannot be used.
    """
    from dousa.estimation.cameras.camera import match_cameras
    from dousa.estimation.silhouettes.silhouette_files import open_views

    if films.masks:
        given = open_views(films.masks, kind="mask", frame_rate=request.rate)
        cameras, notes = match_cameras(films.cameras, [view.name for view in given])
        given[0].warnings = [*given[0].warnings, *notes]
        of_camera = {camera.name: view for camera, view in zip(cameras, given, strict=True)}
        return [of_camera.get(camera.name) for camera in films.cameras]
    if not has_plates(request) or any(map(is_keypoints, request.sources)):
        return []
    return list(
        open_views(
            request.sources,
            request.backgrounds,
            request.background_method,
            request.kind,
            request.rate,
            progress=report,
        )
    )


def has_plates(request: EstimationRequest) -> bool:
    """Whether the background of films is given or to be learnt."""
    return bool(request.backgrounds) or request.background_method is not None


def is_films(request: EstimationRequest, views: Sequence[FilmSource]) -> bool:
    """Whether the views are films of a scene, with plates or without, or their keypoints."""
    from dousa.estimation.silhouettes.images import IMAGE_ENDINGS

    endings = (".npz", *IMAGE_ENDINGS)
    if request.kind == "mask" or (has_plates(request) and request.cues not in (None, "both")):
        return False
    if request.start is not None or not views:
        return False
    if request.cues in ("keypoints", "both"):
        return not any(view.source.suffix.lower() in IMAGE_ENDINGS for view in views)
    return all(view.has_keypoints or (view.source.is_file() and view.source.suffix.lower() not in endings)
               for view in views)  # fmt: skip


def check_scenes(paths: Sequence[Path], progress: ProgressCallback) -> None:
    """Raise CalibrationError if a film, unless it is one of masks, has a cut or is of a camera that moves."""
    from dousa.estimation.cameras.steadiness import check_steady
    from dousa.estimation.silhouettes.images import IMAGE_ENDINGS

    for path in paths:
        if path.is_file() and path.suffix.lower() not in (".npz", *IMAGE_ENDINGS) and not shows_masks(path):
            check_steady(path, progress)


def with_outputs(request: EstimationRequest, number: int) -> EstimationRequest:
    """The same request for one person of several: files named ``OUT-2.bvh`` and so on from the second on."""
    if number == 1:
        return request
    outputs = request.outputs

    def rename(path: Path) -> Path:
        return path.with_name(f"{path.stem}-{number}{path.suffix}")

    others = {
        name: rename(path) for name in ("angles", "overlay", "sheet") if (path := getattr(outputs, name)) is not None
    }
    motions = tuple(rename(path) for path in outputs.motions)
    return replace(request, outputs=replace(outputs, motions=motions, **others))
