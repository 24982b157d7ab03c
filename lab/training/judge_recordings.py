"""The recordings that the judge learns from, and those that are left to the exam."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion
from lab.training.judge_material import Recording

_EXAM_SHARE = 3  # one of so many pairs of gesture and style is left to the exam
_DANCE_END_S = 42.0


def read_recordings(data: Path, *, exam: bool = False) -> list[Recording]:
    """Recordings for learning, or those that are left to the exam.

    Parameters
    ----------
    data : folder with ``hdm05``, ``utd_mhad``, ``bandai`` and ``bandai_dance``, as far as they are there.
    exam : those that nothing is learned from: HDM05's dg, UTD-MHAD's s7, a third of the pairs of
        gesture and style, the dance from 42 s.
    """
    found = [*_read_hdm05(data, exam), *_read_utd(data, exam), *_read_bandai(data, exam), *_read_dance(data, exam)]
    return sorted(found, key=lambda one: (one.set_name, one.person, one.motion_name))


def _read(path: Path) -> CanonicalMotion:
    return read_canonical(path)[0]


def _read_hdm05(data: Path, exam: bool) -> Iterator[Recording]:
    for path in sorted((data / "hdm05").glob("*/HDM_*.[aA][mM][cC]")):
        person = path.name.split("_")[1]
        if (person == "dg") == exam:
            yield Recording("HDM05", person, path.parent.name, _read(path))


def _read_utd(data: Path, exam: bool) -> Iterator[Recording]:
    for path in sorted((data / "utd_mhad" / "skeleton").glob("**/*.c3d")):
        action, person, _ = path.stem.split("_")[:3]
        if (person == "s7") == exam:
            yield Recording("UTD-MHAD", person, action, _read(path))


def _read_bandai(data: Path, exam: bool) -> Iterator[Recording]:
    for path in sorted((data / "bandai").glob("**/*.bvh")):
        pair = re.sub(r"_\d+$", "", path.stem)
        if (zlib.crc32(pair.encode()) % _EXAM_SHARE == 0) == exam:
            yield Recording("Bandai", pair.rsplit("_", 1)[-1], pair, _read(path))


def _read_dance(data: Path, exam: bool) -> Iterator[Recording]:
    for path in sorted((data / "bandai_dance").glob("*.bvh")):
        whole = _read(path)
        if exam:
            yield Recording("dance", path.stem, path.stem, _cut(whole, _DANCE_END_S, whole.duration))
            continue
        for part, start in enumerate((0.0, 14.0, 28.0)):
            yield Recording("dance", path.stem, f"{path.stem}_{part}", _cut(whole, start, start + 14.0))


def _cut(motion: CanonicalMotion, start_s: float, end_s: float) -> CanonicalMotion:
    part = slice(round(start_s * motion.frame_rate), round(end_s * motion.frame_rate))
    missing = None if motion.missing is None else motion.missing[part]
    return replace(motion, positions=motion.positions[part], missing=missing)
