"""How well a library is searched by words, beside searching its names for the letters.

    python -m lab.trials.words ../shared/data [--queries words_queries.toml] [--library FILE] [--details]

The queries were written before the search was; their answers are categories. A clip is found right if its category is
one of those. The baseline looks for the query in categories and names letter by letter, and, in another row, for any
of its words of three letters or more (two for Japanese).
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dousa.library import ClipInfo, Library

SETS = {"hdm05": None, "utd_mhad/skeleton": None, "bandai": None, "irds": None}
Search = Callable[[str], Sequence[int]]


def make_library(data: Path, where: Path) -> Library:
    library = Library.open(where, create=True)
    if not library.stats().n_clips:
        for folder in SETS:
            library.add(data / folder, n_jobs=2)
    return library


def look_for_letters(clips: Sequence[ClipInfo], query: str) -> list[int]:
    wanted = query.casefold()
    return [clip.id for clip in clips if wanted in f"{clip.category} {Path(clip.path).stem}".casefold()]


def look_for_words(clips: Sequence[ClipInfo], query: str) -> list[int]:
    words = [w for w in re.findall(r"[a-z]{3,}|[^\x00-\x7f]{2,}", query.casefold()) if w not in ("the", "with", "and")]
    scores = [sum(word in f"{c.category} {Path(c.path).stem}".casefold() for word in words) for c in clips]
    best = max(scores, default=0)
    return [clip.id for clip, score in zip(clips, scores, strict=True) if best and score == best]


def measure(search: Search, queries: dict[str, list[str]], clips: Sequence[ClipInfo], details: str = "") -> str:
    """Means over queries: precision, recall, F of the whole answer, precision of the first ten."""
    numbers = []
    categories = {clip.id: clip.category or "" for clip in clips}
    empty = 0
    for query, patterns in queries.items():
        found = search(query)
        right = {clip for clip, name in categories.items() if any(re.fullmatch(p, name) for p in patterns)}
        if not patterns:
            empty += not found
        if not right:
            continue
        hits = [clip in right for clip in found]
        precision = float(np.mean(hits)) if hits else 0.0
        recall = sum(hits) / len(right)
        f = 2 * precision * recall / (precision + recall) if hits and any(hits) else 0.0
        first = float(np.mean(hits[:10])) if hits else 0.0
        numbers.append((precision, recall, f, first))
        if details:
            print(f"    {details} {query!r}: P {precision:.2f} R {recall:.2f} first {first:.2f} of {len(found)}")
    if not numbers:
        return f"{empty} of {sum(not patterns for patterns in queries.values())} empty"
    p, r, f, first = np.mean(numbers, axis=0)
    return f"P {p:.2f}  R {r:.2f}  F {f:.2f}  P@10 {first:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--queries", type=Path, default=Path(__file__).with_name("words_queries.toml"))
    parser.add_argument("--library", type=Path, help="made if it is not there; a temporary one by default")
    parser.add_argument("--details", action="store_true")
    options = parser.parse_args()
    table = tomllib.loads(options.queries.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        library = make_library(options.data, options.library or Path(folder) / "words.dousa")
        clips = library.clips()
        start = time.perf_counter()
        library.search_text("warm up", 1)
        first = time.perf_counter() - start
        times: list[float] = []

        def search(query: str) -> list[int]:
            begin = time.perf_counter()
            found = [hit.clip_id for hit in library.search_text(query, None).results]
            times.append(time.perf_counter() - begin)
            return found

        systems: dict[str, Search] = {
            "dousa": search,
            "letters": lambda query: look_for_letters(clips, query),
            "any word": lambda query: look_for_words(clips, query),
        }
        for section, queries in table.items():
            print(f"{section}, {len(queries)} queries")
            for name, system in systems.items():
                details = name if options.details and name == "dousa" else ""
                print(f"  {name:9s} {measure(system, queries, clips, details)}")
        print(f"{len(clips)} clips; first query {first:.2f} s, then {1000 * float(np.median(times)):.0f} ms")
        library.close()


if __name__ == "__main__":
    main()
