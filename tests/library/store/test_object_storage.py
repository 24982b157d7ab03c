"""Fragments in object storage: a server of S3 on this computer, if moto is installed."""

import pytest
import sqlalchemy as sa

from dousa.errors import LibraryError
from dousa.library import Library
from dousa.library.store import fragments as store
from dousa.library.store.fragments import ObjectFragments, Place

pytest.importorskip("s3fs", reason="s3fs is not installed")
moto = pytest.importorskip("moto.server", reason="moto is not installed")


@pytest.fixture(scope="module")
def bucket():
    """URL of an empty bucket of a server that stops afterwards."""
    import boto3

    server = moto.ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "testing")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        boto3.client("s3").create_bucket(Bucket="moves")
        yield "s3://moves"
    server.stop()


def test_blocks_come_back_as_they_were(bucket, monkeypatch):
    own = ObjectFragments(f"{bucket}/plain", "library")
    blocks = [bytes([n]) * (n + 1) for n in range(50)]
    places = own.append(blocks[:30]) + own.append(blocks[30:])
    assert len(own.sizes()) == 2 and sum(own.sizes().values()) == sum(map(len, blocks))
    order = list(reversed(range(50)))
    for gap in (0, 2**16):
        monkeypatch.setitem(store._join.__kwdefaults__, "gap", gap)
        assert own.read([places[n] for n in order]) == [blocks[n] for n in order]
    gone = places[0].fragment
    own.delete(gone)
    assert gone not in own.sizes()
    assert own.read([places[0], places[40], Place("../x", 0, 3)]) == [b"", blocks[40], b""]


def test_a_bucket_that_is_not_there(bucket):
    with pytest.raises(LibraryError) as caught:
        ObjectFragments("s3://nobodys-bucket/x", "moves.dousa").append([b"x"])
    assert caught.value.code == "library_fragments.unusable"
    with pytest.raises(LibraryError, match="xyz"):
        ObjectFragments("xyz://somewhere", "moves.dousa")


@pytest.mark.slow
def test_a_library_on_a_server_keeps_its_arrays_there(url, bucket, moves, write_move, tmp_path):
    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        library.train(n_trees=5, n_jobs=1)
        answers = library.search(1, 20), library.trajectories(2).positions.tobytes()
        with pytest.raises(LibraryError, match="--fragments"):
            library.compact(fragments="")
        report = library.compact(fragments=f"{bucket}/library")
        assert report.moved > 0 and report.n_fragments >= 1
        assert (library.search(1, 20), library.trajectories(2).positions.tobytes()) == answers
    with Library.open(url) as library:
        library.add(write_move(tmp_path / "in" / "wave" / "new.bvh", "wave", 99).parent.parent, n_jobs=1)
        library.train(n_trees=5, n_jobs=1)
        library.remove(category="squat")
        before = library.search(1, 20)
        library.compact()
        assert library.search(1, 20) == before
        assert library.check().damage == ()
        with library.database.reading() as connection:
            query = "SELECT count(*) FROM clip_features WHERE fragment IS NULL OR length(pose_features) > 0"
            assert connection.execute(sa.text(query)).scalar_one() == 0
        with pytest.raises(LibraryError) as caught:
            library.compact(fragments=f"{bucket}/elsewhere")
        assert caught.value.code == "library_fragments.other_place"
