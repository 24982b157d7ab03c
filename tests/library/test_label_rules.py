"""Rules for categories and performers."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import OptionError
from dousa.library import Library
from dousa.library.label_rules import fits_category, parse_label_rule

ROOT = Path("/data")


def label(rule: str | None, file: str, kind: str = "category", root: Path = ROOT) -> str | None:
    return parse_label_rule(rule, kind)(root, root / file)


@pytest.mark.parametrize(
    ("rule", "file", "expected"),
    [("folder", "squat1Reps/a.bvh", "squat1Reps"), ("folder", "walk/active/a.bvh", "walk/active"),
     ("folder", "a.bvh", None), (None, "walk/a.bvh", None), ("none", "walk/a.bvh", None), ("", "walk/a.bvh", None)],
)  # fmt: skip
def test_folder_is_the_path_below_the_given_one(rule, file, expected):
    assert label(rule, file) == expected
    assert parse_label_rule(rule, "category")(ROOT / file, ROOT / file) is None  # of a file given itself


@given(st.text(max_size=20))
def test_any_text_is_a_rule_or_an_option_error(text):
    try:
        rule = parse_label_rule(f"name:{text}", "category")
    except OptionError:
        return
    assert rule(ROOT, ROOT / "walk" / "a.bvh") is None or text


@pytest.mark.parametrize("rule", ["name:(", "name:", "wrong", "csv:", "folder:x", "nam:(a)"])
def test_bad_rules_are_option_errors(rule):
    with pytest.raises(OptionError, match="rule for the category"):
        parse_label_rule(rule, "category")


@pytest.mark.parametrize(
    ("rule", "kind", "expected"),
    [
        (r"name:HDM_(\w\w)_", "performer", "bd"),
        (r"name:(?P<performer>bd)_(?P<category>[a-z]+)", "category", "walk"),
        (r"name:(?P<performer>bd)_(?P<category>[a-z]+)", "performer", "bd"),
        (r"path:^([^/]+)/", "category", "level"),
        (r"path:active", "category", OptionError),
        (r"name:(zzz)", "category", None),
        (r"name:(z*)HDM", "category", None),
    ],
)
def test_expressions(rule, kind, expected):
    if expected is OptionError:
        with pytest.raises(OptionError, match="needs a group"):
            label(rule, "x.bvh", kind)
    else:
        assert label(rule, "level/active/HDM_bd_walk.bvh", kind) == expected


def write_table(tmp_path: Path, text: str, encoding: str = "utf-8") -> str:
    path = tmp_path / "labels.csv"
    path.write_bytes(text.encode(encoding))
    return f"csv:{path}"


@pytest.mark.parametrize(
    "text",
    [
        "path,category,performer\nwalk/a.bvh,walking,anna\n",
        "\ufeffpath;category;performer\r\nwalk/a.bvh;walking;anna\r\n",
        "Performer\tCategory\tFile\nanna\twalking\ta.bvh\n",
        "file,category,performer\n\n./walk/a.bvh, walking ,anna\n",
        "path,category,performer\r\nwalk\\a.bvh,walking,anna\r\nwalk\\b.bvh,,\r\n",  # an empty cell is no label
    ],
)
def test_tables(tmp_path, text):
    rule = write_table(tmp_path, text)
    assert label(rule, "walk/a.bvh") == "walking"
    assert label(rule, "walk/a.bvh", "performer") == "anna"
    assert label(rule, "walk/b.bvh") is None
    rule = write_table(tmp_path, "path,category\nsub/walk/a.bvh,walking\n")  # relative to the table
    assert label(rule, "a.bvh", root=tmp_path / "sub" / "walk") == "walking"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a column 'path' or 'file' and a column 'category', got nothing"),
        ("name,category\n", "got name, category"),
        ("path,performer\n", "column 'category'"),
        ("path,category\na.bvh\n", "labels.csv:2: expected at least 2 columns, got 1"),
        ("path,category\na.bvh,walk\na.bvh,run\n", "labels.csv:3: 'a.bvh' has a second category 'run'"),
    ],
)
def test_bad_tables_say_what_is_wrong(tmp_path, text, message):
    with pytest.raises(OptionError, match=message):
        parse_label_rule(write_table(tmp_path, text), "category")


def test_a_missing_table_and_one_of_another_encoding(tmp_path):
    with pytest.raises(OptionError, match=r"none\.csv cannot be read"):
        parse_label_rule(f"csv:{tmp_path / 'none.csv'}", "category")
    with pytest.raises(OptionError, match="not text in UTF-8; save it as CSV UTF-8"):
        parse_label_rule(write_table(tmp_path, "path,category\nä.bvh,x\n", "latin-1"), "category")


@pytest.mark.parametrize(("label", "message"), [("a\0b", "zero bytes"), ("x" * 1001, "at most 1000 bytes")])
def test_labels_that_not_every_database_keeps(library, moves, tmp_path, label, message):
    before = library.clips()
    table = tmp_path / "labels.csv"
    table.write_text(f"file,category\nwave_p0.bvh,{label}\n", encoding="utf-8")
    calls = (
        lambda: library.relabel(1, category=label),
        lambda: library.relabel(1, performer=label),
        lambda: library.add_motion(library.trajectories(1), label, "wave"),
        lambda: library.add_motion(library.trajectories(1), "m", label),
        lambda: library.add(moves, category_from=f"csv:{table}"),
    )
    for call in calls:
        with pytest.raises(OptionError, match=message):
            call()
    assert library.clips() == before


@pytest.mark.parametrize(
    ("wanted", "fitting"),
    [
        ("kick", "kick kick/left hdm05/kick"),
        ("kick/", "kick kick/left"),
        ("hdm05/", "hdm05/kick hdm05/kickLFront1Reps"),
        ("hdm05/kick", "hdm05/kick"),
        ("kick*", "kick kick/left kickboxing hdm05/kick hdm05/kickLFront1Reps"),
        ("*/kick*", "hdm05/kick hdm05/kickLFront1Reps"),
        ("left", "kick/left"),
        ("[x]", "[x]"),
        ("/", ""),
        ("", ""),
    ],
)
def test_levels_of_a_category(wanted, fitting):
    names = "kick kick/left kickboxing hdm05/kick hdm05/kickLFront1Reps [x]".split()
    assert " ".join(name for name in names if fits_category(name, wanted)) == fitting
    assert not fits_category(None, wanted)


def test_words_that_are_no_text(library, tmp_path, moves):
    for ask in (lambda: library.clips(category="\udcff"), lambda: library.relabel(1, category="\udcff")):
        with pytest.raises(OptionError, match="Unicode"):
            ask()
    with Library.open(tmp_path / "\udcff.dousa", create=True) as odd:
        assert odd.add(moves / "wave").added
    assert (tmp_path / "\udcff.dousa").exists()
