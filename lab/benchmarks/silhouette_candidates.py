"""Candidates of one limb, scored against a silhouette of 320 x 240 pixels, on one thread.

    python -m lab.benchmarks.silhouette_candidates [--candidates N]

A limb is turned about one axis to N angles; each candidate is posed, projected, drawn and its pixels compared with the
silhouette (the mismatch of eq. 2, plain reading). Prints for each limb

- ours: the kernels of the tracker, everything included;
- the whole search of the limb's axes by the tracker's own pass, with P_fixed drawn and the evidence made anew;
- OpenCV as it is usually written: discs projected, their hull as a polygon, `fillConvexPoly`, xor and `countNonZero` on
  the full image;
- the same with the polygons given, so that nothing but OpenCV's own calls is timed; and once more within the polygon's
  bounding box only, which nobody writes, but which is fair.

OpenCV is told to use one thread. Both count the same pixels but for the outline, which OpenCV draws a pixel wide: the
program checks that they differ by no more than the outline's length. Goal: 100 times OpenCV as it is usually written.
"""

from __future__ import annotations

import argparse

import cv2
import numpy as np
from numba import njit

from dousa.estimation import TrackerSettings, make_human, make_ring, standing_state
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.raster.rasteriser import draw_body, outline_part
from dousa.estimation.tracking.search_kernels import count_parts, fill_evidence, move_axis
from dousa.estimation.tracking.search_kernels import place_parts as hang_parts
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import READINGS
from lab.benchmarks.timing import best_of, timed

SIZE = (320, 240)
LIMBS = ("left_forearm", "left_upper_arm", "left_thigh", "trunk")
SHIFT = 4  # binary places of OpenCV's polygon corners
CIRCLE = np.stack((np.cos(a := np.linspace(0, 2 * np.pi, 24, endpoint=False)), np.sin(a)), axis=1)


@njit(error_model="numpy")
def count_all(pose, axis, amounts, parts, model, views, scratch, counts):  # type: ignore[no-untyped-def]
    trial = pose.copy()
    for n in range(len(amounts)):
        trial[:] = pose
        move_axis(trial, axis, amounts[n])
        hang_parts(parts, 1, trial, model[0], scratch)
        counts[n] = count_parts(parts, model, views, scratch[2], scratch[3], scratch, np.inf)


class Limb:
    """One limb before one camera, its silhouette and N angles of its first axis."""

    def __init__(self, name: str, n_candidates: int) -> None:
        self.body, (self.camera,) = make_human(1.75), make_ring(1, size=SIZE, first_angle=0.4)
        self.part = self.body.names.index(name)
        self.pose = standing_state(self.body)
        away = self.pose.copy()
        away[7:] += 0.1
        self.mask = draw_body(self.body, away, self.camera)[0]
        self.setup = SearchSetup(self.body, [self.camera], TrackerSettings(candidates="part"), 30.0, self.mask.sum())
        self.frame = self.setup.pack([self.mask])
        self.axis = 6 + int(self.body.angle_starts[self.part])
        self.amounts = np.linspace(-0.5, 0.5, n_candidates)

    def count_ours(self) -> np.ndarray:
        setup, scratch, counts = self.setup, self.setup.make_scratch(), np.empty(len(self.amounts), np.int64)
        scratch[5][:], scratch[6][:] = place_parts(self.body, self.pose)
        views, parts = setup.views(self.frame), np.array([self.part])
        fill_evidence(READINGS.index("plain"), self.frame.bits, scratch[4], scratch[2], scratch[3], scratch[7])
        count_all(self.pose, self.axis, self.amounts, parts, setup.model, views, scratch, counts)
        return counts + int(self.mask.sum())

    def search_axes(self, repeats: int) -> None:
        setup, scratch = self.setup, self.setup.make_scratch()
        setup.order = np.array([self.part])
        for _ in range(repeats):
            setup.sweep(self.pose.copy(), np.zeros(setup.n_axes), 1.0, self.frame, scratch)

    def make_polygon(self, amount: float) -> np.ndarray:
        """Corners of the hull of the limb's discs, whole numbers of 1 / 16 px, as OpenCV takes them."""
        pose = self.pose.copy()
        pose[self.axis + 1] += amount
        rotations, positions = place_parts(self.body, pose)
        starts = self.body.sphere_starts
        spheres = self.body.spheres[starts[self.part] : starts[self.part + 1]]
        centres = spheres[:, :3] @ rotations[self.part].T + positions[self.part]
        pixels, _ = cv2.projectPoints(
            centres,
            cv2.Rodrigues(self.camera.rotation)[0],
            self.camera.translation,
            self.camera.matrix,
            self.camera.distortion,
        )
        depths = centres @ self.camera.rotation[2] + self.camera.translation[2]
        radii = spheres[:, 3] * np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]) / depths
        corners = (pixels[:, 0][:, None] + radii[:, None, None] * CIRCLE).reshape(-1, 2)
        hull = cv2.convexHull(corners.astype(np.float32))[:, 0]
        return np.rint(hull * 2**SHIFT).astype(np.int32)

    def count_opencv(self, polygons: list[np.ndarray] | None = None) -> np.ndarray:
        silhouette = self.mask.view(np.uint8)
        drawn, wrong = np.empty_like(silhouette), np.empty_like(silhouette)
        counts = np.empty(len(self.amounts), np.int64)
        for n, amount in enumerate(self.amounts):
            polygon = self.make_polygon(amount) if polygons is None else polygons[n]
            drawn[:] = 0
            cv2.fillConvexPoly(drawn, polygon, 1, shift=SHIFT)
            cv2.bitwise_xor(drawn, silhouette, wrong)
            counts[n] = cv2.countNonZero(wrong)
        return counts

    def count_opencv_in_box(self, polygons: list[np.ndarray]) -> np.ndarray:
        """Pixels outside the box are silhouette or not whatever the candidate: their number is known beforehand."""
        silhouette, whole = self.mask.view(np.uint8), int(self.mask.sum())
        drawn, wrong = np.empty_like(silhouette), np.empty_like(silhouette)
        counts = np.empty(len(polygons), np.int64)
        for n, polygon in enumerate(polygons):
            x, y, width, height = cv2.boundingRect(polygon)
            left, top = max(0, x >> SHIFT), max(0, y >> SHIFT)
            box = np.s_[top : ((y + height) >> SHIFT) + 2, left : ((x + width) >> SHIFT) + 2]
            canvas, there = drawn[box], silhouette[box]
            canvas[:] = 0
            cv2.fillConvexPoly(canvas, polygon - (left << SHIFT, top << SHIFT), 1, shift=SHIFT)
            found = cv2.countNonZero(cv2.bitwise_xor(canvas, there, wrong[box]))
            counts[n] = whole - cv2.countNonZero(there) + found
        return counts

    def check(self, ours: np.ndarray, opencv: np.ndarray, boxed: np.ndarray) -> float:
        """Largest difference as a share of the outline's length, which it must not exceed."""
        np.testing.assert_array_equal(opencv, boxed)
        outlines = [cv2.arcLength(self.make_polygon(a).astype(np.float32) / 2**SHIFT, True) for a in self.amounts]
        share = float((np.abs(ours - opencv) / outlines).max())
        assert share <= 1.0, f"ours and OpenCV differ by {share:.2f} of the outline"
        return share


def count_boxes(limb: Limb) -> float:
    """Mean number of pixels of the limb."""
    rotations, positions = place_parts(limb.body, limb.pose)
    work = limb.setup.make_scratch()[0]
    first, last = outline_part(limb.part, limb.camera.to_row(), *SIZE, limb.setup.model[1], rotations, positions, work)
    return float(np.maximum(0, work[3][first:last] - work[2][first:last] + 1).sum())


def compare(name: str, n_candidates: int) -> None:
    limb = Limb(name, n_candidates)
    polygons = [limb.make_polygon(amount) for amount in limb.amounts]
    ours, counted = timed(limb.count_ours, 5)
    usual, theirs = timed(limb.count_opencv, 2)
    given = best_of(lambda: limb.count_opencv(polygons), 3)
    boxed, in_box = timed(lambda: limb.count_opencv_in_box(polygons), 3)
    share = limb.check(counted, theirs, in_box)
    repeats = max(1, n_candidates // 50)
    n_axes = int(limb.body.n_axes[limb.part])
    tried = repeats * n_axes * (limb.setup.half + 3)  # every other one of 2 half + 1, and two neighbours
    limb.search_axes(1)
    searched = best_of(lambda: limb.search_axes(repeats), 3)
    rate = n_candidates / ours
    print(f"-- {name}, {count_boxes(limb):.0f} px; counts differ by at most {share:.2f} of the outline's length")
    print(f"ours: {rate / 1e6:.2f} million candidates/s")
    print(f"ours, the tracker's pass over this limb: {tried / searched / 1e6:.2f} million candidates/s")
    for what, seconds in (
        ("peer, OpenCV with projection and hull", usual),
        ("peer, OpenCV's own calls alone, full image", given),
        ("peer, OpenCV's own calls alone, bounding box", boxed),
    ):
        print(
            f"{what}: {n_candidates / seconds / 1e3:.1f} thousand candidates/s; "
            f"ratio ours / peer: {rate * seconds / n_candidates:.0f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--candidates", type=int, default=20_000)
    parser.add_argument("--limbs", nargs="+", default=LIMBS)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    Limb("trunk", 2).count_ours()  # compiles, or loads what was compiled
    for name in options.limbs:
        compare(name, options.candidates)


if __name__ == "__main__":
    main()
