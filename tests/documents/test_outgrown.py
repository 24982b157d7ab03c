"""The commands for more than one machine of docs/scaling.md, on a server, a bucket and a cluster of our own."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from documents.commands import collect, read_page
from dousa.formats.registry import write_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion
from library.database_server import connect_plainly, run_server, why_no_server
from workers.local_cluster import run_cluster

PAGE = "docs/scaling.md"


@pytest.mark.slow
@pytest.mark.skipif(why_no_server() is not None, reason=why_no_server() or "")
def test_the_commands_work_in_their_order(tmp_path):
    moto = pytest.importorskip("moto.server", reason="moto is not installed")
    pytest.importorskip("distributed", reason="Dask is not installed")
    import boto3

    for kind in ("walk", "squat", "wave_right"):
        for number in range(3):
            path = tmp_path / "recordings" / kind / f"HDM_b{number}_{kind}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(kind, draw_performer(number), seed=number), path)
    write_motion(make_motion("walk", draw_performer(7), seed=7), tmp_path / "query.bvh")
    storage = moto.ThreadedMotoServer(port=0)
    storage.start()
    keys = {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1"}
    address = "http://{}:{}".format(*storage.get_host_and_port())
    with pytest.MonkeyPatch.context() as patch, run_server() as server, run_cluster() as (scheduler, _):
        for name, value in {**keys, "AWS_ENDPOINT_URL": address}.items():
            patch.setenv(name, value)
        boto3.client("s3").create_bucket(Bucket="bucket")
        for name in ("moves", "again"):
            with connect_plainly(f"{server}/postgres", autocommit=True) as connection:
                connection.execute(f"CREATE DATABASE {name}")
        places = {
            "postgresql+psycopg://ann@server": server,
            "/shared/": f"{tmp_path}/shared/",
            "tcp://scheduler:8786": scheduler,
        }
        first = read_page(PAGE)[: read_page(PAGE).index("## When you outgrow")].count("\n")
        done = 0
        for command in collect(PAGE):
            if command.place != "block" or command.line <= first:
                continue
            text = command.text
            for name, own in places.items():
                text = text.replace(name, own)
            words = [sys.executable, "-m", *shlex.split(text)]
            outcome = subprocess.run(
                words, cwd=tmp_path, env=dict(os.environ), capture_output=True, text=True, check=False
            )
            assert outcome.returncode == 0, f"{command.text}: {outcome.stdout}{outcome.stderr}"
            done += 1
    storage.stop()
    assert done >= 11 and list(Path(tmp_path / "shared" / "moves").iterdir())
