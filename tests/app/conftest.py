"""The command line, and a real browser for tests of pages; they skip with a message where there is none."""

import sys

import pytest

from app.browser import Page, open_browser
from dousa.app.cli.main import main
from dousa.messages import use_language
from made_once import learn_labellers_once

labellers_learned_once = pytest.fixture(learn_labellers_once, scope="module", autouse=True)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """A headless Chromium, started once; every test opens its own page in it."""
    with open_browser(tmp_path_factory.mktemp("chromium")) as page:
        yield page


@pytest.fixture(autouse=True)
def no_pose_models(tmp_path, monkeypatch):
    """Films are estimated from silhouettes, whatever models the machine has; a test of models names its own folder."""
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path / "no models"))


@pytest.fixture
def dousa(monkeypatch, capsys):
    """Runs a command in this process: (exit code, standard output, standard error)."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["dousa", *map(str, words)])
        monkeypatch.setattr(sys, "warnoptions", ["error"])  # they fail the test, though no user sees them
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        finally:
            use_language("en")  # whatever the command spoke
        out = capsys.readouterr()
        return code, out.out, out.err

    return run


@pytest.fixture
def succeed(dousa):
    """Runs a command that must succeed: its standard output and standard error."""

    def run(*words):
        code, out, err = dousa(*words)
        assert code == 0, err
        return out, err

    return run
