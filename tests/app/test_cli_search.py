"""dousa search: with a motion and by words, tables and JSON in two languages, and what it refuses."""

import io
import json
import re
import shlex
import shutil

import pytest
from rich.console import Console

from dousa.app.tables.search import print_search
from dousa.library import Hit, Library, SearchResult, Verdict
from dousa.messages import use_language
from made_clips import write_clips


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = write_clips(tmp_path_factory.mktemp("words"), ("kick_left", "clap", "squat"), 3)
    with Library.open(folder / "moves.dousa", create=True) as made:
        made.add(folder, n_jobs=1)
        made.train(n_trees=10, n_jobs=1)
    return folder / "moves.dousa"


def test_the_table_says_what_fits_and_how_many(succeed, library):
    out, _ = succeed("search", library, "--text", "kicking", "-k", 2)
    assert "'kicking': 3 of 9 clips and takes" in out
    assert out.count("kick_left") >= 2
    assert "1 more; show them with: --limit 3" in out


def test_json_has_what_was_understood(dousa, library):
    code, out, _ = dousa("search", library, "--text", "sqaut", "--limit", 1, "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["corrections"] == {"sqaut": "squat"}
    assert (answer["n_found"], len(answer["results"])) == (3, 1)
    assert answer["results"][0]["category"] == "squat"


def test_no_answer_is_said_in_words(dousa, succeed, library):
    out, _ = succeed("search", library, "--text", "xqzzv")
    assert "nothing fits among 9 clips and takes" in out
    assert "xqzzv" in out.splitlines()[-1]
    _code, out, _ = dousa("search", library, "--text", "jumping rope on ice while kicking")
    assert "near words of the library: kick_left" in out


def test_that_words_leave_no_clip_for_a_motion_is_said(dousa, library):
    code, _, err = dousa("search", library, library.parent / "clap" / "p0.bvh", "--text", "xqzzv")
    assert code == 0 and "'xqzzv': nothing fits among 9 clips and takes" in err


def test_that_there_is_nothing_to_search_is_said(dousa, library):
    code, out, err = dousa("search", library, "--text", "kick", "--category", "nothing")
    assert (code, out) == (0, "") and "no clips and takes, or none of this category" in err


def test_words_and_labels_filter_what_a_motion_finds(succeed, library):
    query = library.parent / "clap" / "p0.bvh"
    for words in (("--text", "kick"), ("--category", "kick_left")):
        out, _ = succeed("search", library, query, *words, "--json")
        assert {hit["category"] for hit in json.loads(out)["results"]} == {"kick_left"}


def test_words_and_levels_choose_clips_of_every_command(dousa, library, tmp_path):
    """The folder is kick_left: a level begins so, its name has the letters, its words say so."""
    for words in (("--category", "kick*"), ("--text", "kick"), ("--category", "kick_left", "--text", "kick")):
        code, out, err = dousa("list", library, *words, "--json")
        assert code == 0, err
        assert {clip["category"] for clip in json.loads(out)["clips"]} == {"kick_left"}
    code, out, _ = dousa("export", library, "--text", "kick", "-o", tmp_path / "kicks", "--json")
    assert code == 0 and len(json.loads(out)["written"]) == 3
    code, out, _ = dousa("tag", library, "--text", "kick", "+fight", "--json")
    assert code == 0 and len(json.loads(out)["tagged"]) == 3
    code, out, _ = dousa("relabel", library, "--text", "kick", "--where-category", "clap", "--category", "x", "--json")
    assert code == 2
    code, out, _ = dousa("relabel", library, "--text", "kick", "--category", "kick_left", "--json")
    assert code == 0 and len(json.loads(out)["relabelled"]) == 3
    assert dousa("list", library, "--category", "kick")[2].count("kick_left") == 1
    code, _, err = dousa("list", library, "--text", "xqzzv")
    assert code == 2 and "xqzzv" in err


def test_what_a_search_found_is_taken_along(dousa, succeed, library, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    query = library.parent / "clap" / "p0.bvh"
    for words, expected in (((query,), "clap"), (("--text", "kick"), "kick_left")):
        out, _ = succeed("search", library, *words)
        command = out.splitlines()[-1].partition("dousa ")[2]
        out, _ = succeed(*shlex.split(command), "--json")
        assert {name.partition("/")[0] for name in json.loads(out)["written"]} == {expected}
        shutil.rmtree("found")
    out, _ = succeed("list", library, "--like", query, "--save", "claps", "--json")
    kept, _ = succeed("list", library, "--select", "claps", "--json")
    assert json.loads(kept)["clips"] == json.loads(out)["clips"]
    code, _, err = dousa("export", library, "--like", query, "--text", "kick", "-o", "none")
    assert code == 2 and "no clip is like" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "expected a QUERY that is a motion, or words with --text"),
        (("--text", "kick", "--mirror"), "need a QUERY that is a motion"),
        (("--text", " "), "got an empty text"),
        (("--text", "x" * 600), "at most 500 characters, got 600"),
    ],
)
def test_mistakes_are_told_in_a_line(dousa, library, words, said):
    code, out, err = dousa("search", library, *words)
    assert (code, out) == (2, "")
    assert said in err and len(err.splitlines()) == 1


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


@pytest.mark.parametrize(
    ("detail", "headings"),
    [
        (False, ["rank", "category", "likeness", "file"]),
        (True, ["rank", "category", "likeness", "votes apart", "same for trees", "poses apart", "file"]),
    ],
)
def test_the_likeness_falls_with_the_rank_and_the_rest_is_detail(detail, headings):
    """Also where the order goes by what was learned: the third is nearer than the second, but not alike."""
    far = (0.0, 0.7, 0.2, None)
    hits = tuple(Hit(f"/{k}.bvh", "kick", 0.1, k + 1, k, 0.5, rank_distance=one) for k, one in enumerate(far))
    answer = SearchResult("q", Verdict("kick", "kick", 0.9, 0.9, {"kick": 1.0}), hits, "fused")
    out = io.StringIO()
    print_search(Console(file=out, width=200), answer, detail=detail)
    _, head, *rows = out.getvalue().splitlines()
    assert re.split(r" {2,}", head.strip()) == headings
    assert [row.split()[2] for row in rows] == ["100%", "50%", "50%", "-"]


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
