"""Tables of labels: small files written by hand from what the programs publish about their formats."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import dousa
from dousa.errors import DousaError, MotionFileError, OptionError
from dousa.formats.annotations import is_label_file, read_label_file, write_eaf, write_labels_csv
from dousa.formats.annotations.label_file import MOST_BYTES, is_unknown, to_annotation
from dousa.library import label_rules
from dousa.messages import LANGUAGES, Message
from dousa.motion.annotation import Stretch

STUDIO_WORDS = Path(dousa.__file__).parent / "app" / "studio" / "words"
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"

LONG_GRID = '''File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 3.5
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "left ""arm"""
        xmin = 0
        xmax = 3.5
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 1.25
            text = ""
        intervals [2]:
            xmin = 1.25
            xmax = 2.5
            text = "wave ! high"
        intervals [3]:
            xmin = 2.5
            xmax = 3.5
            text = "手を叩く"
    item [2]:
        class = "TextTier"
        name = "beats"
        xmin = 0
        xmax = 3.5
        points: size = 1
        points [1]:
            number = 1.5
            mark = "beat"
'''
SHORT_GRID = '''File type = "ooTextFile"
Object class = "TextGrid"

0
3.5
<exists>
2
"IntervalTier"
"left ""arm"""
0
3.5
3
0
1.25
""
1.25
2.5
"wave ! high"
2.5
3.5
"手を叩く"
"TextTier"
"beats"
0
3.5
1
1.5
"beat"
'''
EAF = """<?xml version="1.0" encoding="UTF-8"?>
<ANNOTATION_DOCUMENT AUTHOR="" DATE="2020-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0">
  <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"/>
  <TIME_ORDER>
    <TIME_SLOT TIME_SLOT_ID="ts1" TIME_VALUE="500"/>
    <TIME_SLOT TIME_SLOT_ID="ts2"/>
    <TIME_SLOT TIME_SLOT_ID="ts3" TIME_VALUE="1500"/>
    <TIME_SLOT TIME_SLOT_ID="ts4" TIME_VALUE="4000"/>
  </TIME_ORDER>
  <TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="empty"/>
  <TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="action">
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a1" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts2">
      <ANNOTATION_VALUE>sit down</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a2" TIME_SLOT_REF1="ts3" TIME_SLOT_REF2="ts4">
      <ANNOTATION_VALUE>stand up</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a9" TIME_SLOT_REF1="ts2" TIME_SLOT_REF2="ts3">
      <ANNOTATION_VALUE></ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
  </TIER>
  <TIER LINGUISTIC_TYPE_REF="parts" PARENT_REF="action" TIER_ID="parts">
    <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a3" ANNOTATION_REF="a2">
      <ANNOTATION_VALUE>lean</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
    <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a4" ANNOTATION_REF="a2" PREVIOUS_ANNOTATION="a3">
      <ANNOTATION_VALUE>rise</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
  </TIER>
</ANNOTATION_DOCUMENT>
"""
AGGREGATED = """Observation id,Observation date,Media file,Total length,FPS,Subject,Behavior,Behavioral category,\
Behavior type,Start (s),Stop (s),Duration (s),Comment start,Comment stop
s01,2020-01-01,C:\\films\\s01.mp4,60.0,25.0,anna,walk,,STATE,1.0,3.0,2.0,,
s01,2020-01-01,C:\\films\\s01.mp4,60.0,25.0,anna,point,,POINT,3.5,3.5,NA,,
s01,2020-01-01,C:\\films\\s01.mp4,60.0,25.0,bert,sit,,STATE,2.0,9.0,7.0,,
s02,2020-01-01,C:\\films\\s02.mp4,60.0,25.0,anna,walk,,STATE,4.0,5.0,1.0,,
"""
TABULAR = """Observation id,s01
Observation date,2020-01-01 10:00:00
Time offset (s),0

Time,Media file path,Total length,FPS,Subject,Behavior,Behavioral category,Comment,Status
1.0,C:\\films\\s01.mp4,60.0,25,No focal subject,walk,,,START
2.0,C:\\films\\s01.mp4,60.0,25,No focal subject,"wave, high",,,START
2.5,C:\\films\\s01.mp4,60.0,25,No focal subject,clap,,,POINT
3.0,C:\\films\\s01.mp4,60.0,25,No focal subject,walk,,,STOP
3.5,C:\\films\\s01.mp4,60.0,25,No focal subject,"wave, high",,,STOP
"""


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def read(path: Path, tier: str | None = None, take: str = "s01.bvh") -> list[tuple[float, float, str | None]]:
    file = read_label_file(path)
    tiers = file.tiers_of(path.parent / take)
    assert tiers is not None
    annotation, _ = to_annotation(file, tiers, tier, 100.0)
    return [(one.start, one.stop, one.category) for one in annotation.segments]


@pytest.mark.parametrize("text", [LONG_GRID, SHORT_GRID], ids=["long", "short"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16-le", "utf-16-be"])
def test_textgrid(tmp_path, text, encoding):
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(encoding, b"")
    path = write(tmp_path, "s01.TextGrid", mark + text.replace("\n", "\r\n").encode(encoding))
    assert read(path) == [(1.25, 2.5, "wave ! high"), (2.5, 3.5, "手を叩く")]
    tiers = read_label_file(path).tiers_of("s01.bvh")
    assert [tier.name for tier in tiers] == ['left "arm"', "beats"]
    assert read(path, "beats") == []
    assert [note.code for note in to_annotation(read_label_file(path), tiers, "beats")[1]] == ["label_files.points"]


def test_elan(tmp_path):
    path = write(tmp_path, "s01.eaf", EAF)
    assert read(path) == [(0.5, 1.0, "sit down"), (1.5, 4.0, "stand up")]  # a slot without a time is half way
    idle = EAF.replace("</TIME_ORDER>", '<TIME_SLOT TIME_SLOT_ID="ts99"/></TIME_ORDER>')
    assert read(write(tmp_path, "idle.eaf", idle)) == read(path)  # nothing refers to the slot after the last time
    assert read(path, "parts") == [(1.5, 2.75, "lean"), (2.75, 4.0, "rise")]
    file = read_label_file(path)
    (note,) = to_annotation(file, file.takes[""])[1]
    assert (note.code, note.values["tier"], note.values["others"]) == ("label_files.tier_chosen", "action", ("parts",))
    with pytest.raises(OptionError, match=r"no tier 'words'; it has empty, action"):
        to_annotation(file, file.takes[""], "words")


def test_boris_aggregated_events(tmp_path):
    path = write(tmp_path, "all.csv", AGGREGATED)
    assert read(path) == [(1.0, 3.0, "walk")]
    assert read(path, "bert") == [(2.0, 9.0, "sit")]
    assert read(path, take="s02.c3d") == [(4.0, 5.0, "walk")]
    file = read_label_file(path)
    assert file.tiers_of("s03.c3d") is None
    codes = [note.code for note in to_annotation(file, file.tiers_of("s01.c3d"))[1]]
    assert codes == ["label_files.tier_chosen", "label_files.points"]


def test_boris_tabular_events(tmp_path):
    path = write(tmp_path, "s01.boris.csv", TABULAR)
    assert is_label_file(path)
    assert read(path) == [(1.0, 3.0, "walk"), (2.0, 3.5, "wave, high")]
    file = read_label_file(path)
    points, overlap = to_annotation(file, file.takes[""])[1]
    assert (points.code, points.values["n"]) == ("label_files.points", 1)
    assert overlap.values["line"] == 7 and overlap.values["problem"].code == "label_files.overlap"


def test_a_table_of_several_takes(tmp_path):
    text = "file,start_s,end_s,category,tier\nb.bvh,1,2,walk,x\nsub/a.bvh,3,4,run,x\nb.bvh,1,2,slow,y\n"
    path = write(tmp_path, "all.csv", text)
    assert read(path, take="b.bvh") == [(1.0, 2.0, "walk")]
    assert read(path, "y", take="b.bvh") == [(1.0, 2.0, "slow")]
    assert read(path, take="sub/a.bvh") == [(3.0, 4.0, "run")]
    assert read_label_file(path).tiers_of(tmp_path / "c.bvh") is None
    exact = write(tmp_path, "exact.csv", "path,start_s,end_s,category\nsub/a.bvh,3,4,run\n")
    assert read_label_file(exact).tiers_of(tmp_path / "a.bvh") is None
    assert read_label_file(exact).tiers_of(tmp_path / "x" / "sub" / "a.bvh", tmp_path / "x") is not None


def test_a_list_of_cmu(tmp_path):
    text = "86 01\nwalk 100 150 200\njump 300 310 320 \n\n86 02\nrun 50 40 60\nsit 55 90 100\n"
    path = write(tmp_path, "mocap.txt", text)
    assert read(path, take="86_01.amc") == [(0.0, 1.0, "walk"), (2.0, 3.0, "jump")]
    file = read_label_file(path)
    annotation, _ = to_annotation(file, file.tiers_of("86_1.amc"), None, 100.0)
    assert annotation.unclear == ((1.0, 2.0), (3.0, 3.2))
    later, notes = to_annotation(file, file.tiers_of("86_02.amc"), None, 100.0)
    assert [(one.start, one.stop) for one in later.segments] == [(0.0, 0.4), (0.6, 0.9)]
    assert [note.values["problem"].code for note in notes] == ["label_files.cmu_order"]
    with pytest.raises(OptionError, match="frame rate"):
        to_annotation(file, file.tiers_of("86_01.amc"))


def doubts(path: Path, tier: str | None = None) -> list[tuple[int | None, str]]:
    """Lines and codes of what is said of a table."""
    file = read_label_file(path)
    notes = [note.values for note in to_annotation(file, file.takes[""], tier)[1]]
    return [(values.get("line"), values["problem"].code.removeprefix("label_files.")) for values in notes]


@pytest.mark.parametrize(
    "word", ["unknown", "Unknown", "不明", "未知", "(nothing)", "（何もない）", "(nothing, unknown)"]
)
def test_what_dousa_calls_unknown_is_no_category(tmp_path, word):
    path = write(tmp_path, "s01.csv", HEAD + f'1,2,walk\n3,4,"{word}"\n')
    assert read(path) == [(1.0, 2.0, "walk")]
    assert doubts(path) == [(3, "unknown")]
    doubtful = write(tmp_path, "s02.csv", f'start_s,end_s,category,perhaps\n3,4,"{word}",walk\n')
    (tier,) = read_label_file(doubtful).takes[""]
    assert (tier.spans, tier.unclear, tier.n_rest) == ((), ((3.0, 4.0),), 0)
    document = write(tmp_path, "s01.eaf", EAF.replace("sit down", word))
    assert read(document) == [(1.5, 4.0, "stand up")]
    grid = write(tmp_path, "s01.TextGrid", LONG_GRID.replace("wave ! high", word))
    assert read(grid) == [(2.5, 3.5, "手を叩く")]


def test_the_words_for_unknown_are_those_that_dousa_prints():
    for language in LANGUAGES:
        for code in ("columns.unknown", "trial_takes.nothing"):
            assert is_unknown(Message(code).render(language))
    words = json.loads((STUDIO_WORDS / "common.json").read_text(encoding="utf-8"))
    assert all(is_unknown(word) for word in words["unknown"])
    assert not any(is_unknown(word) for word in ("unknown dance", "nothing", "walk"))


def test_an_empty_table_is_blank_and_rows_without_a_category_are_not(tmp_path):
    blank = {
        "a.labels.csv": HEAD,
        "a.eaf": EAF.partition('  <TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="action">')[0]
        + "</ANNOTATION_DOCUMENT>",
        "a.TextGrid": LONG_GRID.replace("wave ! high", "").replace("手を叩く", " "),
    }
    said = {"b.labels.csv": HEAD + "0,5,\n", "c.labels.csv": "start_s,end_s,category,perhaps\n0,5,,walk\n"}
    for name, content in {**blank, **said}.items():
        file = read_label_file(write(tmp_path, name, content))
        annotation, _ = to_annotation(file, file.takes[""])
        assert (annotation.segments, annotation.is_blank) == ((), name in blank), name


HEAD = "start_s,end_s,category\n"
GRID_HEAD = 'File type = "ooTextFile"\nObject class = "TextGrid"\n0\n9\n<exists>\n1\n"IntervalTier"\n"x"\n0\n9\n'


@pytest.mark.parametrize(
    ("name", "content", "line", "code"),
    [
        ("a.labels.csv", HEAD + "1,2,walk\n2,1,run\n", 3, "label_files.backwards"),
        ("a.labels.csv", HEAD + "-1,2,walk\n", 2, "label_files.negative"),
        ("a.labels.csv", HEAD + "one,2,walk\n", 2, "label_files.no_number"),
        ("a.labels.csv", HEAD + "nan,2,walk\n", 2, "label_files.no_time"),
        ("a.labels.csv", HEAD + "1,inf,walk\n", 2, "label_files.no_time"),
        ("a.labels.csv", HEAD + "\n1,2\n", 3, "label_files.too_few_columns"),
        ("a.labels.csv", "from,to,what\n1,2,walk\n", 1, "label_files.no_columns"),
        ("a.labels.csv", HEAD + "1,2,wa\0lk\n", 2, "label_files.zero_bytes"),
        ("a.labels.csv", HEAD.encode() + b"1,2,w\xe4lk\n", 2, "label_files.not_utf8"),
        ("a.labels.csv", b"", None, "disk.empty"),
        ("a.labels.csv", HEAD + '0,1,run\n1,2,"walk\n3,4,sit\n', 3, "label_files.open_quote"),
        ("a.labels.csv", HEAD + '1,2,"walk\n3,4,"sit"\n', 2, "label_files.open_quote"),
        ("a.labels.csv", HEAD + '1,2,"walk\n3,4,sit"\n5,6,run\n', 2, "label_files.open_quote"),
        ("a.labels.csv", HEAD + f"1,2,walk\n3,4,{'x' * 1001}\n", 3, "label_files.long_category"),
        ("a.boris.csv", TABULAR.replace(",START", ",STOP", 1), 6, "label_files.stops_only"),
        ("a.boris.csv", TABULAR.replace(",STOP", ",START", 1), 9, "label_files.starts_twice"),
        ("a.boris.csv", TABULAR.rstrip("\n").rpartition("\n")[0] + "\n", 7, "label_files.never_stops"),
        ("a.boris.csv", TABULAR.replace("POINT", "MAYBE"), 8, "label_files.no_kind"),
        ("a.eaf", "<a/>", None, "label_files.not_elan"),
        ("a.eaf", EAF[:300], None, "markup.broken_xml"),
        ("a.eaf", EAF.replace('REF2="ts4"', 'REF2="ts7"'), None, "label_files.no_slot"),
        ("a.eaf", EAF.replace('VALUE="1500"', 'VALUE="soon"'), None, "label_files.no_slot_time"),
        ("a.eaf", EAF.replace('VALUE="4000"', 'X="1"'), None, "label_files.no_slot_time"),
        ("a.eaf", EAF.replace('ANNOTATION_REF="a2"', 'ANNOTATION_REF="a7"'), None, "label_files.no_parent"),
        ("a.TextGrid", LONG_GRID[:500], None, "label_files.cut_off"),
        ("a.TextGrid", "walk 1 2", 1, "label_files.not_textgrid"),
        ("a.TextGrid", '"Praat chronological TextGrid text file"', 1, "label_files.chronological"),
        ("a.TextGrid", GRID_HEAD + '1\n2\n1\n"w"\n', 12, "label_files.backwards"),
        ("a.TextGrid", GRID_HEAD + '1\n"w"\n', 12, "label_files.grid_order"),
        ("a.TextGrid", GRID_HEAD + "1.5\n", 11, "label_files.grid_order"),
        ("mocap.txt", "86 01\nwalk 1 2 3\nrun fast\n", 3, "label_files.cmu_line"),
        ("mocap.txt", "86 01\nwalk 10 20 30\nrun 1 2 3\n", 3, "label_files.cmu_backwards"),
    ],
)
def test_damaged_tables_say_where(tmp_path, name, content, line, code):
    path = write(tmp_path, name, content)
    with pytest.raises(MotionFileError) as caught:
        read_label_file(path)
    assert caught.value.code == code
    assert str(path) in str(caught.value)
    if line is not None:
        assert caught.value.line == line


def test_categories_are_as_long_as_a_library_keeps_them():
    assert MOST_BYTES == label_rules.MOST_BYTES


NAMES = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Zl", "Zp", "Zs", "Cs"]), min_size=1)


@given(st.lists(st.tuples(st.integers(0, 90_000), st.integers(1, 9000), NAMES), max_size=12))
def test_what_is_written_is_read(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("labels")
    segments = [Stretch(start / 1000, (start + length) / 1000, name) for start, length, name in rows]
    wanted = sorted({(round(one.start, 3), round(one.stop, 3), one.category) for one in segments})
    for name, put in (("s01.labels.csv", write_labels_csv), ("s01.eaf", write_eaf)):
        put(segments, folder / name)
        assert sorted((round(a, 3), round(b, 3), c) for a, b, c in read(folder / name)) == wanted


@given(st.data())
def test_damaged_bytes_are_answered(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    seeds = {"a.TextGrid": LONG_GRID, "b.TextGrid": SHORT_GRID, "a.eaf": EAF, "a.csv": AGGREGATED, "b.csv": TABULAR}
    name = data.draw(st.sampled_from(sorted(seeds)))
    content = bytearray(seeds[name].encode())
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=6))
    path = write(folder, name, bytes(content) or b"x")
    try:
        file = read_label_file(path)
        for tiers in file.takes.values():
            to_annotation(file, tiers)
    except DousaError as error:
        assert str(error)


def test_real_labels():
    if not (DATA / "utkinect").is_dir():
        pytest.skip("needs ../shared/data/utkinect")
    files = sorted((DATA / "utkinect").glob("*.labels.csv"))
    assert [len(read(path)) for path in files] == [10] * 10
    assert not any(is_label_file(path) for path in (DATA / "utkinect").glob("*.trc"))
    file = read_label_file(DATA / "cmu86" / "mocap.txt")
    assert len(file.takes) == 14 and len(file.tiers_of("86_01.amc")[0].spans) == 7
