"""The language of the command line: which one is spoken, and mistakes in the words of a command in both."""

import re

import pytest

from dousa.app.cli.usage import choose_language
from dousa.errors import OptionError
from dousa.messages import get_language, use_language

JAPANESE = re.compile(r"[ぁ-んァ-ヶ一-龠]")


@pytest.fixture(autouse=True)
def english_afterwards():
    yield
    use_language("en")


@pytest.mark.parametrize(
    ("words", "environment", "language"),
    [
        ("info a.bvh", {}, "en"),
        ("info a.bvh", {"LANG": "ja_JP.UTF-8"}, "ja"),
        ("info a.bvh", {"LANG": "ja_JP.UTF-8", "LC_MESSAGES": "de_DE.UTF-8"}, "en"),
        ("info a.bvh", {"LANG": "ja_JP.UTF-8", "LC_ALL": "C"}, "en"),
        ("info a.bvh", {"LANG": "de_DE", "LC_MESSAGES": "ja_JP.eucJP"}, "ja"),
        ("info a.bvh", {"LANG": "C", "DOUSA_LANG": "ja"}, "ja"),
        ("info a.bvh", {"LANG": "ja_JP.UTF-8", "DOUSA_LANG": "en"}, "en"),
        ("info a.bvh --lang ja", {"LANG": "C", "DOUSA_LANG": "en"}, "ja"),
        ("--lang=en info a.bvh", {"DOUSA_LANG": "ja"}, "en"),
        ("--lang en info a.bvh", {"DOUSA_LANG": "fr"}, "en"),
        ("--lang ja info a.bvh --lang en", {}, "en"),
        ("info -- --lang ja", {}, "en"),
        ("info --lang", {"LC_ALL": "ja"}, "ja"),
    ],
)
def test_option_beats_variable_beats_locale(words, environment, language):
    choose_language(words.split(), environment)
    assert get_language() == language


@pytest.mark.parametrize(
    ("words", "environment", "source"), [("--lang fr", {}, "--lang"), ("info", {"DOUSA_LANG": "de"}, "DOUSA_LANG")]
)
def test_a_language_that_there_is_not(words, environment, source):
    with pytest.raises(OptionError) as caught:
        choose_language(words.split(), environment)
    assert caught.value.code == "usage.unknown_language"
    assert caught.value.message.values["source"] == source


MISTAKES = [
    ("serach x", "no such command: serach; did you mean search?"),
    ("frobnicate", "no such command: frobnicate (see dousa --help)"),
    ("train", "LIB is missing (see dousa train --help)"),
    ("train x y z", "unexpected arguments: y, z"),
    ("train x --trees 0", "--trees: expected a number of at least 1, got 0"),
    ("find x y -k 0", "-k: expected a number of at least 1, got 0"),
    ("label x y --threshold 2", "--threshold: expected a number of at most 1, got 2"),
    ("train x --trees q", "--trees: expected a whole number, got 'q'"),
    ("label x y --threshold q", "--threshold: expected a number, got 'q'"),
    ("search x y --rank foo", "--rank: expected fused, histogram, leaves or pose, got 'foo'"),
    ("search x y --pictur z", "no such option: --pictur; did you mean --picture?"),
    ("info --person", "--person: expected a value after this option"),
    ("train x --jobs 2", "--jobs goes for all commands and stands before them"),
]


@pytest.mark.parametrize(("words", "expected"), MISTAKES)
def test_mistakes_in_a_command_are_one_line_in_both_languages(dousa, words, expected):
    code, out, err = dousa(*words.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"dousa: {expected}") and err.count("\n") == 1
    code, out, err = dousa("--lang", "ja", *words.split())
    assert (code, out) == (2, "")
    assert JAPANESE.search(err) and "expected" not in err and err.count("\n") == 1


def test_the_option_stands_before_the_command(dousa):
    assert "整数" in dousa("--lang", "ja", "train", "nowhere", "--trees", "q")[2]
    code, out, err = dousa("train", "nowhere", "--lang", "en")
    assert (code, out) == (2, "") and "--lang goes for all commands and stands before them" in err


def test_no_command_at_all(dousa):
    code, out, _ = dousa()
    assert code == 2 and "Usage" in out
    code, out, err = dousa("--lang", "ja")
    assert (code, out) == (2, "") and JAPANESE.search(err)


def test_notes_are_in_the_language(dousa, tmp_path):
    import numpy as np

    from dousa.formats.registry import write_motion
    from dousa.motion import Trajectories

    path = tmp_path / "dots.trc"
    write_motion(Trajectories(("foo", "bar"), np.zeros((5, 2, 3)), 30), path)
    assert dousa("plot", path, "-o", tmp_path / "a.png")[2].startswith("dousa: note: ")
    assert dousa("--lang", "ja", "plot", path, "-o", tmp_path / "a.png")[2].startswith("dousa: 注意: ")


@pytest.mark.parametrize(
    "words",
    ["info empty.bvh", "info head.bvh", "estimate none.npz"]
    + [f"{command} none.dousa" for command in ("train", "remove 1", "relabel 1", "check", "compact")],
)
def test_damage_is_told_in_japanese_and_makes_nothing(dousa, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    files = {"empty.bvh": "", "head.bvh": "HIERARCHY\n"}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    command, *more, path = words.split()
    code, out, err = dousa("--lang", "ja", command, path, *more)
    (err,) = [line for line in err.splitlines() if not line.startswith("dousa: 注意: ")]
    assert (code, out) == (2, "")
    # Three words of small letters in a row are no name, option or unit any more.
    assert JAPANESE.search(err) and not re.search(r"(?<![\w./-])(?!dousa )[a-z]{2,}(?: [a-z]{2,}){2,}(?![\w/-])", err)
    assert {path.name for path in tmp_path.iterdir()} == set(files)
