"""Poses for avatars: what a receiver on this machine gets."""

import socket
import struct

import numpy as np
import pytest

from dousa.app.vmc import BONES, VmcSender, encode_pose, find_pose
from dousa.errors import OptionError
from dousa.motion import JOINT_INDEX as J
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion


def take_text(data):
    end = data.index(b"\0")
    return data[:end].decode(), data[(end // 4 + 1) * 4 :]


def read_bundle(data):
    """The messages of a bundle, by address and first text."""
    assert data[:8] == b"#bundle\0" and len(data) % 4 == 0
    found, data = {}, data[16:]
    while data:
        (size,) = struct.unpack(">i", data[:4])
        address, rest = take_text(data[4 : 4 + size])
        tags, rest = take_text(rest)
        values = []
        for tag in tags[1:]:
            if tag == "s":
                value, rest = take_text(rest)
            else:
                (value,), rest = struct.unpack(">" + tag, rest[:4]), rest[4:]
            values.append(value)
        found[address, values[0] if isinstance(values[0], str) else ""] = values
        data = data[4 + size :]
    return found


def turn(bone, vector):
    """A vector in Unity's axes turned by the x, y, z, w of a bone."""
    x, y, z, w = bone[4:]
    axis = np.array([x, y, z])
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * np.asarray(vector))


def test_a_receiver_gets_bones_in_the_axes_of_unity():
    kick = canonicalise(make_motion("kick_left", draw_performer(3))).positions
    points = kick[kick[:, J["left_ankle"], 1].argmax()]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        sender = VmcSender(f"127.0.0.1:{receiver.getsockname()[1]}", rate=200.0)
        try:
            sender.push(points)
            found = [read_bundle(receiver.recv(65536)) for _ in range(5)][-1]
        finally:
            sender.end()
    bones = {name: values for (address, name), values in found.items() if address == "/VMC/Ext/Bone/Pos"}
    assert set(bones) == set(BONES) and ("/VMC/Ext/OK", "") in found
    np.testing.assert_allclose(bones["Hips"][1:4], points[J["pelvis"]] * (-1, 1, 1), atol=1e-6)
    wanted = (points[J["left_knee"]] - points[J["left_hip"]]) * (-1, 1, 1)
    thigh = turn(bones["Hips"], turn(bones["LeftUpperLeg"], [0, -1, 0]))
    np.testing.assert_allclose(thigh, wanted / np.linalg.norm(wanted), atol=0.05)


def test_who_stands_as_a_t_turns_no_bone():
    points = np.zeros((20, 3))
    places = {"spine": (0, 1.1, 0), "neck": (0, 1.4, 0), "head": (0, 1.6, 0)}
    for name, sign in (("left", 1), ("right", -1)):
        for joint, x in (("shoulder", 0.2), ("elbow", 0.5), ("wrist", 0.75), ("hand", 0.85)):
            places[f"{name}_{joint}"] = (sign * x, 1.4, 0)
        for joint, y in (("hip", 0.95), ("knee", 0.5), ("ankle", 0.1)):
            places[f"{name}_{joint}"] = (sign * 0.1, y, 0)
        places[f"{name}_toe"] = (sign * 0.1, 0.02, 0.1833)
    points[J["pelvis"]] = (0, 1.0, 0)
    for name, place in places.items():
        points[J[name]] = place
    found = read_bundle(encode_pose(find_pose(points), 0.0))
    for (address, name), values in found.items():
        if address == "/VMC/Ext/Bone/Pos":
            np.testing.assert_allclose(np.abs(values[4:]), [0, 0, 0, 1], atol=2e-3, err_msg=name)


@pytest.mark.parametrize("address", ["", "39539", "127.0.0.1:x", "127.0.0.1:99999", ":1"])
def test_what_is_no_address_is_one_sentence(address):
    with pytest.raises(OptionError, match="expected HOST:PORT"):
        VmcSender(address)
