"""What motions are taken for, how surely, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dousa.app.output import one_line, warn
from dousa.app.tables.lines import print_notes, say_line
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import Classification, Verdict
    from dousa.retrieval import Explanation, Likeness


def print_classes(out: Console, answers: Sequence[Classification]) -> None:
    """What files were taken for."""
    if not answers:
        warn(Message("answers.no_motion_files"))
    for answer in answers:
        if answer.verdict is not None:
            out.print(one_line(f"{answer.path}: {describe_verdict(answer.verdict)}"), markup=False, soft_wrap=True)
            print_mirrored(out, answer.verdict, answer.mirrored)
            print_notes(out, answer.notes, answer.path)
            print_reasons(out, answer.verdict.explanation)


def describe_verdict(verdict: Verdict) -> str:
    """What a motion is taken for, and how surely: ``kick, 97% sure (votes: kick 87%, march 5%)``."""
    values: dict[str, Any] = {"guess": verdict.guess, "votes": describe_votes(verdict.histogram)}
    if verdict.confidence is None:
        return str(Message("verdict.unknown" if verdict.category is None else "verdict.named", **values))
    code = "verdict.perhaps" if verdict.perhaps else "verdict.unlikely"
    return str(Message(code if verdict.category is None else "verdict.sure", confidence=verdict.confidence, **values))


def describe_votes(histogram: dict[str, float], shown: int = 3) -> str:
    """The most voted categories with their shares: ``kick 87%, march 5%``."""
    best = sorted(histogram.items(), key=lambda item: -item[1])[:shown]
    return ", ".join(f"{name} {share:.0%}" for name, share in best if share > 0)


def print_mirrored(out: Console, verdict: Verdict, mirrored: Verdict | None) -> None:
    if mirrored is not None:
        code = "verdict.mirrored_better" if mirrored.fits_better_than(verdict) else "verdict.mirrored"
        say_line(out, code, verdict=describe_verdict(mirrored))


def print_reasons(out: Console, reasons: Explanation | Likeness | None, indent: str = "  ") -> None:
    for reason in reasons.reasons if reasons is not None else ():
        out.print(one_line(f"{indent}{reason.text}"), markup=False, soft_wrap=True)
