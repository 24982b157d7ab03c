"""Files of one frame each, such as images, masks and keypoints: their order, their numbers, and folders of them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from itertools import pairwise


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key that puts frame 10 after frame 9."""
    parts = re.split(r"(\d+)", name.lower())
    return tuple((0, int(part), "") if part.isdigit() and part.isascii() else (1, 0, part) for part in parts)


def number_frames(names: list[str], most_gaps: float = 3.0) -> dict[int, str]:
    """Map frames to files by the number in the name, or by order where these are no frame numbers.

    ``most_gaps`` : how many times more frames than files are plausible.
    """
    by_order = dict(enumerate(names))
    parts = [re.fullmatch(r"(.*?)(\d{1,12})(\D*)", name, re.ASCII) for name in names]
    if len(names) < 2 or any(part is None for part in parts):
        return by_order
    if len({(part[1], part[3].lower()) for part in parts if part}) > 1:
        return by_order
    numbers = [int(part[2]) for part in parts if part]
    steps = [after - before for before, after in pairwise(numbers)]
    if min(steps) < 1:
        return by_order
    step = math.gcd(*steps)
    frames = [(number - numbers[0]) // step for number in numbers]
    if frames[-1] + 1 > most_gaps * len(names):
        return by_order
    return dict(zip(frames, names, strict=True))


_POINTS = re.compile(rb'"(?:pose_keypoints_3d|keypoints3d|joints19|Rh)"\s*:\s*\[[\s\[]*-?\d')
# A frame of OpenPose; one of Panoptic's scenes or EasyMocap's, a list of people.
_PEOPLE = re.compile(rb'"(?:people|bodies|annots)"\s*:\s*\[|\A\s*\[\s*(?:\{\s*"id"\s*:|\])')


def list_frame_files(folder: str | os.PathLike[str]) -> list[str]:
    """List the JSON files of a folder, in the order of their numbers."""
    names = [name for name in os.listdir(folder) if name.lower().endswith(".json") and not name.startswith(".")]
    return sorted(names, key=natural_key)


def is_frame_folder(folder: str | os.PathLike[str], names: Sequence[str] | None = None, looked_at: int = 5) -> bool:
    """Return whether a folder holds the 3D points of the frames of one take, a file for each.

    Parameters
    ----------
    folder : path.
    names : of its files, if known.
    looked_at : how many files are read, as the first may be without a person.
    """
    if names is not None and not any(name.lower().endswith(".json") for name in names):
        return False
    try:
        found = list_frame_files(folder)
        step = max(1, len(found) // looked_at)
        return any(_has_points(os.path.join(folder, name)) for name in found[::step][: looked_at + 1])
    except OSError:
        return False


def _has_points(path: str) -> bool:
    with open(path, "rb") as file:
        head = file.read(65_536)
    return _PEOPLE.search(head) is not None and _POINTS.search(head) is not None and b'"frames"' not in head
