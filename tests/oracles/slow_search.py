"""Eqs. 1 to 3 of the search written out: every candidate drawn as plain masks, every pixel counted.

S the silhouette, F the pixels of the parts already placed (P_fixed), P those of the parts that a candidate moves.
"""

import numpy as np

from dousa.estimation.body.body import BodyModel
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_parts
from dousa.motion import rotations as rot

LEAST_WEIGHT = 1e-3


def counted_pixels(reading, s, f):
    """X and the pixels that count: the mismatch of a candidate P is the number of those of X xor P that count."""
    everywhere = np.ones_like(s)
    return {
        "masked": (s, ~f), "residual": (s & ~f, everywhere), "union": (s | f, everywhere), "plain": (s, everywhere),
        "literal": (s & f, everywhere),
    }[reading]  # fmt: skip


def mismatch(reading, s, f, p, reach=None):
    """Eq. 2: pixels of one view; with ``reach`` only those that some candidate covers."""
    x, counts = counted_pixels(reading, s, f)
    wrong = (x ^ p) & counts
    return int((wrong if reach is None else wrong & reach).sum())


def moved_along(pose, axis, amount):
    """The pose with one degree of freedom changed."""
    moved = pose.copy()
    if axis < 3:
        moved[axis] += amount
    elif axis < 6:
        moved[3:7] = rot.multiply(pose[3:7], rot.from_axis_angle(amount * np.eye(3)[axis - 3]))
    else:
        moved[axis + 1] += amount
    return moved


def subtree(body, part):
    below = [part]
    for other in range(part + 1, body.n_parts):
        if body.parents[other] in below:
            below.append(other)
    return below


def axes_of(body, part):
    first = 6 + body.angle_starts[part]
    return range(6) if part == 0 else range(first, first + body.n_axes[part])


def covered(body, pose, camera, parts):
    layers = draw_parts(body, pose, camera)[0]
    return layers[list(parts)].any(axis=0) if len(parts) else np.zeros(layers.shape[1:], bool)


class SlowSearch:
    """One body before cameras; ``shop`` gives settings, dR, price of strain and the weight of a pixel."""

    def __init__(self, shop, masks):
        self.body, self.settings = shop.body, shop.settings
        self.spread, self.ease, self.limits = shop.bounds
        self.per_pixel = shop.weights[2]
        self.views = [(c, m) for c, m in zip(shop.cameras, masks, strict=True) if m is not None and m.any()]

    def prior(self, pose, axis, off):
        """Log of W (eq. 3), less the price of an awkward joint."""
        found = self.settings.inertia * np.log(max(LEAST_WEIGHT, weight(off, self.spread[axis])))
        found -= self.strain(pose, axis)
        return found

    def strain(self, pose, axis):
        return 0.0 if axis < 6 else ((pose[axis + 1] - self.ease[axis, 0]) * self.ease[axis, 1]) ** 2

    def score_all(self, drawn, fixed):
        """Image part of the score of candidates ``drawn`` {k: masks per view}."""
        reading, evidence = self.settings.reading, self.settings.evidence
        reach = [None] * len(self.views)
        if evidence == "local":
            reach = [np.any([masks[v] for masks in drawn.values()], axis=0) for v in range(len(self.views))]
        scores = {}
        for k, masks in drawn.items():
            wrong = sum(
                mismatch(reading, s, f, p, r) for (_, s), f, p, r in zip(self.views, fixed, masks, reach, strict=True)
            )
            scores[k] = -self.per_pixel * wrong if evidence == "log" else -np.log(1.0 + wrong)
        return scores

    def search_axis(self, pose, shift, axis, moved, fixed_parts, factor, half):
        """Number of the winner among -half to half, and the scores of all that were tried."""
        fixed = [covered(self.body, pose, camera, fixed_parts) for camera, _ in self.views]
        step = factor * self.spread[axis] / half
        drawn, priors, scores, best = {}, {}, {}, 0
        for stage in range(self.settings.thinning):
            tried = range(-half, half + 1, self.settings.thinning) if stage == 0 else (best - 1, best + 1)
            for k in tried:
                candidate = moved_along(pose, axis, k * step)
                if not -half <= k <= half or not self.allowed(candidate, axis, shift[axis] + k * step, k):
                    continue
                drawn[k] = [covered(self.body, candidate, camera, moved) for camera, _ in self.views]
                priors[k] = self.prior(candidate, axis, shift[axis] + k * step)
            scores = {k: image + priors[k] for k, image in self.score_all(drawn, fixed).items()}
            best = choose(scores)
        return best, scores

    def allowed(self, candidate, axis, off, k):
        if k == 0:
            return True
        if axis >= 6 and not self.limits[axis - 6, 0] <= candidate[axis + 1] <= self.limits[axis - 6, 1]:
            return False
        return weight(off, self.spread[axis]) > LEAST_WEIGHT

    def sweep_part(self, pose, shift, part, factor, half):
        """The pose and its shift from the prediction after a search of one part's axes, one after the other."""
        pose, shift, below = pose.copy(), shift.copy(), subtree(self.body, part)
        whole = self.settings.candidates == "subtree"
        moved = below if whole or part == 0 else [part]
        others = [q for q in range(self.body.n_parts) if q not in below and (whole or q < part)]
        for axis in axes_of(self.body, part):
            best, _ = self.search_axis(pose, shift, axis, moved, others, factor, half)
            amount = factor * self.spread[axis] * best / half
            pose = moved_along(pose, axis, amount)
            shift[axis] += amount
        return pose, shift

    def score_pose(self, pose, shift):
        """Log score of a whole pose, with the constant left in."""
        every = range(self.body.n_parts)
        wrong = sum(int((s ^ covered(self.body, pose, camera, every)).sum()) for camera, s in self.views)
        total = -self.per_pixel * wrong
        for axis in range(len(shift)):
            total += self.settings.inertia * np.log(max(LEAST_WEIGHT, weight(shift[axis], self.spread[axis])))
            total -= self.strain(pose, axis)
        return total


def weight(off, spread):
    """W of eq. 3."""
    return 1.0 - off**2 / (4.0 * spread**2)


def choose(scores):
    """The best candidate; of several as good the nearest to where the axis is."""
    most = max(scores.values())
    return min((k for k, score in scores.items() if score >= most - 1e-12), key=lambda k: (abs(k), k))


def random_body(rng, n_parts=4):
    """A tree of parts of 0 to 3 axes, about a metre tall."""
    n_axes = np.array([0] + [int(rng.integers(0, 4)) for _ in range(n_parts - 1)])
    axes, limits = np.zeros((n_parts, 3, 3)), np.zeros((n_parts, 3, 2))
    for part, count in enumerate(n_axes):
        axes[part, :count] = np.linalg.qr(rng.normal(size=(3, 3)))[0][:count]
        limits[part, :count] = np.sort(rng.uniform(-1.2, 1.2, (count, 2)), axis=1)
    spheres = [
        np.column_stack((rng.normal(0, 0.15, (count, 3)), rng.uniform(0.02, 0.2, count)))
        for count in rng.integers(1, 4, n_parts)
    ]
    return BodyModel(
        names=tuple(f"part{k}" for k in range(n_parts)),
        joints=tuple(f"joint{k}" for k in range(n_parts)),
        parents=[-1] + [int(rng.integers(0, part)) for part in range(1, n_parts)],
        offsets=np.concatenate((np.zeros((1, 3)), rng.normal(0, 0.25, (n_parts - 1, 3)))),
        rest=rot.normalise(rng.normal(size=(n_parts, 4))),
        n_axes=n_axes,
        axes=axes,
        limits=limits,
        spheres=np.concatenate(spheres),
        sphere_starts=np.cumsum([0] + [len(part) for part in spheres]),
        tips=("tip",),
        tip_parts=[n_parts - 1],
        tip_offsets=rng.normal(0, 0.1, (1, 3)),
        stature=1.0,
        agility=rng.uniform(0.5, 2.0, n_parts),
        stiffness=rng.uniform(0.0, 2.0, n_parts),
        neutral=np.where(np.arange(3) < n_axes[:, None], limits.mean(axis=2), 0.0),
    )


def random_pose(rng, body):
    limits = body.angle_limits
    turn = rot.normalise(rng.normal(size=4))
    return np.concatenate((rng.normal(0, 0.1, 3), turn, rng.uniform(limits[:, 0], limits[:, 1])))


def two_cameras(width=70, height=40):
    """A pinhole camera and an orthographic one of another size, a quarter round."""
    matrix = [[60.0, 0.0, width / 2], [0.0, 62.0, height / 2], [0.0, 0.0, 1.0]]
    flat = [[22.0, 0.0, 20.0], [0.0, 22.0, 15.0], [0.0, 0.0, 1.0]]
    front, side = np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
    return (
        Camera("front", width, height, matrix, front, [0.0, 0.0, 2.2]),
        Camera("side", 40, 30, flat, side, [0.0, 0.0, 3.0], kind="orthographic"),
    )


def noisy_masks(rng, body, pose, cameras):
    """Silhouettes of the pose with a few pixels turned over."""
    masks = []
    for camera in cameras:
        mask = covered(body, pose, camera, range(body.n_parts))
        masks.append(mask ^ (rng.random(mask.shape) < 0.03))
    return masks
