"""How far an estimated motion is to be trusted: its warnings, the gravest first, and one word for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from dousa.messages import Message

# The motion is wrong, or most likely so.
_WRONG = frozenset({"doubts.bad_overlap", "film_estimate.far_off", "film_estimate.disagree", "start.far_off"})
# It should be looked at before it is used.
_DOUBTFUL = frozenset(
    {
        *(f"doubts.{name}" for name in ("girth", "low_overlap", "odd_view", "one_view", "camera_inside", "full")),
        *(f"doubts.{name}" for name in ("second_region", "cut_off", "empty")),
        *(f"tracker.{name}" for name in ("start_doubtful", "restarted", "lost")),
        *(
            f"film_estimate.{name}"
            for name in ("absent", "exchanged", "lens_assumed", "lost", "not_synchronised", "off")
        ),
        *(f"film_estimate.{name}" for name in ("odd_stature", "one_view", "upright_assumed", "left_out")),
        *(f"calibration.{name}" for name in ("unsure", "doubtful", "few_agree", "hardly_moves")),
        *(f"sync.{name}" for name in ("ambiguous", "disagree")),
        *(f"background.{name}" for name in ("all_moves", "nothing_moves", "plate_moved", "unlike")),
        "body.stature_assumed",
        "film.several",
    }
)
GOOD, DOUBTFUL, WRONG = "good", "unsure", "bad"
_LEVELS = (GOOD, DOUBTFUL, WRONG)
_MOST_LOST = 0.5  # share of frames beyond which there is hardly a motion


def rank_warnings(warnings: Sequence[Message], lost_share: float) -> tuple[str, list[Message], list[str]]:
    """What is said of an estimate, in the order of its weight.

    Parameters
    ----------
    warnings : of the estimation.
    lost_share : of its frames that are lost, 0 to 1.

    Returns
    -------
    ``good``, ``unsure`` or ``bad`` for the whole; the warnings, the gravest first; the same word for each of them.
    """
    weighed = [(max(map(_weigh, _codes(one)), default=0), one) for one in warnings]
    weighed.sort(key=lambda pair: -pair[0])
    worst = max([weight for weight, _ in weighed] + [2 if lost_share > _MOST_LOST else 0])
    return _LEVELS[worst], [one for _, one in weighed], [_LEVELS[weight] for weight, _ in weighed]


def _weigh(code: str) -> int:
    return 2 if code in _WRONG else 1 if code in _DOUBTFUL else 0


def _codes(value: Any) -> Iterator[str]:
    """Of a message and of those among its values."""
    if isinstance(value, Message):
        yield value.code
        for one in value.values.values():
            yield from _codes(one)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _codes(one)
