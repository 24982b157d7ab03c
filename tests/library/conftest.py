"""Small BVH files of a person who does one of a few things, and libraries of them."""

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dousa.library import Library
from library import database_server
from made_once import learn_labellers_once, make_once

WriteMove = Callable[..., Path]

# name, parent, offset in cm
_JOINTS = (
    ("Hips", "", (0, 95, 0)),
    ("Spine", "Hips", (0, 15, 0)),
    ("Neck", "Spine", (0, 35, 0)),
    ("Head", "Neck", (0, 10, 2)),
    *((f"{side}{name}", (side if own else "") + parent, (x * sign, y, z))
      for side, sign in (("Left", 1), ("Right", -1))
      for name, own, parent, (x, y, z) in (
          ("Arm", False, "Spine", (18, 30, 0)), ("ForeArm", True, "Arm", (28, 0, 0)),
          ("Hand", True, "ForeArm", (25, 0, 0)), ("UpLeg", False, "Hips", (9, -3, 0)),
          ("Leg", True, "UpLeg", (0, -43, 0)), ("Foot", True, "Leg", (0, -42, 0)),
          ("ToeBase", True, "Foot", (0, -6, 14)),
      )),
)  # fmt: skip

# joint -> degrees about Z, X, Y at the height of the move
_MOVES = {
    "wave": {"RightArm": (-80, 0, 0), "RightForeArm": (-60, 0, 20)},
    "squat": {"LeftUpLeg": (0, -80, 0), "RightUpLeg": (0, -80, 0), "LeftLeg": (0, 90, 0), "RightLeg": (0, 90, 0)},
    "bow": {"Spine": (0, 70, 0)},
}


def _write_joint(name: str, offset: tuple[float, ...], depth: int, scale: float) -> list[str]:
    children = [joint for joint in _JOINTS if joint[1] == name]
    channels = "6 Xposition Yposition Zposition" if not depth else "3"
    lines = [
        f"{'ROOT' if not depth else 'JOINT'} {name}",
        "{",
        "OFFSET " + " ".join(f"{value * scale:.6f}" for value in offset),
        f"CHANNELS {channels} Zrotation Xrotation Yrotation",
    ]
    for child, _, child_offset in children:
        lines += _write_joint(child, child_offset, depth + 1, scale)
    if not children:
        lines += ["End Site", "{", f"OFFSET 0 {5 * scale:.6f} 0", "}"]
    return [*lines, "}"]


def _order(name: str = "Hips") -> Iterator[str]:
    yield name
    for child, parent, _ in _JOINTS:
        if parent == name:
            yield from _order(child)


def _write_move(path: Path, move: str = "wave", seed: int = 0, n_frames: int = 24) -> Path:
    chance = random.Random(f"{move} {seed}")
    scale, strength = chance.uniform(0.9, 1.1), chance.uniform(0.8, 1.1)
    lines = ["HIERARCHY", *_write_joint("Hips", _JOINTS[0][2], 0, scale)]
    lines += ["MOTION", f"Frames: {n_frames}", "Frame Time: 0.033333"]
    for frame in range(n_frames):
        bend = strength * (1 - abs(2 * frame / max(n_frames - 1, 1) - 1))
        row = [0.0, 95.0 * scale, 0.0]
        for joint in _order():
            row += [angle * bend + chance.gauss(0, 1) for angle in _MOVES[move].get(joint, (0, 0, 0))]
        lines.append(" ".join(f"{value:.4f}" for value in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="session", autouse=True)
def _database_server() -> Iterator[None]:
    """With ``DOUSA_TEST_DATABASE=postgresql`` libraries are databases of a server, as long as the tests last."""
    if not database_server.WANTED:
        yield
        return
    with database_server.use_server():
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What has a server of its own is the same where all have one: the other run of the tests has it."""
    reason = f"the same without DOUSA_TEST_DATABASE={database_server.WANTED}"
    for item in items if database_server.WANTED else ():
        if "server" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def server() -> Iterator[database_server.Server]:
    """A PostgreSQL server with a data folder and a port of its own; skips the test where there is none."""
    if reason := database_server.why_no_server():
        pytest.skip(reason)
    with database_server.run_server() as start:
        yield database_server.Server(start)


@pytest.fixture
def url(server: database_server.Server) -> str:
    """Of an empty database of that server."""
    return server.make()


@pytest.fixture(autouse=True)
def _databases_of_a_test(request: pytest.FixtureRequest) -> Iterator[None]:
    """A test on a server leaves no databases behind."""
    if not database_server.WANTED:
        yield
        return
    if request.node.get_closest_marker("sqlite"):
        pytest.skip("about a file of SQLite")
    folder = request.getfixturevalue("tmp_path")
    yield
    database_server.drop_below(folder)


labellers_learned_once = pytest.fixture(learn_labellers_once, scope="module", autouse=True)


@pytest.fixture(scope="session")
def write_move() -> WriteMove:
    """Writes a BVH file: ``write_move(path, move="wave"|"squat"|"bow", seed=0, n_frames=24)``."""
    return _write_move


@pytest.fixture(scope="session")
def moves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three categories of five files; never changed by a test."""

    def make(folder: Path) -> None:
        for move in _MOVES:
            for seed in range(5):
                _write_move(folder / move / f"{move}_p{seed}.bvh", move, seed)

    return make_once(tmp_path_factory, "moves", make)


@pytest.fixture(scope="session")
def _trained_bytes(moves: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("trained") / "moves.dousa"
    with Library.open(path, create=True) as library:
        library.add(moves, performer_from=r"name:_(p\d)", n_jobs=1)
        library.train(n_trees=20)
    return path.read_bytes()


@pytest.fixture
def library_file(tmp_path: Path, _trained_bytes: bytes) -> Path:
    """A trained library of ``moves``, one for each test."""
    path = tmp_path / "moves.dousa"
    path.write_bytes(_trained_bytes)
    return path


@pytest.fixture
def library(library_file: Path) -> Iterator[Library]:
    """The same, open."""
    with Library.open(library_file) as opened:
        yield opened


@pytest.fixture
def empty_library(tmp_path: Path) -> Iterator[Library]:
    """A new library without clips."""
    with Library.open(tmp_path / "empty.dousa", create=True) as opened:
        yield opened
