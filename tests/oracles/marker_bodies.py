"""Skin markers on bodies whose joints are known: where the marker sets of the laboratories put them, by anatomy.

The layouts are those that the makers publish; the offsets from the joint centres are typical of adults (pelvis: width
between the front spines 0.137 and depth 0.088 of the stature, hip centres 0.08 to the inside and below them; knee and
ankle breadth 0.06 and 0.042; markers stand 7 mm off the skin). No code of the package makes them.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.motion import CANONICAL_JOINTS, Trajectories

SIDES = ("left", "right")
_J = {name: index for index, name in enumerate(CANONICAL_JOINTS)}


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _across(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The part of vectors that is across an axis, of length 1."""
    return _unit(vectors - (vectors * axis).sum(-1, keepdims=True) * axis)


def place_markers(joints: np.ndarray) -> dict[str, np.ndarray]:
    """Landmarks of a body by name, those of the sides as ``left_asis``; the joints are among them.

    Parameters
    ----------
    joints : (T, 20, 3) canonical joints, m, Y up; left is left.
    """
    at = {name: joints[:, index] for name, index in _J.items()}
    leg = sum(
        np.linalg.norm(at[a] - at[b], axis=1).mean()
        for a, b in (("left_hip", "left_knee"), ("left_knee", "left_ankle"))
    )
    size = leg / 0.491  # stature, m: Winter
    found: dict[str, np.ndarray] = {}
    middle = 0.5 * (at["left_hip"] + at["right_hip"])
    left = _unit(at["left_hip"] - at["right_hip"])
    up = _across(at["spine"] - middle, left)
    front = np.cross(left, up)
    chest_up = _unit(at["neck"] - at["spine"])
    chest_left = _across(at["left_shoulder"] - at["right_shoulder"], chest_up)
    chest_front = np.cross(chest_left, chest_up)

    def pelvis(x: float, y: float, z: float) -> np.ndarray:
        return middle + size * (x * left + y * up + z * front)

    def chest(x: float, y: float, z: float) -> np.ndarray:
        return at["neck"] + size * (x * chest_left + y * chest_up + z * chest_front)

    found |= {"sacrum": pelvis(0, 0.051, -0.059), "navel": pelvis(0, 0.09, 0.06)}
    found |= {"waist_front": pelvis(0, 0.06, 0.05), "waist_back": pelvis(0, 0.06, -0.06)}
    found |= {"l5": pelvis(0, 0.075, -0.06), "l3": pelvis(0, 0.11, -0.06)}
    found |= {"c7": chest(0, 0.02, -0.04), "t2": chest(0, -0.02, -0.055), "t8": chest(0, -0.12, -0.065)}
    found |= {"t10": chest(0, -0.16, -0.065), "clav": chest(0, -0.03, 0.04), "strn": chest(0, -0.12, 0.07)}
    found |= {"back_right": chest(-0.05, -0.08, -0.07), "back_left": chest(0.05, -0.08, -0.07)}
    head_up = _unit(at["head"] - at["neck"])
    head_left = _across(chest_left, head_up)
    head_front = np.cross(head_left, head_up)
    found["head_top"] = at["head"] + 0.03 * size * head_up
    found["head_front"] = at["head"] + size * (0.055 * head_front - 0.02 * head_up)
    found["head_back"] = at["head"] - size * (0.055 * head_front + 0.02 * head_up)
    for side, sign in zip(SIDES, (1, -1), strict=True):
        found |= {
            f"{side}_asis": pelvis(sign * 0.0685, 0.049, 0.029),
            f"{side}_psis": pelvis(sign * 0.027, 0.055, -0.057),
            f"{side}_iliac": pelvis(sign * 0.08, 0.075, 0.0),
            f"{side}_trochanter": pelvis(sign * 0.1, -0.01, -0.01),
            f"{side}_scapula": chest(sign * 0.06, -0.08, -0.07),
            f"{side}_acromion": at[f"{side}_shoulder"] + size * (0.032 * chest_up + 0.008 * sign * chest_left),
            f"{side}_shoulder_back": at[f"{side}_shoulder"] - size * 0.035 * chest_front,
            f"{side}_shoulder_front": at[f"{side}_shoulder"] + size * 0.035 * chest_front,
            f"{side}_clavicle": chest(sign * 0.02, -0.03, 0.04),
            f"{side}_head_front": at["head"] + size * (0.04 * sign * head_left + 0.045 * head_front - 0.01 * head_up),
            f"{side}_head_back": at["head"] + size * (0.04 * sign * head_left - 0.045 * head_front - 0.01 * head_up),
            f"{side}_head_side": at["head"] + size * (0.045 * sign * head_left - 0.02 * head_up),
        }
        out = sign * left
        hip, knee, ankle, toe = (at[f"{side}_{joint}"] for joint in ("hip", "knee", "ankle", "toe"))
        thigh, shank, foot = _unit(hip - knee), _unit(knee - ankle), _unit(toe - ankle)
        knee_out, ankle_out = _across(out, thigh), _across(out, shank)
        found |= {
            f"{side}_thigh": 0.5 * (hip + knee) + 0.045 * size * knee_out,
            f"{side}_thigh_front": 0.6 * knee + 0.4 * hip + 0.045 * size * np.cross(knee_out, thigh) * sign,
            f"{side}_knee_lat": knee + 0.034 * size * knee_out,
            f"{side}_knee_med": knee - 0.034 * size * knee_out,
            f"{side}_fibula": knee - size * (0.035 * shank - 0.03 * knee_out),
            f"{side}_tibia_top": knee - size * (0.04 * shank - 0.03 * np.cross(knee_out, shank) * sign),
            f"{side}_shank": 0.5 * (knee + ankle) + 0.035 * size * ankle_out,
            f"{side}_ankle_lat": ankle + 0.024 * size * ankle_out,
            f"{side}_ankle_med": ankle - 0.024 * size * ankle_out,
        }
        foot_out = _across(out, foot)
        foot_up = _across(shank, foot)
        found |= {
            f"{side}_heel": ankle - size * (0.035 * foot + 0.012 * shank),
            f"{side}_toe2": toe + 0.012 * size * foot_up,
            f"{side}_toe_tip": toe + size * (0.035 * foot + 0.008 * foot_up),
            f"{side}_mt1": toe - size * (0.025 * foot_out - 0.01 * foot_up),
            f"{side}_mt5": toe + size * (0.028 * foot_out - 0.015 * foot),
        }
        shoulder, elbow, wrist, hand = (at[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "hand"))
        upper, fore = _unit(shoulder - elbow), _unit(elbow - wrist)
        # Across the plane of a bent arm: the forearm bends to the front of the upper arm.
        elbow_out = _across(sign * (np.cross(fore, upper) + 0.15 * np.cross(upper, chest_front)), upper)
        thumb = _across(chest_front + 0.2 * elbow_out, fore)
        palm = _unit(hand - wrist)
        found |= {
            f"{side}_upper_arm": 0.5 * (shoulder + elbow) + 0.03 * size * elbow_out,
            f"{side}_elbow_lat": elbow + 0.024 * size * elbow_out,
            f"{side}_elbow_med": elbow - 0.024 * size * elbow_out,
            f"{side}_forearm": 0.5 * (elbow + wrist) + 0.025 * size * elbow_out,
            f"{side}_wrist_rad": wrist + 0.02 * size * thumb,
            f"{side}_wrist_uln": wrist - 0.02 * size * thumb,
            f"{side}_hand_back": hand,
            f"{side}_hm2": hand + 0.02 * size * _across(thumb, palm),
            f"{side}_hm5": hand - 0.02 * size * _across(thumb, palm),
        }
    return found | at


@dataclass(frozen=True)
class MarkerSet:
    """One published layout.

    Parameters
    ----------
    title : what it is called.
    names : file name -> landmark or landmarks (joined by +) of `place_markers`.
    absent : required joints that the set does not tell.
    """

    title: str
    names: dict[str, str]
    absent: frozenset[str]


_LEGS = frozenset(f"{side}_{joint}" for side in SIDES for joint in ("hip", "knee", "ankle"))
_ARMS = frozenset(f"{side}_{joint}" for side in SIDES for joint in ("shoulder", "elbow", "wrist"))


def read_sets(tables: dict[str, dict[str, object]]) -> list[MarkerSet]:
    """The sets of ``marker_sets.toml``: entries ``NAME=landmark``; ``{s}`` is the side as ``sides`` spells it."""
    sets = []
    for title, table in tables.items():
        spelled = table.get("sides", ["L", "R"])
        names = {}
        for entry in str(table["markers"]).split(";"):
            if not entry.strip():
                continue
            name, _, place = (part.strip() for part in entry.partition("="))
            if "{s}" not in name:
                names[name] = place
                continue
            for side, word in zip(SIDES, spelled, strict=True):
                names[name.replace("{s}", word)] = "+".join(f"{side}_{one}" for one in place.split("+"))
        gone = str(table.get("absent", ""))
        absent = {"arms": _ARMS, "legs": _LEGS, "": frozenset()}.get(gone)
        if absent is None:
            words = gone.split()
            absent = frozenset(word if word.startswith(SIDES) else f"{side}_{word}" for word in words for side in SIDES)
        sets.append(MarkerSet(title, names, frozenset(absent)))
    return sets


_TABLES = tomllib.loads((Path(__file__).parent / "marker_sets.toml").read_text("utf-8"))
MARKER_SETS = {one.title: one for one in read_sets(_TABLES)}


def wear(markers: MarkerSet, joints: np.ndarray, frame_rate: float) -> Trajectories:
    """The marker set on a body, m, Y up."""
    at = place_markers(joints)
    columns = [np.mean([at[one] for one in place.split("+")], axis=0) for place in markers.names.values()]
    return Trajectories(tuple(markers.names), np.stack(columns, axis=1), frame_rate)
