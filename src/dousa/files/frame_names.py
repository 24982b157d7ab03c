"""Order and numbers of files of one frame each: images, masks, keypoints."""

from __future__ import annotations

import math
import re
from itertools import pairwise

_MOST_GAPS = 3.0  # times more numbers than files: they are no frame numbers


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key that puts frame 10 after frame 9."""
    parts = re.split(r"(\d+)", name.lower())
    return tuple((0, int(part), "") if part.isdigit() and part.isascii() else (1, 0, part) for part in parts)


def number_frames(names: list[str]) -> dict[int, str]:
    """Map frames to files by the number in the name, or by order where these are no frame numbers."""
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
    if frames[-1] + 1 > _MOST_GAPS * len(names):
        return by_order
    return dict(zip(frames, names, strict=True))
