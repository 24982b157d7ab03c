"""Writes the walk of a known person in each format, by the format's own rules, whole or with something wrong in it."""

from __future__ import annotations

import dataclasses
import io
import json
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

# Name; name in MVNX; parent; offset (m, Y up, the person faces +Z); end site.
BODY: tuple[tuple[str, str, int, tuple[float, float, float], tuple[float, float, float] | None], ...] = (
    ("Hips", "Pelvis", -1, (0, 0, 0), None),
    ("Spine", "L5", 0, (0, 0.08, 0), None),
    ("Spine1", "L3", 1, (0, 0.1, 0), None),
    ("Spine2", "T12", 2, (0, 0.1, 0), None),
    ("Spine3", "T8", 3, (0, 0.1, 0), None),
    ("Neck", "Neck", 4, (0, 0.14, 0), None),
    ("Head", "Head", 5, (0, 0.09, 0.01), (0, 0.18, 0)),
    ("RightShoulder", "RightShoulder", 4, (-0.03, 0.09, 0), None),
    ("RightArm", "RightUpperArm", 7, (-0.14, 0, 0), None),
    ("RightForeArm", "RightForeArm", 8, (-0.28, 0, 0), None),
    ("RightHand", "RightHand", 9, (-0.25, 0, 0), (-0.17, 0, 0)),
    ("LeftShoulder", "LeftShoulder", 4, (0.03, 0.09, 0), None),
    ("LeftArm", "LeftUpperArm", 11, (0.14, 0, 0), None),
    ("LeftForeArm", "LeftForeArm", 12, (0.28, 0, 0), None),
    ("LeftHand", "LeftHand", 13, (0.25, 0, 0), (0.17, 0, 0)),
    ("RightUpLeg", "RightUpperLeg", 0, (-0.09, -0.02, 0), None),
    ("RightLeg", "RightLowerLeg", 15, (0, -0.42, 0), None),
    ("RightFoot", "RightFoot", 16, (0, -0.41, 0), None),
    ("RightToeBase", "RightToe", 17, (0, -0.06, 0.13), (0, 0, 0.07)),
    ("LeftUpLeg", "LeftUpperLeg", 0, (0.09, -0.02, 0), None),
    ("LeftLeg", "LeftLowerLeg", 19, (0, -0.42, 0), None),
    ("LeftFoot", "LeftFoot", 20, (0, -0.41, 0), None),
    ("LeftToeBase", "LeftToe", 21, (0, -0.06, 0.13), (0, 0, 0.07)),
)
NAMES = [row[0] for row in BODY]
# The 22 joints of SMPL and HumanML3D, in their order.
SMPL = [NAMES.index(n) for n in (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase RightToeBase Neck "
    "LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm "
    "LeftHand RightHand").split()]  # fmt: skip
N_FRAMES = 40


def rotation(angles: np.ndarray) -> np.ndarray:
    """Compute matrices from angles (..., 3) in degrees of which at most one is not zero."""
    c, s = np.cos(np.radians(angles)), np.sin(np.radians(angles))
    out = np.broadcast_to(np.eye(3), (*angles.shape, 3, 3)).copy()
    for axis, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[..., axis, a, a] = out[..., axis, b, b] = c[..., axis]
        out[..., axis, a, b], out[..., axis, b, a] = -s[..., axis], s[..., axis]
    return out[..., 0, :, :] @ out[..., 1, :, :] @ out[..., 2, :, :]


@dataclasses.dataclass
class Scene:
    """What a file says: declared values, rows, and the cells (row, joint) that hold something else than the person."""

    rate: float = 30.0
    n: int = N_FRAMES
    unit: str = "mm"
    people: tuple[str, ...] = ("",)
    suffix: str = ""
    shift: float = 0.0
    rows: list[int] = dataclasses.field(default_factory=list)
    times: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    first: int = 0
    declared_frames: int = 0
    declared_points: int = 0
    time_digits: int = 6
    cells: dict[tuple[int, int], Any] = dataclasses.field(default_factory=dict)
    tree: str = ""
    still: bool = False
    size: float = 1.0  # of the bones; 0 puts all joints into one point
    header_rate: float | None = None
    newline: str = "\n"

    @property
    def stated(self) -> float:
        """The rate that the head of the file states."""
        return self.rate if self.header_rate is None else self.header_rate

    def __post_init__(self) -> None:
        self.rows = list(range(self.n))
        self.times = (np.arange(self.n) + self.first) / self.rate

    @property
    def angles(self) -> np.ndarray:
        """Angles (n, 23, 3) in degrees, each joint about one axis."""
        phase = 0 if self.still else 2 * np.pi * np.arange(self.n) / 30
        swing = np.sin(phase) * np.ones(self.n)
        out = np.zeros((self.n, len(BODY), 3))

        def put(name: str, axis: int, values: np.ndarray) -> None:
            out[:, NAMES.index(name), axis] = values

        put("Hips", 1, 8 * swing)
        put("Spine1", 1, -5 * swing)
        for side, sign in (("Left", 1), ("Right", -1)):
            put(f"{side}Arm", 2, -sign * (65 + 12 * swing))
            put(f"{side}ForeArm", 1, -sign * (25 + 15 * swing))
            put(f"{side}UpLeg", 0, sign * 25 * swing)
            put(f"{side}Leg", 0, 20 + sign * 15 * swing)
        return out

    @property
    def root(self) -> np.ndarray:
        """Places (n, 3) of the pelvis in metres, the lowest toe on the floor."""
        out = np.zeros((self.n, 3))
        if not self.still:
            out[:, 2] = np.arange(self.n) * 0.03
            out[:, 0] = 0.3 + 0.02 * np.sin(np.arange(self.n) / 5)
        out[:, 1] = -self.pose(out)[0][:, :, 1].min(axis=1)
        return out + self.shift

    def pose(self, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute places (n, 23, 3) and world rotations (n, 23, 3, 3)."""
        turn, place = rotation(self.angles), np.zeros((self.n, len(BODY), 3))
        place[:, 0] = root
        for j, (_, _, parent, offset, _) in enumerate(BODY[1:], 1):
            place[:, j] = place[:, parent] + turn[:, parent] @ (np.array(offset) * self.size)
            turn[:, j] = turn[:, parent] @ turn[:, j]
        return place, turn

    @property
    def truth(self) -> np.ndarray:
        """Places (n, 23, 3) in metres, Y up."""
        return self.pose(self.root)[0]

    def names(self, person: str = "") -> list[str]:
        """Names of the joints in the file."""
        return [f"{person}:{n}{self.suffix}" if person else f"{n}{self.suffix}" for n in NAMES]

    def all_names(self) -> list[str]:
        """Names of all points of all people."""
        return [n for p in self.people for n in self.names(p)]

    def table(self, up: str = "y") -> list[list[Any]]:
        """Numbers in the unit of the file, one list of 3 K cells a row, other people 1.5 m to the side."""
        places = np.concatenate([self.truth + np.array([1.5 * i, 0, 0]) for i in range(len(self.people))], axis=1)
        if up == "z":
            places = np.stack([places[..., 0], -places[..., 2], places[..., 1]], axis=-1)
        rows = (places * (1000.0 if self.unit == "mm" else 1.0)).reshape(self.n, -1).tolist()
        for (row, joint), value in self.cells.items():
            rows[row][3 * joint : 3 * joint + 3] = [value] * 3
        return [rows[r] for r in self.rows]

    @property
    def n_points(self) -> int:
        return len(BODY) * len(self.people)


def number(value: Any) -> str:
    """Spell a cell: a number with nine digits, a word as it is."""
    return value if isinstance(value, str) else f"{value:.9g}" if abs(value) < 1e4 else f"{value:.12g}"


def lines(scene: Scene, head: list[str], sep: str, number_from: int | None, with_time: bool) -> bytes:
    """Join a head and the rows of a table of text."""
    for row, cells in zip(scene.rows, scene.table(), strict=True):
        lead = [str(row + scene.first + number_from)] if number_from is not None else []
        lead += [f"{scene.times[row]:.{scene.time_digits}f}"] if with_time else []
        head.append(sep.join(lead + [number(c) for c in cells]))
    return (scene.newline.join(head) + scene.newline).encode()


def write_trc(s: Scene) -> bytes:
    rate = f"{s.stated:.6g}"
    k, n = s.n_points + s.declared_points, s.n + s.declared_frames
    head = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{n}\t{k}\t{s.unit}\t{rate}\t1\t{n}",
        "Frame#\tTime\t" + "\t\t\t".join(s.all_names()) + "\t\t",
        "\t\t" + "\t".join(f"{a}{i}" for i in range(1, s.n_points + 1) for a in "XYZ"),
        "",
    ]
    return lines(s, head, "\t", 1, True)


def write_motive(s: Scene) -> bytes:
    rate, unit = (
        f"{s.stated:.6f}",
        {"mm": "Millimeters", "m": "Meters"}[s.unit],
    )

    def triple(values: list[str]) -> str:
        return ",".join(v for v in values for _ in range(3))

    head = [
        f"Format Version,1.23,Take Name,walk,Capture Frame Rate,{rate},Export Frame Rate,{rate},Capture Start Time,"
        f"2024-03-01 10.00.00.000 AM,Total Frames in Take,{s.n + s.declared_frames},Total Exported Frames,"
        f"{s.n + s.declared_frames},Rotation Type,Quaternion,Length Units,{unit},Coordinate Space,Global",
        "",
        ",," + triple(["Marker"] * s.n_points),
        ",," + triple(s.all_names()),
        ",," + triple([f'"{i}"' for i in range(s.n_points)]),
        ",," + triple(["Position"] * s.n_points),
        "Frame,Time (Seconds)," + ",".join("XYZ" * s.n_points),
    ]
    head[2:4] = [",Type," + head[2][2:], ",Name," + head[3][2:]]
    head[4] = ",ID," + head[4][2:]
    return lines(s, head, ",", 0, True)


def write_table(s: Scene) -> bytes:
    return lines(s, ["time," + ",".join(f"{n}_{a}" for n in s.all_names() for a in "xyz")], ",", None, True)


def write_nexus(s: Scene) -> bytes:
    head = [
        "Trajectories",
        f"{s.stated:g}",
        ",," + ",,,".join(s.all_names()) + ",,",
        "Frame,Sub Frame," + ",".join("XYZ" * s.n_points),
        ",," + ",".join([s.unit] * 3 * s.n_points),
    ]
    for row, cells in zip(s.rows, s.table("z"), strict=True):
        head.append(",".join([str(row + 1 + s.first), "0", *map(number, cells)]))
    return (s.newline.join(head) + s.newline).encode()


def write_tsv(s: Scene) -> bytes:
    head = [
        f"NO_OF_FRAMES\t{s.n + s.declared_frames}",
        "NO_OF_CAMERAS\t8",
        f"NO_OF_MARKERS\t{s.n_points + s.declared_points}",
        f"FREQUENCY\t{s.stated:g}",
        "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2024-03-01, 10:00:00.000",
        "DATA_INCLUDED\t3D",
        "MARKER_NAMES\t" + "\t".join(s.all_names()),
        "Frame\tTime\t" + "\t".join(f"{n} {a}" for n in s.all_names() for a in "XYZ"),
    ]
    return lines(s, head, "\t", 1, True)


def positions(s: Scene) -> np.ndarray:
    """Collect the cells as an array (rows, points, 3)."""
    return np.array(s.table(), float).reshape(len(s.rows), -1, 3)


def write_npy(s: Scene) -> bytes:
    out = io.BytesIO()
    np.save(out, positions(s)[:, SMPL])
    return out.getvalue()


def write_npz(s: Scene) -> bytes:
    out = io.BytesIO()
    np.savez(out, positions=positions(s), joint_names=np.array(s.all_names()), frame_rate=np.array(s.stated))
    return out.getvalue()


def write_json(s: Scene) -> bytes:
    rows = [[row[3 * j : 3 * j + 3] for j in SMPL] for row in s.table()]
    return json.dumps(rows).replace("Infinity", "1e999").encode()


def write_c3d(s: Scene) -> bytes:
    rate, k, n = s.stated, s.n_points, len(s.rows) + s.declared_frames
    out = bytearray(b"\0\0\0\x54")

    def group(name: str, index: int) -> None:
        out.extend(struct.pack("<bb", len(name), -index) + name.encode() + struct.pack("<hb", 3, 0))

    def parameter(name: str, index: int, kind: int, dims: Sequence[int], data: bytes) -> None:
        body = struct.pack("<bB", kind, len(dims)) + bytes(dims) + data + b"\0"
        out.extend(struct.pack("<bb", len(name), index) + name.encode() + struct.pack("<h", len(body) + 2) + body)

    group("POINT", 1)
    for name, value in (("USED", k + s.declared_points), ("DATA_START", 0), ("FRAMES", n)):
        parameter(name, 1, 2, [], struct.pack("<h", value))
    parameter("SCALE", 1, 4, [], struct.pack("<f", -1.0))
    parameter("RATE", 1, 4, [], struct.pack("<f", s.rate if s.tree == "two rates" else rate))
    parameter("UNITS", 1, -1, [len(s.unit)], s.unit.encode())
    parameter("LABELS", 1, -1, [32, k], b"".join(n.encode().ljust(32) for n in s.all_names()))
    group("ANALOG", 2)
    parameter("USED", 2, 2, [], struct.pack("<h", 0))
    blocks = -(-(len(out) + 2) // 512)
    out[2] = blocks
    start = out.index(b"DATA_START") + len("DATA_START") + 4
    out[start : start + 2] = struct.pack("<h", blocks + 2)
    head = struct.pack(
        "<bbhhhhhfhhf", 2, 0x50, k + s.declared_points, 0, 1 + s.first, n + s.first, 0, -1.0, blocks + 2, 0, rate
    )
    with np.errstate(over="ignore"):
        cells = np.array(s.table("z"), float).reshape(len(s.rows), k, 3).astype("<f4")
    data = np.concatenate([cells, np.zeros((*cells.shape[:2], 1), "<f4")], axis=-1).tobytes()
    data += bytes(-len(data) % 512)
    return head.ljust(512, b"\0") + bytes(out).ljust(512 * blocks, b"\0") + data


def spelled_root(s: Scene, scale: float) -> list[list[Any]]:
    """Spell the places of the pelvis, row by row."""
    places = (s.root * scale).tolist()
    for (row, _), value in s.cells.items():
        places[row] = [value] * 3
    return [places[r] for r in s.rows]


def write_bvh(s: Scene) -> bytes:
    scale, out = 100.0 * s.size, ["HIERARCHY"]
    zero = s.tree == "zero channels"
    flat = s.tree in {"all roots", "all on root"}
    children: dict[int, list[int]] = {j: [] for j in range(-1, len(BODY))}
    for j, (_, _, parent, _, _) in enumerate(BODY):
        children[-1 if s.tree == "all roots" else 0 if flat and j else parent].append(j)
    order: list[tuple[int, int]] = []

    def joint(j: int, person: int, depth: int) -> None:
        name, _, _, offset, end = BODY[j]
        order.append((person, j))
        name = "Spine" if s.tree == "twice" and name == "Spine1" else name
        name = (s.people[person] + ":" if s.people[person] else "") + name + s.suffix
        pad, six = "\t" * depth, depth == 0 or zero
        out.append(f"{pad}{'JOINT' if depth else 'ROOT'} {name}")
        out.append(f"{pad}{{\n{pad}\tOFFSET " + " ".join(number(v * scale) for v in offset))
        places = "Xposition Yposition Zposition " if six else ""
        out.append(f"{pad}\tCHANNELS {6 if six else 3} {places}Zrotation Xrotation Yrotation")
        for child in children[j]:
            joint(child, person, depth + 1)
        if end and not flat:
            out.append(
                f"{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\tOFFSET "
                + " ".join(number(v * scale) for v in end)
                + f"\n{pad}\t}}"
            )
        out.append(pad + "}")

    for person in range(len(s.people)):
        for j in children[-1]:
            joint(j, person, 0)
    spelled = "0" if s.stated == 0 else f"{1 / s.stated:.8g}"
    out += ["MOTION", f"Frames: {len(s.rows) + s.declared_frames}", f"Frame Time: {spelled}"]
    angles, roots = s.angles, spelled_root(s, 100.0)
    for at, row in enumerate(s.rows):
        cells: list[Any] = []
        for person, j in order:
            if j == 0:
                cells += [
                    v if isinstance(v, str) else v + 150.0 * person * (axis == 0) for axis, v in enumerate(roots[at])
                ]
            elif zero or s.tree == "all roots":
                cells += [0.0, 0.0, 0.0]
            x, y, z = angles[row, j]
            cells += [z, x, y]
        out.append(" ".join(map(number, cells)) + (" 0" * s.declared_points))
    return ("\n".join(out) + "\n").replace("\n", s.newline).encode()


def write_asf(s: Scene) -> bytes:
    """Write the skeleton of an AMC file; a bone ends at its first child, others hang on links that do not turn."""
    scale = 0.45 / 0.0254 * s.size
    bones, tree = [], []
    for j, (name, _, parent, offset, end) in enumerate(BODY[1:], 1):
        kids = [row[3] for row in BODY if row[2] == j]
        tip = np.array(kids[0] if kids else end, float)
        above = [row[3] for row in BODY if row[2] == parent]
        gap = np.array(offset, float) - (above[0] if parent else 0)
        hang = NAMES[parent] + s.suffix if parent else "root"
        if np.any(gap):
            bones.append((name + "link", gap, False))
            tree.append(f"{hang} {name}link")
            hang = name + "link"
        bones.append((name + s.suffix, tip, True))
        tree.append(f"{hang} {name}{s.suffix}")
    if s.tree == "circle":
        tree = [t for t in tree if t != "root Spinelink"] + ["Spine1 Spinelink"]
    elif s.tree == "two parents":
        tree.append("RightLeg LeftLeg")
    elif s.tree == "unknown bone":
        tree.append("Spine Tail")
    elif s.tree == "twice":
        bones.append(bones[1])
    text = [":version 1.10", ":name walk", ":units", "  mass 1.0", "  length 0.45", "  angle deg",
            ":documentation", "  walk",
            ":root", "  order TX TY TZ RX RY RZ", "  axis XYZ", "  position 0 0 0",
            "  orientation 0 0 0", ":bonedata"]  # fmt: skip
    for i, (name, tip, turns) in enumerate(bones, 1):
        length = float(np.linalg.norm(tip))
        direction = tip / length
        length *= scale
        text += ["  begin", f"    id {i}", f"    name {name}", "    direction " + " ".join(map(number, direction)),
                 f"    length {number(length)}", "    axis 0 0 0 XYZ"]  # fmt: skip
        text += ["    dof rx ry rz", "    limits (-180 180)", "           (-180 180)", "           (-180 180)"] * turns
        text += ["  end"]
    text += [":hierarchy", "  begin", *("    " + t for t in tree), "  end"]
    return ("\n".join(text) + "\n").encode()


def write_amc(s: Scene) -> bytes:
    out, roots = ["#!OML:ASF walk.asf", ":FULLY-SPECIFIED", ":DEGREES"], spelled_root(s, 0.45 / 0.0254)
    for at, row in enumerate(s.rows):
        out.append(str(row + 1 + s.first))
        for name, angles in zip(s.names(), s.angles[row], strict=True):
            lead = ["root", *map(number, roots[at])] if name == "Hips" + s.suffix else [name]
            out.append(" ".join([*lead, *map(number, angles)]) + " 0" * s.declared_points)
    return (s.newline.join(out) + s.newline).encode()


def quaternions(turn: np.ndarray) -> np.ndarray:
    """Compute unit quaternions wxyz of rotations by less than half a turn."""
    w = np.sqrt(np.maximum(1 + np.trace(turn, axis1=-2, axis2=-1), 1e-12)) / 2
    axis = [turn[..., a, b] - turn[..., b, a] for a, b in ((2, 1), (0, 2), (1, 0))]
    return np.stack([w, *(v / (4 * w) for v in axis)], axis=-1)


def write_mvnx(s: Scene) -> bytes:
    labels = [row[1] for row in BODY]
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
    _, turn = s.pose(s.root)
    spun = quaternions(up @ turn @ up.T)
    k = len(BODY) + s.declared_points
    link = '<joint label="j{0}"><connector1>{1}/j{0}</connector1><connector2>{0}/j{0}</connector2></joint>'
    links = [link.format(row[1], labels[row[2]]) for row in BODY[1:]]
    if s.tree == "circle":
        links[0] = links[0].replace("<connector1>Pelvis/", "<connector1>T8/")
    elif s.tree == "unknown bone":
        links[3] = links[3].replace("<connector1>T12/", "<connector1>Tail/")
    elif s.tree == "two parents":
        links.append(links[-1].replace("LeftFoot/", "RightFoot/"))
    out = ['<?xml version="1.0" encoding="UTF-8"?>', '<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">',
           '<mvn version="2020.0.0" build="x"/>',
           f'<subject label="S" frameRate="{s.stated:g}" segmentCount="{k}" configuration="FullBody">',
           "<segments>", *(f'<segment label="{n}" id="{i}"/>' for i, n in enumerate(labels, 1)), "</segments>",
           *(["<joints>", *links, "</joints>"] if s.tree != "all roots" else []),
           f'<frames segmentCount="{k}" sensorCount="0" jointCount="22">']  # fmt: skip

    def frame(head: str, quats: np.ndarray, cells: Sequence[Any]) -> None:
        orientation, position = (" ".join(map(number, values)) for values in (quats.ravel().tolist(), cells))
        out.append(f"<frame {head}><orientation>{orientation}</orientation><position>{position}</position></frame>")

    flat = np.array([row[3] for row in BODY], float) * s.size
    for j, joint in enumerate(BODY[1:], 1):
        flat[j] += flat[joint[2]]
    still = (flat + np.array([0, 0.95 * s.size, 0])) @ up.T
    for kind in ("identity", "tpose"):
        frame(f'time="0" tc="" ms="0" type="{kind}"', np.tile([1.0, 0, 0, 0], (len(BODY), 1)), still.ravel().tolist())
    for row, cells in zip(s.rows, s.table("z"), strict=True):
        clock = f'time="{1000 * s.times[row]:.0f}" index="{row + s.first}" tc="" ms="0"'
        frame(f'{clock} type="normal"', spun[row], cells)
    return ("\n".join([*out, "</frames>", "</subject>", "</mvnx>"]) + "\n").replace("\n", s.newline).encode()


def write_glb(s: Scene) -> bytes:
    nodes: list[dict[str, Any]] = []
    chunks = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    tracks: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def accessor(values: np.ndarray, kind: str) -> int:
        views.append({"buffer": 0, "byteOffset": len(chunks), "byteLength": values.size * 4})
        with np.errstate(over="ignore"):
            chunks.extend(values.astype("<f4").tobytes())
        bounds = {"min": [float(values.min())], "max": [float(values.max())]} if kind == "SCALAR" else {}
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": 5126, "count": len(values), "type": kind, **bounds}
        )
        return len(accessors) - 1

    clock = accessor(np.array([s.times[r] for r in s.rows]), "SCALAR")
    turns = quaternions(rotation(s.angles))[s.rows][..., [1, 2, 3, 0]]
    for index, person in enumerate(s.people):
        base = len(nodes)
        for j, (name, row) in enumerate(zip(s.names(person), BODY, strict=True)):
            nodes.append({"name": name, "translation": [v * s.size for v in row[3]]})
            if j:
                parent = base + (0 if s.tree == "all on root" else row[2])
                nodes[parent].setdefault("children", []).append(base + j)
            tracks.append({"sampler": len(samplers), "target": {"node": base + j, "path": "rotation"}})
            samplers.append({"input": clock, "output": accessor(turns[:, j], "VEC4")})
        roots = np.array(spelled_root(s, 1.0), float) + np.array([1.5 * index, 0, 0])
        tracks.append({"sampler": len(samplers), "target": {"node": base, "path": "translation"}})
        samplers.append({"input": clock, "output": accessor(roots, "VEC3")})
        for j, row in enumerate(BODY):
            if row[4]:
                nodes.append({"name": f"{s.names(person)[j]}_End", "translation": [v * s.size for v in row[4]]})
                nodes[base + j].setdefault("children", []).append(len(nodes) - 1)
    at = {n: i for i, n in enumerate(s.names(s.people[0]))}
    if s.tree == "circle":
        nodes[at["Spine1"]]["children"].append(at["Spine"])
    elif s.tree == "two parents":
        nodes[at["RightLeg"]]["children"].append(at["LeftFoot"])
    elif s.tree == "unknown bone":
        nodes[at["Spine1"]]["children"].append(999)
    accessors[1]["count"] += s.declared_frames
    roots_of = [i for i, n in enumerate(nodes) if not any(i in m.get("children", []) for m in nodes)]
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": roots_of}], "nodes": nodes,
        "animations": [{"name": "walk", "channels": tracks, "samplers": samplers}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(chunks)}],
    }).encode()  # fmt: skip
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(chunks))
    return (
        head
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(chunks), b"BIN\0")
        + bytes(chunks)
    )


@dataclasses.dataclass(frozen=True)
class Format:
    """How files of a format are made, and what they can say."""

    name: str
    write: Callable[[Scene], bytes]
    says: (
        str  # n row numbers, t times, r rate, f frame count, k point count, p named points, w words in cells, j joints
    )
    beside: tuple[str, Callable[[Scene], bytes]] | None = None
    unit: str = "mm"
    rate: float = 30.0
    trees: tuple[str, ...] = ()

    @property
    def suffix(self) -> str:
        return self.name.rpartition(" ")[2]


FORMATS = (
    Format("bvh", write_bvh, "rfkwj", trees=("all roots", "all on root", "twice")),
    Format(
        "amc",
        write_amc,
        "nkwj",
        ("asf", write_asf),
        rate=120.0,
        trees=("circle", "two parents", "unknown bone", "twice"),
    ),
    Format("mvnx", write_mvnx, "ntrkw", unit="m", trees=("all roots", "circle", "two parents", "unknown bone")),
    Format("glb", write_glb, "tfj", unit="m", trees=("all on root", "circle", "two parents", "unknown bone")),
    Format("c3d", write_c3d, "rfkp"),
    Format("trc", write_trc, "ntrfkpw"),
    Format("motive csv", write_motive, "ntrfpw"),
    Format("table csv", write_table, "tpw"),
    Format("nexus csv", write_nexus, "nrpw"),
    Format("tsv", write_tsv, "ntrfkpw"),
    Format("npy", write_npy, "", unit="m"),
    Format("npz", write_npz, "rp", unit="m"),
    Format("json", write_json, "", unit="m"),
)
