"""The body: a tree of rigid parts whose joint angles fix the pose (Kameda, Minoh and Ikeda, section 2).

A part is a convex solid: the hull of a few spheres (two make a tapered capsule, more a trunk or a foot, spheres
without radius a polyhedron). Its joint has one to three axes. The tracker, the renderer and the writers see nothing
but this description, so that a robot, an animal or a costume is tracked as a person is: the body is data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError

__all__ = ["BodyModel"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class BodyModel:
    """A tree of rigid parts.

    A pose is one row of 7 + A numbers: position (3) m and orientation (4, unit quaternion w x y z) of the root
    part, then the joint angles (A) rad, part after part, axis after axis. The rotation of a part's axes in its
    parent's is ``rest`` times: R(axis 1, angle 1) for one axis; R(axis 1, angle 1) R(axis 2, angle 2) for two; for
    three the swing exp(angle 1 axis 1 + angle 2 axis 2) times the twist R(axis 3, angle 3). With the rest direction in
    the middle of the reach no pose of a person comes near the swing's one singularity, 180 degrees.

    Parameters
    ----------
    names : (P,) names of the parts; the root comes first.
    joints : (P,) name of the joint by which each part hangs on its parent (the root's is the body's place).
    parents : (P,) index of the parent part, which stands before it; -1 for the root and only for it.
    offsets : (P, 3) m, place of the part's joint in the parent's axes; zeros for the root.
    rest : (P, 4) unit quaternions, the rotation of the part's axes in the parent's at angle zero.
    n_axes : (P,) number of axes of the joint, 0 to 3 (0 for the root, which is free, and for parts that are stuck).
    axes : (P, 3, 3) unit vectors in the part's axes, one per row; unused rows are zero. Of three axes the third is
        the twist, along the part.
    limits : (P, 3, 2) rad, least and greatest angle of each axis.
    spheres : (S, 4) m, centre in the part's axes and radius.
    sphere_starts : (P + 1,) the spheres of part p are ``spheres[sphere_starts[p]:sphere_starts[p + 1]]``.
    tips : names of further points that are written out, such as ``"left_hand"``.
    tip_parts : (K,) the part that each of these points belongs to.
    tip_offsets : (K, 3) m, in that part's axes.
    stature : m, height of the body standing upright; what scales it.
    agility : (P,) how far each joint may leave its prediction from frame to frame, as a share of the tracker's dR
        (an arm more, a trunk less; the root's is that of its turning); ones by default.
    neutral : (P, 3) rad, the angles at which each joint is at ease; zeros by default.
    stiffness : (P,) what it costs the tracker to hold a joint at the end of its range, as a share of the usual; zeros
        by default, so that nothing is preferred.

    Raises
    ------
    BodyModelError : shapes that disagree, no part, a part without a solid, a parent after its child, axes that are
        not of unit length or not square to each other, limits that are no interval, numbers that are not finite.
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    parents: IntArray
    offsets: FloatArray
    rest: FloatArray
    n_axes: IntArray
    axes: FloatArray
    limits: FloatArray
    spheres: FloatArray
    sphere_starts: IntArray
    tips: tuple[str, ...]
    tip_parts: IntArray
    tip_offsets: FloatArray
    stature: float
    agility: FloatArray = None  # type: ignore[assignment]
    neutral: FloatArray = None  # type: ignore[assignment]
    stiffness: FloatArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        n_parts, n_tips = len(self.names), len(self.tips)
        if n_parts == 0:
            raise BodyModelError("body: expected at least one part, got none")
        set_field(self, "names", tuple(str(name) for name in self.names))
        set_field(self, "joints", tuple(str(name) for name in self.joints))
        set_field(self, "tips", tuple(str(name) for name in self.tips))
        if len(self.joints) != n_parts:
            raise BodyModelError(f"body: expected {n_parts} joint names, got {len(self.joints)}")
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
        for field, usual in (("agility", np.ones(n_parts)), ("neutral", np.zeros((n_parts, 3)))):
            if getattr(self, field) is None:
                set_field(self, field, usual)
        if self.stiffness is None:
            set_field(self, "stiffness", np.zeros(n_parts))
        for field, (dtype, shape) in shapes.items():
            set_field(self, field, _checked(getattr(self, field), dtype, shape, field))
        set_field(self, "stature", float(self.stature))
        self._check_tree()
        self._check_joints()

    def _check_tree(self) -> None:
        parents = self.parents
        if parents[0] != -1 or (len(parents) > 1 and not (parents[1:] >= 0).all()):
            raise BodyModelError("body: expected one root, the first part, with parent -1")
        if (parents >= np.arange(len(parents))).any():
            bad = int(np.flatnonzero(parents >= np.arange(len(parents)))[0])
            raise BodyModelError(f"body: part '{self.names[bad]}': expected its parent before it")
        starts = self.sphere_starts
        if starts[0] != 0 or starts[-1] != len(self.spheres) or (np.diff(starts) < 1).any():
            raise BodyModelError(
                "body: expected at least one sphere for every part, in the order of the parts"
            )
        if (self.spheres[:, 3] < 0).any():
            raise BodyModelError("body: expected radii of 0 m or more")
        if len(self.tip_parts) and not ((self.tip_parts >= 0) & (self.tip_parts < len(parents))).all():
            raise BodyModelError("body: a tip belongs to a part that is not there")
        if (self.agility <= 0).any() or (self.stiffness < 0).any():
            raise BodyModelError(
                "body: expected an agility above 0 and a stiffness of 0 or more for every part"
            )
        if not 0 < self.stature < 1000:
            raise BodyModelError(f"body: expected a stature in metres above 0, got {self.stature:g}")

    def _check_joints(self) -> None:
        if self.n_axes[0] != 0:
            raise BodyModelError("body: expected no axes for the root: it is free to move and turn")
        for part, count in enumerate(self.n_axes):
            name = self.names[part]
            if not 0 <= count <= 3:
                raise BodyModelError(f"body: part '{name}': expected 0 to 3 axes, got {count}")
            axes, limits = self.axes[part, :count], self.limits[part, :count]
            if np.abs(axes @ axes.T - np.eye(count)).max(initial=0.0) > 1e-6:
                raise BodyModelError(
                    f"body: part '{name}': expected axes of unit length, square to each other"
                )
            if (limits[:, 0] > limits[:, 1]).any() or (np.abs(limits) > 2 * np.pi).any():
                raise BodyModelError(
                    f"body: part '{name}': expected limits (least, greatest) within one turn"
                )
        if np.abs(np.linalg.norm(self.rest, axis=1) - 1.0).max() > 1e-6:
            raise BodyModelError("body: expected unit quaternions as rest rotations")

    @property
    def n_parts(self) -> int:
        """Number of rigid parts."""
        return len(self.names)

    @property
    def n_angles(self) -> int:
        """Number of joint angles A; a pose has 7 + A numbers."""
        return int(self.n_axes.sum())

    @property
    def angle_starts(self) -> IntArray:
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
        rows = [self.limits[part, :count] for part, count in enumerate(self.n_axes)]
        return np.concatenate(rows) if rows else np.zeros((0, 2))


def _checked(values: ArrayLike, dtype: type, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = np.array(values, dtype)
    except (TypeError, ValueError) as error:
        raise BodyModelError(f"body: {what}: expected numbers: {error}") from error
    if array.shape != shape and not (array.size == 0 and np.prod(shape) == 0):
        raise BodyModelError(f"body: {what}: expected shape {shape}, got {array.shape}")
    array = array.reshape(shape)
    if not np.isfinite(array).all():
        raise BodyModelError(f"body: {what}: expected finite numbers")
    array.flags.writeable = False
    return array
