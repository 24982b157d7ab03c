"""Weights of segments: a teacher tells what matters in a dance.

A file of TOML or plain lines ``segment = number``:

    arms = 2            # arms are what this dance is about
    left_forearm = 1.5  # what is named more exactly counts
    legs = 0            # not judged

What is not named weighs 1.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError, OptionError
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.files.disk import read_small_text
from dousa.messages import Message

_LARGEST = 1e6
_SHOWN = 40  # letters of a wrong value in a message

# From the coarse names to the exact ones, which are laid over them.
LEVELS: tuple[dict[str, tuple[str, ...]], ...] = (
    {
        "arms": tuple(SEGMENTS[i] for i in (*LIMBS["left_arm"], *LIMBS["right_arm"])),
        "legs": tuple(SEGMENTS[i] for i in (*LIMBS["left_leg"], *LIMBS["right_leg"])),
    },
    {name: tuple(SEGMENTS[i] for i in members) for name, members in LIMBS.items() if name not in SEGMENTS},
    {name: (name,) for name in SEGMENTS},
)


def read_weights(path: str | os.PathLike[str]) -> dict[str, float]:
    """Read a file of weights.

    Parameters
    ----------
    path : TOML, or lines ``segment = number``; names of `SEGMENTS`, of `LIMBS`, or ``arms`` and ``legs``. Spaces
        in a name are underscores, capitals do not matter.

    Returns
    -------
    Weight of every one of the nine segments, 0 or more, at least one above 0.

    Raises
    ------
    OptionError : the file cannot be read, a name that is no segment, a weight that is no number of 0 or more,
        nothing that weighs.
    """
    where = os.fspath(path)
    entries: dict[str, Any] = {}
    try:
        text = read_small_text(path)
    except MotionFileError as error:
        raise OptionError("weights_file.unreadable", path=where, problem=error.message) from error
    for given, value in _parse(text, where).items():
        if _plain(given) in entries:
            raise OptionError("weights_file.repeated", path=where, name=given)
        entries[_plain(given)] = value
    known = [name for level in LEVELS for name in level]
    for name, value in entries.items():
        if name not in known:
            raise OptionError("weights_file.unknown", path=where, name=name, known=tuple(known))
        _check(value, name, where)
    weights = _lay_over(entries)
    if not any(weights.values()):
        raise OptionError("weights_file.nothing", path=where)
    return weights


def _parse(text: str, where: str) -> Mapping[str, Any]:
    try:
        entries = tomllib.loads(text)
    except (ValueError, RecursionError):  # no TOML, or a number of too many digits
        entries = _parse_lines(text, where)
    if len(entries) == 1 and isinstance(inner := next(iter(entries.values())), dict):
        entries = inner  # under one heading, such as [weights]
    if not entries:
        raise OptionError("weights_file.empty", path=where)
    return entries


def _parse_lines(text: str, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content or (content.startswith("[") and content.endswith("]")):
            continue
        name, equals, value = (part.strip() for part in content.partition("="))
        if not equals or not name or not value:
            raise OptionError("weights_file.form", path=where, line=number, found=_shown(content))
        if _plain(name) in found:
            raise OptionError("weights_file.repeated_line", path=where, line=number, name=name)
        try:
            found[_plain(name)] = float(value)
        except ValueError:
            raise OptionError("weights_file.number", path=where, line=number, name=name, found=_shown(value)) from None
    return found


def _plain(name: str) -> str:
    return "_".join(name.strip().lower().replace("-", " ").split())


def _check(value: Any, name: str, where: str) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # nan is in no range; an integer may be too large for a float.
    if not number or not 0 <= value <= _LARGEST:
        raise OptionError("weights_file.weight", path=where, name=name, found=_shown(value))


def _shown(value: Any) -> str | Message:
    """The beginning of a wrong value."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        return Message("weights_file.huge")
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def spread_weights(weights: Mapping[str, float] | None) -> FloatArray:
    """(9,) weights; those above 0 have a mean of 1, so that leaving limbs out makes nobody stricter with the rest."""
    given = dict(weights or {})
    known = [name for level in LEVELS for name in level]
    for name, value in given.items():
        if name not in known:
            raise OptionError("evaluation.weight_name", known=tuple(known), name=name)
        if not isinstance(value, int | float) or not 0.0 <= value <= _LARGEST:
            raise OptionError("evaluation.weight", name=name, value=repr(value))
    shares = np.array(list(_lay_over(given).values()))
    if shares.sum() <= 0.0:
        raise OptionError("evaluation.no_weight")
    return np.asarray(shares / shares[shares > 0.0].mean())


def _lay_over(given: Mapping[str, float]) -> dict[str, float]:
    """Weight of every segment: what is named more exactly counts, in whatever order it comes."""
    weights = dict.fromkeys(SEGMENTS, 1.0)
    for level in LEVELS:
        for name in level.keys() & given.keys():
            weights.update(dict.fromkeys(level[name], float(given[name])))
    return weights
