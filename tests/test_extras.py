"""What is not installed says which extra brings it."""

import copy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dousa.errors import MissingExtraError
from dousa.extras import require

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]

# Run where these packages cannot be imported.
HIDDEN = """
import sys
for name in ("cv2", "matplotlib", "fontTools", "fastapi", "uvicorn", "jinja2", "scipy", "PIL", "librosa", "av",
             "ai_edge_litert", "distributed", "sklearn"):
    sys.modules[name] = None
"""
CASES = [
    ("film", "from dousa.extras import cv2; cv2.imread"),
    ("film", "from dousa.estimation.silhouettes.images import read_image; read_image('x.png')"),
    ("film", "from dousa.estimation import find_keypoints; find_keypoints('x.png', cache=False)"),
    ("pictures", "from dousa.app.pictures.canvas import new_figure; new_figure(2.0, 1.0)"),
    ("pictures", "from dousa.app.pictures.canvas import drawable; drawable('x')"),
    ("music", "from dousa.evaluation import find_beats; find_beats('x.wav')"),
    ("map", "from dousa.library.care.clip_map import map_clips; map_clips(None, None)"),
    ("studio", "from dousa.app.studio import create_app"),
    ("cluster", "from dousa.workers import use_cluster; use_cluster('tcp://127.0.0.1:9').__enter__()"),
]


@pytest.mark.parametrize(("extra", "code"), CASES)
def test_what_is_not_installed_is_named_with_its_extra(extra, code, tmp_path):
    assert extra in PROJECT["optional-dependencies"]
    (tmp_path / "x.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    outcome = subprocess.run(
        [sys.executable, "-c", HIDDEN + code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 1
    assert "MissingExtraError" in outcome.stderr
    assert f"pip install 'dousa[{extra}]'" in outcome.stderr


@pytest.mark.parametrize("extra", ["film", "frames", "pictures", "studio", "share"])
def test_all_that_the_readme_shows_comes_with_all(extra):
    (names,) = PROJECT["optional-dependencies"]["all"]
    assert extra in names.partition("[")[2].rstrip("]").split(",")


def test_a_package_that_is_there_is_given():
    assert require("json", "film").loads("[1]") == [1]


def test_a_missing_package_names_its_extra():
    with pytest.raises(MissingExtraError, match=r"pip install 'dousa\[film\]'") as caught:
        require("no_such_package_of_dousa", "film")
    assert isinstance(caught.value, ImportError)


def test_a_package_that_is_broken_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "broken_package_of_dousa.py").write_text("import no_such_package_of_dousa\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ModuleNotFoundError, match="no_such_package_of_dousa") as caught:
        require("broken_package_of_dousa", "film")
    assert not isinstance(caught.value, MissingExtraError)


THREADS = """
import threading, time
from dousa.extras import cv2
failed = []
def use(seconds):
    time.sleep(seconds)
    try:
        cv2.resize
    except AttributeError as error:
        failed.append(error)
threads = [threading.Thread(target=use, args=(0.004 * k,)) for k in range(40)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert not failed, failed[0]
"""


def test_threads_that_use_it_first_wait_for_each_other():
    pytest.importorskip("cv2")
    subprocess.run([sys.executable, "-c", THREADS], check=True)


def test_it_can_be_copied_and_inspected():
    from dousa.extras import cv2

    assert not hasattr(cv2, "__wrapped__")
    assert copy.deepcopy(cv2) is not None
