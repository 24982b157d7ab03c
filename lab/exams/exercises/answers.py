"""What dousa says, asked through its public functions only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dousa.errors import DousaError, OptionError
from dousa.evaluation import ErrorEvent, advise, assess, praise
from dousa.motion import CanonicalMotion


@dataclass(frozen=True, slots=True)
class Answer:
    """A grade (nan: none), its half interval (nan: none), events, what is told first, praise, and all that is said."""

    score: float
    half: float = math.nan
    coverage: float = 0.0
    events: tuple[ErrorEvent, ...] = ()
    named: tuple[str, ...] = ()
    praised: bool = False
    words: tuple[str, ...] = ()


class Asker:
    """Asks for the side to be found, where that can be asked for."""

    def __init__(self) -> None:
        self.side = "auto"

    def ask(self, references: Sequence[CanonicalMotion], performance: CanonicalMotion) -> Answer:
        """What dousa says of a performance; a refusal is an answer without a grade."""
        try:
            return _read(assess(references, performance, side=self.side))
        except OptionError:
            if self.side == "same":
                raise
            self.side = "same"
            return self.ask(references, performance)
        except DousaError as error:
            return Answer(math.nan, words=(str(error),))


def _read(assessment) -> Answer:
    advice = advise(assessment)
    told = [one for one in advice if one.segments or one.event is not None]
    named = told[0].segments if told else ()
    if told and not named:
        named = assessment.events[told[0].event].segments
    low, high = assessment.score_interval
    words = [one.says.render("en") for one in assessment.events]
    words += [one.message.render("en") for one in advice]
    words += [one.render("en") for one in assessment.warnings]
    return Answer(
        float(assessment.score),
        float(high - low) / 2.0,
        float(assessment.coverage),
        tuple(assessment.events),
        tuple(named),
        praise(assessment) is not None or any(one.about == "praise" for one in advice),
        tuple(words),
    )
