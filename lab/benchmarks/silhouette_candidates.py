"""Candidates of one limb, scored against a silhouette of 320 x 240 pixels, on one thread.

    python -m lab.benchmarks.silhouette_candidates [--candidates N]

A limb is turned about one axis to N angles; each candidate is posed, projected, drawn and its pixels compared with
the silhouette (the mismatch of eq. 2, plain reading). Peers: OpenCV as it is usually written (discs projected, their
hull as a polygon, `fillConvexPoly`, xor and `countNonZero` on the full image); the same with the polygons given, so
that only OpenCV's own calls are timed; and that within the polygon's bounding box, which nobody writes.
The last row of a limb is the search of its axes by the tracker's own pass, with all else drawn and evidence made anew.

OpenCV is told to use one thread. Both count the same pixels but for the outline, which OpenCV draws a pixel wide: the
program checks that they differ by no more than the outline's length.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import cv2
import numpy as np

from dousa.estimation import TrackerSettings, make_human, make_ring, standing_state
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.search_kernels import count_parts, fill_evidence, move_axis
from dousa.estimation.tracking.search_kernels import place_parts as hang_parts
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import READINGS
from dousa.kernels import kernel
from lab.benchmarks.timing import Row, run, take_turns

SIZE = (320, 240)
LIMBS = ("left_forearm", "left_upper_arm", "left_thigh", "trunk")
SHIFT = 4  # binary places of OpenCV's polygon corners
CIRCLE = np.stack((np.cos(a := np.linspace(0, 2 * np.pi, 24, endpoint=False)), np.sin(a)), axis=1)


@kernel(allocates=True)
def count_all(pose, axis, amounts, parts, reading, model, views, scratch, counts):  # type: ignore[no-untyped-def]
    fill_evidence(reading, views[3], scratch[4], scratch[2], scratch[3], scratch[7])
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
        plain = READINGS.index("plain")
        count_all(self.pose, self.axis, self.amounts, parts, plain, setup.model, views, scratch, counts)
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


def compare(name: str, n_candidates: int, repeats: int) -> Iterator[Row]:
    limb = Limb(name, n_candidates)
    polygons = [limb.make_polygon(amount) for amount in limb.amounts]
    share = limb.check(limb.count_ours(), limb.count_opencv(), limb.count_opencv_in_box(polygons))
    n_searches = max(1, n_candidates // 50)
    calls = {
        "ours": limb.count_ours,
        "OpenCV: projectPoints, convexHull, fillConvexPoly, xor, countNonZero": limb.count_opencv,
        "OpenCV, corners given, full image": lambda: limb.count_opencv(polygons),
        "OpenCV, corners given, bounding box": lambda: limb.count_opencv_in_box(polygons),
        "searched": lambda: limb.search_axes(n_searches),
    }
    found = take_turns(calls, repeats)
    note = f"counts differ by at most {share:.2f} of the outline's length"
    for peer in list(calls)[1:-1]:
        yield Row(f"candidates of {name}", found["ours"], peer, found[peer], n_candidates / 1e3, "thousand/s", note)
    n_axes = int(limb.body.n_axes[limb.part])
    tried = n_searches * n_axes * (limb.setup.half + 3)  # every other one of 2 half + 1, and two neighbours
    yield Row(f"the tracker's pass over {name}", found["searched"], amount=tried / 1e3, unit="thousand/s")


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    cv2.setNumThreads(1)
    for name in options.limbs:
        yield from compare(name, options.candidates, options.repeats)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--candidates", type=int, default=5_000)
    parser.add_argument("--limbs", nargs="+", default=LIMBS)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
