"""A real browser for tests of pages; they skip with a message where there is none."""

from __future__ import annotations

import pytest

from app.browser import Page, open_browser


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """A headless Chromium, started once; every test opens its own page in it."""
    with open_browser(tmp_path_factory.mktemp("chromium")) as page:
        yield page
