"""Where likeness ends, over libraries of several producers: precision and recall before the cut, and the order.

    python -m lab.trials.likeness ../shared/data [--report hdm05,irds,utkinect] [--queries 6]

All sets are in one library, each with its own names of categories. Queries are clips of a meaning that several sets
share. *inside*: the query is a clip of the library; *outside*: its set is left out of the library, so it comes from a
producer that the library has never seen. Right is a clip of the query's meaning; the query itself does not count. The
baseline is the order without the angle between the clips, with as many hits as are right (which nobody knows).
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.library import ClipInfo, Library, SearchResult
from dousa.library.search import search as search_room
from dousa.library.search.search import Group

SETS = {
    "hdm05": "name:HDM_(..)_",
    "utd_mhad/skeleton": r"name:_s(\d+)_",
    "bandai": None,
    "irds": None,
    "utkinect": None,
}
MEANINGS = {
    "squat": r"squat.*", "walk": r"walk/.*|walk", "run": r"run/.*|jog.*", "throw": r"throw.*|pickup_throw",
    "wave": r"wave.*", "clap": r"clap.*", "sit": r"stand_to_sit|sitDown", "stand": r"sit_to_stand|standUp",
    "push": r"push", "pick up": r"pickUp|pickup_throw", "raise both": r"raise-up-both.*|g6/.*",
    "raise one": r"raise-up-(?:left|right).*|g[2345]/.*",
}  # fmt: skip


def add_set(library: Library, data: Path, name: str) -> None:
    if name == "utkinect":
        library.add(data / name, kind="take", labels_from="beside", n_jobs=2)
    else:
        library.add(data / name, performer_from=SETS[name], n_jobs=2)


def find_meaning(clip: ClipInfo) -> str:
    name = clip.category or ""
    return next((meaning for meaning, pattern in MEANINGS.items() if re.fullmatch(pattern, name)), "")


def find_set(clip: ClipInfo, data: Path) -> str:
    return next((name for name in SETS if Path(clip.path).is_relative_to((data / name).resolve())), "")


def measure(answer: SearchResult, right: set[int], own: int | None) -> list[float]:
    """Precision and recall of the hits called alike, R-precision, and the average precision of the order."""
    hits = [hit for hit in answer.results if hit.clip_id != own]
    alike = [hit.clip_id in right for hit in hits if hit.alike]
    order = [hit.clip_id in right for hit in hits]
    places = np.flatnonzero(order)
    average = float(np.mean((np.arange(len(places)) + 1) / (places + 1))) if len(places) else 0.0
    precision = float(np.mean(alike)) if alike else float("nan")
    return [len(alike), precision, sum(alike) / len(right), float(np.mean(order[: len(right)])), average]


def average(rows: list[np.ndarray] | list[list[float]]) -> np.ndarray:
    """Means of the columns, without what is not a number; that is what is left where nothing else is."""
    table = np.array(rows, float)
    counts = np.isfinite(table).sum(axis=0)
    return np.where(counts > 0, np.nansum(table, axis=0) / np.maximum(counts, 1), np.nan)


def ask(library: Library, queries: dict[str, list[ClipInfo]], where: str, outside: Library | None = None) -> None:
    table = defaultdict(list)
    clips = [clip for clip in library.clips() if clip.kind == "clip"]
    for meaning, chosen in queries.items():
        right = {clip.id for clip in clips if find_meaning(clip) == meaning}
        for clip in chosen:
            own = clip.id if outside is None else None
            query = clip.id if outside is None else outside.trajectories(clip.id)
            wanted = right - {own}
            if len(wanted) < 3:
                continue
            for name, cosines in (("dousa", True), ("without the angle", False)):
                table[name, meaning].append(measure(search(library, query, len(clips), cosines), wanted, own))
    for name in ("dousa", "without the angle"):
        rows = {meaning: average(rows) for (system, meaning), rows in table.items() if system == name}
        for meaning, row in rows.items():
            print_row(f"{where}, {name}, {meaning}", row, name == "dousa")
        if rows:
            print_row(f"{where}, {name}, MEAN", average(list(rows.values())), name == "dousa")


def print_row(title: str, row: np.ndarray, has_cut: bool) -> None:
    cut = f"alike {row[0]:5.0f}  precision {row[1]:.2f}  recall {row[2]:.2f}  " if has_cut else ""
    print(f"{title:45s} {cut}R-precision {row[3]:.2f}  AP {row[4]:.2f}", flush=True)


def search(library: Library, query: object, k: int, cosines: bool) -> SearchResult:
    """The answer; or as it would be without the angle, and with equal clips in a random order, not in that of paths."""
    if cosines:
        return library.search(query, k)  # type: ignore[arg-type]
    usual = search_room.rank_groups

    def search_blindly(groups: Sequence[Group], *asked):  # type: ignore[no-untyped-def]
        index = groups[0].index
        names = np.array([b"%08d" % place for place in np.random.default_rng(1).permutation(len(index.living))])
        ends = names.itemsize * np.arange(1, len(names) + 1)
        parts = [
            replace(part, directions=None, path_ends=ends[: len(part)], path_bytes=names[a:b].view(np.uint8))
            for part, a, b in zip(index.parts, index.starts[:-1], index.starts[1:], strict=True)
        ]
        hits, _ = usual([replace(groups[0], index=replace(index, parts=tuple(parts)))], *asked)
        return tuple(replace(hit, path="") for hit in hits), None

    search_room.rank_groups = search_blindly
    try:
        return library.search(query, k)  # type: ignore[arg-type]
    finally:
        search_room.rank_groups = usual


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--report", default="hdm05,irds,utkinect", help="sets whose clips are the queries")
    parser.add_argument("--queries", type=int, default=6, help="of each meaning and set")
    parser.add_argument("--trees", type=int, default=100)
    options = parser.parse_args()
    chance = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        whole = Library.open(Path(folder) / "all.dousa", create=True)
        for name in SETS:
            add_set(whole, options.data, name)
        whole.train(n_trees=options.trees)
        by_set: dict[str, dict[str, list[ClipInfo]]] = defaultdict(lambda: defaultdict(list))
        for clip in whole.clips():
            if find_meaning(clip):
                by_set[find_set(clip, options.data)][find_meaning(clip)].append(clip)
        for name in options.report.split(","):
            queries = {
                meaning: [clips[n] for n in chance.permutation(len(clips))[: options.queries]]
                for meaning, clips in by_set[name].items()
            }
            ask(whole, queries, f"{name} inside")
            others = Library.open(Path(folder) / f"without_{name}.dousa", create=True)
            for other in SETS:
                if other != name:
                    add_set(others, options.data, other)
            others.train(n_trees=options.trees)
            ask(others, queries, f"{name} outside", whole)
            others.close()
        whole.close()


if __name__ == "__main__":
    main()
