"""Work that looks after a library: comparing all checksums, and giving back room."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.studio.jobs.lanes import Context

_MOST_TOLD = 30  # lines; the result has all


def check(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Check the library, as `dousa check`; ``request``: repair.

    A file whose structure is damaged is not repaired while a studio has it open, which is said.
    """
    with context.open_library() as library:
        repair = bool(request.get("repair"))
        report = library.check(repair=repair, salvage=False, progress=context.progress)
        if repair and any(one.what.code == "library_damage.structure" for one in report.damage):
            context.tell(Message("studio_jobs.repair_closed", library=library.name))
    lines = list(report.to_messages())
    for line in (*islice(lines[:-1], _MOST_TOLD), lines[-1]):
        context.tell(line)
    return report.to_json()


def compact(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Forget removed clips and make the file smaller, as `dousa compact`; ``request``: fragments."""
    with context.open_library() as library:
        report = library.compact(fragments="" if request.get("fragments") else None, progress=context.progress)
    for line in report.to_messages():
        context.tell(line)
    return report.to_json()
