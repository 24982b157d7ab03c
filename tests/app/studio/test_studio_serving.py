"""``dousa studio`` and ``dousa demo --studio`` as programs: start, answer, end."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import contextmanager

import pytest

from dousa.app.cli.studio import prepare_studio


@contextmanager
def started(*words):
    """A program that serves; what it says first, address and token."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dousa.app.cli.main", *map(str, words)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        for line in process.stderr:
            if found := re.search(r"(http://127\.0\.0\.1:\d+)/\?token=(\S+)", line):
                yield process, found[1], found[2]
                return
        raise AssertionError("it did not start")
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ask(url, token, path, value=None):
    data = None if value is None else json.dumps(value).encode()
    headers = {"authorization": f"Bearer {token}", "content-type": "application/json"}
    with urllib.request.urlopen(urllib.request.Request(url + path, data, headers), timeout=60) as answer:
        return json.load(answer)


def test_start_answer_and_end(library_copy):
    with started("studio", library_copy, "--no-browser", "--port", 0) as (process, url, token):
        assert ask(url, token, "/api/info")["library"]["n_clips"] == 24
        job = ask(url, token, "/api/jobs/train", {"n_trees": 2000})
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)[1]
        assert process.returncode == 0
        assert "has stopped" in said
        assert "Traceback" not in said
    with started("studio", library_copy, "--no-browser", "--port", 0) as (_, url, token):
        assert ask(url, token, f"/api/jobs/{job['id']}")["state"] == "stopped"


def test_a_port_that_is_taken_is_passed_over(library_copy):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with started("studio", library_copy, "--no-browser", "--port", port) as (_, url, token):
            assert int(url.rpartition(":")[2]) > port
            assert ask(url, token, "/api/info")


@pytest.mark.parametrize(
    ("make", "words", "says"),
    [
        (lambda folder: (folder / "x").write_text("hello"), ["x"], "not a dousa library"),
        (lambda folder: None, ["none/x.dousa"], "folder"),
        (lambda folder: (folder / "x.studio").write_text(""), ["x.dousa"], "--home"),
    ],
)
def test_what_cannot_be_opened_is_one_sentence(dousa, tmp_path, monkeypatch, make, words, says):
    make(tmp_path)
    monkeypatch.chdir(tmp_path)
    code, _, err = dousa("studio", *words, "--no-browser", "--port", 0)
    assert code == 2
    assert says in err
    assert err.count("\n") == 1


def test_without_the_extra_the_pip_command_is_told(dousa, library_copy, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    code, _, err = dousa("studio", library_copy, "--no-browser")
    assert code == 2
    assert "pip install 'dousa[studio]'" in err


def test_the_demo_library_gets_the_takes(library_copy, bvh, dousa, tmp_path):
    from dousa.library import Library

    (tmp_path / "demo.dousa").write_bytes(library_copy.read_bytes())
    (tmp_path / "take.bvh").write_bytes(bvh.read_bytes() + b"\n")
    for _ in range(2):  # the second time nothing changes
        with Library.open(prepare_studio(tmp_path)) as library:
            assert library.stats().n_takes == 1
    code, _, err = dousa("demo", "--help")
    assert (code, err) == (0, "")
