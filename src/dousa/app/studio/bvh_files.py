"""A motion, or a part of one, as the bytes of a BVH file."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.studio.gates import Gate
from dousa.errors import DousaError

if TYPE_CHECKING:
    from dousa.app.studio.motions import MotionRef, Named
    from dousa.motion import Motion

__all__ = ["make_bvh"]

_SAME = 1e-3  # m: joints of the library are rounded
_WAIT = 60.0  # s
_gate = Gate(2, 6, "other motions are being written; try again in a moment")  # an hour takes half a minute


def make_bvh(named: Named, source: Path, ref: MotionRef) -> bytes:
    """The motion as a BVH file.

    Parameters
    ----------
    named : the motion, or the part.
    source : the file it came from; it may be gone, or be something else by now.
    ref : which part, and what was said about the file.

    Returns
    -------
    Bytes. Where the source still holds this very motion as rotations, all its joints are in them; else a body of
    the canonical joints is fitted.

    Raises
    ------
    RefusedError : many others wait.
    """
    from dousa.formats import write_motion

    with _gate.enter(_WAIT), tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        path = Path(folder) / "motion.bvh"
        original = _read_original(named, source, ref)
        if original is None:
            write_motion(_fit(named), path)
        else:
            write_motion(original, path)
        return path.read_bytes()


def _read_original(named: Named, source: Path, ref: MotionRef) -> Motion | None:
    """The part of the file that is meant; None if it does not hold this motion."""
    from dousa.formats import read_motion
    from dousa.motion import Motion

    try:
        motion = read_motion(source, unit=ref.unit, up=ref.up)
        if not isinstance(motion, Motion):
            return None
        first = 0 if ref.start_s is None else round(ref.start_s * motion.frame_rate)
        last = first + named.motion.n_frames
        if not ref.is_whole:
            motion = motion.replace(
                rotations=motion.rotations[first:last], translations=motion.translations[first:last]
            )
        return motion if _is_same(motion, named, ref) else None
    except (DousaError, OSError):
        return None  # what the library keeps serves as well


def _is_same(motion: Motion, named: Named, ref: MotionRef) -> bool:
    """Whether a file still moves as the library remembers it: same length, rate, places and unit."""
    from dousa.motion import canonicalise

    if motion.n_frames != named.motion.n_frames or motion.frame_rate != named.motion.frame_rate:
        return False
    positions = canonicalise(motion, ref.joint_map).positions
    return bool(np.abs(positions - named.motion.positions).max() <= _SAME)


def _fit(named: Named) -> Motion:
    from dousa.motion import fit_motion

    return fit_motion(named.motion)
