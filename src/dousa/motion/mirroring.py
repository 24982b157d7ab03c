"""The mirror image of a motion: what the left side did, the right side does, and the other way round.

The reflection is that of the plane X = 0 of the world: Y stays up, heights, speeds and times stay, a turn to the
left becomes one to the right, and somebody who starts facing Z still does. Left and right joints change places
with it, so the axes stay right-handed and every arm stays on its side of the body. Mirroring twice gives
the motion back, to the last bit.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dousa.errors import InvalidMotionError
from dousa.motion._types import FloatArray
from dousa.motion.canonical import CanonicalMotion, JointMapping
from dousa.motion.joints import CANONICAL_JOINTS, MIRRORED_JOINTS

__all__ = ["mirror_canonical", "mirror_positions"]

_MIRRORED = np.array(MIRRORED_JOINTS)


class _Posed(Protocol):
    """A dataclass with canonical joints over time: a canonical motion, a labelled clip."""

    __dataclass_fields__: dict[str, Any]

    @property
    def positions(self) -> FloatArray: ...


_Some = TypeVar("_Some", bound=_Posed)


def mirror_positions(positions: ArrayLike) -> FloatArray:
    """The mirror image of canonical positions.

    Parameters
    ----------
    positions : (..., 20, 3), right-handed, Y up, any unit, order of ``CANONICAL_JOINTS``; NaN stays NaN.

    Returns
    -------
    (..., 20, 3) in the same unit and order, a new array.

    Raises
    ------
    InvalidMotionError : another shape.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim < 2 or points.shape[-2:] != (len(CANONICAL_JOINTS), 3):
        raise InvalidMotionError(f"expected canonical positions (..., 20, 3), got shape {points.shape}")
    mirrored = points[..., _MIRRORED, :]
    # 0 - x and not -x: a joint at 0 must not come back as -0, which is other bytes and another content hash.
    mirrored[..., 0] = 0.0 - mirrored[..., 0]
    return mirrored


def mirror_canonical(motion: _Some) -> _Some:
    """The mirror image of a motion of canonical joints.

    Parameters
    ----------
    motion : a ``CanonicalMotion``, or another frozen dataclass with ``positions`` (T, 20, 3) m, such as a labelled
        clip; its other fields (frame rate, height, category) are kept as they are.

    Returns
    -------
    The same kind of motion. Of a ``CanonicalMotion`` the joints that were not seen, and where joints come from,
    change sides too: the left hand of the mirror image comes from the right hand of the file.

    Raises
    ------
    InvalidMotionError : positions of another shape.
    """
    positions = mirror_positions(motion.positions)
    positions.flags.writeable = False
    changed: dict[str, Any] = {"positions": positions}
    if isinstance(motion, CanonicalMotion):
        changed["mapping"] = _mirror_mapping(motion.mapping)
        changed["missing"] = None if motion.missing is None else motion.missing[:, _MIRRORED]
    return dataclasses.replace(motion, **changed)  # type: ignore[type-var, no-any-return]


def _mirror_mapping(mapping: JointMapping) -> JointMapping:
    names = {
        joint: CANONICAL_JOINTS[other] for joint, other in zip(CANONICAL_JOINTS, MIRRORED_JOINTS, strict=True)
    }
    sources = {joint: mapping.sources[names[joint]] for joint in names if names[joint] in mapping.sources}
    derived = tuple(names[joint] for joint in mapping.derived)
    return dataclasses.replace(mapping, sources=sources, derived=derived)
