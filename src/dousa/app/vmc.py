"""A live motion for avatars: poses go out by the Virtual Motion Capture protocol (VMC), as OSC messages over UDP.

VMC (https://protocol.vmc.info/english) names bones as Unity does and turns each from a T-pose facing +Z, in Unity's
left-handed axes: X right, Y up, Z forward. That is the rest pose of `fit_points` in a mirror. OSC 1.0
(https://opensoundcontrol.stanford.edu/spec-1_0.html) pads texts to four bytes and writes numbers big-endian.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from contextlib import suppress

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.motion.canonical.fitting import fit_points
from dousa.motion.canonical.joints import JOINT_INDEX

# The joint at which each bone turns; the canonical neck carries the shoulders, as Unity's chest does.
_TRUNK = {"Hips": "pelvis", "Spine": "spine", "Chest": "neck"}
_LIMBS = {
    "UpperArm": "shoulder", "LowerArm": "elbow", "Hand": "wrist",
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle",
}  # fmt: skip
BONES = _TRUNK | {
    side + bone: f"{side.lower()}_{joint}" for side in ("Left", "Right") for bone, joint in _LIMBS.items()
}
"""Canonical joints by the names of Unity's bones."""


def encode_message(address: str, *values: str | float) -> bytes:
    """Encode an OSC message; whole numbers are int32, others float32."""
    tags, content = ",", b""
    for value in values:
        if isinstance(value, str):
            tags, content = tags + "s", content + _pad(value)
        elif isinstance(value, int):
            tags, content = tags + "i", content + struct.pack(">i", value)
        else:
            tags, content = tags + "f", content + struct.pack(">f", value)
    return _pad(address) + _pad(tags) + content


def _pad(text: str) -> bytes:
    data = text.encode() + b"\0"
    return data + b"\0" * (-len(data) % 4)


def find_pose(points: FloatArray) -> FloatArray:
    """Return the turns of Unity's bones and the place of the hips, (B + 1, 4), from canonical joints (20, 3), m, Y up.

    A row of turns is x, y, z, w in Unity's axes, the last row x, y, z in m and 0.
    """
    turns = fit_points(points[None], 1.0).rotations[0, [JOINT_INDEX[joint] for joint in BONES.values()]]
    place = np.append(points[JOINT_INDEX["pelvis"]] * (-1.0, 1.0, 1.0), 0.0)
    return np.vstack((turns[:, [1, 2, 3, 0]] * (1.0, -1.0, -1.0, 1.0), place))


def encode_pose(pose: FloatArray, seconds: float) -> bytes:
    """Encode a pose of `find_pose` at a time in s as one OSC bundle of a VMC performer."""
    messages = [encode_message("/VMC/Ext/OK", 1), encode_message("/VMC/Ext/T", float(seconds))]
    messages.append(encode_message("/VMC/Ext/Root/Pos", "root", *map(float, (0, 0, 0, 0, 0, 0, 1))))
    *turns, hips = pose.tolist()
    for bone, turn in zip(BONES, turns, strict=True):
        place = hips[:3] if bone == "Hips" else [0.0, 0.0, 0.0]
        messages.append(encode_message("/VMC/Ext/Bone/Pos", bone, *place, *turn))
    parts = (struct.pack(">i", len(one)) + one for one in messages)
    return b"#bundle\0" + struct.pack(">q", 1) + b"".join(parts)  # 1: at once


def _approach(pose: FloatArray, other: FloatArray, share: float) -> FloatArray:
    """Go a share of the way from one pose to another."""
    turns = other[:-1] * np.where((pose[:-1] * other[:-1]).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    turns = pose[:-1] + share * (turns - pose[:-1])
    place = pose[-1] + share * (other[-1] - pose[-1])
    return np.vstack((turns / np.linalg.norm(turns, axis=1, keepdims=True), place))


class VmcSender:
    """Sends the newest pose to a receiver, many times a second, each step a part of the way there.

    Parameters
    ----------
    address : ``HOST:PORT`` of the receiver; 39539 is the port that most listen on.
    rate : Hz; a camera gives fewer poses.
    settled_s : s in which two thirds of the way to a new pose are gone.
    held_s : s after the last pose, in which it is still sent.

    Raises OptionError for an address that there is not.
    """

    def __init__(self, address: str, *, rate: float = 60.0, settled_s: float = 0.05, held_s: float = 2.0) -> None:
        host, _, port = address.rpartition(":")
        try:
            found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM) if 0 < int(port) < 65536 else []
            self._to = found[0][4]
        except (OSError, ValueError, IndexError):
            raise OptionError("studio_live.vmc_address", found=address) from None
        self._rate, self._share, self._held_s = rate, 1.0 - np.exp(-1.0 / (rate * settled_s)), held_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._newest: tuple[float, FloatArray] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="vmc", daemon=True)
        self._thread.start()

    def push(self, points: FloatArray) -> None:
        """Take the next pose (20, 3), m, Y up; one that is not whole is left out."""
        if np.isfinite(points).all():
            self._newest = time.monotonic(), find_pose(points)

    def end(self) -> None:
        """Stop to send."""
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        begun = due = time.monotonic()
        shown = None
        while not self._over.wait(due - time.monotonic()):
            pushed, newest = self._newest or (-np.inf, None)
            now = time.monotonic()
            due = max(due, now - 1.0 / self._rate) + 1.0 / self._rate
            if newest is None or now - pushed > self._held_s:
                shown = None
                continue
            shown = newest if shown is None else _approach(shown, newest, self._share)
            with suppress(OSError):  # no program listens there yet
                self._socket.sendto(encode_pose(shown, now - begun), self._to)
