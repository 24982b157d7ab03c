"""Errors of joint angles on films of made-up people, in degrees.

    python -m lab.trials.degrees --kept FOLDER [--mesh FOLDER] [--people tuned|kept] [--films N] [--views 4,2,1]
        [--cues ...] [--noise 2,4,8]

People of random shape and clothes (see `lab.trials.person_maker`; ``--mesh`` as in `lab.trials.made_people`) move
before four phones that stand anywhere on a ring: 720 x 960 pixels, 30 Hz, rolled by up to 8 degrees, with a lens that
bends lines and the noise of a dim room. ``tuned`` wear recordings of HDM05's dg, and of UI-PRMD's (Vicon) people 4 and
5, on which the fit was chosen; ``kept`` those of bd and bk, and of people 1 to 3. Cameras are known. Needs the models
(``dousa keypoints --install``). Prints for each number of views

- keypoints: our fit, by BlazePose's heavy model; the stature is told with one view only;
- silhouettes: our tracker, on masks of 240 x 320 with ragged edges and blots; the stature is told, the start is found;
- plain: the same keypoints, triangulated linearly (with one view: the network's places in space, put where they fit the
  picture), smoothed at 6 Hz, and inverse kinematics of a body with the median lengths;
- joints, and plain joints: likewise of points that are the joints themselves but for noise of ``--noise`` pixels (4),
  as of a network other than BlazePose; several views only. Asked for these alone, people are made without pictures, and
  no model is needed.

Columns: mm of 12 joints, and with the hips in place; legs: mean of the knee's flexion and of the angle between thigh
and trunk; arms: of elbow and upper arm likewise; then the coordinates of docs/opensim.md by joint, flexion and other
planes; of the shoulder the direction of the upper arm in the trunk's axes, and its turn about itself where the elbow is
bent by 20 degrees. Views are those of `lab.estimation.clips.choose_views`. Below a row of fits with several views:
how far the stature is off, and how many statures and lengths lie within 1.64 of the said spread (nine of ten should).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.signal import butter, sosfiltfilt

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation import MEDIAPIPE_NAMES, Camera, PersonTrack, estimate, fit_keypoints, make_human, make_ring
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names
from dousa.estimation.body.posing import fit_poses
from dousa.estimation.body.skeleton_body import fit_body
from dousa.estimation.keypoints.pose_models import LandmarkModel
from dousa.estimation.multiview.keypoint_fit import place_world
from dousa.estimation.multiview.landmarks import gather
from dousa.estimation.multiview.triangulation import reduce_known
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.formats.opensim import body_at_rest, compute_coordinates
from dousa.motion import Motion
from dousa.motion import rotations as rot
from dousa.motion.resampling import fill_gaps
from lab.estimation.clips import choose_views
from lab.trials.made_people import Film, find_points, keep_film
from lab.trials.person_maker import N_BODY, Mesh, draw_mask, list_kinds, make_parser, move_person, open_mesh

_RATE, _FRAMES, _SIZE, _SMALL = 30.0, 45, (720, 960), 3
_DIMNESS, _ROLL, _BEND, _STRAIGHT = 6.0, np.deg2rad(8.0), 0.12, 20.0
_NINE_OF_TEN = 1.64  # sigmas of a normal distribution
# fmt: off
_PEOPLE = {
    "kept": ["hdm05/*/HDM_b[dk]_*.[aA][mM][cC]", "uiprmd/vicon/*/correct/*_s0[123]_*.trc"],
    "tuned": ["hdm05/*/HDM_dg_*.[aA][mM][cC]", "uiprmd/vicon/*/correct/*_s0[45]_*.trc"],
}
_OWNERS = {"pelvis": "pelvis", "spine": "trunk", "hip": "thigh", "knee": "shank", "ankle": "foot",
           "shoulder": "upper_arm", "elbow": "forearm"}
COLUMNS = {"mm": (), "hips in place": (), "legs": (), "arms": (),
           "hip flexion": ("hip_flexion",), "hip other": ("hip_adduction", "hip_rotation"), "knee": ("knee_angle",),
           "ankle": ("ankle_angle",), "upper arm": (), "arm rotation": (), "elbow": ("elbow_flex",)}
# fmt: on


def make_film(
    mesh: Mesh,
    motions: list[list[Path]],
    number: int,
    seed: int,
    model: LandmarkModel | None = "heavy",
    n_frames: int = _FRAMES,
) -> dict[str, FloatArray]:
    """One person before four phones: what is true, and what the network finds and masks, without a model neither."""
    rng = np.random.default_rng(seed + number)
    moved = move_person(mesh, motions[number % len(motions)], rng, _RATE, n_frames)
    distance = rng.uniform(3.2, 4.6) + 1.5 * max(0.0, moved.reach - 0.4)
    ring = make_ring(4, distance=distance, height=rng.uniform(0.8, 1.8), size=_SIZE, first_angle=rng.uniform(0, 6),
                     focal=rng.uniform(0.95, 1.2) * 0.3 * _SIZE[1] * distance)  # fmt: skip
    cameras = [_hold(camera, rng) for camera in ring]
    if model is None:
        size = (len(moved.turns), len(MEDIAPIPE_NAMES))
        return keep_film(moved, cameras, [PersonTrack(np.full((*size, 2), np.nan), np.zeros(size))] * len(cameras))
    tracks = [find_points(camera, mesh, moved.person, moved.vertices, rng, _RATE, _DIMNESS, model)
              for camera in cameras]  # fmt: skip
    faces = mesh.faces[(mesh.faces < N_BODY).all(axis=1)]
    masks = [[_roughen(draw_mask(shrink(camera), faces, vertices), rng) for vertices in moved.vertices]
             for camera in cameras]  # fmt: skip
    return keep_film(moved, cameras, tracks) | {"masks": np.packbits(np.array(masks), axis=3)}


def _hold(camera: Camera, rng: np.random.Generator) -> Camera:
    """Roll a camera, and give it a lens."""
    turn = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-_ROLL, _ROLL)]))[0]
    bend = np.array([rng.uniform(-_BEND, _BEND), 0.0, 0.0, 0.0, 0.0])
    return replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation, distortion=bend)


def shrink(camera: Camera) -> Camera:
    """The camera of the masks, as `Camera` has its pixel centres."""
    matrix = camera.matrix.copy()
    matrix[:2, :2] /= _SMALL
    matrix[:2, 2] = (matrix[:2, 2] + 0.5) / _SMALL - 0.5
    return replace(camera, width=_SIZE[0] // _SMALL, height=_SIZE[1] // _SMALL, matrix=matrix)


def _roughen(mask: BoolArray, rng: np.random.Generator) -> BoolArray:
    """Ragged edges, holes and blots, as of a difference of pictures."""
    noise = cv2.GaussianBlur(rng.normal(0, 1, mask.shape), (0, 0), 1.5)
    edge = cv2.GaussianBlur(mask.astype(np.float64), (0, 0), 1.2) + 0.25 * noise / noise.std()
    blots = cv2.GaussianBlur(rng.normal(0, 1, mask.shape), (0, 0), 2.0)
    return np.asarray((edge > 0.5) ^ (blots > 3.6 * blots.std()))


def coordinates_of(names: tuple[str, ...], turns: FloatArray, rate: float) -> dict[str, FloatArray]:
    """Coordinates of parts turned (T, P, 3, 3) from standing straight, by the one convention there is."""
    body = body_at_rest()
    local = rot.identity((len(turns), body.n_joints))
    world = {name: turns[:, names.index(owner)] for name in body.names if (owner := _find_owner(name))}
    for row, name in enumerate(body.names):
        if name in world:
            above = world[body.names[body.parents[row]]] if row else np.broadcast_to(np.eye(3), world[name].shape)
            local[:, row] = rot.from_matrix(np.swapaxes(above, -1, -2) @ world[name])
    places = np.tile(body.offsets, (len(turns), 1, 1))
    return compute_coordinates(Motion(body, local, places, rate))


def _find_owner(joint: str) -> str:
    """The part that turns about a joint; "" for none that is compared."""
    side, _, end = joint.rpartition("_")
    return "" if end not in _OWNERS else f"{side}_{_OWNERS[end]}".removeprefix("_")


def measure(film: Film, body: BodyModel, poses: FloatArray, places: FloatArray | None = None) -> dict[str, FloatArray]:
    """Errors (T,) of each column; ``places`` (T, 12, 3) m where they are not those of the poses."""
    names = list(film.joints)
    points = compute_points(body, poses)[:, [point_names(body).index(name) for name in names]]
    found, true = points if places is None else places, film.truth
    hips = [names.index("left_hip"), names.index("right_hip")]
    posed = found + (true - found)[:, hips].mean(axis=1, keepdims=True)
    errors: dict[str, list[FloatArray]] = defaultdict(list)
    errors["mm"] = [1e3 * np.linalg.norm(found - true, axis=2).mean(axis=1)]
    errors["hips in place"] = [1e3 * np.linalg.norm(posed - true, axis=2).mean(axis=1)]
    turns = place_parts(body, poses)[0]
    everything = (turns, tuple(body.names)), (film.kept["turns"], tuple(film.parts))
    ours, truth = (coordinates_of(parts, t, film.rate) for t, parts in everything)
    for column, coordinates in COLUMNS.items():
        for name in [name for name in ours if name[:-2] in coordinates]:
            errors[column].append(_difference(ours, truth, name))
    for side in ("left_", "right_"):
        knee, elbow = (_difference(ours, truth, f"{name}_{side[0]}") for name in ("knee_angle", "elbow_flex"))
        (thigh, true_thigh), (arm, true_arm) = (
            [np.swapaxes(t[:, parts.index("trunk")], -1, -2) @ t[:, parts.index(side + part)]
             for t, parts in everything] for part in ("thigh", "upper_arm")
        )  # fmt: skip
        errors["legs"] += [knee, np.abs(_bend(thigh) - _bend(true_thigh))]
        errors["arms"] += [elbow, np.abs(_bend(arm) - _bend(true_arm))]
        errors["upper arm"].append(np.degrees(np.arccos(np.clip((arm[..., 1] * true_arm[..., 1]).sum(axis=1), -1, 1))))
        twist = rot.to_axis_angle(rot.from_matrix(np.swapaxes(true_arm, -1, -2) @ arm))[:, 1]
        bent = truth[f"elbow_flex_{side[0]}"] > _STRAIGHT
        errors["arm rotation"].append(np.where(bent, np.abs(np.degrees(twist)), np.nan))
    return {column: reduce_known(np.nanmean, np.stack(values), 0) for column, values in errors.items()}


def _difference(ours: dict[str, FloatArray], truth: dict[str, FloatArray], name: str) -> FloatArray:
    return np.abs((ours[name] - truth[name] + 180) % 360 - 180)


def _bend(turned: FloatArray) -> FloatArray:
    """Degrees between a limb and the trunk."""
    return np.degrees(np.arccos(np.clip(turned[:, 1, 1], -1, 1)))


def see_joints(film: Film, camera: Camera, seed: int, noise: float) -> PersonTrack:
    """The true joints in a picture, with noise (px)."""
    points = camera.project(film.truth)
    points = points + np.random.default_rng(seed).normal(0, noise, points.shape)
    return PersonTrack(points, np.ones(points.shape[:2]), None)


def fit_plainly(
    film: Film, cameras: list[Camera], tracks: list[PersonTrack], points: Sequence[str]
) -> tuple[BodyModel, FloatArray, FloatArray]:
    """The baseline: body, poses, and places (T, 12, 3) m before them; ``points`` are the keypoints' names."""
    seen = gather(tracks, points, len(film.truth))
    if len(cameras) > 1:
        places = _triangulate(cameras, seen.points, seen.visibility)
    else:
        places = place_world(cameras[0], seen.points[0], seen.visibility[0], seen.world[0])
    places = fill_gaps(places)
    known = np.isfinite(places[:, :, 0]).all(axis=0)
    places[:, known] = sosfiltfilt(butter(2, 6.0, fs=film.rate, output="sos"), places[:, known], axis=0)
    names = [name for name, good in zip(seen.names, known, strict=True) if good]
    rows = dict(zip(names, np.swapaxes(places[:, known], 0, 1), strict=True))
    usual = make_human(film.stature)
    joints = [
        name for name in names if name in point_names(usual) and not name.endswith(("toe", "hand", "neck", "head"))
    ]
    body = fit_body(usual, {name: rows[name] for name in joints})
    poses, _ = fit_poses(body, np.stack([rows[name] for name in joints], axis=1), joints)
    return body, poses, np.stack([rows[name] for name in film.joints], axis=1)


def _triangulate(cameras: list[Camera], points: FloatArray, visibility: FloatArray) -> FloatArray:
    """The points (T, L, 3) nearest to all rays, by weight."""
    square, right = np.zeros((*points.shape[1:3], 3, 3)), np.zeros((*points.shape[1:3], 3))
    for camera, own, weight in zip(cameras, points, visibility, strict=True):
        start, way = camera.compute_rays(np.nan_to_num(own))
        good = np.where(np.isfinite(own[..., 0]), weight, 0.0)
        across = good[..., None, None] * (np.eye(3) - way[..., :, None] * way[..., None, :])
        square, right = square + across, right + (across @ start[..., None])[..., 0]
    found = np.linalg.solve(square + 1e-9 * np.eye(3), right[..., None])[..., 0]
    found[(np.nan_to_num(visibility) > 0).sum(axis=0) < 2] = np.nan
    return np.asarray(found)


def fit_film(film: Film, cue: str, views: list[int]) -> dict[str, FloatArray]:
    """Errors of one way to fit; of joints the last word is the noise in px."""
    cameras = [film.cameras[view] for view in views]
    tracks, points = [film.tracks[view] for view in views], MEDIAPIPE_NAMES
    if "joints" in cue:
        noise, points = float(cue.rsplit(maxsplit=1)[-1]), tuple(film.joints)
        tracks = [see_joints(film, film.cameras[view], view, noise) for view in views]
    if cue.startswith("plain"):
        return measure(film, *fit_plainly(film, cameras, tracks, points))
    if cue != "silhouettes":
        found = fit_keypoints(cameras, tracks, points, film.rate,
                              stature=film.stature if len(views) == 1 else None).estimate  # fmt: skip
    else:
        small = [shrink(camera) for camera in cameras]
        masks = [film.kept["masks"][view] for view in views]
        names = [camera.name for camera in cameras]
        seen = PackedSilhouettes.from_packed(masks, [camera.size for camera in small], film.rate, names)
        found = estimate(seen, small, make_human(film.stature), n_threads=1)
    errors = measure(film, found.body, found.poses)
    if cue == "silhouettes":
        return errors
    true = {"stature": film.stature} | film.lengths
    off, said = np.array([(np.log(found.lengths[name][0] / value), found.lengths[name][1] / value)
                          for name, value in true.items()]).T  # fmt: skip
    return errors | {"stature": off[:1], "sigmas": off / np.maximum(said, 1e-9)}


def print_table(films: dict[str, Film], cues: list[str], counts: list[int], *, each: bool) -> None:
    """Print means of films."""
    print("| views | cue | " + " | ".join(COLUMNS) + " | films |\n" + "| --- " * (len(COLUMNS) + 3) + "|")
    for count in counts:
        for cue in cues:
            if count == 1 and "joints" in cue:
                continue
            rows, small, sigmas = [], [], []
            for name, film in films.items():
                views = list(choose_views(film.cameras, count))
                try:
                    errors = fit_film(film, cue, views)
                except Exception as error:  # a film that is refused is told, and left out
                    print(f"  {name} {cue} {count}: {type(error).__name__} {error}")
                    continue
                rows.append([float(reduce_known(np.nanmean, errors[column], 0)) for column in COLUMNS])
                if "sigmas" in errors:
                    small.append(errors["stature"][0])
                    sigmas.append(np.abs(errors["sigmas"]) < _NINE_OF_TEN)
                if each:
                    print(f"  {name}", cue, count, np.round(rows[-1], 1))
            values = " | ".join(f"{value:.1f}" for value in reduce_known(np.nanmean, np.array(rows), 0))
            print(f"| {count} | {cue} | {values} | {len(rows)} |", flush=True)
            if small and count > 1:
                good = np.array(sigmas)
                print(f"  stature: {100 * np.mean(small):+.1f} %, spread {100 * np.std(small):.1f} %;", end=" ")
                print(f"within 1.64 spreads {good[:, 0].sum()} of {len(good)}, lengths {good[:, 1:].mean():.0%}")


def main() -> None:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--people", choices=list(_PEOPLE), default="kept")
    parser.add_argument("--films", type=int, default=12)
    parser.add_argument("--views", default="4,2,1")
    parser.add_argument("--cues", default="keypoints,silhouettes,plain,joints,plain joints")
    parser.add_argument("--noise", default="4", help="of joints, px")
    parser.add_argument("--each", action="store_true", help="print every film too")
    given = parser.parse_args()
    kinds, films = list_kinds(given.data, _PEOPLE[given.people]), {}
    cues = [f"{cue} {noise}" if cue.endswith("joints") else cue for cue in given.cues.split(",")
            for noise in (given.noise.split(",") if cue.endswith("joints") else "1")]  # fmt: skip
    bare = all("joints" in cue for cue in cues)
    for number in range(given.films):
        path = given.kept / f"{given.people}{'_joints' * bare}_{number:03d}.npz"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            other = list(_PEOPLE).index(given.people)
            if bare:
                made = make_film(open_mesh(given.mesh), kinds, number, 61_000 - 30_000 * other, None, 30)
            else:
                made = make_film(open_mesh(given.mesh), kinds, number, 50_000 + 10_000 * other)
            np.savez_compressed(path, **made)  # type: ignore[arg-type]
        films[path.stem] = Film(dict(np.load(path)))
    print_table(films, cues, [int(count) for count in given.views.split(",")], each=given.each)


if __name__ == "__main__":
    main()
