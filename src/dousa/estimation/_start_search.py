"""The search for a pose without any pose to begin with: templates, sweeps, limbs exchanged, twins."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dousa.estimation._placing import Outline, guess_place, move_onto, turn_about
from dousa.estimation._templates import find_limbs, is_person, list_templates, mirror_twins
from dousa.estimation._types import TrackerSettings
from dousa.estimation._working import Frame, Workshop
from dousa.estimation.kinematics import compute_points

__all__ = ["Scored", "StartSearch"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Scored = tuple[float, FloatArray]

_HEADINGS = 16
_FIRST, _SECOND, _LAST = 20, 8, 4  # poses kept from step to step
_APART = 0.03  # statures, mean distance of joints: nearer poses are one
_LIMBS_TRIED, _LIMBS_APART = 5, 0.35  # templates searched for each limb; rad
# dR of the sweeps of each step.
_WIDE, _NARROW, _TWIN, _LIMB, _FINE = (1.5, 1.0), (1.0, 0.5), (1.5, 1.0, 0.5), (1.5, 0.75, 0.4), (0.5, 0.25)
_STEPS = 5
_LEVEL = 0.1  # a camera that looks straight down or up tells no front from back


class StartSearch:
    """The silhouettes of one frame, and a body that is looked for in them.

    Parameters
    ----------
    workshop : the body before its cameras.
    frame : the silhouettes as the workshop packs them.
    outlines : (V,) box and centre of each silhouette; None where nobody is seen.
    """

    def __init__(self, workshop: Workshop, frame: Frame, outlines: Sequence[Outline | None]) -> None:
        self.body, self.cameras = workshop.body, workshop.cameras
        self.frame, self.outlines = frame, outlines
        area = float(np.bitwise_count(frame.bits).sum()) / max(int(frame.seen.sum()), 1)
        self.shop = Workshop(self.body, self.cameras, _own_settings(workshop.settings), 30.0, area)
        self.scratch = self.shop.make_scratch()
        self.still = np.zeros(self.shop.n_axes)
        self.limbs = find_limbs(self.body)

    @property
    def templates(self) -> FloatArray:
        """See `list_templates`."""
        return list_templates(self.body)

    def run(self, near: FloatArray | None, tell: Callable[[int, int, str], None]) -> list[Scored]:
        """From nothing (or a pose of some time ago) to a few refined poses, best first."""
        what = "looking for the first pose"
        tell(0, _STEPS, what)
        found = self.keep([(self.score(pose), pose) for pose in self._list_candidates(near)], _FIRST)
        tell(1, _STEPS, what)
        found = self.keep([self.refine(pose, _WIDE) for _, pose in found], _SECOND)
        tell(2, _STEPS, what)
        found = self.keep([self.refine(self._exchange_limbs(pose), _NARROW) for _, pose in found], _LAST)
        tell(3, _STEPS, what)
        if is_person(self.body):
            twins = [self.refine(twin, _TWIN) for _, pose in found for twin in self._list_twins(pose)]
            found = self.keep(found + twins, _LAST)
        tell(4, _STEPS, what)
        found = self.keep([self.refine(self._exchange_limbs(pose), _NARROW) for _, pose in found], _LAST)
        tell(_STEPS, _STEPS, what)
        return found

    def finish(self, found: Sequence[Scored], count: int) -> list[Scored]:
        """The last fine sweeps, and the ``count`` best of what is then still different."""
        return self.keep([self.refine(pose, _FINE) for _, pose in found], count)

    def score(self, pose: FloatArray) -> float:
        """Log score of image, ease and floor."""
        return self.shop.score(pose, self.still, self.frame, self.scratch)

    def refine(self, pose: FloatArray, factors: Sequence[float]) -> Scored:
        """Score and pose after sweeps of these widths, none held back by those before."""
        pose = pose.copy()
        for factor in factors:
            self._sweep(pose, factor)
            pose[3:7] /= np.linalg.norm(pose[3:7])
        return self.score(pose), pose

    def keep(self, found: Sequence[Scored], count: int) -> list[Scored]:
        """The best ``count`` that are not nearly the same."""
        ordered = sorted(found, key=lambda pair: -pair[0])
        points = compute_points(self.body, np.array([pose for _, pose in ordered]))
        kept: list[int] = []
        for index in range(len(ordered)):
            if len(kept) == count:
                break
            off = np.linalg.norm(points[kept] - points[index], axis=-1).mean(axis=-1)
            if not (off < _APART * self.body.stature).any():
                kept.append(index)
        return [ordered[index] for index in kept]

    def measure_overlap(self, pose: FloatArray) -> float:
        """Mean intersection over union of the views that see somebody."""
        from dousa.estimation.rasteriser import draw_body, pack_bits

        shares = []
        for view in np.flatnonzero(self.frame.seen):
            drawn = pack_bits(draw_body(self.body, pose, self.cameras[view])[0])
            bits = self.frame.bits[view, : drawn.shape[0], : drawn.shape[1]]
            both, either = np.bitwise_count(drawn & bits).sum(), np.bitwise_count(drawn | bits).sum()
            shares.append(float(both) / max(float(either), 1.0))
        return float(np.mean(shares))

    def _sweep(self, pose: FloatArray, factor: float) -> None:
        self.shop.sweep(pose, np.zeros(self.shop.n_axes), factor, self.frame, self.scratch)

    def _list_candidates(self, near: FloatArray | None) -> FloatArray:
        """Templates (N, 7 + A) in all headings, laid onto the silhouettes."""
        place = guess_place(self.cameras, self.outlines, self.body.stature)
        templates = self.templates if near is None else np.concatenate((self.templates, near[None]))
        turned = [turn_about(templates, 2.0 * np.pi * k / _HEADINGS) for k in range(_HEADINGS)]
        moved = move_onto(self.body, np.concatenate(turned), place, self.cameras, self.outlines)
        return moved if near is None else np.concatenate((moved, near[None]))

    def _exchange_limbs(self, pose: FloatArray) -> FloatArray:
        """Each limb as it is in the template where it fits best after a search of its own."""
        pose, templates = pose.copy(), self.templates
        whole = self.shop.order
        for limb, parts in self.limbs:
            best, kept = self.score(pose), pose[limb].copy()
            scores = np.empty(len(templates))
            for number, template in enumerate(templates):
                pose[limb] = template[limb]
                scores[number] = self.score(pose)
            self.shop.order = parts
            for number in _pick_limbs(templates[:, limb], scores):
                pose[limb] = templates[number, limb]
                for factor in _LIMB:
                    self._sweep(pose, factor)
                score = self.score(pose)
                if score > best:
                    best, kept = score, pose[limb].copy()
            self.shop.order = whole
            pose[limb] = kept
        return pose

    def _list_twins(self, pose: FloatArray) -> list[FloatArray]:
        """What the first view that sees somebody could mistake for the pose."""
        seen = [camera for camera, found in zip(self.cameras, self.outlines, strict=True) if found]
        towards = seen[0].rotation[2] * (1.0, 0.0, 1.0)
        length = float(np.linalg.norm(towards))
        return mirror_twins(self.body, pose, towards / length) if length > _LEVEL else []


def _pick_limbs(limbs: FloatArray, scores: FloatArray) -> list[int]:
    """Numbers of the templates whose limbs (N, n) rad fit best, all different."""
    chosen: list[int] = []
    for number in np.argsort(-scores, kind="stable"):
        if len(chosen) == _LIMBS_TRIED:
            break
        if not (np.abs(limbs[chosen] - limbs[number]).max(axis=1) < _LIMBS_APART).any():
            chosen.append(int(number))
    return chosen


def _own_settings(settings: TrackerSettings) -> TrackerSettings:
    """The default tracker without inertia, whatever tracks afterwards."""
    usual = TrackerSettings()
    return dataclasses.replace(
        usual, inertia=0.0, floor=settings.floor, stiffness=max(settings.stiffness, usual.stiffness)
    )
