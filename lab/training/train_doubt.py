"""Learn how much each sign of doubt weighs in the expected error of a joint, and tell how often it is right.

    python -m lab.training.train_doubt --mesh FOLDER --kept FOLDER [--cues silhouettes,keypoints] [--clips N]
        [--left-out N] [--fits keypoints,late]

Made people (`lab.trials.crossings`; ``--mesh`` as in `lab.trials.made_people`) move as HDM05's bd and bk and as
people of Bandai Namco who wave and raise their hands. Silhouettes: every other clip has ragged outlines, holes,
specks and shadows; they are tracked with four views, two and one, the start searched for, and with two and four also
from legs or arms exchanged, so that there is something to find. Keypoints: films of `lab.trials.degrees`, seen by
BlazePose's heavy and full models in turn, with and without the network's masks, and noisy (6 px, a tenth of the
points not seen); with one view errors are those of the posture (hips in place), and the spread of the distance is
printed by itself. Several views are also spoilt, by one that is late or whose camera is turned. Prints the weights
(`dousa.estimation.body.doubt.WEIGHTS`), by cue and for one view or more, and the curve: how many of the frames off by
more than 150 mm are found when so many of the others are said too; for the people it learns from, each by what the
others teach, and for people, shapes and recordings left out (HDM05's dg, Bandai Namco's walking and running). Beside
it the plainest way: the root mean square of the misfit (of keypoints, the reprojection error) alone, from what 5 % of
the good frames of the same people exceed. What is made is kept, and so are the fits of films until the code of the fit
changes; some 15 s a clip on one core, 60 s a film.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import minimize

import dousa.estimation
from dousa.arrays import BoolArray, FloatArray
from dousa.estimation import MEDIAPIPE_NAMES, PersonTrack, TrackerSettings, estimate, fit_keypoints, make_human
from dousa.estimation.body.doubt import LOST_ERROR, SIGNS, Cue, find_misfit
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_pose
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.estimation.tracking.diagnosis import Diagnosis, list_signs
from dousa.estimation.tracking.outlines import do_meet
from dousa.estimation.tracking.search_setup import SearchSetup, Shrinker
from dousa.estimation.tracking.tracker import smooth_poses
from lab.estimation.clips import BenchClip, choose_views, read_clip, take_part
from lab.trials.crossings import make_clip
from lab.trials.degrees import make_film
from lab.trials.made_people import Film
from lab.trials.person_maker import list_kinds, make_parser, open_mesh

# fmt: off
RECORDINGS = {
    "tuned": ("hdm05/*/HDM_bd_*.[aA][mM][cC]", "hdm05/*/HDM_bk_*.[aA][mM][cC]", "bandai/[rw]a*[ds]/*/*.bvh",
              "hdm05/*/HDM_b[dk]_*.[aA][mM][cC]"),
    "left out": ("hdm05/*/HDM_dg_*.[aA][mM][cC]", "bandai/[wr][au][ln]*/*/*.bvh", "hdm05/*/HDM_dg_*.[aA][mM][cC]"),
}
# fmt: on
_ENDS = {"legs": ("knee", "ankle"), "arms": ("elbow", "wrist")}
_STARTS = (("auto", 4), ("auto", 2), ("auto", 1), ("legs", 2), ("legs", 4), ("arms", 2))
_VIEWS = (4, 2, 1)
_FITS = (*((what, views) for what in ("keypoints", "noisy", "both") for views in _VIEWS), ("late", 2), ("late", 4),
         ("turned", 2), ("turned", 4))  # fmt: skip
_LATE, _TURNED = 0.5, np.deg2rad(5.0)  # s, rad, by which a view is spoilt, so that there is something to find
_NOISE, _UNSEEN = 6.0, 0.1  # px, and the share of points that a noisy film does not show
_LEAST = 0.01  # m, below which errors do not matter


class Tracked(NamedTuple):
    """Signs (T, N, S) and errors (T, N) m of the points of one track, nan where the truth is unknown.

    ``kind`` is the cue and the number of views. ``what`` it is, of which ``film``; ``usual`` ones began with a search.
    ``away`` (T,): the distance found by the true one, with one view of keypoints.
    """

    signs: FloatArray
    errors: FloatArray
    kind: tuple[Cue, int]
    what: str = ""
    film: int = 0
    usual: bool = True
    away: FloatArray = np.ones(0)

    @property
    def off(self) -> BoolArray:
        """Frames (T,) that are off."""
        return np.asarray(np.nanmean(self.errors, axis=1) > LOST_ERROR)


class Learned(NamedTuple):
    """Weights (S,), the expected mean error in m and the misfit from which a frame is said to be off.

    ``by_misfit``: ``said`` is of the misfit, as no other sign tells the frames of people left out.
    """

    weights: FloatArray
    said: float
    plain: float = np.inf
    by_misfit: bool = False

    def expect(self, track: Tracked) -> FloatArray:
        """Compute the expected mean error (T,) m of each frame."""
        return np.asarray(np.sqrt(((self.weights * track.signs) ** 2).sum(axis=-1)).mean(axis=1))

    def says(self, track: Tracked) -> BoolArray:
        """Return whether each frame (T,) is said to be off."""
        return np.asarray((find_misfit(track.signs) if self.by_misfit else self.expect(track)) > self.said)


def disturb(clip: BenchClip, rng: np.random.Generator) -> BenchClip:
    """Return a clip with ragged outlines, holes, specks, and now and then a shadow."""
    level, silhouettes = rng.uniform(0.5, 1.5), clip.silhouettes
    read = [[_disturb_mask(mask, rng, level) for mask in silhouettes.read(t)] for t in range(silhouettes.n_frames)]
    packed = [np.packbits([masks[view] for masks in read], axis=2) for view in range(silhouettes.n_views)]
    missing = np.zeros((silhouettes.n_views, silhouettes.n_frames), bool)
    noisy = PackedSilhouettes.from_packed(packed, silhouettes.sizes, silhouettes.frame_rate, silhouettes.names, missing)
    return replace(clip, silhouettes=noisy, variant="noisy")


def _disturb_mask(mask: BoolArray | None, rng: np.random.Generator, level: float) -> BoolArray:
    assert mask is not None
    drawn, (height, width) = mask.astype(np.uint8), mask.shape
    wave = cv2.resize(rng.normal(0, 1, (height // 4, width // 4)).astype(np.float32), (width, height),
                      interpolation=cv2.INTER_CUBIC)  # fmt: skip
    deep = cv2.distanceTransform(drawn, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - drawn, cv2.DIST_L2, 3)
    drawn = (deep + 1.6 * level * wave > 0).astype(np.uint8)
    rows, columns = np.nonzero(mask)
    for _ in range(rng.poisson(2.0 * level) if len(rows) else 0):
        at = rng.integers(len(rows))
        size = (int(rng.integers(1, 6)), int(rng.integers(1, 6)))
        cv2.ellipse(drawn, (int(columns[at]), int(rows[at])), size, rng.uniform(0, 180), 0, 360, 0, -1)
    for _ in range(rng.poisson(5.0 * level)):
        cv2.circle(drawn, (int(rng.integers(width)), int(rng.integers(height))), int(rng.integers(1, 3)), 1, -1)
    if len(rows) and rng.random() < 0.5 * level:
        middle = (int(columns.mean() + rng.integers(-8, 8)), int(rows.max()))
        cv2.ellipse(drawn, middle, (int(rng.integers(10, 30)), int(rng.integers(2, 6))), 0, 0, 360, 1, -1)
    return drawn.astype(bool)


def track(clip: BenchClip, count: int, start: str) -> Tracked:
    """Track a clip, and compare what its poses show with what is true."""
    views, body, places = choose_views(clip.cameras, count), make_human(clip.stature), dict(clip.joints_at(0))
    for end in _ENDS.get(start, ()):
        left, right = f"left_{end}", f"right_{end}"
        places[left], places[right] = places[right], places[left]
    first = None if start == "auto" else fit_pose(body, places)[0]
    cameras, silhouettes = [clip.cameras[view] for view in views], take_part(clip.silhouettes, views)
    settings = TrackerSettings(smoothing=0.0)
    found = estimate(silhouettes, cameras, body, first, settings=settings, n_threads=1)
    area = float(np.mean([mask.sum() for mask in silhouettes.read(0) if mask is not None]))
    shrinker = Shrinker(cameras, area, settings.height)
    area *= shrinker.area_share
    setup = SearchSetup(found.body, shrinker.cameras, settings, found.frame_rate, area)
    meet = do_meet(np.array([camera.rotation[2] for camera in cameras]))
    notes = Diagnosis(setup, area, meet)
    for frame, pose in enumerate(found.poses):
        notes.write(pose, setup.pack(shrinker.shrink(silhouettes.read(frame))))
    smooth = smooth_poses(found.poses, found.frame_rate, TrackerSettings().smoothing)
    names, points = point_names(found.body), compute_points(found.body, smooth)
    errors = np.full(points.shape[:2], np.nan)
    for row, joint in enumerate(clip.joints):
        if joint in names:
            own = names.index(joint)
            errors[:, own] = np.linalg.norm(points[:, own] - clip.truth[:, row], axis=-1)
    signs = list_signs(setup, found.poses, notes.arrays())
    what = f"{'noisy' if clip.variant == 'noisy' else 'clean'}, {count}" + ("" if start == "auto" else f", {start}")
    return Tracked(signs, errors, ("silhouettes", 1 + meet), what, usual=start == "auto")


def fit(film: Film, count: int, what: str) -> Tracked:
    """Fit keypoints of a film: alone, "noisy", with the network's masks ("both"), or one view "late" or "turned"."""
    views, masks = list(choose_views(film.cameras, count)), what == "both"
    cameras, tracks = [film.cameras[view] for view in views], [film.tracks[view] for view in views]
    if what == "noisy":
        tracks = [blur(track, np.random.default_rng(view)) for view, track in zip(views, tracks, strict=True)]
    elif what == "late":
        tracks[-1] = delay(tracks[-1], round(_LATE * film.rate))
    elif what == "turned":
        turn = cv2.Rodrigues(np.array([0.0, _TURNED, 0.0]))[0]
        cameras[-1] = replace(
            cameras[-1], rotation=turn @ cameras[-1].rotation, translation=turn @ cameras[-1].translation
        )
    found = fit_keypoints(cameras, tracks, MEDIAPIPE_NAMES, film.rate, stature=film.stature if count == 1 else None,
                          silhouettes=film.silhouettes(views) if masks else None)  # fmt: skip
    names, points = point_names(found.estimate.body), compute_points(found.estimate.body, found.estimate.poses)
    rows, hips = [names.index(joint) for joint in film.joints], [names.index(f"{s}_hip") for s in ("left", "right")]
    truth, away = film.truth, np.ones(0)
    if count == 1:
        own, true = points[:, hips].mean(axis=1), truth[:, [film.joints.index(names[hip]) for hip in hips]].mean(axis=1)
        away = cameras[0].compute_depths(own) / cameras[0].compute_depths(true)
        truth = truth + (own - true)[:, None]
    errors = np.full(points.shape[:2], np.nan)
    errors[:, rows] = np.linalg.norm(points[:, rows] - truth, axis=-1)
    return Tracked(found.signs, errors, ("keypoints", min(count, 2)), f"{what}, {count}", away=away)


def blur(track: PersonTrack, rng: np.random.Generator) -> PersonTrack:
    """Return a track whose points are off and now and then not seen."""
    points = track.points + rng.normal(0, _NOISE, track.points.shape)
    seen = rng.random(track.visibility.shape) > _UNSEEN
    return PersonTrack(points, np.where(seen, track.visibility, 0.0), track.world)


def delay(track: PersonTrack, count: int) -> PersonTrack:
    """Return a track (T, ...) so many frames later, as of a film that is badly synchronised."""
    rows = np.maximum(np.arange(track.n_frames) - count, 0)
    return PersonTrack(track.points[rows], track.visibility[rows], None if track.world is None else track.world[rows])


def learn(tracks: Sequence[Tracked], tail: float = 4.0) -> FloatArray:
    """Return the weights (S,), 0 or more, that make the errors likeliest.

    The logarithm of an error over the expected one has Student's distribution with ``tail`` degrees of freedom.
    """
    signs = np.concatenate([own.signs.reshape(-1, len(SIGNS)) for own in tracks])
    errors = np.concatenate([own.errors.ravel() for own in tracks])
    known = np.isfinite(errors)
    squares, told = signs[known] ** 2, np.log(np.maximum(errors[known], _LEAST))
    usual = squares.mean(axis=0) + 1e-12
    squares = squares / usual

    def cost(values: FloatArray) -> tuple[float, FloatArray]:
        shares, spread = np.exp(values[:-1]), np.exp(values[-1])
        total = squares @ shares
        off = (told - 0.5 * np.log(total)) / spread
        slope = (tail + 1.0) * off / (tail + off * off)
        gradient = -(squares * (0.5 * slope / spread / total)[:, None]).mean(axis=0) * shares
        value = (0.5 * (tail + 1.0) * np.log1p(off * off / tail)).mean() + values[-1]
        return float(value), np.append(gradient, 1.0 - (slope * off).mean())

    begun = np.append(np.full(len(SIGNS), np.log(1e-3)), np.log(0.5))
    bounds = [(-25.0, 2.0)] * len(SIGNS) + [(-3.0, 1.0)]
    found = minimize(cost, begun, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 500}).x
    weights = np.sqrt(np.exp(found[:-1]) / usual)
    return np.where((found[:-1] > -14.0) & (usual > 1e-9), weights, 0.0)  # nothing is known of a sign that never shows


def learn_bound(tracks: Sequence[Tracked], least: float = 0.05) -> Learned:
    """Learn the weights, and from where to say it: ``least`` is the share that may be said wrongly.

    With one view of keypoints it is said by the misfit: of other films like these, drawn with replacement, nine in ten
    draws say no more wrongly.
    """
    learned = Learned(learn(tracks), LOST_ERROR)
    if tracks[0].kind == ("silhouettes", 1):
        return learned  # nothing tells good frames: the expected error itself decides
    usual = [track for track in tracks if track.usual]
    said, plain = (float(np.quantile(np.concatenate([measure(track)[~track.off] for track in usual]), 1.0 - least))
                   for measure in (learned.expect, lambda track: find_misfit(track.signs)))  # fmt: skip
    if tracks[0].kind != ("keypoints", 1):
        return learned._replace(said=said, plain=plain)
    films, rng = sorted({track.film for track in usual}), np.random.default_rng(0)
    good = [np.concatenate([find_misfit(track.signs)[~track.off] for track in usual if track.film == film])
            for film in films]  # fmt: skip
    draws = [np.concatenate([good[row] for row in rng.integers(len(good), size=len(good))]) for _ in range(300)]
    surely = float(np.quantile([np.quantile(draw, 1.0 - least) for draw in draws], 0.9))
    return learned._replace(said=surely, plain=plain, by_misfit=True)


def print_curve(name: str, tracks: Sequence[Tracked], learned: Sequence[Learned]) -> None:
    """Print how many frames off are found, each track by its own weights, when so many of the others are said."""
    expected = np.concatenate([own.expect(track) for own, track in zip(learned, tracks, strict=True)])
    said = np.concatenate([own.says(track) for own, track in zip(learned, tracks, strict=True)])
    plain = np.concatenate([find_misfit(track.signs) > own.plain for own, track in zip(learned, tracks, strict=True)])
    actual = np.concatenate([np.nanmean(track.errors, axis=1) for track in tracks])
    off = np.concatenate([track.off for track in tracks])
    cells = [name, f"{off.sum()} of {len(off)}"]
    for share in (0.02, 0.05, 0.1, 0.2, 0.4):
        bound = np.quantile(expected[~off], 1.0 - share) if (~off).any() else np.inf
        cells.append(f"{100 * (expected[off] > bound).mean():.0f}" if off.any() else "")
    cells.append(_tell(said, off))
    cells.append(_tell(plain, off))
    cells += [f"{1e3 * values.mean():.0f}" for values in (expected, actual)]
    print(f"| {' | '.join(cells)} |")


def _tell(said: BoolArray, off: BoolArray) -> str:
    found = f"{100 * said[off].mean():.0f}" if off.any() else "-"
    return f"{found}, {100 * said[~off].mean():.1f}" if (~off).any() else found


def _suits(track: Tracked, what: str | None) -> bool:
    return track.usual if what is None else track.what == what


def report(tuned: Sequence[Tracked], left_out: Sequence[Tracked]) -> None:
    """Print the weights, and the curves of the tracks and of others."""
    print("| | off | found at 2 % said wrongly | 5 | 10 | 20 | 40 | said of these, of the others "
          "| by the misfit alone | expected, mm | actual |\n" + "| --- " * 11 + "|")  # fmt: skip
    for kind in dict.fromkeys(track.kind for track in tuned):
        own = [track for track in tuned if track.kind == kind]
        learned = learn_bound(own)
        films = {film: [track for track in own if track.film != film] for film in {track.film for track in own}}
        others = {film: learn_bound(rest) for film, rest in films.items() if rest}
        for what in (None, *dict.fromkeys(track.what for track in own)):
            name = what or f"{kind[0]}, {kind[1]}"
            rows = [track for track in own if track.film in others and _suits(track, what)]
            if rows:
                print_curve(f"each left out, {name}", rows, [others[track.film] for track in rows])
            rows = [track for track in left_out if track.kind == kind and _suits(track, what)]
            if rows:
                print_curve(f"left out, {name}", rows, [learned] * len(rows))
        print(kind, dict(zip(SIGNS, learned.weights.round(3).tolist(), strict=True)), f"said from {learned.said:.3f} m")
        away = np.concatenate([track.away for track in own])
        if len(away):
            print(f"distance: {np.median(away):.3f} of the true one in the middle, one sigma "
                  f"{1.48 * np.median(np.abs(np.log(away))):.3f}")  # fmt: skip


def track_all(given: argparse.Namespace, people: str, number: int) -> list[Tracked]:
    """Track a clip of silhouettes in all ways; it is made if it is not there."""
    clean = open_clip(given.kept / _name(people, number), given, people, number)
    noisy = disturb(clean, np.random.default_rng(900 * (people != "tuned") + number))
    if people == "tuned":
        return [track(noisy if number % 2 else clean, views, start) for start, views in _STARTS]
    return [track(own, views, "auto") for own in (clean, noisy) for views in _VIEWS]


@cache
def _hash_code() -> str:
    """Return what tells the code of the fit from any other."""
    folder = Path(dousa.estimation.__path__[0])
    # doubt.py holds what is learned here: no fit depends on it.
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".py", ".toml") and path.name != "doubt.py"]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def fit_all(given: argparse.Namespace, people: str, number: int) -> list[Tracked]:
    """Fit a film's keypoints in all ways; the film is made if it is not there, and what was fitted is kept."""
    found = []
    for what, views in _FITS:
        if what not in given.fits.split(","):
            continue
        path = given.kept / "fits" / f"{people.replace(' ', '_')}_{number:03d}_{what}_{views}.npz"
        kept = dict(np.load(path)) if path.is_file() else {}
        if str(kept.get("code")) != _hash_code():
            film = open_film(given.kept / "films" / _name(people, number), given, people, number)
            path.parent.mkdir(parents=True, exist_ok=True)
            own = fit(film, views, what)
            kept = {"signs": own.signs, "errors": own.errors, "away": own.away, "code": np.array(_hash_code())}
            np.savez_compressed(path, **kept)
        found.append(Tracked(kept["signs"], kept["errors"], ("keypoints", min(views, 2)), f"{what}, {views}",
                             away=kept["away"]))  # fmt: skip
    return found


def _name(people: str, number: int) -> str:
    return f"{people.replace(' ', '_')}_{number:03d}.npz"


def open_clip(path: Path, given: argparse.Namespace, people: str, number: int) -> BenchClip:
    """A clip of silhouettes, made if it is not there."""
    if not path.is_file():
        kinds = list_kinds(given.data, RECORDINGS[people])
        seed = 50000 * (1 + list(RECORDINGS).index(people)) + number
        make_clip(path, open_mesh(given.mesh), kinds[number % len(kinds)], seed)
    return read_clip(path)


def open_film(path: Path, given: argparse.Namespace, people: str, number: int) -> Film:
    """A film with keypoints, made if it is not there."""
    if not path.is_file():
        seed = 50777 + 50000 * list(RECORDINGS).index(people)
        kinds = list_kinds(given.data, RECORDINGS[people])
        made = make_film(open_mesh(given.mesh), kinds, number, seed, "full" if number % 2 else "heavy", 30)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **made)  # type: ignore[arg-type]
    return Film(dict(np.load(path)))


def main() -> None:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--cues", default="silhouettes,keypoints")
    parser.add_argument("--clips", type=int, default=30)
    parser.add_argument("--left-out", type=int, default=10)
    parser.add_argument(
        "--fits", default=",".join(dict.fromkeys(what for what, _ in _FITS)), help="of films: which ways"
    )
    given = parser.parse_args()
    tracks: dict[str, list[Tracked]] = {}
    for people, count in (("tuned", given.clips), ("left out", given.left_out)):
        tracks[people] = []
        for number in range(count):
            for cue in given.cues.split(","):
                found = fit_all(given, people, number) if cue == "keypoints" else track_all(given, people, number)
                tracks[people] += [own._replace(film=number) for own in found]
    report(tracks["tuned"], tracks["left out"])


if __name__ == "__main__":
    main()
