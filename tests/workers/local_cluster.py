"""A scheduler and two worker processes on this machine, for tests."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from patience import PATIENCE

_PROGRAM = """
import json, sys
from distributed import LocalCluster

if __name__ == "__main__":
    options = {"threads_per_worker": 1, "processes": True, "dashboard_address": None, "host": "127.0.0.1"}
    with LocalCluster(n_workers=int(sys.argv[1]), **options) as cluster:
        print(json.dumps([cluster.scheduler_address, [worker.pid for worker in cluster.workers.values()]]), flush=True)
        sys.stdin.readline()
"""


@contextmanager
def run_cluster(n_workers: int = 2) -> Iterator[tuple[str, list[int]]]:
    """The address of a scheduler, and the process numbers of its workers; one that dies is started again by Dask."""
    program = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", _PROGRAM, str(n_workers)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert program.stdin is not None and program.stdout is not None
    with program.stdin, program.stdout:
        try:
            address, pids = json.loads(program.stdout.readline())
            yield address, pids
            program.stdin.write("\n")
            program.stdin.flush()
            program.wait(timeout=PATIENCE)
        finally:
            program.kill()
            program.wait()
