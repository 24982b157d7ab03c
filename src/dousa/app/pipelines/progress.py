"""From the answers of several evaluations to a pupil over time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.evaluation import Progress

_MOST_BYTES = 100_000_000


def compare_answers(paths: Sequence[Path]) -> tuple[Progress, bool]:
    """Compare evaluations.

    Parameters
    ----------
    paths : files that ``dousa evaluate --json`` wrote, the oldest first.

    Returns
    -------
    progress : the comparison.
    alike : whether all have the same reference.

    Raises
    ------
    OptionError : a file that cannot be read or is something else; fewer than two files.
    """
    from dousa.evaluation import compare_attempts, read_attempt

    answers = [_read(path) for path in paths]
    attempts = [
        read_attempt(answer, _name(answer, path)) if isinstance(answer, Mapping) else read_attempt({}, str(path))
        for path, answer in zip(paths, answers, strict=True)
    ]
    models = {json.dumps(answer.get("references")) for answer in answers}
    return compare_attempts(attempts), len(models) == 1


def _read(path: Path) -> Any:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise OptionError("progress.too_large", path=path)
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise OptionError("progress.unreadable", path=path, reason=error) from error


def _name(answer: Mapping[str, Any], path: Path) -> str:
    """Of the performance; of the file where that is not known."""
    performance = answer.get("performance")
    return Path(performance).name if isinstance(performance, str) else path.name
