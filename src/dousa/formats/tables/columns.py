"""The columns of a table by a property: three of one stem, ending in x, y and z, are the places of a point.

A title is the stem of a point and an axis (``LHip_x``, ``LHip.X``, ``LHip x [mm]``, ``X_LHip``), or the axis stands
alone below a row of names, which may span the columns (Vicon Nexus, DeepLabCut 3D). Words name what else a table has: a
time, a number of the frame, a confidence, the person, and of tables with a row for every point its name.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

_BETWEEN = r"[\s_.:|/\-]*"
_UNIT = r"(?:[\s_]*[\[(]\s*(?P<unit>[a-z]+)\s*[\])]|_(?P<short>mm|cm|m))?"
_LAST = re.compile(rf"(?P<stem>.*?){_BETWEEN}[\[(]?(?P<axis>[xyzw])[\])]?{_UNIT}", re.IGNORECASE | re.DOTALL)
_FIRST = re.compile(rf"(?P<axis>[xyzw]){_BETWEEN}[\[(]?(?P<stem>.*?)[\])]?{_UNIT}", re.IGNORECASE | re.DOTALL)
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_SURE = re.compile(
    rf"(?:(?P<stem>.*?){_BETWEEN}(?:score|conf|confidence|visibility|likelihood|vis|prob)|(?P<after>.*?)[\s_.]+[vcp]"
    rf"|v(?P<number>\d+))", re.IGNORECASE | re.DOTALL,
)  # fmt: skip

_ALONE = re.compile(r"[xyz]|score|conf|confidence|likelihood|visibility", re.IGNORECASE)

# Words for other quantities than places, at either end of a stem; words for places.
_OTHER = frozenset(
    "acc accel acceleration gyr gyro mag magnetometer vel velocity speed omega rot rotation orientation orient quat q "
    "quaternion euler angle angles ang force moment torque power jerk error std variance cop com grf emg imu".split()
)
_PLACE = frozenset("pos position positions loc location coord coords coordinate translation world 3d".split())
_ROLES = {
    role: words.split()
    for role, words in {
        "times": "time times timestamp timestamps t seconds secs sec elapsed 時間 時刻",
        "numbers": "frame frames fnum field framenumber frameid frameindex frameno framenum syncindex フレーム",
        "parts": "subframe",
        "people": "person personid body bodyid trackid subject subjectid skeletonid userid playerid",
        "clips": "id video videoid sequence sequenceid clip clipid trial trialid session sessionid file filename",
        "kinds": "model trajectory trajectorytype datatype aspect tracker",
        "labels": "keypoint joint landmark marker name bodypart point label jointname jointid jointtype landmarkname "
        "landmarkid landmarkindex keypointid keypointname markername markerid pointid pointname",
    }.items()
}
# Seconds in each, by the definition of the units; other units of a title are seconds, or found by the rate.
_TIME_UNITS = {
    "ms": 1e-3,
    "msec": 1e-3,
    "milliseconds": 1e-3,
    "us": 1e-6,
    "usec": 1e-6,
    "microseconds": 1e-6,
    "ns": 1e-9,
}


@dataclass(slots=True)
class Columns:
    """What the columns of a table hold, by their numbers from 0.

    Parameters
    ----------
    points : by name the columns of x, y, z, in the order of the table.
    flat : names of what has x and y only.
    scores : by name the column of the confidence that the point was seen.
    roles : column of ``times``, ``numbers`` (of frames), ``parts`` (of a frame), ``people``, ``clips``, ``kinds``,
        ``labels``, where there.
    unit : named in the titles, else "".
    seconds : per unit of the times if their title names it, else None.
    counted : whether the points have numbers for names: their order gives the layout.
    """

    points: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    flat: tuple[str, ...] = ()
    scores: dict[str, int] = field(default_factory=dict)
    roles: dict[str, int] = field(default_factory=dict)
    unit: str = ""
    seconds: float | None = None
    counted: bool = False


def find_columns(titles: Sequence[str]) -> Columns:
    """Find the points, and what else is known, in a row of titles; without points where there are none."""
    cells = [title.strip().strip('"').strip() for title in titles]
    found = max((_group(cells, pattern) for pattern in (_LAST, _FIRST)), key=lambda some: len(some.points))
    taken = {column for triple in found.points.values() for column in triple}
    for column, title in enumerate(cells):
        if column not in taken and title:
            _find_role(found, column, title)
    numbers = [re.fullmatch(r"\D*?(\d+)", name) for name in found.points]
    order = [int(match[1]) if match else -1 for match in numbers]
    found.counted = len(order) > 1 and order == list(range(order[0], order[0] + len(order))) and order[0] in (0, 1)
    return found


def _group(cells: list[str], pattern: re.Pattern[str]) -> Columns:
    axes: dict[str, dict[str, int]] = {}
    units = set()
    for column, cell in enumerate(cells):
        match = pattern.fullmatch(cell)
        name = _name_place(match["stem"]) if match else None
        if match is not None and name is not None:
            axes.setdefault(name, {}).setdefault(match["axis"].lower(), column)
            units.add((match["unit"] or match["short"] or "").lower())
    # With a w they are quaternions.
    points = {name: (own["x"], own["y"], own["z"]) for name, own in axes.items() if set(own) == {"x", "y", "z"}}
    flat = tuple(name for name, own in axes.items() if set(own) == {"x", "y"} and name)
    return Columns(points, flat, unit=units.pop() if len(units) == 1 else "")


def _name_place(stem: str) -> str | None:
    """The name of a point, without a word for its place, "" if there is none; None for another quantity."""
    words = [word.lower() for word in _WORDS.findall(stem)]
    if words and (words[-1] in _OTHER or words[0] in _OTHER):
        return None
    if words and words[-1] in _PLACE:
        stem = stem.rstrip(" _.:|/-])")[: -len(words[-1])]
    return stem.strip(" _.|/-")


def _find_role(found: Columns, column: int, title: str) -> None:
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|[^\W\d_a-zA-Z]+", title)]
    joined, first = "".join(words), words[0] if words else ""
    for role, known in _ROLES.items():
        ends = (first, words[-1] if words and role == "times" else "")
        within = any(len(word) > 1 and word in known for word in ends)
        fits = joined in known or (role in ("times", "numbers") and within and "rate" not in words)
        if fits and role not in found.roles:
            found.roles[role] = column
            if role == "times":
                found.seconds = next((_TIME_UNITS[word] for word in words if word in _TIME_UNITS), None)
            return
    sure = _SURE.fullmatch(title)
    if sure is not None:
        name = next(part for part in (sure["stem"], sure["after"], sure["number"]) if part is not None).strip(" _.|/-")
        if name in found.points:
            found.scores.setdefault(name, column)


def find_odd(columns: Columns) -> list[str]:
    """Find the points whose columns lie otherwise to each other than those of most: their names stand over others."""
    ways = {name: (y - x, z - x) for name, (x, y, z) in columns.points.items()}
    usual = Counter(ways.values()).most_common(1)
    return [name for name, way in ways.items() if way != usual[0][0]]


def spread_names(names: Sequence[str], axes: Sequence[str]) -> list[str]:
    """Put the names of a row over single axes in the row below; a name reaches as far as the next.

    ``names``, ``axes`` : cells of the two rows; columns without an axis keep their own title.
    """
    spread, over = [], ""
    for column, axis in enumerate(axes):
        over = (names[column].strip() if column < len(names) else "") or over
        spread.append(f"{over} {axis}" if over and _ALONE.fullmatch(axis.strip()) else axis)
    return spread
