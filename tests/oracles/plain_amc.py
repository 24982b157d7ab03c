"""An ASF/AMC reader as plain as possible: bones end to end, as the Acclaim documents describe them."""

import math
from pathlib import Path

import numpy as np
from oracles.plain_bvh import turn


def read_asf(path: Path) -> tuple[dict[str, dict], dict[str, str]]:
    """Bones (direction, length, axis, dof) and the parent of each; HDM05 and CMU files only."""
    bones: dict[str, dict] = {}
    parents: dict[str, str] = {}
    bone: dict = {}
    section = ""
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0].startswith(":"):
            section = words[0]
        elif section == ":bonedata":
            if words[0] == "begin":
                bone = {"dof": []}
            elif words[0] == "end":
                bones[bone["name"]] = bone
            elif words[0] == "name":
                bone["name"] = words[1]
            elif words[0] == "length":
                bone["length"] = float(words[1])
            elif words[0] == "dof":
                bone["dof"] = words[1:]
            elif words[0] in ("direction", "axis"):
                bone[words[0]] = [float(word) for word in words[1:4]]
        elif section == ":hierarchy" and words[0] not in ("begin", "end"):
            parents.update({child: words[0] for child in words[1:]})
    return bones, parents


def read_amc(path: Path) -> list[dict[str, list[float]]]:
    """Per frame the values of every bone."""
    frames: list[dict[str, list[float]]] = []
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        if not words or words[0][0] in ":#":
            continue
        if words[0].isdigit():
            frames.append({})
        else:
            frames[-1][words[0]] = [float(word) for word in words[1:]]
    return frames


def xyz(angles: list[float]) -> np.ndarray:
    """First about x, then y, then z, in fixed axes."""
    x, y, z = angles
    return turn("Z", z) @ turn("Y", y) @ turn("X", x)


def bone_tips(bones: dict[str, dict], parents: dict[str, str], frame: dict[str, list[float]]) -> dict[str, np.ndarray]:
    """Where every bone ends in the world, in the file's unit, and ``root``."""
    rotation = {"root": xyz(frame["root"][3:])}
    tip = {"root": np.array(frame["root"][:3])}
    for name, parent in parents.items():  # HDM05 and CMU list parents first
        bone = bones[name]
        angles = dict(zip(bone["dof"], frame.get(name, []), strict=True))
        own = xyz([angles.get(channel, 0.0) for channel in ("rx", "ry", "rz")])
        axis = xyz(bone["axis"])
        rotation[name] = rotation[parent] @ axis @ own @ np.linalg.inv(axis)
        ray = np.array([*bone["direction"], 0.0]) / math.hypot(*bone["direction"]) * bone["length"]
        tip[name] = tip[parent] + (rotation[name] @ ray)[:3]
    return tip
