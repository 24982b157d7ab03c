"""What a check of a library found, as lines for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dousa.app.output import one_line
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import CheckReport


def print_check(out: Console, report: CheckReport) -> None:
    """What is damaged and what can be done, or that nothing is."""

    def say(message: Message) -> None:
        out.print(one_line(str(message)), markup=False, soft_wrap=True)

    for one in report.damage:
        where = {"what": one.what, "remedy": one.remedy}
        if one.clip_id is None:
            say(Message("library_check.part", **where))
        else:
            say(Message("library_check.of_clip", path=one.path, number=one.clip_id, **where))
    if report.n_sealed:
        say(Message("library_check.sealed", n=report.n_sealed))
    if report.n_unsealed:
        say(Message("library_check.unsealed", n=report.n_unsealed))
    counts = {"clips": report.n_clips, "rows": report.n_rows, "seconds": report.seconds}
    left = sum(not one.repaired for one in report.damage)
    if left:
        say(Message("library_check.damaged", left=left, **counts))
    else:
        say(Message("library_check.sound", **counts))
