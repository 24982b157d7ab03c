"""What the command line says of clusters that cannot be used; ``tests/workers`` uses one."""

import os

import pytest

from dousa.errors import ClusterError
from dousa.workers import cluster as cluster_module
from dousa.workers import current

pytest.importorskip("distributed", reason="Dask distributed is not installed: pip install 'dousa[cluster]'")


class Workers:
    """Workers that do not see the files."""

    def check_paths(self, paths):
        raise ClusterError("cluster.hidden", worker="tcp://w:1", path=paths[0])


@pytest.fixture
def files(tmp_path):
    from dousa.formats import write_motion
    from dousa.motion.synthetic import draw_performer, make_motion

    (tmp_path / "in" / "walk").mkdir(parents=True)
    write_motion(make_motion("walk", draw_performer(1), seed=1), tmp_path / "in" / "walk" / "a.bvh")
    return tmp_path / "in"


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "127.0.0.1:9"])
def test_no_scheduler_is_one_error_and_no_library(dousa, tmp_path, files, monkeypatch, address):
    monkeypatch.setitem(cluster_module.connect.__wrapped__.__kwdefaults__, "timeout", 0.5)
    code, out, err = dousa("--cluster", address, "add", tmp_path / "m.dousa", files)
    assert (code, out) == (2, "")
    assert "Dask scheduler" in err and "Traceback" not in err
    assert err.startswith("dousa: ") and err.count("\n") <= 3
    assert os.listdir(tmp_path) == ["in"]


def test_files_that_workers_do_not_see_are_one_error_and_no_library(dousa, tmp_path, files, monkeypatch):
    from contextlib import contextmanager

    @contextmanager
    def connect(address):
        yield Workers()

    monkeypatch.setattr(cluster_module, "connect", connect)
    code, _, err = dousa("--cluster", "tcp://127.0.0.1:9", "add", tmp_path / "m.dousa", files)
    assert code == 2
    assert "does not see" in err and "a.bvh" in err
    assert os.listdir(tmp_path) == ["in"]
    assert current.current_cluster() is None
