"""Motive-like CSV: a motion as a skeleton of bones, trajectories as labelled markers."""

from __future__ import annotations

import math
import os

import numpy as np

from dousa.errors import MotionWriteError
from dousa.files.disk import atomic_write
from dousa.motion import Motion, Trajectories, forward_kinematics

_BONE = ("Rotation",) * 4 + ("Position",) * 3
_BONE_AXES = tuple("XYZWXYZ")


def write_motive(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a table as Motive exports it: metres, Y up, rotations of bones as quaternions in the world.

    A motion is written with the row ``Parent`` of version 1.24; missing values are blank.

    Raises
    ------
    MotionWriteError : a name with a comma, a quote or a line break, a disk error.
    """
    bones = isinstance(motion, Motion)
    names = motion.skeleton.names if isinstance(motion, Motion) else motion.names
    for name in names:
        if not name.strip() or any(sign in name for sign in ',"\r\n:'):
            raise MotionWriteError(path, "motive.name", name=name)
    if isinstance(motion, Motion):
        skeleton = motion.skeleton
        positions, world = forward_kinematics(skeleton.parents, motion.rotations, motion.translations)
        values = np.concatenate((world[..., [1, 2, 3, 0]], positions), axis=2)
        above = tuple(names[parent] if parent >= 0 else "" for parent in skeleton.parents)
    else:
        values, above = motion.positions, ()
    width = values.shape[2]
    rate = repr(float(motion.frame_rate))
    keys = (
        "Format Version", "1.24", "Take Name", "dousa", "Capture Frame Rate", rate, "Export Frame Rate", rate,
        "Total Exported Frames", str(motion.n_frames), "Rotation Type", "Quaternion", "Length Units", "Meters",
        "Coordinate Space", "Global",
    )  # fmt: skip

    def spread(title: str, cells: tuple[str, ...]) -> str:
        return ",".join(("", title, *(cell for cell in cells for _ in range(width))))

    kind = "Bone" if bones else "Marker"
    rows = [",".join(keys), "", spread("Type", (kind,) * len(names)), spread("Name", names)]
    rows.append(spread("ID", tuple(str(number) for number in range(1, len(names) + 1))))
    if bones:
        rows.append(spread("Parent", above))
    quantities, axes = (_BONE, _BONE_AXES) if bones else (("Position",) * 3, tuple("XYZ"))
    rows.append(",".join(("", "", *quantities * len(names))))
    rows.append(",".join(("Frame", "Time (Seconds)", *axes * len(names))))
    with atomic_write(path) as file:
        file.write(("\r\n".join(rows) + "\r\n").encode())
        for frame, row in enumerate(values.reshape(motion.n_frames, -1).tolist()):
            cells = ",".join("" if math.isnan(value) else repr(value) for value in row)
            file.write(f"{frame},{frame / motion.frame_rate!r},{cells}\r\n".encode())
