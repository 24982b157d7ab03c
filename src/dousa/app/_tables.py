"""Answers of the commands as tables for people; each prints to the console it is given."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from dousa.app._output import one_line, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from dousa.library import AddReport, Classification, SearchResult, Verdict
    from dousa.retrieval import Explanation, Likeness

__all__ = [
    "describe_verdict",
    "describe_votes",
    "print_add",
    "print_classes",
    "print_clips",
    "print_experiment",
    "print_info",
    "print_search",
    "print_some",
    "print_stats",
]

_NO_FILES = "found no motion files (.bvh, .amc, .c3d, .trc, .npz) there"
_SHOWN = 10
_SHOWN_CONFUSIONS = 5
_SCORES = ("recall", "precision", "f_measure", "accuracy")
_SYSTEM_NAMES = {
    "full_tree": "single full tree",
    "random_tree": "single random tree",
    "forest": "forest",
    "motion_templates": "motion templates",
}


def _cell(text: str) -> str:
    """The text as Rich shows it: square brackets are square brackets, and it is one line."""
    return escape(one_line(text))


def print_info(out: Console, answer: dict[str, Any]) -> None:
    """One file, as `dousa info` describes it."""
    table = Table(
        title=_cell(answer["path"]), title_justify="left", show_header=False, box=None, padding=(0, 2)
    )
    table.add_row("format", f"{answer['format']}, holds {answer['holds']}")
    table.add_row(
        "length",
        f"{answer['n_frames']} frames at {answer['frame_rate']:g} Hz, {answer['duration_s']:.2f} s",
    )
    table.add_row("unit", f"{answer['unit_m']:g} m ({answer['unit_source']})")
    table.add_row("up", f"{answer['up']} ({answer['up_source']})")
    mapping = answer["mapping"]
    if mapping is None:
        table.add_row("mapping", "[bold red]not understood[/]")
    else:
        derived = f"; derived: {', '.join(mapping['derived'])}" if mapping["derived"] else ""
        table.add_row("mapping", escape(f"{mapping['table']}{derived}"))
        table.add_row("left/right", f"names and geometry {mapping['sides']}")
        table.add_row("height", f"{answer['height_m']:.2f} m (from the {answer['height_source']})")
    table.add_row("joints", escape(f"{answer['n_joints']}: {', '.join(answer['joints'])}"))
    for warning in answer["warnings"]:
        table.add_row("[yellow]note[/]", escape(warning))
    out.print(table)


def print_add(out: Console, report: AddReport) -> None:
    """What was added to a library, and what was not and why."""
    rate = report.bytes / 1e6 / report.seconds if report.seconds > 0 else 0.0
    out.print(
        f"{len(report.added)} added, {report.bytes / 1e6:.1f} MB in {report.seconds:.1f} s ({rate:.0f} MB/s)"
    )
    for what, files in (
        ("replaced, as their file had changed", report.replaced),
        ("followed to their new place", report.moved),
        ("already there", report.unchanged),
    ):
        if files:
            out.print(f"{len(files)} {what}")
    if report.duplicates:
        pairs = [f"{item.path} = {item.same_as}" for item in report.duplicates]
        print_some(out, f"{len(pairs)} with the content of another file", pairs)
    if report.skipped:
        print_some(
            out, f"{len(report.skipped)} skipped", [f"{item.path}: {item.reason}" for item in report.skipped]
        )
    if report.n_learned:
        out.print(f"{_describe_learning(report)}; dousa train makes a new one")
    if report.other_kind:
        warn(
            f"{len(report.other_kind)} files stay what they are, clips or takes; to change that, take them out first "
            "with: dousa remove"
        )
    for text, count in Counter(text for _, text in report.warnings).most_common(_SHOWN):
        warn(f"{text} ({count} {'file' if count == 1 else 'files'})")
    told = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates, report.skipped)
    if not any(told):
        warn(_NO_FILES)
    if report.other_labels:
        warn(f"{len(report.other_labels)} files keep the labels they had; change them with: dousa relabel")


def _describe_learning(report: AddReport) -> str:
    """What the forest learned while clips were added."""
    new = len(report.new_categories)
    learned = f"the forest learned {report.n_learned} {'clip' if report.n_learned == 1 else 'clips'}"
    return f"{learned} and {new} new {'category' if new == 1 else 'categories'}" if new else learned


def print_some(out: Console, heading: str, lines: list[str]) -> None:
    """A heading and the first lines of a list."""
    out.print(heading)
    for line in lines[:_SHOWN]:
        out.print(f"  {one_line(line)}", markup=False, soft_wrap=True)
    if len(lines) > _SHOWN:
        out.print(f"  and {len(lines) - _SHOWN} more (all with --json)")


def print_classes(out: Console, answers: Sequence[Classification]) -> None:
    """What files were taken for."""
    if not answers:
        warn(_NO_FILES)
    for answer in answers:
        if answer.verdict is not None:
            out.print(
                one_line(f"{answer.path}: {describe_verdict(answer.verdict)}"), markup=False, soft_wrap=True
            )
            _print_mirrored(out, answer.verdict, answer.mirrored)
            _print_reasons(out, answer.verdict.explanation)


def describe_verdict(verdict: Verdict) -> str:
    """What a motion is taken for: ``kick (kick 87%, march 5%)``."""
    votes = describe_votes(verdict.histogram)
    if verdict.category is not None:
        return f"{verdict.category} ({votes})"
    known = "" if verdict.known is None else f", {verdict.known:.0%} likely to be known"
    return f"unknown (most like {verdict.guess}{known}; {votes})"


def _print_mirrored(out: Console, verdict: Verdict, mirrored: Verdict | None) -> None:
    if mirrored is not None:
        better = ", which fits better" if mirrored.fits_better_than(verdict) else ""
        line = f"  mirrored: {describe_verdict(mirrored)}{better}"
        out.print(one_line(line), markup=False, soft_wrap=True)


def _print_reasons(out: Console, reasons: Explanation | Likeness | None, indent: str = "  ") -> None:
    for reason in reasons.reasons if reasons is not None else ():
        out.print(one_line(f"{indent}{reason.text}"), markup=False, soft_wrap=True)


def print_search(out: Console, answer: SearchResult) -> None:
    """A query and the clips found."""
    verdict = answer.verdict
    out.print(one_line(f"{answer.query}: {describe_verdict(verdict)}"), markup=False, soft_wrap=True)
    _print_mirrored(out, verdict, answer.mirrored)
    _print_reasons(out, verdict.explanation)
    if not answer.results:
        warn("no clip was found: the library has none, or none of this category")
        return
    table = Table(box=None)
    for name in ("rank", "distance", "same leaf", "poses"):
        table.add_column(name, justify="right")
    table.add_column("category")
    if answer.mirrored is not None:
        table.add_column("")
    table.add_column("file", overflow="fold")
    for hit in answer.results:
        poses = "-" if hit.pose_distance is None else f"{hit.pose_distance:.3f}"
        numbers = (str(hit.rank), f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}", poses)
        side = () if answer.mirrored is None else ("mirrored" if hit.mirrored else "",)
        table.add_row(*numbers, _cell(hit.category or "-"), *side, _cell(hit.path))
    out.print(table)
    for hit in answer.results:
        if hit.likeness is not None and hit.likeness.reasons:
            out.print(one_line(f"{hit.rank}. {hit.path}"), markup=False, soft_wrap=True)
            _print_reasons(out, hit.likeness, "   ")


def describe_votes(histogram: dict[str, float], shown: int = 3) -> str:
    """The most voted categories with their shares: ``kick 87%, march 5%``."""
    best = sorted(histogram.items(), key=lambda item: -item[1])[:shown]
    return ", ".join(f"{name} {share:.0%}" for name, share in best if share > 0)


def print_clips(out: Console, rows: list[dict[str, Any]]) -> None:
    """Clips of a library, one in a row."""
    table = Table(box=None)
    for name in ("clip", "kind", "category", "taken for", "performer", "s", "Hz", "file"):
        table.add_column(name, justify="right" if name in ("clip", "s", "Hz") else "left", overflow="fold")
    for row in rows:
        labels = [_cell(row[name] or "-") for name in ("category", "predicted_category", "performer")]
        table.add_row(
            str(row["id"]),
            row["kind"],
            *labels,
            f"{row['duration']:.1f}",
            f"{row['frame_rate']:g}",
            _cell(row["path"]),
        )
    out.print(table)


def print_stats(out: Console, library: str, stats: dict[str, Any]) -> None:
    """A library in numbers."""
    forest = (
        "not trained yet; run: dousa train" if not stats["trained_at"] else f"trained {stats['trained_at']}"
    )
    if stats["trained_at"]:
        forest += f" on features '{stats['parameters'].get('feature_set', 'paper')}'"
    if stats["n_learned"]:
        forest += f", learned {stats['n_learned']} clips since"
    if stats["trained_at"] and not stats["forest_is_current"]:
        forest += ", clips or labels changed since; run: dousa train"
    count = stats["n_takes"]
    words = f"{count} {'take' if count == 1 else 'takes'}, {stats['take_seconds'] / 60:.1f} minutes, "
    takes = words if count else ""
    out.print(
        escape(f"{library}: {stats['n_clips']} clips, {stats['seconds'] / 60:.1f} minutes, {takes}"
               f"{len(stats['performers'])} performers; forest {forest}"),
        soft_wrap=True,
    )  # fmt: skip
    table = Table(box=None)
    table.add_column("category")
    table.add_column("clips", justify="right")
    for name, count in stats["categories"].items():
        table.add_row(_cell(name), str(count))
    if stats["n_unlabelled"]:
        table.add_row("(none)", str(stats["n_unlabelled"]))
    out.print(table)


def print_experiment(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of an experiment as tables."""
    table = Table(
        title=f"{len(answer['categories'])} categories, {answer['n_train']} clips train, {answer['n_test']} tested "
        f"({answer['split']}, {answer['repeats']} x)",
        title_justify="left",
    )
    table.add_column("system")
    for name in ("recall", "precision", "F", "accuracy", "train s", "ms per query"):
        table.add_column(name, justify="right")
    for name, scores in answer["systems"].items():
        cells = [_with_spread(scores, score) for score in _SCORES]
        times = (f"{scores['fit_seconds']:.2f}", f"{scores['query_milliseconds']:.3f}")
        table.add_row(_SYSTEM_NAMES[name], *cells, *times, style="bold" if name == "forest" else None)
    out.print(table)
    seconds = answer["feature_seconds"], answer["relational_seconds"], answer["compile_seconds"]
    out.print(
        "macro means; pose features of all clips took {:.2f} s, relational features {:.2f} s; "
        "making the kernels ready {:.1f} s".format(*seconds)
    )
    for category, count in answer["untrained"].items():
        out.print(f"[yellow]{escape(category)}[/]: {count} test clips, none to train on; counted as wrong")
    confusions = answer["systems"].get("forest", {}).get("confusions", [])[:_SHOWN_CONFUSIONS]
    for mistake in confusions:
        out.print(
            escape(f"the forest took {mistake['truth']} for {mistake['predicted']} {mistake['count']} times")
        )


def _with_spread(scores: dict[str, Any], name: str) -> str:
    spread = scores.get(f"{name}_std")
    return f"{scores[name]:.3f}" if spread is None else f"{scores[name]:.3f} ± {spread:.3f}"
