"""Clips of made-up performers in files, for tests: category/pN.bvh."""

from collections.abc import Iterable
from pathlib import Path

from dousa.formats.registry import write_motion
from dousa.motion.synthetic import draw_performer, make_motion


def write_clip(folder: Path, category: str, number: int) -> Path:
    """Write how performer ``number`` does it."""
    path = folder / category / f"p{number}.bvh"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_motion(make_motion(category, draw_performer(number), seed=number), path)
    return path


def write_clips(folder: Path, categories: Iterable[str], people: int) -> Path:
    """Write every category by each of so many performers."""
    for category in categories:
        for number in range(people):
            write_clip(folder, category, number)
    return folder
