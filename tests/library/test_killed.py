"""kill -9 at any moment leaves a library that opens and is consistent."""

import random
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from dousa.library import Library
from fuzzing import count_tries
from library.database_server import address

_PROGRAM = """
import sys
from dousa.library import Library
library = Library.open(sys.argv[1], create=True)
print("open", flush=True)
while True:
    library.add(sys.argv[2], n_jobs=1, progress=lambda done, total, path: print(done, flush=True))
    library.add(sys.argv[3], n_jobs=1, kind="take")
    library.train(n_trees=5, n_jobs=1)
    library.remove(category="bow")
    library.relabel(where_category="wave", performer="somebody")
"""


def check(path: Path) -> None:
    """Every clip has its arrays; a trained library has every histogram, all of its own forest."""
    with Library.open(path, create=True) as library:
        clips = library.clips()
        for clip in clips:
            assert library.trajectories(clip.id).n_frames == clip.n_frames
        takes = [clip for clip in clips if clip.kind == "take"]
        clips = [clip for clip in clips if clip.kind == "clip"]
        stats = library.stats()
        assert all((clip.predicted_category is not None) == (stats.trained_at is not None) for clip in clips)
        if stats.trained_at and takes and clips:
            assert library.find(clips[0].id, k=1).n_takes == 1
        if stats.trained_at and clips:
            assert len(library.search(clips[0].id, 100).results) == len(clips)
        if library.database.engine.dialect.name != "sqlite":
            return
        with library.database.engine.connect() as connection:
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar_one() == "ok"
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []


@pytest.mark.fuzz
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill programs outright")
def test_a_killed_program_leaves_a_whole_library(tmp_path, moves, write_move):
    path, take = tmp_path / "m.dousa", write_move(tmp_path / "take.bvh", "bow", 90, n_frames=120)
    chance = random.Random(0)
    for _ in range(count_tries(12)):
        program = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, address(path, create=True), moves, take], stdout=subprocess.PIPE, text=True
        )
        assert program.stdout is not None
        with program.stdout as output:
            # Let it do a number of things, and strike between two of them.
            for _ in range(chance.randrange(1, 40)):
                output.readline()
            with suppress(subprocess.TimeoutExpired):
                program.wait(timeout=chance.uniform(0, 0.02))
            program.kill()
        assert program.wait() == -signal.SIGKILL
        check(path)
    with Library.open(path, create=True) as library:
        library.add(moves)
        assert library.stats().n_clips == 15


@pytest.mark.fuzz
@pytest.mark.slow
@pytest.mark.sqlite  # these are files
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill programs outright")
def test_every_writing_command_can_be_killed_and_done_again():
    program = Path(__file__).resolve().parents[2] / "lab" / "reliability" / "library_kill.py"
    words = [sys.executable, str(program), "--kills", str(count_tries(24)), "--seed", "5"]
    outcome = subprocess.run(words, capture_output=True, text=True, check=False)
    assert outcome.stdout.splitlines()[-1].endswith(": 0 faults"), outcome.stdout + outcome.stderr
    assert outcome.returncode == 0
