"""``dousa studio`` and ``dousa demo --studio`` as programs: start, answer, end."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest

from dousa.app.cli.studio import prepare_studio
from patience import PATIENCE


@contextmanager
def started(*words):
    """A program that serves: its process, its address without a code, and its token."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dousa.app.cli.main", *map(str, words)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        url = ""
        for line in process.stderr:
            if found := re.search(r"(http://127\.0\.0\.1:\d+)/\?code=\S+", line):
                url, opening = found[1], found[0]
            if url and (found := re.search(r"browsers: (\S+)\)", line)):
                process.opening = opening
                yield process, url, found[1]
                return
        raise AssertionError("it did not start")
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ask(url, token, path, value=None):
    data = None if value is None else json.dumps(value).encode()
    headers = {"authorization": f"Bearer {token}", "content-type": "application/json"}
    with urllib.request.urlopen(urllib.request.Request(url + path, data, headers), timeout=PATIENCE) as answer:
        return json.load(answer)


def test_start_answer_and_end(library_copy):
    with started("studio", library_copy, "--no-browser", "--port", 0) as (process, url, token):
        assert ask(url, token, "/api/info")["library"]["n_clips"] == 24
        job = ask(url, token, "/api/jobs/train", {"n_trees": 2000})
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=PATIENCE)[1]
        assert process.returncode == 0
        assert "has stopped" in said
        assert "Traceback" not in said
    with started("studio", library_copy, "--no-browser", "--port", 0) as (_, url, token):
        assert ask(url, token, f"/api/jobs/{job['id']}")["state"] == "stopped"


@pytest.mark.slow
def test_a_second_start_shows_the_studio_that_runs(library_copy):
    with started("studio", library_copy, "--no-browser", "--port", 0) as (first, url, token):
        # One after the other: the last of them is not done before the second start has answered.
        job = [ask(url, token, "/api/jobs/train", {"n_trees": 2000}) for _ in range(20)][-1]
        second = subprocess.run(
            [sys.executable, "-m", "dousa.app.cli.main", "studio", str(library_copy), "--no-browser", "--port", "0"],
            capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip
        assert second.returncode == 0
        assert re.search(rf"runs already: {url}/\?code=\S+$", second.stderr.strip())
        assert token not in second.stderr
        assert ask(url, token, f"/api/jobs/{job['id']}")["state"] in ("queued", "running")  # nobody took it away
        first.kill()  # the lock ends with the process
        first.wait()
    with started("studio", library_copy, "--no-browser", "--port", 0) as (_, url, token):
        assert ask(url, token, f"/api/jobs/{job['id']}")["state"] == "stopped"


def test_a_studio_of_another_library_in_the_folder_is_named(library_copy, dousa, tmp_path):
    home = tmp_path / "home"
    with started("studio", library_copy, "--no-browser", "--port", 0, "--home", home):
        code, _, err = dousa("studio", tmp_path / "other.dousa", "--no-browser", "--port", 0, "--home", home)
    assert code == 2
    assert f"the studio of {library_copy} uses this folder" in err and "--home" in err


def test_a_browser_comes_in_by_a_name_of_its_own_or_by_the_field(library_copy, browser):
    with started("studio", library_copy, "--no-browser", "--port", 0) as (process, url, token):
        browser.driver.get(process.opening)
        browser.wait("return document.querySelector('.cell canvas')")
        host = browser.run("return location.hostname")
        assert re.fullmatch(r"dousa-[0-9a-f]{16}\.localhost", host)
        assert browser.run("return location.search") == ""
        browser.driver.get(f"{url}/library")  # where cookies go to every server of this machine, there is none
        assert browser.run("return document.querySelector('h1').textContent").endswith("(401)")
        browser.find("[name=token]").send_keys(token, "\n")
        browser.wait("return document.querySelector('.cell canvas')")
        assert browser.run("return location.href") == f"{url}/library"
        browser.driver.get("about:blank")
        browser.driver.delete_all_cookies()


def test_a_studio_that_does_not_answer_is_named(dousa, library_copy):
    from dousa.app.studio.core.workspace import Workspace

    home = Workspace(library_copy.with_suffix(".studio"))
    home.hold()  # it has said no address yet
    code, _, err = dousa("studio", library_copy, "--no-browser", "--port", 0)
    home.release()
    assert code == 2
    assert f"process {os.getpid()}" in err and "--home" in err


@pytest.mark.slow
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


def test_the_help_names_the_extras(dousa):
    """Square brackets are markup to what prints the help, and vanish if nobody says otherwise."""
    _, out, _ = dousa("studio", "--help")
    said = " ".join(out.split())
    assert "'dousa[studio]'" in said and "'dousa[share]'" in said


def test_the_demo_library_gets_the_takes(library_copy, bvh, dousa, tmp_path):
    from dousa.library import Library

    (tmp_path / "demo.dousa").write_bytes(library_copy.read_bytes())
    (tmp_path / "take.bvh").write_bytes(bvh.read_bytes() + b"\n")
    for _ in range(2):  # the second time nothing changes
        with Library.open(prepare_studio(tmp_path)) as library:
            assert library.stats().n_takes == 1
    code, _, err = dousa("demo", "--help")
    assert (code, err) == (0, "")


PAGE = Path(__file__).resolve().parents[3] / "docs" / "studio.md"


def lines_of_the_page():
    """Every line of the blocks that has to do with curl, in order; dousa and pip are not for this test."""
    blocks = re.findall(r"^```console\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]
    return [line for line in lines if not re.match(r"(dousa|pip|make) ", line)]


def newest_curl():
    """Whether there is a curl that knows --json (7.82)."""
    if shutil.which("curl") is None or shutil.which("bash") is None:
        return False
    said = subprocess.run(["curl", "--version"], capture_output=True, text=True, check=True).stdout
    return tuple(int(part) for part in re.match(r"curl (\d+)\.(\d+)", said).groups()) >= (7, 82)


@pytest.fixture
def seen(tmp_path, bvh):
    """Silhouettes of three frames."""
    from dousa.app.pipelines.render import render_file
    from dousa.app.requests.estimation import RenderRequest, parse_size

    size = parse_size("80x60")
    render_file(RenderRequest(motion=bvh, output=tmp_path / "seen.npz", n_ring=2, size=size, frames="0:3"))


@pytest.mark.slow
@pytest.mark.skipif(not newest_curl(), reason="no curl that knows --json, or no bash")
def test_every_call_of_the_page_is_answered(running, bvh, seen, tmp_path):
    shutil.copy(bvh, tmp_path / "query.bvh")
    lines = lines_of_the_page()
    assert sum("curl" in line for line in lines) >= 15
    # --fail-with-body would hide nothing, but the page should stay plain: a status of 400 or more fails here.
    script = "\n".join(["set -eu", 'curl() { command curl --fail-with-body "$@" && echo; }', *lines])
    folder = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "URL": running.url, "TOKEN": running.token, "PATH": folder, "no_proxy": "127.0.0.1"}
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert not [answer for answer in answers if answer.get("problem")]
    search = next(answer for answer in answers if "ranking" in answer)
    assert search["category"] == "kick_left"
    assert (tmp_path / "hit.bvh").read_text().startswith("HIERARCHY")
