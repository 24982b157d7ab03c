"""Which clips train and which test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError, TrainingError

__all__ = ["Split", "leave_performer_out", "split_half"]


@dataclass(frozen=True, slots=True)
class Split:
    """Indices of the training and of the test clips.

    Parameters
    ----------
    train, test : sorted, without common members.
    name : the performer left out, ``"half"`` or ``"given"``.
    """

    train: NDArray[np.intp]
    test: NDArray[np.intp]
    name: str = "given"


def split_half(
    categories: Sequence[str],
    random_state: int | np.random.Generator | None = None,
    train_share: float = 0.5,
) -> Split:
    """Draw half of the clips of every category, or another share, for training.

    Parameters
    ----------
    categories : (N,) label of every clip.
    random_state : seed, or a generator to draw from.
    train_share : of the clips of each category, above 0 and below 1.

    Returns
    -------
    Split. What is no whole number of clips is rounded up; so a category with one clip trains only.

    Raises
    ------
    TrainingError : no clips, or so few in every category that nothing is left to test.
    OptionError : a share out of range.

    Source: Hamada, Kuriyama, Mukai, section 4.1.
    """
    if not 0.0 < train_share < 1.0:
        raise OptionError(f"expected a share of training clips between 0 and 1, got {train_share}")
    labels = np.asarray(categories, dtype=object)
    if not len(labels):
        raise TrainingError("expected clips to split into training and test, got none")
    generator = np.random.default_rng(random_state)
    train: list[int] = []
    for category in sorted(set(labels)):
        members = np.flatnonzero(labels == category)
        count = math.ceil(len(members) * train_share - 1e-9)
        train.extend(generator.permutation(members)[:count])
    chosen = np.zeros(len(labels), bool)
    chosen[train] = True
    if chosen.all():
        raise TrainingError(
            "every category has so few clips that none is left to test; add clips, or give test clips of their own"
        )
    return Split(np.flatnonzero(chosen), np.flatnonzero(~chosen), "half")


def leave_performer_out(performers: Sequence[str | None]) -> tuple[Split, ...]:
    """One split per performer, whose clips test what the others' clips train.

    Parameters
    ----------
    performers : (N,) performer of every clip.

    Returns
    -------
    Splits named after the performers, in alphabetical order.

    Raises
    ------
    TrainingError : no clips, a clip without a performer, or one performer only.
    """
    if not len(performers):
        raise TrainingError("expected clips to split into training and test, got none")
    unknown = [index for index, performer in enumerate(performers) if not performer]
    if unknown:
        raise TrainingError(
            f"leaving performers out needs the performer of every clip; {len(unknown)} of {len(performers)} "
            f"have none, the first is clip {unknown[0]}; say where to find it (--performer-from) "
            "or use the half split"
        )
    names = np.asarray(performers, dtype=object)
    everyone = sorted(set(names))
    if len(everyone) < 2:
        raise TrainingError(
            f"leaving performers out needs at least two, all {len(names)} clips are by '{everyone[0]}'; "
            "use the half split"
        )
    return tuple(Split(np.flatnonzero(names != one), np.flatnonzero(names == one), one) for one in everyone)
