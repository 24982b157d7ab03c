"""A BVH reader as plain as possible: Python's float(), 4 x 4 matrices, one joint after the other."""

import math
from pathlib import Path

import numpy as np

AXES = "XYZ"


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = ((1, 2), (2, 0), (0, 1))[AXES.index(axis)]
    matrix = np.eye(4)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def read(path: Path) -> tuple[list[dict], np.ndarray]:
    """Joints (name, parent, offset, channels) and the channel values (T, C)."""
    lines = path.read_text(encoding="utf-8").splitlines()
    joints: list[dict] = []
    stack: list[int] = []
    for number, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        if words[0] in ("ROOT", "JOINT", "End"):
            joints.append({"name": " ".join(words[1:]), "parent": stack[-1] if stack else -1, "channels": []})
            stack.append(len(joints) - 1)
        elif words[0] == "OFFSET":
            joints[stack[-1]]["offset"] = [float(word) for word in words[1:]]
        elif words[0] == "CHANNELS":
            joints[stack[-1]]["channels"] = words[2:]
        elif words[0] == "}":
            stack.pop()
        elif words[0] == "MOTION":
            rows = [row.split() for row in lines[number + 3 :]]
            break
    return joints, np.array([[float(word) for word in row] for row in rows if row])


def world_positions(joints: list[dict], row: np.ndarray) -> np.ndarray:
    """(J, 3) positions of one frame, in the file's unit."""
    world, column = [], 0
    for joint in joints:
        place, rotation = list(joint["offset"]), np.eye(4)
        for channel in joint["channels"]:
            if channel.endswith("position"):
                place[AXES.index(channel[0])] = row[column]
            else:
                rotation = rotation @ turn(channel[0], row[column])
            column += 1
        local = np.eye(4)
        local[:3, 3] = place
        parent = world[joint["parent"]] if joint["parent"] >= 0 else np.eye(4)
        world.append(parent @ local @ rotation)
    return np.array([matrix[:3, 3] for matrix in world])
