"""The central types: Skeleton, Motion, Trajectories, and Provenance.

Frozen and slotted; their arrays are read-only and checked once, at construction. Units are metres, seconds and
radians, right-handed, Y up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError
from dousa.messages import Message
from dousa.notebooks import plays, short_repr


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Mark an array without other references as read-only, so that constructors do not copy it."""
    array.flags.writeable = False
    return array


def _frozen_array(values: ArrayLike, dtype: type, shape: tuple[int | None, ...], what: str) -> NDArray[Any]:
    """A read-only C-ordered array of the wanted shape (None fits any length); copies only what is writable."""
    try:
        array: NDArray[Any] = np.ascontiguousarray(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InvalidMotionError("motion.numbers", what=what, shape=shape, reason=error) from error
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InvalidMotionError("motion.shape", what=what, wanted=wanted, shape=array.shape)
    if array.flags.writeable:
        # A view could still be changed through its buffer.
        array = array.copy() if array is values or array.base is not None else array
        array.flags.writeable = False
    return array


def _check_rate(frame_rate: float, what: str) -> float:
    rate = float(frame_rate)
    if not (np.isfinite(rate) and 0 < rate <= 1e6):
        raise InvalidMotionError("motion.rate", what=what, rate=frame_rate)
    return rate


def _check_parents(parents: IndexArray, what: str) -> None:
    later = np.flatnonzero(parents >= np.arange(len(parents)))
    if len(later) or (parents < -1).any():
        bad = int(later[0]) if len(later) else int(np.flatnonzero(parents < -1)[0])
        raise InvalidMotionError("motion.parents", what=what, joint=bad, parent=int(parents[bad]))


@dataclass(frozen=True, slots=True)
class Provenance:
    """Source of a motion, and the conversion of the file's numbers to metres with Y up.

    Parameters
    ----------
    path : the file read.
    format : short name of the format, such as ``"bvh"``.
    unit : metres per unit of the file.
    unit_source : ``"declared"``, ``"inferred"`` (from body height), ``"given"`` or ``"assumed"``.
    up : axis of the file that points up: ``"x"``, ``"y"``, ``"z"``, or with a minus ``"-y"`` ...
    up_source : as ``unit_source``.
    layout : of this format only (channel order, declared frame time ...); see the format's module.
    values : the file's own numbers, for writing an unchanged motion to the last digit; None in derived motions. Ask
        `values_of`, which knows whether they still are the motion's.
    read : the arrays that were made of them, shared with the motion.
    notes : for the user, on the reading of the file: wrong declarations, assumptions.
    shift : m, (x, y, z) with Y up, taken off all positions as they were too far from the origin; None mostly.
    """

    path: str
    format: str
    unit: float = 1.0
    unit_source: str = "declared"
    up: str = "y"
    up_source: str = "declared"
    layout: Any = None
    values: FloatArray | None = None
    read: tuple[NDArray[Any], ...] = ()
    notes: tuple[Message, ...] = ()
    shift: tuple[float, float, float] | None = None

    def values_of(self, *arrays: NDArray[Any]) -> FloatArray | None:
        """Return the file's own numbers if ``arrays`` are those made of them on reading; None if any was changed."""
        same = len(arrays) == len(self.read) and all(
            one is other or np.array_equal(one, other, equal_nan=True)
            for one, other in zip(arrays, self.read, strict=True)
        )
        return self.values if same else None

    def derive(self) -> Provenance:
        """Return the source of a motion with other arrays, without the file's own numbers."""
        return dataclasses.replace(self, values=None, read=())


@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """A tree of joints.

    Parameters
    ----------
    names : (J,) joint names as the file spells them.
    parents : (J,) index of each joint's parent, which stands before it; -1 for a root.
    offsets : (J, 3) m, position in the parent's axes at rest.
    end_sites : (J,) true for tips of chains without their own rotation (BVH ``End Site``); none by default.

    Raises
    ------
    InvalidMotionError : no joint, shapes that disagree, a parent after its child, offsets that are not finite.

    >>> skeleton = dousa.Skeleton(("hips", "chest"), [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    >>> skeleton.n_joints
    2
    """

    names: tuple[str, ...]
    parents: IndexArray
    offsets: FloatArray
    end_sites: BoolArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        names = tuple(map(str, self.names))
        count = len(names)
        if count == 0:
            raise InvalidMotionError("motion.no_joint")
        parents = _frozen_array(self.parents, np.intp, (count,), "skeleton parents")
        _check_parents(parents, "skeleton")
        offsets = _frozen_array(self.offsets, np.float64, (count, 3), "skeleton offsets")
        if not np.isfinite(offsets).all():
            bad = names[int(np.argwhere(~np.isfinite(offsets))[0][0])]
            raise InvalidMotionError("motion.offsets", joint=bad)
        ends = np.zeros(count, bool) if self.end_sites is None else self.end_sites
        set_field = object.__setattr__
        set_field(self, "names", names)
        set_field(self, "parents", parents)
        set_field(self, "offsets", offsets)
        set_field(self, "end_sites", _frozen_array(ends, np.bool_, (count,), "skeleton end sites"))

    @property
    def n_joints(self) -> int:
        """Number of joints, end sites included."""
        return len(self.names)

    def index(self, name: str) -> int:
        """Return the index of the first joint of that name; InvalidMotionError if there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise InvalidMotionError("motion.unknown_joint", name=name, known=self.names) from None


class _Recording:
    """The part that motions and trajectories share."""

    __slots__ = ()
    if TYPE_CHECKING:
        frame_rate: float
        provenance: Provenance | None

        @property
        def n_frames(self) -> int: ...

    @property
    def duration(self) -> float:
        """Seconds from the first pose to the end of the last."""
        return self.n_frames / self.frame_rate

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed, without the file's own numbers."""
        if "provenance" not in changes and self.provenance is not None:
            changes["provenance"] = self.provenance.derive()
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]  # of the dataclasses below


@plays
@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class Motion(_Recording):
    """Joint rotations over time.

    Parameters
    ----------
    skeleton : the joints.
    rotations : (T, J, 4) local unit quaternions, w x y z; a row of NaN where the file has none.
    translations : (T, J, 3) m, local positions in the parent's axes (real files animate them).
    frame_rate : Hz.
    provenance : source, if it was read.

    Raises
    ------
    InvalidMotionError : zero frames, shapes that disagree, quaternions not of unit length, infinite values.

    >>> motion = dousa.read_motion("wave.bvh")
    >>> motion.rotations.shape == (motion.n_frames, motion.skeleton.n_joints, 4)
    True
    """

    skeleton: Skeleton
    rotations: FloatArray
    translations: FloatArray
    frame_rate: float
    provenance: Provenance | None = None

    def __post_init__(self) -> None:
        joints = self.skeleton.n_joints
        rotations = _frozen_array(self.rotations, np.float64, (None, joints, 4), "motion rotations")
        frames = len(rotations)
        if frames == 0:
            raise InvalidMotionError("motion.no_frames")
        translations = _frozen_array(self.translations, np.float64, (frames, joints, 3), "motion translations")
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file may hold 1e300 and infinities
            # Of infinity it is true too; NaN is what is missing. Piece by piece: a long recording fills the memory.
            pieces = (rotations[start : start + 65_536] for start in range(0, frames, 65_536))
            far = any((np.abs(np.einsum("tjk,tjk->tj", some, some) - 1.0) > 1e-6).any() for some in pieces)
            whole = np.isfinite(translations.sum())  # spares the look at every value
        if far or (not whole and np.isinf(translations).any()):
            raise InvalidMotionError("motion.quaternions")
        set_field = object.__setattr__
        set_field(self, "rotations", rotations)
        set_field(self, "translations", translations)
        set_field(self, "frame_rate", _check_rate(self.frame_rate, "motion"))

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.rotations)


@plays
@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class Trajectories(_Recording):
    """Positions of named points over time, common to all formats.

    Parameters
    ----------
    names : (K,) names of the points (joints or markers).
    positions : (T, K, 3) m, world, Y up; NaN where missing.
    frame_rate : Hz.
    parents : (K,) tree of the points of a skeleton; -1 for a root, None if unknown.
    rest_positions : (K, 3) m, the skeleton's rest pose in its own axes, if known.
    provenance : source, if it was read.

    Raises
    ------
    InvalidMotionError : zero frames, no points, shapes that disagree, infinite values.

    >>> steps = dousa.Trajectories(("left_heel", "right_heel"), [[[0, 0, 0], [0.2, 0, 0]]], 100.0)
    >>> steps.positions.shape
    (1, 2, 3)
    """

    names: tuple[str, ...]
    positions: FloatArray
    frame_rate: float
    parents: IndexArray | None = None
    rest_positions: FloatArray | None = None
    provenance: Provenance | None = None

    def __post_init__(self) -> None:
        names = tuple(map(str, self.names))
        count = len(names)
        positions = _frozen_array(self.positions, np.float64, (None, count, 3), "trajectories")
        if count == 0 or len(positions) == 0:
            raise InvalidMotionError("motion.no_points", points=count, frames=len(positions))
        if np.isinf(positions).any():
            frame, point, _ = np.argwhere(np.isinf(positions))[0]
            raise InvalidMotionError("motion.infinite", name=names[point], frame=int(frame))
        set_field = object.__setattr__
        set_field(self, "names", names)
        set_field(self, "positions", positions)
        set_field(self, "frame_rate", _check_rate(self.frame_rate, "trajectories"))
        if self.parents is not None:
            parents = _frozen_array(self.parents, np.intp, (count,), "trajectories parents")
            _check_parents(parents, "trajectories")
            set_field(self, "parents", parents)
        if self.rest_positions is not None:
            rest = _frozen_array(self.rest_positions, np.float64, (count, 3), "rest positions")
            set_field(self, "rest_positions", rest)

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.positions)

    def select(self, names: Sequence[str]) -> FloatArray:
        """Return the positions (T, len(names), 3) of the points of these names, in this order."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InvalidMotionError("motion.unknown_point", name=missing[0], known=self.names)
        return self.positions[:, [self.names.index(name) for name in names]]
