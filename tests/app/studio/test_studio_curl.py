"""The calls of docs/studio.md, typed into a shell as they stand there."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
    from dousa.app.pipelines.render import parse_size, render_file
    from dousa.app.requests.estimation import RenderRequest

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
    environment = {
        **os.environ,
        "URL": running.url,
        "TOKEN": running.token,
        "PATH": folder,
        "no_proxy": "127.0.0.1",
    }
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert not [answer for answer in answers if answer.get("problem")]
    search = next(answer for answer in answers if "ranking" in answer)
    assert search["category"] == "kick_left"
    assert (tmp_path / "hit.bvh").read_text().startswith("HIERARCHY")
