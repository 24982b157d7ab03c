"""Motions and models of MikuMikuDance, written byte by byte for the tests and the fuzzer."""

import struct

import numpy as np

from dousa.formats.mmd.models import template

LINEAR = bytes([20] * 8 + [107] * 8)


def spread_curve(channels=((20, 20, 107, 107),) * 4):
    """64 bytes of the curves of x, y, z and the turn, as MMD writes them: three more rows, each shifted by one."""
    first = bytes(channels[c][k] for k in range(4) for c in range(4))
    return b"".join(first[row:] + bytes(row) for row in range(4))


def make_key(bone, frame, place=(0, 0, 0), turn=(0, 0, 0, 1), curve=None):
    """111 bytes; place and turn (x, y, z, w) left-handed, as MMD has them."""
    name = bone.encode("cp932")[:15].ljust(15, b"\0")
    return struct.pack("<15sI3f4f", name, frame, *place, *turn) + (curve or spread_curve())


def make_vmd(keys, switches=(), model="ミク"):
    """A motion: keys of `make_key`, and (frame, {IK bone: on})."""
    head = b"Vocaloid Motion Data 0002".ljust(30, b"\0") + model.encode("cp932").ljust(20, b"\0")
    body = struct.pack("<I", len(keys)) + b"".join(keys) + struct.pack("<IIII", 0, 0, 0, 0)
    body += struct.pack("<I", len(switches))
    for frame, states in switches:
        body += struct.pack("<IBI", frame, 1, len(states))
        body += b"".join(struct.pack("<20sB", name.encode("cp932"), on) for name, on in states.items())
    return head + body


def make_pmx(bones=None, *, encoding=0, n_vertices=3, scale=1.0):
    """A model with the bones of our template, a few vertices of every kind, a texture and a material."""
    bones = template().bones if bones is None else bones
    form = ("utf-16-le", "utf-8")[encoding]

    def text(words):
        raw = words.encode(form)
        return struct.pack("<i", len(raw)) + raw

    weights = [
        b"\0" + struct.pack("<h", 0),
        b"\1" + struct.pack("<2hf", 0, 1, 0.5),
        b"\2" + struct.pack("<4h4f", 0, 1, 2, 3, *[0.25] * 4),
        b"\3" + struct.pack("<2h10f", 0, 1, *[0.5] * 10),
    ]
    data = b"PMX " + struct.pack("<fB8B", 2.0, 8, encoding, 1, 1, 1, 1, 2, 1, 1)
    data += text("体") + text("body") + text("") + text("")
    data += struct.pack("<i", n_vertices)
    for number in range(n_vertices):
        data += struct.pack("<8f4f", *[0.5] * 12) + weights[number % 4] + struct.pack("<f", 1.0)
    data += struct.pack("<i3B", 3, 0, 1, 2) + struct.pack("<i", 1) + text("skin.png")
    data += struct.pack("<i", 1) + text("肌") + text("skin") + struct.pack("<11fB5f", *[1.0] * 11, 0, *[1.0] * 5)
    data += struct.pack("<bbBBB", 0, -1, 0, 1, 3) + text("memo") + struct.pack("<i", 3)
    data += struct.pack("<i", len(bones))
    for bone in bones:
        flags = 0x20 * (bone.ik is not None) + 0x100 * bone.turns
        place = np.array(bone.place) * (scale, scale, -scale)
        data += text(bone.name) + text("") + struct.pack("<3fhiH", *place, bone.parent, 0, flags)
        end = (0.0, 0.0, 0.0) if bone.end is None else (np.array(bone.end) - bone.place) * (scale, scale, -scale)
        data += struct.pack("<3f", *end)
        if bone.turns:
            data += struct.pack("<hf", bone.source, bone.share)
        if bone.ik is not None:
            data += struct.pack("<hifi", bone.ik.target, 40, 2.0, len(bone.ik.links))
            for link in bone.ik.links:
                limited = "ひざ" in bones[link].name
                data += struct.pack("<hB", link, limited) + (struct.pack("<6f", -3.14, 0, 0, -0.0087, 0, 0) * limited)
    return data + struct.pack("<i", 0)


def make_pmd(bones=None):
    """The older kind of model, with the bones of our template that have no source."""
    bones = template().bones if bones is None else bones
    data = b"Pmd" + struct.pack("<f20s256s", 1.0, "体".encode("cp932"), b"")
    data += struct.pack("<I", 1) + bytes(38) + struct.pack("<I", 3) + bytes(6) + struct.pack("<I", 1) + bytes(70)
    data += struct.pack("<H", len(bones))
    for bone in bones:
        place = np.array(bone.place) * (1, 1, -1)
        data += struct.pack("<20sHHBH3f", bone.name.encode("cp932"), bone.parent % 65536, 0, 0, 0, *place)
    chains = [(number, bone.ik) for number, bone in enumerate(bones) if bone.ik is not None]
    data += struct.pack("<H", len(chains))
    for number, ik in chains:
        data += struct.pack(f"<HHBHf{len(ik.links)}H", number, ik.target, len(ik.links), 40, 2.0, *ik.links)
    return data + bytes(20)
