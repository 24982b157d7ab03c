"""Landmarks: the places of keypoints on the body, and their spread in networks.

Places are in statures in the axes of the part (see ``anthropometry.toml``). They were measured on synthetic films of
synthetic people with known joints (``lab/trials/made_people.py``: BlazePose's heavy model, meshes of MakeHuman in poses
of HDM05 and Bandai Namco). The shift of a group of points in a film is estimated (`body_fit`). The joints of other
networks are taken as they are: a film then moves the body's hips and shoulders onto the points instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import KeypointError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.keypoints.keypoints import PersonTrack

# Measured by python -m lab.trials.made_people.
_MIDDLE: dict[str, tuple[str, tuple[float, float, float], float, str]] = {
    "nose": ("head", (0.0, 0.066, 0.086), 0.025, "head"),
    "neck": ("head", (0.0, 0.0, 0.0), 0.035, "neck"),
    "head": ("head", (0.0, 0.140, 0.018), 0.035, "crown"),
}
# Measured by python -m lab.trials.made_people.
_LEFT: dict[str, tuple[str, tuple[float, float, float], float, str]] = {
    "eye": ("head", (0.014, 0.084, 0.072), 0.025, "head"),
    "ear": ("head", (0.028, 0.076, 0.044), 0.025, "head"),
    "mouth": ("head", (0.009, 0.047, 0.076), 0.025, "head"),
    "shoulder": ("upper_arm", (0.0, 0.0175, 0.0), 0.03, "shoulder"),
    "elbow": ("forearm", (0.0, 0.0, 0.006), 0.03, "elbow"),
    "wrist": ("hand", (0.0, -0.005, 0.0025), 0.025, "wrist"),
    "hand": ("hand", (-0.006, -0.047, -0.004), 0.03, "hand"),
    "hip": ("thigh", (0.005, -0.002, 0.010), 0.035, "hip"),
    "knee": ("shank", (-0.002, -0.0025, -0.005), 0.03, "knee"),
    "ankle": ("foot", (0.001, 0.0125, 0.0015), 0.025, "ankle"),
    "heel": ("foot", (-0.001, -0.024, -0.019), 0.03, "heel"),
    "toe": ("foot", (-0.004, -0.031, 0.096), 0.03, "toe"),
}
"""Point -> part, place, m by which networks are off, and the group of points that are off together."""

SHIFTS = {"head": 0.015, "neck": 0.03, "crown": 0.03, "shoulder": 0.015, "elbow": 0.008, "wrist": 0.006,
          "hand": 0.01, "hip": 0.02, "knee": 0.012, "ankle": 0.008, "heel": 0.01, "toe": 0.01}  # fmt: skip
"""m, how far the points of a group lie beside their places from person to person (python -m lab.trials.made_people)."""

JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Points that are joints of the body, by definition."""

BREADTHS = {"hip_breadth": 0.103, "shoulder_breadth": 0.210}
"""Statures between the joints of both sides: hips by Harrington and others (2007) for a pelvis 240 mm wide, shoulders
18 mm within the acromia (Gordon and others, ANSUR II, 2012), below which de Leva (1996) has them too."""

# Of a side; the first there is.
_SOURCES = {
    "mouth": ("mouth_{}",), "hand": ("{}_index {}_pinky",), "toe": ("{}_foot_index", "{}_big_toe {}_small_toe"),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Points on a body that keypoints show.

    Parameters
    ----------
    names : (L,), such as ``"left_hip"``.
    parts : (L,) of the body.
    places : (L, 3) m in the part's axes.
    spread : (L,) m, one sigma of a network's errors where points are seen well.
    groups : (L,) name of the group with a common shift, "" for points that are joints.
    """

    names: tuple[str, ...]
    parts: IndexArray
    places: FloatArray
    spread: FloatArray
    groups: tuple[str, ...]

    def shifted(self, shifts: dict[str, FloatArray]) -> Landmarks:
        """Return landmarks with groups shifted by (3,) m to the left, up and ahead, mirrored on the right."""
        places = self.places.copy()
        for row, (name, group) in enumerate(zip(self.names, self.groups, strict=True)):
            if group in shifts:
                side = -1.0 if name.startswith("right_") else 1.0
                places[row] += shifts[group] * np.array([side, 1.0, 1.0])
        return replace(self, places=places)


def join(one: Landmarks, other: Landmarks) -> Landmarks:
    """Return the points of both."""
    parts, places = np.concatenate((one.parts, other.parts)), np.concatenate((one.places, other.places))
    spread = np.concatenate((one.spread, other.spread))
    return Landmarks(one.names + other.names, parts, places, spread, one.groups + other.groups)


def lie_beside_joints(names: Sequence[str]) -> bool:
    """Return whether landmarks lie where BlazePose has them, which alone has corners of the mouth."""
    return "left_mouth" in names


def find_sources(names: Sequence[str], least: int = 6) -> dict[str, tuple[int, ...]]:
    """Return for each landmark the keypoints whose mean it is; KeypointError for less than ``least`` of a body's."""
    place = {name: row for row, name in enumerate(names)}
    found: dict[str, tuple[int, ...]] = {name: (place[name],) for name in _MIDDLE if name in place}
    for point in _LEFT:
        for side in ("left", "right"):
            for words in (*_SOURCES.get(point, ()), f"{{}}_{point}"):
                sources = words.format(side, side).split()
                if all(source in place for source in sources):
                    found[f"{side}_{point}"] = tuple(place[source] for source in sources)
                    break
    if sum(name.split("_")[-1] in JOINTS for name in found) < least:
        raise KeypointError("multiview.no_body", names=tuple(names))
    return found


def place_landmarks(body: BodyModel, names: Sequence[str]) -> Landmarks:
    """Return the landmarks of these names on a person's body.

    Parameters
    ----------
    body : with the parts of `make_human`.
    names : of `find_sources`.

    Raises
    ------
    KeypointError : the body lacks the parts of a person.
    """
    rows, beside = [], lie_beside_joints(names)
    for name in names:
        side, _, point = name.rpartition("_")
        part, place, spread, group = _LEFT[point] if side else _MIDDLE[name]
        if point in JOINTS and not beside:
            place = (0.0, 0.0, 0.0)
        owner = part if part in body.names else f"{side}_{part}"
        if owner not in body.names:
            raise KeypointError("multiview.no_part", part=owner)
        mirror = -1.0 if side == "right" else 1.0
        row = body.names.index(owner)
        at = body.stature * np.array((mirror * place[0], place[1], place[2]))
        if point == "shoulder":  # it goes with the trunk, whose joint it is near
            at, row = at + body.offsets[row], int(body.parents[row])
        rows.append((row, at, spread, group))
    parts, places, spreads, groups = zip(*rows, strict=True)
    return Landmarks(tuple(names), np.array(parts), np.array(places), np.array(spreads), tuple(groups))


@dataclass(frozen=True, slots=True, eq=False)
class SeenLandmarks:
    """Landmarks in the images of V views at T moments.

    Parameters
    ----------
    names : (L,).
    points : (V, T, L, 2) px, nan where not seen.
    visibility : (V, T, L) 0 to 1.
    world : (V, T, L, 3) m, the network's places in space about the hips along the camera's axes; nan without.
    """

    names: tuple[str, ...]
    points: FloatArray
    visibility: FloatArray
    world: FloatArray

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(V, T, L) whether there is a point."""
        return np.asarray(np.isfinite(self.points[..., 0]))

    @property
    def n_views(self) -> int:
        """How many views show the person."""
        return int(self.seen.any(axis=(1, 2)).sum())


def gather(tracks: Sequence[PersonTrack | None], names: Sequence[str], n_frames: int) -> SeenLandmarks:
    """Return the landmarks of one person in all views.

    Parameters
    ----------
    tracks : (V,) of the person, of T frames at the same moments; None where a view does not show the person.
    names : (K,) of the keypoints.
    n_frames : T.
    """
    sources = find_sources(names)
    shape = (len(tracks), n_frames, len(sources))
    points, visibility, world = np.full((*shape, 2), np.nan), np.zeros(shape), np.full((*shape, 3), np.nan)
    for view, track in enumerate(tracks):
        if track is None:
            continue
        for row, rows in enumerate(sources.values()):
            points[view, :, row] = track.points[:, rows].mean(axis=1)
            visibility[view, :, row] = track.visibility[:, rows].min(axis=1)
            if track.world is not None:
                world[view, :, row] = track.world[:, rows].mean(axis=1)
    visibility[~np.isfinite(points[..., 0])] = 0.0
    return SeenLandmarks(tuple(sources), points, visibility, world)
