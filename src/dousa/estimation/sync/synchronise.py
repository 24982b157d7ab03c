"""Time offsets of films of one scene, by the movement of people and by sound, and their TOML files.

A file has one table ``[[film]]`` for each film: ``offset`` (s) is added to the film's own time, which begins with its
first image, to get the time of the first film; ``spread`` (s) is its standard deviation; ``basis`` its evidence.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, MotionFileError, OptionError
from dousa.estimation.calibration.bundle import Limb, Rig
from dousa.estimation.calibration.person import guess_lenses
from dousa.estimation.calibration.sightings import Track, choose_points, list_limbs, make_track, name_views
from dousa.estimation.cameras.camera import Camera, find_views
from dousa.estimation.keypoints.keypoints import ViewKeypoints
from dousa.estimation.sync.sound import Sound, find_sound_lag
from dousa.estimation.sync.timing import (
    Agreement,
    Movement,
    TimedRig,
    choose_step,
    correlate,
    describe_movement,
    fit_times,
)
from dousa.files.disk import atomic_write, read_bytes
from dousa.files.markup import parse_toml, quote_toml
from dousa.messages import Message, Progress

_SAME = 0.05  # s; offsets that differ by less are one answer, see docs/estimation.md
_BETTER = 0.8  # of the misfit of another answer; by those half as large again at wrong times, see `timing`


@dataclass(frozen=True, slots=True, eq=False)
class Synchronisation:
    """The time offsets of films.

    Parameters
    ----------
    offsets : (V,) s: a film's own time plus its offset is the time of the first film, whose offset is 0.
    spreads : (V,) s, standard deviations of the offsets.
    basis : (V,) evidence: ``"movement"``, ``"sound"``, ``"both"`` or, for the first, ``"reference"``.
    people : (V,) place of the compared person among those of each view.
    by_sound : (V,) s, the offsets by sound alone; nan where there is none.
    misfit : cost of a sighting, see `TimedRig`; nan without geometry.
    warnings : notes for the user.
    """

    offsets: FloatArray
    spreads: FloatArray
    basis: tuple[str, ...]
    people: tuple[int, ...]
    by_sound: FloatArray
    misfit: float
    warnings: tuple[Message, ...] = ()


class _Start(NamedTuple):
    """A first guess: offsets (V,) s, people (V,), the score of their movements, and whether it is that of sound."""

    offsets: FloatArray
    people: tuple[int, ...]
    score: float
    heard: bool = False


def sync(
    views: Sequence[ViewKeypoints],
    *,
    cameras: Sequence[Camera] | None = None,
    sounds: Sequence[Sound | None] | None = None,
    progress: Progress | None = None,
    largest_spread: float = 0.25,
) -> Synchronisation:
    """Find the time offsets of films of one scene.

    Parameters
    ----------
    views : (V,) keypoints of the films with their time stamps; their rates may differ and change.
    cameras : (V,) calibrated, in one world, for a more exact result; unknown cameras are found as well.
    sounds : (V,) of the films, None for one without.
    progress : called with (done, total, what).
    largest_spread : s; offsets that are less sure count as undetermined.

    Raises
    ------
    OptionError : fewer than two films, another number of cameras or sounds.
    CalibrationError : the time is undetermined: no person moves or is seen, or films differ in moment or people.
    """
    for what, given in (("cameras", cameras), ("sounds", sounds)):
        if given is not None and len(given) != len(views):
            raise OptionError("sync.count", what=what, found=len(given), films=len(views))
    if len(views) < 2:
        raise OptionError("sync.one_film")
    names = name_views(views)
    by_sound, heard = _listen(sounds, len(views))
    shared = [name for name in views[0].names if all(name in view.names for view in views)]
    points = choose_points(shared)
    tracks = [
        _make_tracks(view, points, camera) for view, camera in zip(views, cameras or guess_lenses(views), strict=True)
    ]
    problem = _find_problem(tracks, names, len(shared))
    if problem is not None:
        return _by_sound_only(by_sound, heard, problem)
    starts = _find_starts(tracks)
    if heard:
        starts.insert(0, _Start(by_sound, starts[0].people if starts else (0,) * len(views), 0.0, True))
    judge = _Judge(tracks, list_limbs(points), cameras, progress or (lambda done, total, what: None))
    found = judge.compare(starts)
    if found is None:
        return _by_sound_only(by_sound, heard, CalibrationError("sync.no_agreement", films=names))
    best, start, others = found
    is_sure = judge.excludes_other_times(best, start)
    best = judge.fit(start, best.offsets, best.rig) or best
    if not is_sure or (best.spreads > largest_spread).any():
        worst = names[int(np.argmax(best.spreads))]
        return _by_sound_only(by_sound, heard, CalibrationError("sync.no_time", films=names, film=worst))
    return _answer(best, start, others, by_sound, names)


def _make_tracks(view: ViewKeypoints, points: Sequence[str], camera: Camera, most_people: int = 3) -> list[Track]:
    """Return the first ``most_people`` of a view with the points common to all views."""
    places = view.find(points)
    return [
        make_track(view.times, person.points[:, places], person.visibility[:, places], camera)
        for person in view.people[:most_people]
    ]


def _find_problem(
    tracks: Sequence[Sequence[Track]], names: Sequence[str], n_shared: int, least_speed: float = 0.12
) -> CalibrationError | None:
    """Return the reason why the movement of people cannot determine the time; None without one.

    Who moves by less than ``least_speed`` of the own height in a second stands still.
    """
    if n_shared < 4:
        return CalibrationError("sync.few_points", found=n_shared)
    for some, name in zip(tracks, names, strict=True):
        if not any((track.weights > 0).any(axis=1).sum() >= 3 for track in some):
            return CalibrationError("sync.nobody", film=name)
    for some, name in zip(tracks, names, strict=True):
        if max(describe_movement(track, choose_step([track])).speed for track in some) < least_speed:
            return CalibrationError("sync.still", film=name)
    return None


def _listen(sounds: Sequence[Sound | None] | None, n_views: int) -> tuple[FloatArray, bool]:
    """Return offsets by sound (V,) s, nan where there is none, and whether all are known."""
    offsets = np.full(n_views, np.nan)
    offsets[0] = 0.0
    if sounds is None:
        return offsets, False
    known, newest = {0}, [0]
    while newest:  # from the films whose time is known to those whose is not: one comparison a film if all are clear
        found: dict[int, tuple[float, float]] = {}
        for one, other in itertools.product(newest, range(n_views)):
            first, second = sounds[one], sounds[other]
            if other in known or first is None or second is None:
                continue
            lag = find_sound_lag(first, second)
            if lag is not None and lag.clarity > found.get(other, (0.0, 0.0))[0]:
                found[other] = lag.clarity, offsets[one] + lag.lag
        for other, (_, offset) in found.items():
            offsets[other] = offset
        known, newest = known | found.keys(), list(found)
    return offsets, len(known) == n_views


def _by_sound_only(
    by_sound: FloatArray, heard: bool, problem: CalibrationError, spread: float = 0.015
) -> Synchronisation:
    """Return the offsets by sound, which takes 3 ms for a metre and is recorded some ms beside the picture."""
    if not heard:
        raise problem
    n_views = len(by_sound)
    spreads = np.full(n_views, spread)
    spreads[0] = 0.0
    basis = ("reference", *("sound",) * (n_views - 1))
    note = Message("sync.sound_only", reason=problem.message)
    return Synchronisation(by_sound, spreads, basis, (0,) * n_views, by_sound, np.nan, (note,))


def _find_starts(
    tracks: Sequence[Sequence[Track]], *, most: int = 3, same: float = 0.1, clear: float = 2.0
) -> list[_Start]:
    """Return at most ``most`` sets of offsets for which the movements agree, best first, more than ``same`` s apart.

    The best stands alone if its score is twice the next one's and ``clear`` for each pair of films. Else films that
    start together, as those that a program has cut do, are one more: periodic or shaky movement may not show it.
    """
    step = choose_step([track for some in tracks for track in some])
    movements = [[describe_movement(track, step) for track in some] for some in tracks]
    agreements: dict[tuple[int, int, int, int], Agreement] = {}
    for one, other in itertools.combinations(range(len(tracks)), 2):
        for p, q in itertools.product(range(len(movements[one])), range(len(movements[other]))):
            agreements[one, p, other, q] = correlate(movements[one][p], movements[other][q])
    found: list[_Start] = []
    for root in range(len(tracks)):
        found += _grow(root, movements, agreements, most)
    different: list[_Start] = []
    for start in sorted(found, key=lambda one: -one.score):
        is_known = any(
            start.people == other.people and np.abs(start.offsets - other.offsets).max() < same for other in different
        )
        if not is_known:
            different.append(start)
    n_pairs = len(tracks) * (len(tracks) - 1) / 2
    if len(different) > 1 and different[0].score > max(clear * n_pairs, 2.0 * different[1].score):
        return different[:1]
    everybody = dict.fromkeys(start.people for start in different[:most])
    return [*different[:most], *(_Start(np.zeros(len(tracks)), people, 0.0) for people in everybody)]


def _grow(
    root: int,
    movements: Sequence[Sequence[Movement]],
    agreements: dict[tuple[int, int, int, int], Agreement],
    most: int,
    beam: int = 60,
    most_lags: int = 5,
) -> list[_Start]:
    """Grow sets of offsets from one film, film by film, by ``most_lags`` of a pair, and keep the ``beam`` best."""

    def score(one: int, p: int, other: int, q: int, lag: float) -> float:
        if one < other:
            return agreements[one, p, other, q].at(lag)
        return agreements[other, q, one, p].at(-lag)

    sets = [({root: (0.0, person)}, 0.0) for person in range(len(movements[root]))]
    for view in range(len(movements)):
        if view == root:
            continue
        grown = []
        for placed, total in sets:
            person = placed[root][1]
            for q in range(len(movements[view])):
                key = (root, person, view, q) if root < view else (view, q, root, person)
                sign = 1.0 if root < view else -1.0
                for lag in (sign * found for found in agreements[key].find(most_lags)):
                    gain = sum(score(o, p, view, q, lag - at) for o, (at, p) in placed.items())
                    grown.append(({**placed, view: (lag, q)}, total + gain))
        sets = sorted(grown, key=lambda item: -item[1])[:beam]
    starts = []
    for placed, total in sets[:most]:
        offsets = np.array([placed[view][0] for view in range(len(movements))])
        people = tuple(placed[view][1] for view in range(len(movements)))
        starts.append(_Start(offsets - offsets[0], people, total))
    return starts


class _Judge:
    """Compare sets of offsets by the geometry."""

    def __init__(
        self, tracks: Sequence[Sequence[Track]], limbs: Sequence[Limb], cameras: Sequence[Camera] | None, tell: Progress
    ) -> None:
        self._tracks, self._limbs, self._tell = tracks, limbs, tell
        self._done = 0
        self._rig = None if cameras is None else rig_of(cameras)

    def fit(self, start: _Start, offsets: FloatArray, rig: Rig | None = None) -> TimedRig | None:
        """Improve offsets, quickly or, with the rig of an answer, by more moments."""
        tracks = [some[person] for some, person in zip(self._tracks, start.people, strict=True)]
        known = self._rig is not None
        if rig is not None:
            return fit_times(tracks, offsets, self._limbs, rig.focals, rig, known)
        self._tell(self._done, self._done + 1, Message("sync.progress"))
        self._done += 1
        focals = np.array([track.focal for track in tracks])
        return fit_times(tracks, offsets, self._limbs, focals, self._rig, known, most=60, rounds=3)

    def compare(
        self, starts: Sequence[_Start], same: float = _SAME, better: float = _BETTER
    ) -> tuple[TimedRig, _Start, list[TimedRig]] | None:
        """Return the best answer, its start, and others by over ``same`` s hardly worse; None where none fits.

        Of answers that fit alike, as those of periodic movement do, sound decides.
        """
        found = [(timed, start) for start in starts for timed in [self.fit(start, start.offsets)] if timed]
        if not found:
            return None
        found.sort(key=lambda item: item[0].misfit)
        alike = [item for item in found if found[0][0].misfit > better * item[0].misfit]
        for timed, start in alike:
            if start.heard:
                return timed, start, []
        best, start = found[0]
        return best, start, [timed for timed, _ in alike if np.abs(timed.offsets - best.offsets).max() > same]

    def excludes_other_times(
        self, best: TimedRig, start: _Start, shift: float = 0.5, same: float = _SAME, better: float = _BETTER
    ) -> bool:
        """Return whether other times, ``shift`` s off, lead back to within ``same`` s or fit worse.

        Those fit worse of whose misfit ours is less than the share ``better``.
        """
        shifts = np.where(np.arange(len(best.offsets)) % 2 == 1, shift, 0.0)
        for sign in (1.0, -1.0):
            other = self.fit(start, best.offsets + sign * shifts)
            if other is None:
                continue
            if np.abs(other.offsets - best.offsets).max() < same:
                return True
            return best.misfit < better * other.misfit
        return True


def rig_of(cameras: Sequence[Camera]) -> Rig:
    """Return calibrated cameras as a rig of the bundle adjustment."""
    return Rig(
        np.stack([camera.rotation for camera in cameras]),
        np.stack([camera.translation for camera in cameras]),
        np.array([camera.matrix[0, 0] for camera in cameras]),
        np.zeros(len(cameras)),
    )


def _answer(
    best: TimedRig,
    start: _Start,
    others: Sequence[TimedRig],
    by_sound: FloatArray,
    names: Sequence[str],
    differs: float = 0.06,
    usual: float = 0.4,
) -> Synchronisation:
    """Put the answer together; sound more than ``differs`` s off, and a misfit beyond what is ``usual``, are notes."""
    notes = []
    if best.misfit > usual:
        notes.append(Message("sync.misfit", misfit=best.misfit, usual=usual))
    for view, name in enumerate(names):
        open_times = [other.offsets[view] for other in others if abs(other.offsets[view] - best.offsets[view]) > _SAME]
        if open_times:
            notes.append(Message("sync.ambiguous", film=name, offset=best.offsets[view], other=open_times[0]))
    apart = np.abs(by_sound - best.offsets)
    for view in np.flatnonzero(apart > differs).tolist():
        values = {"movement": best.offsets[view], "sound": by_sound[view]}
        notes.append(Message("sync.disagree", film=names[view], **values))
    both = (apart <= differs).tolist()
    basis = ("reference", *("both" if agree else "movement" for agree in both[1:]))
    return Synchronisation(best.offsets, best.spreads, basis, start.people, by_sound, best.misfit, tuple(notes))


def write_offsets(path: str | os.PathLike[str], names: Sequence[str], found: Synchronisation) -> None:
    """Write time offsets; the file appears whole or not at all.

    Parameters
    ----------
    path : the file to write or replace.
    names : (V,) of the films, without suffix.
    found : their offsets.

    Raises
    ------
    MotionWriteError : the folder is missing or read-only, or the disk is full.
    """
    lines = ["# A film's own time plus its offset is the time of the first film; in seconds.", ""]
    for name, offset, spread, basis in zip(names, found.offsets, found.spreads, found.basis, strict=True):
        lines += ["[[film]]", f"name = {quote_toml(name)}", f"offset = {float(offset):.6f}"]
        lines += [f"spread = {float(spread):.6f}", f"basis = {quote_toml(basis)}", ""]
    with atomic_write(path) as file:
        file.write("\n".join(lines).encode("utf-8"))


def read_offsets(path: str | os.PathLike[str], names: Sequence[str]) -> list[float]:
    """Read the time offsets (V,) s of films.

    Parameters
    ----------
    path : a file of `write_offsets`, or one by hand with ``name`` and ``offset`` of each film.
    names : (V,) of the films, without suffix, in the wanted order.

    Raises
    ------
    CalibrationError : missing, no TOML, no offset for a film, or one that is no number.
    """
    try:
        tree = parse_toml(read_bytes(path).decode("utf-8-sig"))
    except MotionFileError as error:
        raise CalibrationError(error.message).at(path) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError("sync_file.toml", reason=str(error)[:200]).at(path) from error
    films = tree.get("film")
    if not isinstance(films, list) or not all(isinstance(film, Mapping) and "name" in film for film in films):
        raise CalibrationError("sync_file.no_films").at(path)
    try:
        places = find_views([str(film["name"]) for film in films], names)
    except CalibrationError as error:
        raise error.at(path) from error
    return [_read_offset(films[place], path) for place in places]


def _read_offset(film: Mapping[str, object], path: str | os.PathLike[str], most: float = 1e6) -> float:
    """Return the offset of a film, at most ``most`` s."""
    offset = film.get("offset")
    number = isinstance(offset, int | float) and not isinstance(offset, bool)
    if not number or not abs(offset) <= most:  # type: ignore[arg-type]  # nan neither
        raise CalibrationError("sync_file.offset", film=str(film["name"])[:80], found=str(offset)[:40]).at(path)
    return float(offset)  # type: ignore[arg-type]
