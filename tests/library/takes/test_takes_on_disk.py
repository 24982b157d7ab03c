"""Finding in takes that are too many for memory gives the answers of those that are not."""

import random
import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryError
from dousa.files.disk import create_alone
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library.takes import portions, scanning
from dousa.library.takes import windows as keeper
from dousa.messages import Message
from dousa.retrieval.takes.windows import TakeWindows
from library.takes.test_takes import join

OPEN = keeper.WindowKeeper.open.__kwdefaults__

ASKED = ("wave", 4, False), ("squat", 15, True), ("bow", 15, True)
ORDERS = ("bow wave squat bow", "squat squat wave", "wave bow", "bow squat bow wave wave", "wave", "squat bow bow")


def make_take(write_move, folder: Path, number: int) -> Path:
    moves = ORDERS[number % len(ORDERS)].split()
    files = [
        write_move(folder / f"{number} {place}.bvh", move, 50 + 7 * number + place, n_frames=48 + 4 * place)
        for place, move in enumerate(moves)
    ]
    path = folder / f"take {number}.trc"
    write_motion(join(*files), path)
    return path


@pytest.fixture(scope="session")
def made(write_move, tmp_path_factory) -> Path:
    """A trained library with six takes, motions to look for, and a take that is not in it."""
    root = tmp_path_factory.mktemp("many takes")
    for move in ("wave", "squat", "bow"):
        for seed in range(5):
            write_move(root / "clips" / move / f"{move}_p{seed}.bvh", move, seed, n_frames=50 + 5 * seed)
        write_move(root / "asked" / f"{move}.bvh", move, 90, n_frames=60)
    takes = [make_take(write_move, root, number) for number in range(7)]
    with Library.open(root / "moves.dousa", create=True) as library:
        library.add(root / "clips", performer_from=r"name:_(p\d)", n_jobs=1)
        library.train(n_trees=30)
        for path in takes[:6]:
            library.add(path, kind="take", n_jobs=1)
    return root


@pytest.fixture
def library_path(made, tmp_path) -> Path:
    return Path(shutil.copy(made / "moves.dousa", tmp_path))


@pytest.fixture
def many(monkeypatch):
    """Takes are more than memory has room for, from now on; two or so are in a file, and all windows are compared."""

    def begin(most: int = 10**9) -> None:
        monkeypatch.setitem(OPEN, "in_memory", 0)
        monkeypatch.setitem(OPEN, "in_a_file", 40_000)
        monkeypatch.setattr(scanning, "MOST_KEPT", 4 * most)
        monkeypatch.setattr(scanning, "MOST_COMPARED", most)

    return begin


def ask(library: Library, made: Path, takes=None):
    return [library.find(made / "asked" / f"{move}.bvh", takes, k=k, mirror=mirror) for move, k, mirror in ASKED]


def find_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.windows"))


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_answers_are_those_of_takes_in_memory(library_path, made, many, tmp_path, monkeypatch):
    with Library.open(library_path) as library:
        expected = ask(library, made)
        assert not find_files(tmp_path)
    many()
    steps: list[tuple[int, int, str]] = []
    with Library.open(library_path) as library:
        library.find(made / "asked" / "bow.bvh", progress=lambda *step: steps.append((*step[:2], step[2].code)))
        assert ask(library, made) == expected
        asked = made / "asked" / "squat.bvh"
        monkeypatch.setattr(scanning, "MOST_COMPARED", 10)
        few = library.find(asked, k=15, mirror=True)
        assert few.results != expected[1].results
        assert [note.code for note in few.notes] == ["library_takes.sketched"]
        assert library.find(asked, k=15, mirror=True, exact=True) == expected[1]
    monkeypatch.setattr(scanning, "MOST_COMPARED", 10**9)
    files = find_files(tmp_path)
    assert 2 <= len(files) <= 4
    assert steps == [(done, 6, "library_takes.keeping") for done in range(7)]
    unpacked = []
    unpack = TakeWindows.from_bytes
    monkeypatch.setattr(TakeWindows, "from_bytes", lambda data: unpacked.append(data) or unpack(data))
    with Library.open(library_path) as other:  # reads no take of those in files
        assert other.find(made / "asked" / "wave.bvh", k=4) == expected[0]
        assert len(unpacked) == 6 - sum(len(portions.read_portion(path).ids) for path in files)
    assert find_files(tmp_path) == files


def test_some_takes_are_looked_into(library_path, made, many):
    with Library.open(library_path) as library:
        numbers = sorted(clip.id for clip in library.clips() if clip.kind == "take")
        wanted = [numbers[4], numbers[0], numbers[3], 1, made / "take 6.trc"]
        expected = ask(library, made, wanted)
        many()
        assert ask(library, made, wanted) == expected
        assert {place.clip_id for answer in expected for place in answer.results} <= {*wanted[:4], None}


@pytest.mark.parametrize("most", [25, 100])
def test_few_windows_are_compared_and_what_is_found_has_the_same_numbers(library_path, made, many, most):
    with Library.open(library_path) as library:
        exact = ask(library, made)
        every = [library.find(made / "asked" / f"{move}.bvh", k=1000, mirror=mirror) for move, _, mirror in ASKED]
        many(most)
        for expected, whole, found in zip(exact, every, ask(library, made), strict=True):
            assert found.results[0].to_json() == expected.results[0].to_json()
            assert (found.n_takes, found.seconds) == (expected.n_takes, expected.seconds)
            known = {replace(place, rank=0) for place in whole.results}
            own = [replace(place, rank=0) for place in found.results]
            assert len(known.intersection(own)) >= 0.8 * len(own)


def test_of_more_windows_more_are_compared_up_to_a_number(library_path, made, many, monkeypatch):
    """One of so many that are as long as the query asks for; who asks about some takes has theirs counted."""
    many(2)
    with Library.open(library_path) as library:
        query, numbers = made / "asked" / "bow.bvh", sorted(c.id for c in library.clips() if c.kind == "take")
        library.find(query, mirror=True)
        told = {}
        for one_of, most in ((10**9, 9), (4, 10**9), (2, 10**9), (2, 9)):
            monkeypatch.setattr(scanning, "_ONE_OF", one_of)
            monkeypatch.setattr(scanning, "_MOST_OF_MANY", most)
            (note,) = library.find(query, mirror=True).notes
            told[one_of, most] = note.values["n"]
        assert told[10**9, 9] == 2 and told[2, 9] == 9
        assert 9 < told[4, 10**9] == told[2, 10**9] // 2
        monkeypatch.setattr(scanning, "_MOST_OF_MANY", 10**9)
        (note,) = library.find(query, numbers[:4], mirror=True).notes
        assert note.values["n"] < told[2, 10**9]


@pytest.mark.slow
def test_files_follow_the_library(library_path, made, many, write_move, tmp_path, monkeypatch):
    """Whatever is changed, answers are those of a library whose takes are all in memory."""

    def check() -> None:
        with Library.open(library_path) as other, monkeypatch.context() as patch:
            patch.setitem(OPEN, "in_memory", 1 << 40)
            expected = ask(other, made)
        assert ask(library, made) == expected

    many()
    with Library.open(library_path) as library:
        check()
        before = find_files(tmp_path)
        takes = sorted(clip.id for clip in library.clips() if clip.kind == "take")
        library.add(made / "take 6.trc", kind="take", n_jobs=1)
        check()
        library.remove(takes[:1])
        check()
        library.undo()
        check()
        assert set(before) <= set(find_files(tmp_path))
        library.remove(takes[:3])
        check()
        write_move(tmp_path / "more" / "wave" / "new.bvh", "wave", 95, n_frames=60)
        library.add(tmp_path / "more", n_jobs=1)
        check()
        assert not set(before) & set(find_files(tmp_path))
        library.train(n_trees=12)
        check()
        assert library.check().is_sound
        shutil.rmtree(find_files(tmp_path)[0].parent)
        check()


def test_a_damaged_file_is_left_out(library_path, made, many, tmp_path):
    many()
    chance = random.Random(3)
    with Library.open(library_path) as library:
        expected = ask(library, made)
        whole = {path: path.read_bytes() for path in find_files(tmp_path)}
    for turn in range(6):
        path = chance.choice(list(whole))
        data = bytearray(whole[path])
        for _ in range(20):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data[: chance.randrange(len(data))] if turn == 3 else data)
        with Library.open(library_path) as library:
            assert ask(library, made) == expected
        for one, content in whole.items():
            one.write_bytes(content)


def test_a_training_and_an_add_make_the_files(library_path, made, many, write_move, tmp_path):
    """They say how far that is; what they left over is as little as one file would have, and a search makes none."""
    with Library.open(library_path) as library:
        many()
        steps = []
        library.train(n_trees=10, progress=lambda *step: steps.append((step[0], step[2])))
        files = find_files(tmp_path)
        assert len(files) >= 2
        told = [(done, what.values["done"]) for done, what in steps if "keeping" in what.code]
        assert told == [(5, done) for done in range(7)]
        assert steps[-1][0] == 6 and steps[-1][1].code == "library_training.done"
        ask(library, made)
        assert find_files(tmp_path) == files
        more = [write_move(tmp_path / f"more {seed}.bvh", "wave", 80 + seed, n_frames=400) for seed in range(4)]
        told = []
        library.add(more, kind="take", n_jobs=1, progress=lambda done, total, what: told.append((done, what)))
        again = find_files(tmp_path)
        assert set(files) < set(again)
        assert told[-1][0] > 0 and told[-1][1] == str(Message("library_takes.keeping"))
        ask(library, made)
        assert find_files(tmp_path) == again


@pytest.mark.parametrize(
    "part",
    [
        "header",
        pytest.param("sketches", marks=pytest.mark.slow),
        pytest.param("marks", marks=pytest.mark.slow),
        pytest.param("rows", marks=pytest.mark.slow),
        "poses",
        "cut",
    ],
)
def test_a_check_finds_what_a_search_does_not_look_at(library_path, made, many, tmp_path, part):
    """A repair takes the file away, and the next search makes it again."""
    many()
    with Library.open(library_path) as library:
        expected = ask(library, made)
        assert library.check().is_sound
        (path, *_) = find_files(tmp_path)
        portion, whole = portions.read_portion(path), path.read_bytes()
        ends = portion.places
        place = {"header": len(whole) - 30, "sketches": ends[0] + 40, "marks": ends[1] - 1, "rows": ends[-2] + 3}
        data = bytearray(whole)
        data[place.get(part, ends[-1] + 5)] ^= 8
        path.write_bytes(data[:-1] if part == "cut" else data)
        (found,) = library.check().damage
        assert (found.what.code, found.what.values["file"]) == ("library_damage.window_file", path.name)
        assert not found.repaired and found.clip_id is None
        report = library.check(repair=True)
        assert report.is_sound and [one.repaired for one in report.damage] == [True]
        assert not path.exists() and library.check().damage == ()
        assert ask(library, made) == expected
        assert path.read_bytes() == whole


def test_compacting_takes_files_away_that_no_search_uses(library_path, made, many, tmp_path, monkeypatch):
    many()
    with Library.open(library_path) as library:
        expected = ask(library, made)
        files = find_files(tmp_path)
        with suppress(LibraryError):  # a server has nothing else to compact
            assert library.compact().swept == 0
        assert find_files(tmp_path) == files and ask(library, made) == expected
        portion = portions.read_portion(files[0])
        library.remove(portion.ids[: len(portion.ids) // 2 + 1].tolist())
        size = files[0].stat().st_size
        report = library.compact()
        assert report.swept == report.to_json()["swept"] == size
        assert "library_compact.swept" in [message.code for message in report.to_messages()]
        assert find_files(tmp_path) == files[1:]
        monkeypatch.setitem(OPEN, "in_memory", 1 << 40)
        library.train(n_trees=10)
        assert library.compact().swept > 0
        assert not files[0].parent.exists()


def test_who_may_not_write_makes_no_files(library_path, made, many, tmp_path):
    with Library.open(library_path) as library:
        expected = ask(library, made)
    many()
    with Library.open(library_path, read_only=True) as library:
        assert ask(library, made) == expected
        assert not find_files(tmp_path)
    with Library.open(library_path) as library:
        library.find(made / "asked" / "bow.bvh")
    files = find_files(tmp_path)
    with Library.open(library_path, read_only=True) as library:
        assert ask(library, made) == expected
        assert find_files(tmp_path) == files


def test_one_program_makes_a_file_at_a_time(library_path, made, many, tmp_path):
    many()
    with Library.open(library_path) as library:
        expected = ask(library, made)
        (first, *_) = files = find_files(tmp_path)
    first.unlink()
    with create_alone(first) as file:
        assert file is not None
        with Library.open(library_path) as library:
            assert ask(library, made) == expected
        assert find_files(tmp_path) == files[1:]
        file.write(b"nothing of it")
    with Library.open(library_path) as library:
        assert ask(library, made) == expected
    assert portions.read_portion(first) is not None


def test_windows_are_where_the_take_has_them(made, many, library_path, tmp_path):
    many()
    with Library.open(library_path) as library:
        library.find(made / "asked" / "bow.bvh")
        read = {}
        for path in find_files(tmp_path):
            portion = portions.read_portion(path)
            with open(path, "rb") as file:
                for take, number in enumerate(portion.ids.tolist()):
                    read[number] = portion.read_frames(file, take, 0, int(portion.n_frames[take]))[1]
                for place, length in enumerate(portion.lengths.tolist()):
                    windows = np.arange(portion.ends[place, -1])
                    takes, rows, starts = portion.locate(place, windows)
                    codes = portion.read_rows(file, np.full(len(windows), place), windows)
                    for take, row, start, code in zip(takes, rows, starts, codes, strict=True):
                        with library.database.reading() as connection:
                            forest = library._forests.load(connection)
                            own = library._takes._read(connection, forest, int(portion.ids[take]))
                        assert (own.starts[row], own.stops[row]) == (start, start + length)
                        assert np.array_equal(portion.encode(own.leaves[row].astype(np.int64)), code)
                        assert np.array_equal(read[int(portion.ids[take])], own.poses)
    assert len(read) >= 4


@pytest.mark.parametrize("length", [2**40, 2**63])
def test_a_file_that_claims_a_huge_size_is_no_file(tmp_path, length):
    path = tmp_path / "x.windows"
    path.write_bytes(portions._START.pack(portions._MAGIC, 10, length, 0) + b"some more bytes")
    assert portions.read_portion(path) is None


def test_what_a_killed_program_left_is_taken_away_later(library_path, made, many, tmp_path):
    with Library.open(library_path) as library:
        many()
        ask(library, made)
        folder = find_files(tmp_path)[0].parent
        for path in find_files(tmp_path):
            path.unlink()
        half = folder / ".0000000001-00000000.windows.00000000.part"
        half.write_bytes(b"half")
        with create_alone(folder / "0000000002-00000000.windows") as file:
            ask(library, made)
            assert not half.exists() and Path(file.name).exists()
