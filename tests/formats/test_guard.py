"""The guard: every kind of fault in every format that can have it, and sound files that look faulty.

A cell of the table that is empty has a reason in ``NOT_THERE``.
"""

import dataclasses
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from oracles.c3d_file import make_c3d

from dousa.errors import MotionFileError
from dousa.formats.guard import MOST_POINTS, Clock, find_lost, given_rate, settle_clock
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from formats import made_files as made
from formats.test_asf_amc import ASF

RATE, FRAMES = 100.0, 40
BODY = dataclasses.replace(make_motion("walk", draw_performer(3)), frame_rate=RATE)
BODY = dataclasses.replace(BODY, rotations=BODY.rotations[:FRAMES], translations=BODY.translations[:FRAMES].copy())
PATH = compute_trajectories(BODY)


@dataclass
class File:
    """What stands in a file: rows of points (T, K, 3) in m, and what it says of time and of itself."""

    points: np.ndarray = field(default_factory=PATH.positions.copy)
    numbers: np.ndarray = field(default_factory=lambda: np.arange(1, FRAMES + 1))
    times: np.ndarray = field(default_factory=lambda: np.arange(FRAMES) / RATE)
    rate: float = RATE
    frames: int = FRAMES
    part: float = 1.0  # of the bytes

    def keep(self, rows):
        return dataclasses.replace(self, points=self.points[rows], numbers=self.numbers[rows], times=self.times[rows])


def rows_of(file, mark, scale=1.0):
    lines = []
    for number, time, places in zip(file.numbers, file.times, file.points * scale, strict=True):
        cells = [f"{number}", f"{time:.6f}", *(repr(value) for value in places.ravel().tolist())]
        lines.append(mark.join(cells))
    return "\n".join([*lines, ""])


def write_trc(file):
    keys = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
    values = f"{file.rate!r}\t{file.rate!r}\t{file.frames}\t{file.points.shape[1]}\tm\t{file.rate}\t1\t{file.frames}"
    names = "Frame#\tTime\t" + "\t\t\t".join(PATH.names) + "\t\t"
    return f"PathFileType\t4\t(X/Y/Z)\tx\n{keys}\n{values}\n{names}\n\t\t\n\n{rows_of(file, chr(9))}".encode()


def write_motive(file):
    names = ",".join(name for name in PATH.names for _ in "XYZ")
    count = file.points.shape[1]
    head = (
        f"Format Version,1.23,Capture Frame Rate,{file.rate!r},Export Frame Rate,{file.rate!r},"
        f"Total Exported Frames,{file.frames},Length Units,Meters\n\n,Type{',Marker' * 3 * count}\n,Name,{names}\n"
        f",ID\n,{',Position' * 3 * count}\nFrame,Time (Seconds){',X,Y,Z' * count}\n"
    )
    return (head + rows_of(file, ",")).encode()


def write_qualisys(file):
    head = f"NO_OF_FRAMES\t{file.frames}\nFREQUENCY\t{file.rate!r}\nMARKER_NAMES\t" + "\t".join(PATH.names)
    titles = "\t".join(f"{name} {axis}" for name in PATH.names for axis in "XYZ")
    return f"{head}\nFrame\tTime\t{titles}\n{rows_of(file, chr(9), 1000.0)}".encode()


def write_table(file):
    titles = ",".join(f"{name}_{axis}" for name in PATH.names for axis in "xyz")
    return f"fps: {file.rate!r}\nframe,time,{titles}\n{rows_of(file, ',')}".encode()


def write_c3d(file):
    return make_c3d(file.points * 1000, list(PATH.names), rate=file.rate, frames=file.frames)


def write_npz(file):
    return made.make_npz(joints=file.points, joint_names=np.array(PATH.names), fps=np.array(file.rate))


def write_json(file):
    frames = [[[v if np.isfinite(v) else None for v in p] for p in f] for f in file.points.tolist()]
    return json.dumps({"fps": file.rate, "joint_names": PATH.names, "frames": frames}).encode()


def moved(file):
    """The body with its root where the file has the first point."""
    translations = BODY.translations[: len(file.points)].copy()
    translations[:, 0] = file.points[:, 0]
    return translations


def write_bvh(file, tmp_path):
    """As dousa writes it, with the numbers of the root, the rate and the count replaced."""
    path = tmp_path / "sound.bvh"
    write_motion(BODY, path)
    head, _, rows = path.read_text().partition("MOTION")
    lines = [line.split() for line in rows.splitlines()[3:]][: len(file.points)]
    for line, place in zip(lines, (100 * file.points[:, 0]).tolist(), strict=True):
        line[:3] = map(repr, place)
    text = "\n".join(" ".join(line) for line in lines)
    return f"{head}MOTION\nFrames: {file.frames}\nFrame Time: {1 / file.rate!r}\n{text}\n".encode()


def write_amc(file, tmp_path):
    (tmp_path / "x.asf").write_text(ASF.replace("length 0.45", "length 1").replace("angle deg", "angle deg"))
    text = f":FULLY-SPECIFIED\n:DEGREES\n:SAMPLES-PER-SECOND {file.rate:g}\n"
    for number, place in zip(file.numbers, file.points[:, 0].tolist(), strict=True):
        turn = 5 + 30 * place[0]  # the same in a row that is repeated
        text += f"{number}\nroot {' '.join(map(repr, place))} 0 {turn:.3f} 0\nthigh 5 6 7\nshin 41\ntrunk 11 12\n"
    return text.encode()


def write_mvnx(file):
    text = made.make_mvnx().decode().replace('frameRate="60"', f'frameRate="{file.rate!r}"')
    head, frame, _ = text.partition('<frame time="0" type="normal"')
    turns = " ".join(["1 0 0 0"] * 4)
    rest = made.PLACES - made.PLACES[0]
    frames = ""
    for number, time, place in zip(file.numbers, file.times, file.points[:, 0], strict=True):
        places = " ".join(repr(value) for value in (place + rest).ravel().tolist())
        frames += f'<frame time="{1000 * time:.0f}" index="{number}" type="normal"><orientation>{turns}</orientation>'
        frames += f"<position>{places}</position></frame>"
    return f"{head}{frames}</frames></subject></mvnx>".encode() if frame else b""


def write_glb(file, tmp_path):
    """As dousa writes it, with the places of the root and the times of its keys replaced."""
    path = tmp_path / "sound.glb"
    write_motion(dataclasses.replace(BODY, translations=moved(File())), path)
    data = bytearray(path.read_bytes())
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    (animation,) = tree["animations"]
    channel = next(one for one in animation["channels"] if one["target"]["path"] == "translation")
    times = file.times if file.times.any() else np.arange(len(file.times)) / file.rate
    sampler = animation["samplers"][channel["sampler"]]
    for number, values in ((sampler["input"], times), (sampler["output"], file.points[:, 0])):
        accessor = tree["accessors"][number]
        start = 28 + length + tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        place = start + accessor.get("byteOffset", 0)
        with np.errstate(over="ignore"):
            packed = values.astype("<f4").tobytes()
        data[place : place + len(packed)] = packed
        accessor.pop("min", None), accessor.pop("max", None)
    data[20 : 20 + length] = json.dumps(tree, separators=(",", ":")).encode().ljust(length)
    return bytes(data)


def write_own(file):
    texts = dict.fromkeys(("path", "format", "unit_source", "up", "up_source"), "")
    return made.make_npz(
        format=np.array("dousa motion"),
        version=np.array(1),
        kind=np.array("trajectories"),
        names=np.array(PATH.names),
        frame_rate=np.array(file.rate),
        positions=file.points,
        provenance=np.array(json.dumps(texts | {"unit": 1.0})),
    )


WRITERS: dict[str, Callable[..., bytes]] = {
    "trc": write_trc,
    "csv": write_motive,
    "tsv": write_qualisys,
    "table": write_table,
    "c3d": write_c3d,
    "npz": write_npz,
    "own.npz": write_own,
    "json": write_json,
    "bvh": write_bvh,
    "amc": write_amc,
    "mvnx": write_mvnx,
    "glb": write_glb,
}
BESIDE = ("bvh", "amc", "glb")  # made of other files


def read(tmp_path, name, file):
    """(T, K, 3) of the points that count, the motion, and the codes of its notes."""
    path = tmp_path / f"x.{'csv' if name == 'table' else name}"
    data = WRITERS[name](file, *([tmp_path] if name in BESIDE else []))
    path.write_bytes(data[: round(file.part * len(data))])
    unit = {"tsv": "mm", "c3d": "mm", "bvh": "cm"}.get(name, "m")
    motion = read_motion(path, **({} if name == "own.npz" else {"unit": unit, "up": "y"}))
    places = motion.translations[:, :1] if isinstance(motion, Motion) else motion.positions
    return places, motion, [note.code for note in motion.provenance.notes]


def lose(value, part=slice(10, 15)):
    def change(file):
        file.points[part, 0] = value
        right = PATH.positions.copy()
        right[part, 0] = np.nan
        return file, right

    return change


def cut_gap(file):
    right = PATH.positions.copy()
    right[12:20] = np.nan
    return file.keep([*range(12), *range(20, FRAMES)]), right


def repeat(file):
    return file.keep([*range(9), 9, 9, 9, *range(10, FRAMES)]), PATH.positions


def exchange(file):
    return file.keep([*range(5), *range(20, 25), *range(10, 20), *range(5, 10), *range(25, FRAMES)]), PATH.positions


def contradict(file):
    return dataclasses.replace(file, times=np.arange(FRAMES) / 50.0), PATH.positions


def say_seconds(file):
    return dataclasses.replace(file, rate=1 / RATE, times=np.zeros(FRAMES)), PATH.positions


def miscount(file):
    return dataclasses.replace(file, frames=FRAMES - 5), PATH.positions


def go_far(file):
    return dataclasses.replace(file, points=file.points + np.array([4.5e6, 0.0, 5e5])), PATH.positions


def explode(value):
    def change(file):
        file.points[7, 0, 1] = value
        return file, None

    return change


def cut_short(file):
    return dataclasses.replace(file, part=0.6), None


def flatten(file):
    file.points[..., 2] = 0.0
    return file, None


KINDS = {  # the change, and the note or error
    "zeros": (lose(0.0), "guard.lost"),
    "sentinel": (lose(-9999.0), "guard.lost"),
    "huge sentinel": (lose(1e9), "guard.lost"),
    "nan": (lose(np.nan), None),
    "gap": (cut_gap, "guard.gaps"),
    "repeated rows": (repeat, "guard.repeated_rows"),
    "exchanged rows": (exchange, "guard.exchanged_rows"),
    "other times": (contradict, "guard.rate_of_times"),
    "seconds for a rate": (say_seconds, "guard.rate_is_time"),
    "count": (miscount, "guard.frame_count"),
    "far": (go_far, "guard.shifted"),
    "infinite": (explode(np.inf), "guard.no_place"),
    "1e300": (explode(1e300), "guard.no_place"),
    "in a picture": (flatten, "guard.flat"),
    "cut short": (cut_short, None),
}
TREES = ("bvh", "amc", "mvnx", "glb")

NO_ROWS = dict.fromkeys(("c3d", "npz", "own.npz", "json", "bvh"), "frames have neither number nor time")
NOT_THERE = {
    **{(kind, name): why for kind in ("gap", "repeated rows", "exchanged rows") for name, why in NO_ROWS.items()},
    **{("other times", name): why for name, why in {**NO_ROWS, "amc": "no times"}.items()},
    **{("count", name): "declares no number of frames" for name in ("table", "npz", "own.npz", "json", "amc", "mvnx")},
    ("gap", "glb"): "what lies between two keys is interpolated by the definition of the format",
    ("repeated rows", "glb"): "two keys at one time are a jump by the definition of the format",
    ("exchanged rows", "glb"): "times that fall are refused",
    ("other times", "glb"): "declares no rate beside the times",
    ("count", "glb"): "times and values of other numbers are refused",
    ("1e300", "glb"): "as c3d",
    ("far", "glb"): "numbers of 32 bits: what is lost was lost on writing",
    ("nan", "glb"): "numbers must be finite: refused",
    ("infinite", "glb"): "as nan",
    ("infinite", "own.npz"): "as nan",
    ("zeros", "tsv"): "0 0 0 is missing by the definition of the format: no note",
    ("zeros", "json"): "as tsv",
    ("count", "c3d"): "the file then holds more frames than it declares: said by its bytes",
    ("far", "c3d"): "numbers of 32 bits: what is lost was lost on writing",
    ("nan", "amc"): "has no spelling for missing values",
    ("1e300", "c3d"): "numbers of 32 bits hold no 1e300: it is infinite",
    ("infinite", "json"): "has no spelling for it",
    ("infinite", "bvh"): "the numbers of a row must be finite: refused with the line",
    ("infinite", "amc"): "as bvh",
    **{("in a picture", name): "a tree is read, with a note that it has no depth" for name in TREES},
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_mended_or_refused_and_always_said(tmp_path, kind, name):
    if (kind, name) in NOT_THERE:
        pytest.skip(NOT_THERE[kind, name])
    change, code = KINDS[kind]
    file, right = change(File())
    if right is None:
        try:
            _, _, codes = read(tmp_path, name, file)
        except MotionFileError as error:
            assert code in (None, error.code)
        else:
            assert code is None and {"guard.cut_off", "guard.frame_count", "guard.bytes_lacking"} & {*codes}
        return
    places, motion, codes = read(tmp_path, name, file)
    assert code is None or code in codes
    right = right[:, : places.shape[1]]
    shift = motion.provenance.shift
    off = 0.0 if shift is None else np.array(file.points[0, 0] - PATH.positions[0, 0]) - shift
    np.testing.assert_allclose(places, right + off, atol=1e-3 if name == "c3d" else 1e-6)
    rate = {"other times": 50.0}.get(kind, RATE)
    assert motion.frame_rate == pytest.approx(rate, rel=1e-6)


def make_table():
    """The table of the document: what happens to each kind in each format, a letter for why it cannot be there."""
    plain = {about: why for about, why in NOT_THERE.items() if not why.startswith("as ")}
    letters = {why: "abcdefghijklmnopqrstuvwxyz"[n] for n, why in enumerate(dict.fromkeys(plain.values()))}
    same = {
        "as c3d": ("1e300", "c3d"),
        "as tsv": ("zeros", "tsv"),
        "as bvh": ("infinite", "bvh"),
        "as nan": ("nan", "glb"),
    }
    lines = [f"| fault | {' | '.join(WRITERS)} |", "|" + " --- |" * (1 + len(WRITERS))]
    for kind, (change, code) in KINDS.items():
        right = change(File())[1]
        usual = "refused" if right is None else "missing" if code is None else "noted"
        usual = "said" if right is None and code is None else usual
        reasons = [NOT_THERE.get((kind, name)) for name in WRITERS]
        cells = [usual if why is None else letters[plain.get(same.get(why), why)] for why in reasons]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *(f"- {letter}: {why}" for why, letter in letters.items())])


def test_the_document_has_the_table():
    page = Path(__file__).parents[2] / "docs" / "formats.md"
    assert make_table() in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", WRITERS)
def test_sound_files_pass_unchanged(tmp_path, name):
    places, motion, codes = read(tmp_path, name, File())
    assert not [code for code in codes if code.startswith("guard.")]
    np.testing.assert_allclose(places, PATH.positions[:, : places.shape[1]], atol=1e-5 if name == "c3d" else 1e-9)
    assert motion.frame_rate == RATE


def tick(numbers=None, times=None, rate=RATE, **more):
    return Clock(rate, times, numbers, **more)


COUNTED = np.arange(200.0)
JITTER = np.random.default_rng(0).uniform(-0.2, 0.2, 200)


@pytest.mark.parametrize(
    ("clock", "rate"),
    [
        (tick(COUNTED + 2342, COUNTED / RATE), RATE),
        (tick(COUNTED, np.round(COUNTED / RATE, 2)), RATE),
        (tick(COUNTED, np.round(COUNTED / 120, 2), 120.0), 120.0),  # 0.01 for frames of 0.0083: times twice
        (tick(COUNTED, np.round(COUNTED / 30, 3), 30.0), 30.0),
        (tick(COUNTED, COUNTED / 29.97, 30.0), 30.0),
        (tick(COUNTED * 2, COUNTED / RATE), RATE),  # every second frame of a recording at 200 Hz
        (tick(np.floor(COUNTED * 5 / 3), COUNTED / 30, 30.0), 30.0),  # 30 Hz of 50: 0, 1, 3, 5, 6, 8
        (tick(COUNTED * 0, COUNTED * 0), RATE),
        (tick(COUNTED * 0 + np.nan, COUNTED * 0 + np.nan), RATE),
        (tick(COUNTED, COUNTED * 1000 / RATE), RATE),  # ms
        (tick(COUNTED, 637_000_000_000_000_000 + np.round(COUNTED * 1e7 / 30), 30.0), 30.0),  # 100 ns since year 1
        (tick(COUNTED, (COUNTED + JITTER) / 30 + 1e5, 30.0), 30.0),
        (tick(COUNTED, 1.7e18 + np.round(COUNTED * 1e9 / 50), None), 50.0),  # ns since 1970
        (tick(np.where(COUNTED == 50, np.nan, COUNTED), COUNTED / RATE), RATE),
        (tick(COUNTED, COUNTED / 0.5, 0.5), 0.5),
    ],
)
def test_clocks_of_real_files_are_believed(clock, rate):
    found = settle_clock("x.trc", clock, 200)
    assert found.rate == pytest.approx(rate)
    assert found.rows is None
    assert not {note.code for note in found.notes} - {"guard.odd_rate", "guard.uneven_times", "guard.time_unit"}


def test_a_wrong_number_moves_no_frame():
    numbers = COUNTED.copy()
    numbers[70] = 7000
    found = settle_clock("x.trc", tick(numbers), 200)
    assert found.rows is None or np.array_equal(found.rows, np.arange(200))
    assert [note.code for note in found.notes] == ["guard.time_slips"]


def test_recordings_in_one_file_are_read_one_after_the_other():
    content = np.random.default_rng(1).normal(size=(200, 3))
    found = settle_clock("x.trc", tick(COUNTED % 100), 200, content)
    assert found.rows is None
    assert [(note.code, note.values["row"]) for note in found.notes] == [("guard.starts_again", 101)]


def test_a_gap_beyond_all_bounds_is_refused():
    with pytest.raises(MotionFileError, match="split the file"):
        settle_clock("x.trc", tick(np.where(COUNTED > 100, COUNTED + 1e7, COUNTED)), 200)


@pytest.mark.parametrize(
    ("said", "rate"), [(24, 24), (30, 30), (120, 120), (1000 / 30, 30), (1000 / 60, 60), (2, 0.5), (1e5, 1e-5)]
)
def test_seconds_that_are_a_rate_or_milliseconds(said, rate):
    found = settle_clock("x.bvh", Clock(1 / said), 10)
    assert found.rate == pytest.approx(rate)
    assert len(found.notes) == 1


def test_a_given_rate_wins():
    with given_rate(30.0):
        assert settle_clock("x.bvh", Clock(120.0), 10).rate == 30.0
    assert settle_clock("x.bvh", Clock(120.0), 10).rate == 120.0


def test_places_of_sound_recordings_are_not_lost():
    """A root at the origin, a path that begins there, a point that passes it: none jumps away from the others."""
    walk = PATH.positions
    assert find_lost(walk - walk[:, :1]) is None
    assert find_lost(walk - walk[0, 0]) is None
    assert find_lost(walk - walk[20, 5]) is None
    single = np.linspace(-1, 1, 201)[:, None, None] * (1.0, 2.0, 3.0)
    assert find_lost(single) is None


def test_a_frame_in_which_all_points_are_one_is_lost():
    walk = PATH.positions.copy()
    walk[:3] = 0.0
    assert find_lost(walk)[:3].all()
    walk[-2:] = -1.0
    assert find_lost(walk).sum() == 5 * walk.shape[1]


def test_points_beyond_all_others_are_lost():
    walk = PATH.positions.copy()
    walk[4, 2, 1] = 1e6
    lost = find_lost(walk)
    assert lost[4, 2] and lost.sum() == 1


@pytest.mark.parametrize("suffix", [".trc", ".csv", ".npz", ".bvh", ".c3d", ".glb"])
@pytest.mark.parametrize("offset", [0.0, 12.5, 500.0, 5e5, 4.5e6, 1e7])
def test_what_is_written_far_away_keeps_its_shape(tmp_path, suffix, offset):
    """Shape: the points against the first one; 0.2 mm where the format has 32 bits and the place is below 1 km."""
    translations = BODY.translations.copy()
    translations[:, 0] += (offset, 0.0, offset)
    motion = dataclasses.replace(BODY, translations=translations)
    write_motion(motion, tmp_path / f"x{suffix}")
    again = read_motion(tmp_path / f"x{suffix}")
    points = compute_trajectories(again) if isinstance(again, Motion) else again
    index = [points.names.index(name) for name in PATH.names]
    found = points.positions[:, index]
    np.testing.assert_allclose(found - found[:1, :1], PATH.positions - PATH.positions[:1, :1], atol=1e-6)


def test_a_table_of_millions_of_markers_is_refused_from_its_header(tmp_path):
    path = tmp_path / "wide.trc"
    text = write_trc(File()).decode().replace("\t\t\t".join(PATH.names), "A\t\t\t" * 300_000)
    path.write_text(text)
    with pytest.raises(MotionFileError, match=f"at most {MOST_POINTS:,}") as caught:
        read_motion(path)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("place", [3, 600, 2000, 5000])
def test_bytes_that_a_c3d_file_has_too_many_or_too_few_are_said(tmp_path, place):
    data = write_c3d(File())
    for changed in (data[:place] + b"\x07" * 5 + data[place:], data[:place] + data[place + 3 :]):
        path = tmp_path / "x.c3d"
        path.write_bytes(changed)
        try:
            motion = read_motion(path)
        except MotionFileError:
            continue
        assert {note.code for note in motion.provenance.notes} & {
            "guard.bytes_over", "guard.bytes_lacking", "guard.frame_count", "c3d.analog_count"
        }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "old", "new", "code"),
    [
        ("trc", f"\t{len(PATH.names)}\tm\t", "\t7\tm\t", "guard.point_count"),
        ("tsv", "FREQUENCY", "NO_OF_MARKERS\t7\nFREQUENCY", "guard.point_count"),
        ("mvnx", 'segmentCount="4"', 'segmentCount="3"', "guard.point_count"),
        ("mvnx", "<connector1>Pelvis", "<connector1>Pelvic", "mvnx.unknown_segment"),
        ("csv", "\n5,0.04", "\n,5,0.04", "guard.row_width"),
        ("tsv", "\n5\t0.04", "\n5\t\t0.04", "guard.row_width"),
        ("trc", "\n5\t0.04", "\n5\t\t0.04", "guard.row_width"),
        ("csv", f",{PATH.names[3]},", ",", "motive.columns"),
        ("csv", f",{PATH.names[3]},", ",Hid,", "motive.columns"),
        ("csv", ",Name,", ",Name,,", "motive.header"),
        ("table", f"{PATH.names[3]}_y,{PATH.names[3]}_z", f"{PATH.names[3]}_z,{PATH.names[3]}_y", "tables.odd_columns"),
        ("mvnx", 'type="normal"', 'type="norlal"', "mvnx.frame_type"),
        ("mvnx", 'segmentCount="4"', 'segmentCount="4" jointCount="9"', "guard.point_count"),
    ],
)
def test_declared_and_found_counts_that_differ_are_said(tmp_path, name, old, new, code):
    text = WRITERS[name](File()).decode()
    assert old in text
    path = tmp_path / f"x.{'csv' if name == 'table' else name}"
    path.write_text(text.replace(old, new, 1))
    assert code in [note.code for note in read_motion(path).provenance.notes]


MELTED = re.compile(rb"(\.\d)\d*[,\t ]+-?\d+\.(\d)")


@pytest.mark.parametrize("name", [name for name in WRITERS if name not in ("c3d", "npz", "own.npz", "glb")])
def test_two_numbers_melted_into_one_are_refused_or_left_empty(tmp_path, name):
    path = tmp_path / f"x.{'csv' if name == 'table' else name}"
    data = WRITERS[name](File(), *([tmp_path] if name in BESIDE else []))
    places = [found.start() for found in MELTED.finditer(data)]
    for place in (places[-len(places) // 3], places[-1]):
        path.write_bytes(data[:place] + MELTED.sub(rb"\1\2", data[place:], count=1))
        try:
            motion = read_motion(path)
        except MotionFileError as error:
            assert len(str(error)) < 300
        else:
            codes = {note.code for note in motion.provenance.notes}
            if name == "bvh":  # its last row breaks off
                assert codes == {"guard.frame_count"}
                continue
            assert codes - {"motive.header"} == {"guard.row_width"}
            assert np.isnan(motion.positions).all(axis=(1, 2)).sum() == 1


@pytest.mark.parametrize("above", ["two_parents", "circle"])
def test_a_tree_of_mvnx_that_is_none_is_refused(tmp_path, above):
    text = write_mvnx(File()).decode()
    first = re.search(r"<joint label.*?</joint>", text, re.DOTALL)[0]
    one, other = re.findall(r"<connector\d>([^/<]+)", first)
    added = first.replace(one, "@").replace(other, one).replace("@", other)
    if above == "two_parents":
        third = next(label for label in re.findall(r'<segment label="(\w+)"', text) if label not in (one, other))
        added = first.replace(one, third)
    path = tmp_path / "x.mvnx"
    path.write_text(text.replace(first, first + added))
    with pytest.raises(MotionFileError) as caught:
        read_motion(path)
    assert caught.value.code == f"mvnx.{above}"


@pytest.mark.parametrize("key", ["rate", "points", "scale"])
def test_a_header_of_c3d_that_its_parameters_contradict_is_said(tmp_path, key):
    place, word = {"rate": (20, np.float32(31)), "points": (2, np.uint16(3)), "scale": (12, np.float32(0.5))}[key]
    data = write_c3d(File())
    path = tmp_path / "x.c3d"
    path.write_bytes(data[:place] + word.tobytes() + data[place + word.nbytes :])
    motion = read_motion(path)
    assert [note.code for note in motion.provenance.notes] == ["c3d.header"]
    np.testing.assert_allclose(motion.positions, PATH.positions, atol=1e-5)


def test_bytes_behind_an_archive_and_a_damaged_list_of_arrays_are_said(tmp_path):
    data, path = write_npz(File()), tmp_path / "x.npz"
    path.write_bytes(data + b"more")
    assert "guard.bytes_over" in [note.code for note in read_motion(path).provenance.notes]
    end = data.rindex(b"PK\x05\x06")
    path.write_bytes(data[: end + 12] + b"\xff\xff\xff\x7f" + data[end + 16 :])
    with pytest.raises(MotionFileError, match="damaged"):
        read_motion(path)


def test_keys_of_glb_that_are_far_apart_are_questioned_and_must_be_finite(tmp_path):
    path = tmp_path / "x.glb"
    path.write_bytes(write_glb(lose(np.nan)(File())[0], tmp_path))
    assert made.code_of(path) == "gltf.finite"
    write_motion(dataclasses.replace(BODY, frame_rate=1 / 24), path)
    motion = read_motion(path)
    assert motion.n_frames == FRAMES
    assert motion.frame_rate == 24.0
    assert "guard.rate_is_time" in [note.code for note in motion.provenance.notes]
