"""A slow rasteriser: how deep each pixel centre lies in the hull of the discs that a part's spheres project to.

A point p lies in the hull iff for every direction u: u . p <= max_k (u . c_k + r_k). The least slack over all
directions is the signed distance from p to the border. Between the directions in which two discs reach equally far
one disc alone counts, whose slack is least where u points from its centre to p: only these directions are tried.
"""

import math

import numpy as np

NEAREST = 0.05


def depth_in_hull(discs, width: int, height: int) -> np.ndarray:
    """(height, width) px from each pixel centre to the border of the hull of discs (x, y, r), negative outside."""
    centres, radii = np.array([d[:2] for d in discs], float), np.array([d[2] for d in discs], float)
    crossings = equal_directions(discs)
    depths = np.empty((height, width))
    for row in range(height):
        points = np.stack((np.arange(width, dtype=float), np.full(width, float(row))), axis=1)
        depths[row] = [least_slack(point, centres, radii, crossings) for point in points]
    return depths


def equal_directions(discs) -> np.ndarray:
    """(N, 2) unit vectors u with u . c_i + r_i = u . c_j + r_j for some pair of discs."""
    found = []
    for i, (xi, yi, ri) in enumerate(discs):
        for xj, yj, rj in discs[:i]:
            dx, dy = xi - xj, yi - yj
            distance = math.hypot(dx, dy)
            if distance <= abs(ri - rj) or distance == 0.0:
                continue  # one disc reaches farther in every direction
            middle, half = math.atan2(dy, dx), math.acos((rj - ri) / distance)
            found += [(math.cos(middle + s * half), math.sin(middle + s * half)) for s in (-1, 1)]
    return np.array(found).reshape(-1, 2)


def least_slack(point, centres, radii, crossings) -> float:
    away = point - centres
    length = np.linalg.norm(away, axis=1)
    own = away[length > 0] / length[length > 0][:, None]
    directions = np.concatenate((crossings, own, [[1.0, 0.0]]))
    slack = (directions @ (centres - point).T + radii).max(axis=1)
    return float(slack.min())


def project(camera, point, radius: float) -> tuple[float, float, float] | None:
    """Disc (column, row, radius) of a sphere as OpenCV's manual has it; None behind a pinhole camera."""
    x, y, z = camera.rotation @ np.asarray(point) + camera.translation
    (fx, skew, cx), (_, fy, cy) = camera.matrix[0], camera.matrix[1]
    if camera.kind == "pinhole":
        if z < NEAREST:
            return None
        x, y, radius = x / z, y / z, radius / z
        k1, k2, p1, p2, k3 = camera.distortion
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x, y = (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y)
    return fx * x + skew * y + cx, fy * y + cy, radius * math.sqrt(fx * fy)


def part_depths(body, rotations, positions, camera) -> np.ndarray:
    """(P, height, width) px, see `depth_in_hull`, of every part placed by (P, 3, 3) and (P, 3)."""
    depths = np.full((body.n_parts, camera.height, camera.width), -np.inf)
    for part in range(body.n_parts):
        spheres = body.spheres[body.sphere_starts[part] : body.sphere_starts[part + 1]]
        discs = [project(camera, rotations[part] @ s[:3] + positions[part], s[3]) for s in spheres]
        if None not in discs:
            depths[part] = depth_in_hull(discs, camera.width, camera.height)
    return depths
