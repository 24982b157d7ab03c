"""Answers of ``evaluate`` and ``experiment-errors`` as tables for people; each prints to the console it is given."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from dousa.app._output import one_line, warn

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import Assessment

__all__ = ["print_assessment", "print_error_experiment"]

_WORDS = {
    "en": {
        "grade": "grade",
        "of": "of 100",
        "calibrated": "limits calibrated on {n} takes of the reference",
        "uncalibrated": "limits not calibrated: give several takes of the reference (5 or more) for a fair grade",
        "time": "time",
        "furi": "furi",
        "error": "error",
        "severity": "x limit",
        "says": "what differs",
        "lapse": "order",
        "none": "no error found",
        "gaps": "{s:.1f} s of gaps in the recording were not judged",
    },
    "ja": {
        "grade": "評価",
        "of": "/ 100",
        "calibrated": "しきい値は手本{n}回分から求めました",
        "uncalibrated": "しきい値は未校正です。公平な評価には手本が複数回分(5回以上)必要です",
        "time": "時刻",
        "furi": "振り",
        "error": "ミス",
        "severity": "許容値の倍数",
        "says": "手本との違い",
        "lapse": "順序",
        "none": "ミスは見つかりませんでした",
        "gaps": "記録の欠けている{s:.1f}秒は評価していません",
    },
}
# Sentences begin with the moment and end with the figure, which have columns of their own here.
_MOMENT = re.compile(r"^-?\d+:\d\d(\.\d+)?[\s,、::]*")
_FURI = re.compile(r"\s*[((](?:furi |振り)\d+[))]$")


def print_assessment(out: Console, assessment: Assessment, language: str = "en") -> None:
    """The grade, how it came about, and every error and lapse in order of time.

    Parameters
    ----------
    out : where to print.
    assessment : the answer.
    language : ``"en"`` or ``"ja"``.
    """
    words = _WORDS[language]
    score = "-" if assessment.score != assessment.score else f"{assessment.score:.0f}"
    key = "calibrated" if assessment.calibrated else "uncalibrated"
    calibration = words[key].format(n=assessment.n_references)
    out.print(f"{words['grade']} [bold]{score}[/] {words['of']}; {calibration}", soft_wrap=True)
    out.print(assessment.score_formula, markup=False, soft_wrap=True)
    rows = _event_rows(assessment, language) + _lapse_rows(assessment, language)
    if rows:
        table = Table(box=None)
        for name in ("time", "furi", "error", "severity", "says"):
            table.add_column(words[name], justify="right" if name in ("furi", "severity") else "left",
                             overflow="fold")  # fmt: skip
        for _, cells in sorted(rows, key=lambda row: row[0]):
            table.add_row(*(escape(one_line(cell)) for cell in cells))
        out.print(table)
    if not assessment.events:
        out.print(words["none"], markup=False)
    if assessment.gaps:
        seconds = _covered([(start, end) for start, end, _ in assessment.gaps])
        out.print(words["gaps"].format(s=seconds), markup=False)


Row = tuple[float, tuple[str, str, str, str, str]]


def _event_rows(assessment: Assessment, language: str) -> list[Row]:
    from dousa.evaluation.words import KIND_WORDS

    return [
        (
            event.start_s,
            (
                _span(event.start_s, event.end_s),
                "" if event.furi is None else str(event.furi + 1),
                KIND_WORDS[language].get(event.kind, event.kind),
                f"{event.severity:.1f}",
                _FURI.sub("", _MOMENT.sub("", event.says)),
            ),
        )
        for event in assessment.events
    ]


def _lapse_rows(assessment: Assessment, language: str) -> list[Row]:
    from dousa.evaluation.words import LAPSE_WORDS

    lapse_word = _WORDS[language]["lapse"]
    return [
        (
            lapse.start_s,
            (
                _span(lapse.start_s, lapse.end_s),
                "",
                f"{lapse_word}: {LAPSE_WORDS[language].get(lapse.kind, lapse.kind)}",
                "",
                _MOMENT.sub("", lapse.says),
            ),
        )
        for lapse in assessment.lapses
    ]


def _span(start: float, end: float) -> str:
    from dousa.evaluation.words import format_time

    return f"{format_time(start)}-{format_time(end)}"


def _covered(spans: list[tuple[float, float]]) -> float:
    """Seconds that lie in at least one span."""
    total, reached = 0.0, float("-inf")
    for start, end in sorted(spans):
        total += max(end - max(start, reached), 0.0)
        reached = max(reached, end)
    return total


_SHOWN_GROUPS, _SHOWN_PROBLEMS = 20, 3
_SET_WORDS = {
    "all": "all motions",
    "tuning": "motions that the limits may have been chosen on",
    "held-out": "held-out motions, that nothing was tuned on",
}


def print_error_experiment(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of ``experiment-errors`` as tables: one for each set of motions, then second takes."""
    sets = answer.get("sets", {})
    # One set alone is all there is.
    names = [name for name in ("tuning", "held-out", "all") if name in sets]
    names = [name for name in names if len(names) == 3 or name != "all"]
    for name in names:
        _print_set(out, name, sets[name])
    if sets:
        last = sets[names[-1]]
        _print_variants(out, last["variants"])
        _print_confusion(out, last["confusion"])
        for problem in last["problems"][:_SHOWN_PROBLEMS]:
            warn(problem)
        if len(last["problems"]) > _SHOWN_PROBLEMS:
            warn(f"{len(last['problems']) - _SHOWN_PROBLEMS} more trials were refused (all with --json)")
    if "second_takes" in answer:
        _print_second_takes(out, answer["second_takes"])


def _print_set(out: Console, name: str, scores: dict[str, Any]) -> None:
    title = f"{_SET_WORDS[name]}: {scores['n_motions']}, {scores['n_trials']} trials"
    table = Table(title=title, title_justify="left")
    table.add_column("error")
    for heading in ("injected", "reported", "found", "precision", "recall", "F"):
        table.add_column(heading, justify="right")
    for kind, row in scores["classes"].items():
        counts = (str(row["n_errors"]), str(row["n_events"]), str(row["n_matched"]))
        table.add_row(kind, *counts, *(_share(row[key]) for key in ("precision", "recall", "f_measure")))
    means = (_share(scores[f"macro_{key}"]) for key in ("precision", "recall", "f"))
    table.add_row("mean", "", "", "", *means, style="bold")
    out.print(table)
    alarms = scores["false_alarms"]
    out.print(
        f"median onset error {_times(scores['onset_s'], 1000)} ms, end {_times(scores['offset_s'], 1000)} ms; mean "
        f"error of lag {_times(scores['lag_mae_ms'])} ms, of shortfall {_times(scores['shortfall_mae_deg'], 1, 1)} deg",
        markup=False,
        soft_wrap=True,
    )
    out.print(
        f"without an error: {len(alarms['events'])} false alarms in {alarms['minutes']:.1f} minutes, "
        f"{_times(alarms['per_minute'], 1, 2)} a minute",
        markup=False,
        soft_wrap=True,
    )


def _print_variants(out: Console, variants: dict[str, dict[str, int]]) -> None:
    table = Table(box=None, title="Recall by kind of error", title_justify="left")
    table.add_column("what was done")
    for heading in ("injected", "found", "recall"):
        table.add_column(heading, justify="right")
    for name, count in variants.items():
        share = count["found"] / count["injected"] if count["injected"] else None
        table.add_row(escape(name), str(count["injected"]), str(count["found"]), _share(share))
    out.print(table)


def _print_confusion(out: Console, confusion: dict[str, dict[str, int]]) -> None:
    columns = list(dict.fromkeys(kind for row in confusion.values() for kind in row))
    table = Table(box=None, title="Reported as", title_justify="left")
    table.add_column("injected")
    for kind in columns:
        table.add_column(kind, justify="right")
    for kind, row in confusion.items():
        table.add_row(kind, *(str(row.get(column, "")) for column in columns))
    out.print(table)


def _print_second_takes(out: Console, answer: dict[str, Any]) -> None:
    table = Table(
        title=f"Other takes of the same, {answer['n_references']} references: {answer['n_takes']} takes",
        title_justify="left",
    )
    table.add_column("takes of", overflow="fold")
    for heading in ("takes", "minutes", "false alarms", "a minute"):
        table.add_column(heading, justify="right")
    rows = sorted(answer["groups"].items(), key=lambda item: -len(item[1]["events"]))
    for group, alarms in rows[:_SHOWN_GROUPS]:
        cells = (str(alarms["n_takes"]), f"{alarms['minutes']:.1f}", str(len(alarms["events"])))
        table.add_row(escape(one_line(group)), *cells, _times(alarms["per_minute"], 1, 2))
    if len(rows) > _SHOWN_GROUPS:
        table.add_row(f"and {len(rows) - _SHOWN_GROUPS} more (all with --json)")
    total = str(sum(len(alarms["events"]) for _, alarms in rows))
    rate = _times(answer["per_minute"], 1, 2)
    table.add_row("all", str(answer["n_takes"]), f"{answer['minutes']:.1f}", total, rate, style="bold")
    out.print(table)
    if answer["n_with_fewer_references"]:
        out.print(
            f"{answer['n_with_fewer_references']} takes had fewer than {answer['n_references']} others to be "
            f"references; {answer['n_alone']} groups of one take were left out",
            markup=False,
            soft_wrap=True,
        )


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _times(value: float | None, factor: float = 1.0, digits: int = 0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"
