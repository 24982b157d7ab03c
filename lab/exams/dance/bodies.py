"""Motions of the exam: bodies that can be edited, and somebody else doing the same well."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J

SEGMENTS = {
    "trunk": ("pelvis", "neck"),
    **{f"{s}_upper_arm": (f"{s}_shoulder", f"{s}_elbow") for s in ("left", "right")},
    **{f"{s}_forearm": (f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")},
    **{f"{s}_thigh": (f"{s}_hip", f"{s}_knee") for s in ("left", "right")},
    **{f"{s}_shank": (f"{s}_knee", f"{s}_ankle") for s in ("left", "right")},
}
NAMES = tuple(SEGMENTS)
START, END = (np.array([J[pair[i]] for pair in SEGMENTS.values()]) for i in (0, 1))
LIMBS = {
    f"{side} {limb}": ([J[f"{side}_{j}"] for j in joints], [NAMES.index(f"{side}_{s}") for s in parts])
    for side in ("left", "right")
    for limb, joints, parts in (
        ("arm", ("elbow", "wrist", "hand"), ("upper_arm", "forearm")),
        ("leg", ("knee", "ankle", "toe"), ("thigh", "shank")),
    )
}
ALL = list(range(len(NAMES)))


def unit(v):
    """Vectors of length 1."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def angle(a, b):
    """Degrees between unit vectors."""
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


def mix(a, b, weight):
    """Directions on the great circle from a (weight 0) to b (weight 1)."""
    weight = np.reshape(weight, np.shape(weight) + (1,) * (a.ndim - np.ndim(weight)))
    apart = np.clip(np.arccos(np.clip((a * b).sum(-1, keepdims=True), -1, 1)), 1e-6, np.pi - 1e-3)
    return unit(np.sin((1 - weight) * apart) * a + np.sin(weight * apart) * b)


def sample(values, at):
    """Values (T, ...) at fractional frames."""
    at = np.clip(at, 0, len(values) - 1)
    low = np.minimum(at.astype(int), max(len(values) - 2, 0))
    share = (at - low).reshape((-1,) + (1,) * (values.ndim - 1))
    return values[low] * (1 - share) + values[np.minimum(low + 1, len(values) - 1)] * share


@dataclass
class Body:
    """A motion as bone directions and lengths, so that edits keep the lengths."""

    dirs: np.ndarray
    lengths: np.ndarray
    root: np.ndarray
    rate: float
    template: object

    @classmethod
    def of(cls, motion):
        """The bones of a canonical motion."""
        step = max(1, round(motion.frame_rate / 60))  # 120 Hz thinned to 60: the exam is to be short
        points = np.array(motion.positions[::step])
        bones = points - points[:, [max(p, 0) for p in CANONICAL_PARENTS]]
        bones[:, 0] = 0
        return cls(unit(bones), np.linalg.norm(bones, axis=2), points[:, 0], motion.frame_rate / step, motion)

    def __len__(self):
        return len(self.dirs)

    def having(self, **changes):
        """A copy with other arrays."""
        return dataclasses.replace(self, **changes)

    def positions(self):
        """(T, 20, 3) joint positions."""
        points = np.empty_like(self.dirs)
        for joint, parent in enumerate(CANONICAL_PARENTS):
            bone = self.lengths[:, joint, None] * self.dirs[:, joint]
            points[:, joint] = self.root if parent < 0 else points[:, parent] + bone
        return points

    def motion(self):
        """As the candidate wants it."""
        points = np.ascontiguousarray(self.positions())
        points.flags.writeable = False
        return dataclasses.replace(self.template, positions=points, frame_rate=self.rate, missing=None, warnings=())

    def segments(self):
        """(T, 9, 3) unit directions of the nine segments."""
        points = self.positions()
        return unit(points[:, END] - points[:, START])

    def heading(self):
        """Radians about the vertical of the hips' axis."""
        points = self.positions()
        across = points[:, J["left_hip"]] - points[:, J["right_hip"]]
        return np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))

    def turned(self, radians):
        """Turned about the vertical, by one angle or one for each frame."""
        turn = Rotation.from_rotvec(np.outer(np.broadcast_to(radians, len(self)), (0, 1, 0))).as_matrix()
        return self.having(
            dirs=np.einsum("tij,tbj->tbi", turn, self.dirs), root=np.einsum("tij,tj->ti", turn, self.root)
        )

    def axes(self, limb):
        """(T, 3, 3) columns left, up, front of the chest or the pelvis that a limb hangs on."""
        points = self.positions()
        part = "shoulder" if "arm" in limb else "hip"
        up = unit(points[:, J["neck"]] - points[:, J["pelvis"]])
        left = points[:, J[f"left_{part}"]] - points[:, J[f"right_{part}"]]
        left = unit(left - (left * up).sum(1, keepdims=True) * up)
        return np.stack([left, up, np.cross(left, up)], axis=2)

    def local(self, limb):
        """(T, 3, 3) directions of a limb's bones in its carrier's axes."""
        return np.einsum("tji,tbj->tbi", self.axes(limb), self.dirs[:, LIMBS[limb][0]])

    def with_local(self, limb, local):
        """With other directions of a limb."""
        dirs = self.dirs.copy()
        dirs[:, LIMBS[limb][0]] = np.einsum("tij,tbj->tbi", self.axes(limb), local)
        return self.having(dirs=dirs)

    def at(self, frames):
        """Another timing: the poses at these fractional frames."""
        return self.having(
            dirs=unit(sample(self.dirs, frames)), lengths=sample(self.lengths, frames), root=sample(self.root, frames)
        )

    def cut(self, a, b):
        """Frames a to b."""
        return self.having(dirs=self.dirs[a:b], lengths=self.lengths[a:b], root=self.root[a:b])


def medley(bodies, pause_s=0.4):
    """One clip after another, each facing as the one before ended, joined by a short passage."""
    whole = bodies[0]
    for clip in bodies[1:]:
        body = clip.turned(whole.heading()[-1] - clip.heading()[0])
        move = whole.root[-1] - body.root[0]
        body = body.having(root=body.root + np.array([move[0], 0, move[2]]))
        n = round(pause_s * whole.rate)
        w = smooth_step(np.arange(1, n + 1) / (n + 1))
        lin = w[:, None]
        between = mix(np.repeat(whole.dirs[-1:], n, 0), np.repeat(body.dirs[:1], n, 0), w)
        whole = whole.having(
            dirs=np.concatenate([whole.dirs, between, body.dirs]),
            lengths=np.concatenate(
                [whole.lengths, (1 - lin) * whole.lengths[-1] + lin * body.lengths[0], body.lengths]
            ),
            root=np.concatenate([whole.root, (1 - lin) * whole.root[-1] + lin * body.root[0], body.root]),
        )
    return whole


def smooth_step(x):
    """0 to 1 with level ends."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def performer(body, rng):
    """Somebody else doing it well: posture and tempo wander, another build, another facing."""
    n, rate = len(body), body.rate

    def wander(size, rms, scale_s):
        noise = gaussian_filter1d(rng.standard_normal((n + 200, *size)), scale_s * rate, axis=0)[100:-100]
        return noise * rms / max(float(noise.std()), 1e-9)

    jitter = wander((), rng.uniform(0.010, 0.030), rng.uniform(0.6, 1.2)) * rate
    body = body.at(np.arange(n) + jitter)
    vectors = wander((20, 3), np.radians(rng.uniform(2, 3)) / np.sqrt(2), rng.uniform(0.3, 0.7))
    turn = Rotation.from_rotvec(vectors.reshape(-1, 3))
    build = rng.uniform(0.95, 1.05, 20)
    build[[J[f"right_{k}"] for k in ("elbow", "wrist", "knee", "ankle")]] = build[
        [J[f"left_{k}"] for k in ("elbow", "wrist", "knee", "ankle")]
    ]
    body = body.having(
        dirs=turn.apply(body.dirs.reshape(-1, 3)).reshape(n, 20, 3),
        lengths=body.lengths * build * rng.uniform(0.9, 1.1),
    )
    return body.turned(rng.uniform(-np.pi, np.pi))
