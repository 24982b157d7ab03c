"""Two worker processes read, describe and grow trees: the library is that of one computer, whoever is killed."""

import os
import signal
import subprocess
import sys

import pytest
import sqlalchemy as sa

from dousa.errors import ClusterError
from dousa.library import Library
from dousa.library.store import schema
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.workers import cluster as cluster_module
from dousa.workers import use_cluster
from dousa.workers.remote import check_versions, cut, find_hidden, list_versions
from workers.local_cluster import run_cluster

pytest.importorskip("distributed", reason="Dask distributed is not installed: pip install 'dousa[cluster]'")
needs_kill = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill programs outright")
# Of Dask, about sockets that it leaves to Python to close.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")

_MOMENTS = {"applied_at", "added_at", "trained_at", "fingerprint", "revision", "learned", "clips_revision"}
_ADD = """
import sys
from dousa.library import Library
from dousa.workers import use_cluster

with use_cluster(sys.argv[3]), Library.open(sys.argv[1], create=True) as library:
    progress = lambda done, total, path: print(done, flush=True)
    library.add(sys.argv[2], performer_from=r"name:(p\\d+)", progress=progress)
"""


def dump(library: Library) -> dict[str, list[tuple]]:
    """Every row of the library, without the times and the numbers of writes, and the checksums that cover these."""
    rows = {}
    with library.database.reading() as connection:
        for table in schema.metadata.sorted_tables:
            if table.name == "journal":  # which says when something was done
                continue
            columns = [column for column in table.c if column.name not in _MOMENTS and "checksum" not in column.name]
            query = sa.select(*columns).order_by(*table.primary_key.columns)
            rows[table.name] = [tuple(row) for row in connection.execute(query)]
    return rows


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """60 files of three categories, ten of them for later."""
    from dousa.formats import write_motion

    root = tmp_path_factory.mktemp("files")
    for category in ("walk", "bow", "squat"):
        for number in range(20):
            folder = root / ("more" if number > 16 else "first") / category
            folder.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(category, draw_performer(number), seed=number), folder / f"p{number}.bvh")
    (root / "first" / "walk" / "broken.bvh").write_text("HIERARCHY\nnothing\n")
    return root


def make(path, files, address, kill=None) -> tuple[dict[str, list[tuple]], list]:
    """A library made with a cluster, or without; a worker is killed while files of a trained library are read."""
    done: list[int] = []

    def progress(number, total, path):
        done.append(number)
        if kill is not None and number == 3:
            os.kill(kill, signal.SIGKILL)

    with use_cluster(address), Library.open(path, create=True) as library:
        first = library.add(files / "first", performer_from=r"name:(p\d+)", progress=progress)
        assert len(first.skipped) == 1
        library.train(n_trees=10)
        library.add(files / "more", performer_from=r"name:(p\d+)")
        answers = [library.search(number, 5).to_json() for number in (1, 40, 60)]
        assert library.check().is_sound
        return dump(library), answers


@pytest.fixture(scope="module")
def alone(files, tmp_path_factory):
    return make(tmp_path_factory.mktemp("alone") / "m.dousa", files, None)


@pytest.fixture(scope="module")
def workers():
    """The address of a cluster whose workers live on."""
    with run_cluster() as (address, _):
        yield address


@pytest.fixture
def small_portions(monkeypatch):
    """Several portions, some of them shared."""
    monkeypatch.setitem(cluster_module.Cluster.map.__kwdefaults__, "most_bytes", 100_000)
    monkeypatch.setitem(cluster_module._send.__kwdefaults__, "inline", 10_000)


@pytest.mark.slow
@pytest.mark.usefixtures("small_portions")
def test_the_same_library_as_without_a_cluster(files, tmp_path, alone, workers):
    made = make(tmp_path / "m.dousa", files, workers)
    assert made[1] == alone[1]
    assert made[0] == alone[0]


@pytest.mark.slow
@needs_kill
@pytest.mark.usefixtures("small_portions")
def test_the_same_library_where_a_worker_is_killed(files, tmp_path, alone):
    with run_cluster() as (address, pids):
        made = make(tmp_path / "m.dousa", files, address, pids[0])
    assert made[1] == alone[1]
    assert made[0] == alone[0]


@pytest.mark.slow
@needs_kill
def test_a_client_that_was_killed_goes_on(files, tmp_path, alone, workers):
    path = tmp_path / "m.dousa"
    words = [sys.executable, "-W", "ignore", "-c", _ADD, path, files / "first", workers]
    program = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    with program.stdout as output:
        for line in output:
            if int(line) >= 20:
                break
        program.kill()
    assert program.wait() == -signal.SIGKILL
    assert make(path, files, workers) == alone


@pytest.mark.slow
def test_experiments_give_the_same_numbers(files, monkeypatch, workers):
    from dousa.app.pipelines.experiment_clips import read_labelled_clips
    from dousa.experiments.recognition import run_experiment
    from dousa.formats.motion_files import ReadOptions

    found = []
    for where in (None, workers):
        with use_cluster(where):
            rules = {"category_from": "folder", "performer_from": None, "options": ReadOptions()}
            clips, skipped = read_labelled_clips([files / "first"], **rules)
            assert len(skipped) == 1
            result = run_experiment(clips, n_trees=5, systems=["forest"]).to_json()
            found.append({name: one["confusions"] for name, one in result["systems"].items()})
    with use_cluster(workers) as cluster:
        assert list(cluster.map(abs, range(-200, 0), most=7)) == list(range(200, 0, -1))
        assert list(cluster.map(abs, [])) == []
        with pytest.raises(ZeroDivisionError):
            list(cluster.map(lambda number: 1 // number, [1, 0]))
        monkeypatch.setattr(os.path, "getsize", lambda path: 1)  # what the workers see has another size
        with pytest.raises(ClusterError, match="does not see"):
            cluster.check_paths([files / "first" / "walk" / "broken.bvh"])
    assert found[0] == found[1]


def test_other_versions_are_told():
    ours = list_versions()
    check_versions("tcp://w:1", ours, ours)
    with pytest.raises(ClusterError, match=r"tcp://w:1: this worker has dousa 0\.0, this computer"):
        check_versions("tcp://w:1", {**ours, "dousa": "0.0"}, ours)


def test_files_that_a_worker_does_not_see(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    assert find_hidden({str(path): 3}) is None
    assert find_hidden({str(path): 4}) == str(path)
    assert find_hidden({str(tmp_path / "b"): 3}) == str(tmp_path / "b")


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [([], []), ([1] * 5, [(0, 2), (2, 4), (4, 5)]), ([9, 50, 1, 1], [(0, 1), (1, 2), (2, 4)]), ([50], [(0, 1)])],
)
def test_portions_have_a_number_and_a_size(sizes, expected):
    assert [(part.start, part.stop) for part in cut(sizes, 2, 10)] == expected
