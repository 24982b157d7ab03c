"""Writing the report: the page and two tables for spreadsheets, each whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from dousa._files import atomic_write
from dousa.app.report._curves import to_curves_csv, to_events_csv
from dousa.app.report._page import CURVES_NAME, EVENTS_NAME, build_page
from dousa.errors import MotionWriteError, OptionError
from dousa.evaluation._types import Assessment
from dousa.evaluation.words import check_language

__all__ = ["write_report"]

_PAGE_NAME = "report.html"


def write_report(
    assessment: Assessment,
    folder: str | os.PathLike[str],
    *,
    language: str = "en",
    title: str | None = None,
) -> Path:
    """Write ``report.html``, ``curves.csv`` and ``events.csv``.

    Parameters
    ----------
    assessment : what is reported, of one frame or more.
    folder : made if it is missing; files of these names in it are replaced.
    language : ``"en"`` or ``"ja"``, of the page. The sentences of the events are those of the assessment.
    title : of the page; None for who against whom.

    Returns
    -------
    The path of the page. It needs no other file and no network. If the Japanese font is not installed, the
    page says so and uses the fonts of the machine.

    Raises
    ------
    OptionError : a language that there is not, or a folder that cannot be made or written.
    """
    check_language(language)
    page = build_page(assessment, language, title)
    home = Path(folder)
    contents = {
        CURVES_NAME: to_curves_csv(assessment),
        EVENTS_NAME: to_events_csv(assessment),
        _PAGE_NAME: page.encode("utf-8", "replace"),
    }
    try:
        home.mkdir(parents=True, exist_ok=True)
        for name, data in contents.items():
            with atomic_write(home / name) as file:
                file.write(data)
    except (OSError, ValueError, MotionWriteError) as error:
        reason = (
            error.problem
            if isinstance(error, MotionWriteError)
            else getattr(error, "strerror", None) or error
        )
        raise OptionError(
            f"{os.fspath(folder)}: the report cannot be written: {reason}; choose another folder"
        ) from error
    return home / _PAGE_NAME
