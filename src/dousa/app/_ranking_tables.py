"""The answer of the ranking experiment as tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["print_ranking"]

_SCORES = {
    "p_at_1": "P@1",
    "p_at_10": "P@10",
    "map": "MAP",
    "ndcg_at_10": "nDCG@10",
}
_SYSTEM_NAMES = {
    "fused": "fused (default)",
    "histogram": "histogram (eq. 8)",
    "leaves": "leaves",
    "pose": "pose",
    "euclidean": "Euclidean on poses",
    "dtw": "DTW on poses",
    "motion_templates": "motion templates",
}
_DESCRIBED = {
    "forest": "features and pose sequence (ours)",
    "poses": "poses at 30 Hz (Euclidean, DTW)",
    "motion_templates": "relational features (motion templates)",
}


def print_ranking(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of the ranking experiment as a table, and below it how to read it."""
    table = Table(
        title=f"{len(answer['categories'])} categories, {answer['n_queries']} queries, {answer['n_gallery']} clips "
        f"ranked ({answer['split']}, features {answer['features']}, {answer['n_trees']} trees)",
        title_justify="left",
    )
    table.add_column("ranking")
    for name in (*_SCORES.values(), "ms per query", "x DTW"):
        table.add_column(name, justify="right")
    for name, system in answer["systems"].items():
        cells = [escape(_tell(system, score)) for score in _SCORES]
        faster = system["times_faster_than_dtw"]
        times = (f"{system['query_milliseconds']:.3f}", "-" if faster is None else f"{faster:.3g}")
        table.add_row(_SYSTEM_NAMES[name], *cells, *times, style="bold" if name == "fused" else None)
    out.print(table)
    for line in _explain(answer):
        out.print(line, markup=False, soft_wrap=True)


def _explain(answer: dict[str, Any]) -> list[str]:
    systems = answer["systems"]
    lines = [
        f"means over the queries [95 % of {answer['n_resamples']} bootstrap resamples of the queries]; time: median of "
        "queries whose description is known, one after the other; x DTW: how many times faster than DTW",
        "describing a clip: "
        + "; ".join(f"{_DESCRIBED[k]} {ms:.2f} ms" for k, ms in answer["describe_milliseconds"].items()),
    ]
    for what, score, sign in (
        ("MAP beyond DTW", "map_beyond_dtw", "+"),
        ("R-precision", "r_precision", ""),
    ):
        shown = [f"{name} {_tell(one, score, sign)}" for name, one in systems.items() if score in one]
        lines += [f"{what}: {'; '.join(shown)}"] if shown else []
    by_performer = {name: one.get("map_interval_by_performer") for name, one in systems.items()}
    shown = [f"{name} [{ends[0]:.3f}, {ends[1]:.3f}]" for name, ends in by_performer.items() if ends]
    if shown:
        lines.append(
            f"MAP with whole performers resampled instead, which is rough if they are few: {'; '.join(shown)}"
        )
    if answer["n_short"]:
        lines.append(
            f"{answer['n_short']} queries have fewer than 10 clips to find; P@10 divides by 10 all the same, so a "
            f"perfect ranking reaches {answer['best_p_at_10']:.3f}"
        )
    for category, count in answer["without_relevant"].items():
        lines.append(
            f"{category}: queries left out, as no clip of this category is there to be found: {count}"
        )
    return lines


def _tell(system: dict[str, Any], name: str, sign: str = "") -> str:
    low, high = system[f"{name}_interval"]
    number = f"{{:{sign}.3f}}"
    return f"{number.format(system[name])} [{number.format(low)}, {number.format(high)}]"
