"""The body: a tree of rigid parts whose joint angles fix the pose (Kameda, Minoh and Ikeda, section 2).

A part is a convex solid: the hull of a few spheres (two make a tapered capsule, more a trunk or a foot, spheres
without radius a polyhedron). Its joint has one to three axes. Robots, animals or costumes are tracked as people are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import BodyModelError


@dataclass(frozen=True, slots=True, eq=False)
class BodyModel:
    """A tree of rigid parts.

    A pose is one row of 7 + A numbers: position (3) m and orientation (4, unit quaternion w x y z) of the root
    part, then the joint angles (A) rad, part after part, axis after axis. The rotation of a part's axes in its
    parent's is ``rest`` times: R(axis 1, angle 1) for one axis; R(axis 1, angle 1) R(axis 2, angle 2) for two; for
    three the swing exp(angle 1 axis 1 + angle 2 axis 2) times the twist R(axis 3, angle 3), which is singular at 180
    degrees.

    Parameters
    ----------
    names : (P,) names of the parts; the root comes first.
    joints : (P,) name of the joint between each part and its parent (the root's is the body's place).
    parents : (P,) index of the parent part, before the part itself; -1 for the root only.
    offsets : (P, 3) m, place of the part's joint in the parent's axes; zeros for the root.
    rest : (P, 4) unit quaternions, the rotation of the part's axes in the parent's at angle zero.
    n_axes : (P,) number of axes of the joint, 0 to 3 (0 for the root, which is free, and for fixed parts).
    axes : (P, 3, 3) unit vectors in the part's axes, one per row; unused rows are zero. Of three axes the third is
        the twist, along the part.
    limits : (P, 3, 2) rad, least and greatest angle of each axis.
    spheres : (S, 4) m, centre in the part's axes and radius.
    sphere_starts : (P + 1,) the spheres of part p are ``spheres[sphere_starts[p]:sphere_starts[p + 1]]``.
    tips : names of further output points, such as ``"left_hand"``.
    tip_parts : (K,) the part of each of these points.
    tip_offsets : (K, 3) m, in that part's axes.
    stature : m, height of the body standing upright.
    agility : (P,) range of each joint about its prediction from frame to frame, as a share of the tracker's dR (the
        root's is that of its turning); ones by default.
    neutral : (P, 3) rad, the angles at which each joint is at ease; zeros by default.
    stiffness : (P,) cost of a joint at the end of its range, as a share of the tracker's usual; zeros by default.

    Raises
    ------
    BodyModelError : shapes that disagree, no part, a part without a solid, a parent after its child, axes that are
        not of unit length or not square to each other, limits that are no interval, numbers that are not finite.
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    parents: IndexArray
    offsets: FloatArray
    rest: FloatArray
    n_axes: IndexArray
    axes: FloatArray
    limits: FloatArray
    spheres: FloatArray
    sphere_starts: IndexArray
    tips: tuple[str, ...]
    tip_parts: IndexArray
    tip_offsets: FloatArray
    stature: float
    agility: FloatArray = None  # type: ignore[assignment]
    neutral: FloatArray = None  # type: ignore[assignment]
    stiffness: FloatArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        n_parts, n_tips = len(self.names), len(self.tips)
        if n_parts == 0:
            raise BodyModelError("body.no_part")
        for field in ("names", "joints", "tips"):
            set_field(self, field, tuple(str(name) for name in getattr(self, field)))
        if len(self.joints) != n_parts:
            raise BodyModelError("body.joint_names", expected=n_parts, found=len(self.joints))
        shapes: dict[str, tuple[type, tuple[int, ...]]] = {
            "parents": (np.intp, (n_parts,)),
            "offsets": (np.float64, (n_parts, 3)),
            "rest": (np.float64, (n_parts, 4)),
            "n_axes": (np.intp, (n_parts,)),
            "axes": (np.float64, (n_parts, 3, 3)),
            "limits": (np.float64, (n_parts, 3, 2)),
            "spheres": (np.float64, (len(self.spheres), 4)),
            "sphere_starts": (np.intp, (n_parts + 1,)),
            "tip_parts": (np.intp, (n_tips,)),
            "tip_offsets": (np.float64, (n_tips, 3)),
            "agility": (np.float64, (n_parts,)),
            "neutral": (np.float64, (n_parts, 3)),
            "stiffness": (np.float64, (n_parts,)),
        }
        usual = {"agility": 1.0, "neutral": 0.0, "stiffness": 0.0}
        for field, (dtype, shape) in shapes.items():
            value = getattr(self, field)
            if value is None and field in usual:
                value = np.full(shape, usual[field])
            set_field(self, field, _checked(value, dtype, shape, field))
        set_field(self, "stature", float(self.stature))
        self._check_tree()
        self._check_joints()

    def _check_tree(self) -> None:
        parents = self.parents
        if parents[0] != -1 or (len(parents) > 1 and not (parents[1:] >= 0).all()):
            raise BodyModelError("body.one_root")
        if (parents >= np.arange(len(parents))).any():
            bad = int(np.flatnonzero(parents >= np.arange(len(parents)))[0])
            raise BodyModelError("body.parent_first", part=self.names[bad])
        starts = self.sphere_starts
        if starts[0] != 0 or starts[-1] != len(self.spheres) or (np.diff(starts) < 1).any():
            raise BodyModelError("body.no_sphere")
        if (self.spheres[:, 3] < 0).any():
            raise BodyModelError("body.radius")
        if len(self.tip_parts) and not ((self.tip_parts >= 0) & (self.tip_parts < len(parents))).all():
            raise BodyModelError("body.tip_part")
        if (self.agility <= 0).any() or (self.stiffness < 0).any():
            raise BodyModelError("body.ease")
        if not 0 < self.stature < 1000:
            raise BodyModelError("body.stature", found=self.stature)

    def _check_joints(self) -> None:
        if self.n_axes[0] != 0:
            raise BodyModelError("body.root_axes")
        for part, count in enumerate(self.n_axes):
            name = self.names[part]
            if not 0 <= count <= 3:
                raise BodyModelError("body.axis_count", part=name, found=int(count))
            axes, limits = self.axes[part, :count], self.limits[part, :count]
            if np.abs(axes @ axes.T - np.eye(count)).max(initial=0.0) > 1e-6:
                raise BodyModelError("body.axes", part=name)
            if (limits[:, 0] > limits[:, 1]).any() or (np.abs(limits) > 2 * np.pi).any():
                raise BodyModelError("body.limits", part=name)
        if np.abs(np.linalg.norm(self.rest, axis=1) - 1.0).max() > 1e-6:
            raise BodyModelError("body.rest")

    @property
    def n_parts(self) -> int:
        """Number of rigid parts."""
        return len(self.names)

    @property
    def n_angles(self) -> int:
        """Number of joint angles A; a pose has 7 + A numbers."""
        return int(self.n_axes.sum())

    @property
    def angle_starts(self) -> IndexArray:
        """(P + 1,) index of each part's first angle among the joint angles."""
        return np.concatenate(([0], np.cumsum(self.n_axes))).astype(np.intp)

    @property
    def angle_names(self) -> tuple[str, ...]:
        """(A,) ``"left_elbow.1"`` and so on: the joint and the number of its axis."""
        return tuple(
            f"{joint}.{axis + 1}"
            for joint, count in zip(self.joints, self.n_axes, strict=True)
            for axis in range(count)
        )

    @property
    def angle_limits(self) -> FloatArray:
        """(A, 2) rad, least and greatest of each joint angle."""
        return self.limits[np.arange(3) < self.n_axes[:, None]]


def _checked(values: ArrayLike, dtype: type, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = np.array(values, dtype)
    except (TypeError, ValueError) as error:
        raise BodyModelError("body.numbers", field=what) from error
    if array.shape != shape and not (array.size == 0 and np.prod(shape) == 0):
        raise BodyModelError("body.shape", field=what, expected=str(shape), found=str(array.shape))
    array = array.reshape(shape)
    if not np.isfinite(array).all():
        raise BodyModelError("body.finite", field=what)
    array.flags.writeable = False
    return array


def pad_axes(rows: Any, width: int) -> FloatArray:
    """Return the rows (n, width) of up to three axes of a joint, filled up with zeros to (3, width)."""
    values = np.array(rows, np.float64).reshape(-1, width)[:3]
    return np.concatenate((values, np.zeros((3 - len(values), width))))


def reshape(
    body: BodyModel,
    offsets: FloatArray,
    tip_offsets: FloatArray,
    girths: FloatArray | None = None,
    *,
    short: float = 0.02,
) -> BodyModel:
    """Move the joints and tips of a body and stretch its solids with them; stature stays.

    Each part is stretched along its three axes, both directions separately, as the joints of its children and its tips
    move relative to its own joint. Radii stay unless ``girths`` change them.

    Parameters
    ----------
    body : the body to start from.
    offsets : (P, 3) m, new places of the joints in their parents' axes.
    tip_offsets : (K, 3) m, new places of the tips in their parts' axes.
    girths : (S,) factors of the spheres' radii and distances from the part's Y axis; ones by default.
    short : statures; a bone shorter than this along an axis does not stretch the solid along it.
    """

    def stretch(before: FloatArray, after: FloatArray) -> FloatArray:
        long = before > short * body.stature
        return np.where(long & (after > 0), after / np.where(long, before, 1.0), 1.0)

    spheres = body.spheres.copy()
    for part in range(body.n_parts):
        children, tips = body.parents == part, body.tip_parts == part
        before = np.concatenate((body.offsets[children], body.tip_offsets[tips], np.zeros((1, 3))))
        after = np.concatenate((offsets[children], tip_offsets[tips], np.zeros((1, 3))))
        own = slice(body.sphere_starts[part], body.sphere_starts[part + 1])
        centres = spheres[own, :3]
        up = stretch(before.max(axis=0), after.max(axis=0))
        down = stretch(-before.min(axis=0), -after.min(axis=0))
        spheres[own, :3] = centres * np.where(centres > 0, up, down)
    if girths is not None:
        spheres[:, [0, 2, 3]] *= girths[:, None]
    return replace(body, offsets=offsets, tip_offsets=tip_offsets, spheres=spheres)


def widen(body: BodyModel, shares: ArrayLike) -> BodyModel:
    """Scale the girth of each part by ``shares`` (P,) or a number; joints and tips stay.

    Parts without children (head, hands, feet) grow in length too.
    """
    grown = np.broadcast_to(np.asarray(shares, np.float64), body.n_parts)
    owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
    scale = np.repeat(grown[owner, None], 4, axis=1)
    ends = ~np.isin(np.arange(body.n_parts), body.parents)
    scale[~ends[owner], 1] = 1.0
    return replace(body, spheres=body.spheres * scale)
