"""A studio that is killed with work under way: what it had stays, and what worked for it goes."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from dousa.app.studio.core.workspace import Workspace, open_private
from dousa.app.studio.work import worker
from dousa.files.disk import lock_file
from fuzzing import count_tries
from patience import PATIENCE

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.fuzz
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for processes in /proc")
def test_killed_at_some_moments_nothing_is_lost_and_nothing_stays_behind():
    """A share of what `lab/reliability/studio_kill.py` does a hundred times."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT / "src"), str(ROOT)))}
    words = [str(count_tries(12)), "--port", "0", "--seed", "4"]
    command = [sys.executable, "-m", "lab.reliability.studio_kill", *words]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=3 * PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0  faults" in done.stdout


def test_work_waits_until_the_process_before_it_has_left_the_folder_of_the_job(tmp_path):
    path = tmp_path / "work.lock"
    taken = []
    with open_private(path) as before:
        lock_file(before)
        waiting = threading.Thread(target=lambda: taken.append(worker._wait_for_predecessor(path)))
        waiting.start()
        waiting.join(timeout=0.3)
        assert waiting.is_alive() and not taken
    waiting.join(timeout=PATIENCE)
    assert taken
    taken[0].close()


def test_a_start_takes_away_the_half_files_of_a_studio_that_was_killed(tmp_path):
    workspace = Workspace(tmp_path / "home")
    folder = workspace.job_folder("0" * 16)
    folder.mkdir(parents=True)
    halves = [folder / ".motion.bvh.0a1b2c3d4e5f.part", workspace.root / "files" / ".x.bvh.0a1b2c3d4e5f.part"]
    for half in halves:
        half.write_bytes(b"half")
    (folder / "motion.part").write_bytes(b"a whole file with that name")
    workspace.hold()
    assert not any(half.exists() for half in halves)
    assert (folder / "motion.part").exists()
    workspace.release()
