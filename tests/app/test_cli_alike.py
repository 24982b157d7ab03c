"""dousa search and find say where likeness ends."""

from __future__ import annotations

import io

from rich.console import Console

from dousa.app.tables import print_search
from dousa.library import Hit, SearchResult, Verdict
from dousa.messages import use_language


def show(flags, count, language="en"):
    hits = tuple(
        Hit(f"/{number}.bvh", "kick", 0.1, number + 1, number, 0.5, alike=flag) for number, flag in enumerate(flags)
    )
    verdict = Verdict("kick", "kick", 0.9, 0.9, {"kick": 1.0})
    out = io.StringIO()
    use_language(language)
    try:
        print_search(Console(file=out, width=200), SearchResult("q", verdict, hits, "fused", alike_count=count))
    finally:
        use_language("en")
    return out.getvalue()


def test_a_line_stands_where_likeness_ends():
    lines = show([True, True, False], 2).splitlines()
    (line,) = [place for place, text in enumerate(lines) if "below here no longer alike" in text]
    assert "/1.bvh" in lines[line - 1] and "/2.bvh" in lines[line + 1]


def test_no_line_stands_where_all_are_alike_or_nothing_was_learned():
    assert "no longer alike" not in show([True, True], 2)
    assert "alike" not in show([None, None], None).replace("alike?", "")
    assert "27 more are alike; show them with: -k 29" in show([True, True], 29)


def test_nothing_alike_is_said():
    assert "nothing in the library is alike" in show([False, False], 0)
    assert "似た動きはありません" in show([False, False], 0, "ja")
    assert "ここから下は似ていません" in show([True, False], 1, "ja")
