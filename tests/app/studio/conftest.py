"""Studios for tests: one asked directly, one that listens for a real browser; each on a library of its own."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the studio is not installed: pip install 'dousa[studio]'")

from app.browser import Page
from app.studio.axe_core import AXE, find_faults
from app.studio.evaluation_cases import keep, write_dances
from app.studio.firefox import Firefox, open_firefox
from app.studio.forked_workers import use_forks
from app.studio.one_address import Address, run_app
from app.studio.studio_client import Client
from dousa.app.studio import Settings, create_app
from dousa.app.studio.jobs import lanes
from dousa.evaluation.grade import assessment
from made_once import make_once
from patience import PATIENCE

TOKEN = "the-token-of-the-tests"
CATEGORIES = ("kick_left", "squat", "wave_right", "walk")


@pytest.fixture(scope="session")
def trained_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trained library of 24 synthetic clips in four categories; never changed, copied for every test."""
    from dousa.app.demo import write_library
    from dousa.library import Library

    def make(folder: Path) -> None:
        write_library(folder / "motions", n_performers=6, categories=CATEGORIES)
        with Library.open(folder / "moves.dousa", create=True) as library:
            library.add([folder / "motions"], performer_from=r"name:^(performer\d+)_")
            library.train(n_trees=30)

    return make_once(tmp_path_factory, "studio-library", make) / "moves.dousa"


@pytest.fixture
def library_copy(trained_library: Path, tmp_path: Path) -> Iterator[Path]:
    """That library, to be changed at will; the files beside the first one are for all tests, and stay what they are."""
    files = sorted(trained_library.parent.rglob("*"))
    yield Path(shutil.copy(trained_library, tmp_path / "moves.dousa"))
    assert sorted(trained_library.parent.rglob("*")) == files, "a test has changed the files that all tests share"


@pytest.fixture(scope="session")
def forks() -> Iterator[Any]:
    """What starts the workers of studios, see ``forked_workers.py``; coverage is measured in plain ones alone."""
    if not sys.platform.startswith("linux") or os.environ.get("COVERAGE"):
        yield None
        return
    with use_forks() as found:
        yield found


@pytest.fixture(scope="module", autouse=True)
def forked_workers(forks: Any) -> Iterator[None]:
    """Workers begin as forks."""
    with pytest.MonkeyPatch.context() as patch:
        if forks is not None:
            patch.setattr(lanes, "subprocess", forks)
        yield


@pytest.fixture(scope="module", autouse=True)
def kept_comparisons() -> Iterator[None]:
    """Dances are compared once, not for each page that judges them: what comparing says is tried without a studio."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("prepare_references", "compare_bodies", "weigh"):
            patch.setattr(assessment, name, keep(getattr(assessment, name)))
        yield


def _start_plainly(request: pytest.FixtureRequest) -> Iterator[None]:
    """Workers of what has the mark ``plain_workers`` begin from nothing; each kind of work has such a test."""
    with pytest.MonkeyPatch.context() as patch:
        if request.node.get_closest_marker("plain_workers"):
            patch.setattr(lanes, "subprocess", subprocess)
        yield


plain_workers_of_module = pytest.fixture(_start_plainly, scope="module", autouse=True)
plain_workers_of_test = pytest.fixture(_start_plainly, autouse=True)


@pytest.fixture
def bvh(trained_library: Path) -> Path:
    """A BVH file of the library: somebody kicks."""
    return next((trained_library.parent / "motions" / "kick_left").glob("*.bvh"))


def ask_directly(library: Path) -> Iterator[Any]:
    """A client that asks a studio without a network; its headers hold the token. ``.app.state.studio`` is inside."""
    from starlette.testclient import TestClient

    app = create_app(Settings(library, token=TOKEN))
    with TestClient(app, "http://127.0.0.1:8765") as client:
        client.headers["authorization"] = f"Bearer {TOKEN}"
        yield client


@pytest.fixture
def studio(library_copy: Path) -> Iterator[Any]:
    """Such a client, of the trained library."""
    yield from ask_directly(library_copy)


def send(studio: Any, name: str, content: bytes, batch: str | None = None) -> dict[str, Any]:
    """The answer to an upload."""
    answer = studio.post("/api/uploads", params={"name": name} | ({"batch": batch} if batch else {}), content=content)
    assert answer.status_code == 201, answer.text
    return answer.json()


def list_below(folder: Path) -> set[str]:
    """All names below a folder; one that goes meanwhile is passed over."""
    walked = os.walk(folder)
    return {str(Path(root, name).relative_to(folder)) for root, *names in walked for name in chain(*names)}


def wait_for(client: Any, job_id: str, seconds: float = PATIENCE) -> dict[str, Any]:
    """A job of a client when it is over."""
    end = time.monotonic() + seconds
    pause = 0.02  # s; who waits long asks less often, as the answer costs what the job could use
    while time.monotonic() < end:
        job: dict[str, Any] = client.get(f"/api/jobs/{job_id}").json()
        if job["state"] not in ("queued", "running", "stopping"):
            return job
        time.sleep(pause)
        pause = min(1.1 * pause, 0.25)
    raise AssertionError(f"job {job_id} is not over after {seconds} s")


@pytest.fixture(scope="session")
def wait_job() -> Callable[..., dict[str, Any]]:
    """``wait_job(client, job_id)``: the job when it is over."""
    return wait_for


@dataclass(frozen=True, slots=True)
class Running:
    """A studio that listens.

    Parameters
    ----------
    url : where, without a slash at its end.
    token : its secret.
    app : the application, for a look inside.
    """

    url: str
    token: str
    app: Any


@contextmanager
def listening(settings: Settings) -> Iterator[Running]:
    """A studio in a thread, on a free port."""
    import socket
    from dataclasses import replace

    with socket.socket(proto=socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        settings = replace(settings, port=listener.getsockname()[1])
        app = create_app(settings)
        with run_app(app, listener):
            yield Running(f"http://127.0.0.1:{settings.port}", settings.token, app)


@pytest.fixture(scope="session")
def one_address() -> Iterator[Address]:
    """Where the studios of all tests are found by the browser."""
    found = Address()
    with found.open():
        yield found


@pytest.fixture(scope="session")
def firefox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Firefox]:
    """A headless Firefox, started once."""
    with open_firefox(tmp_path_factory.mktemp("firefox") / "profile") as found:
        yield found


@pytest.fixture
def running(library_copy: Path, one_address: Address) -> Iterator[Running]:
    """A studio for the browser."""
    app = create_app(Settings(library_copy, token=TOKEN, port=one_address.port))
    with one_address.serve(app):
        yield Running(one_address.url, TOKEN, app)


@pytest.fixture
def client(running: Running) -> Client:
    """A program that asks the studio which the browser shows."""
    return Client(running)


@pytest.fixture(scope="session")
def dances(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """Takes of a reference, and a pupil's; never changed by a test."""
    return write_dances(tmp_path_factory.mktemp("dances"))


@pytest.fixture
def show(browser: Page, running: Running, one_address: Address) -> Iterator[Callable[..., Page]]:
    """``show("/library?x=1", width=1280, height=720, scheme="light", language="en")``: a page of that studio.

    At the end of the test its console must be empty, but for what the test has taken out with ``page.messages()``.
    """

    def open_page(path: str, width: int = 1280, height: int = 720, scheme: str = "light", language: str = "en") -> Page:
        browser.resize(width, height)
        features = [
            {"name": "prefers-color-scheme", "value": scheme},
            {"name": "prefers-reduced-motion", "value": "no-preference"},
        ]
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        browser.driver.get_log("browser")
        joint = "&" if "?" in path else "?"
        browser.driver.get(f"{running.url}{path}{joint}token={running.token}&lang={language}")
        browser.wait("return document.readyState === 'complete'")
        return browser

    yield open_page
    messages = browser.messages()
    # A page that is left open would ask a studio that is gone, and complain in the next test.
    one_address.leave(browser)
    assert messages == []


@pytest.fixture
def faults() -> Callable[[Page], list[str]]:
    """``faults(page)``: what axe-core finds wrong with what a page shows; nothing where there is no axe-core."""
    return find_faults if AXE.is_file() else lambda page: []


@pytest.fixture
def downloads(browser, tmp_path):
    """``downloads(suffix)``: the file that the browser has fetched."""
    folder = tmp_path / "downloads"
    folder.mkdir()
    browser.driver.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder), "eventsEnabled": False}
    )

    def wait(suffix, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = [path for path in folder.glob(f"*{suffix}") if path.stat().st_size]
            if found:
                return found[0]
            time.sleep(0.05)
        raise AssertionError(f"no {suffix} came: {list(folder.iterdir())}")

    return wait
