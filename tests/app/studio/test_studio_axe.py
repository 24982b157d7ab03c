"""What axe-core finds on the pages of the studio: nothing, in light and dark, in both languages, wide and narrow."""

import pytest

from app.studio.axe_core import AXE

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys

PAGES = ("/library", "/search?motion=clip:1", "/takes", "/evaluate?references=clip:1", "/estimate", "/live", "/api")


@pytest.fixture
def check(faults):
    """As ``faults``; skips without axe-core."""
    if not AXE.is_file():
        pytest.skip(
            "no axe-core here: npm install --prefix build axe-core@4.14.1, or its axe.min.js named by DOUSA_AXE"
        )
    return faults


def wait_until_filled(page, path):
    page.wait("return performance.getEntriesByType('resource').every((one) => one.responseEnd > 0)")
    if path.startswith("/search"):
        page.wait("return document.querySelectorAll('.hit').length > 3")
    if path == "/library":
        page.wait("return document.querySelectorAll('.cell').length > 3")


@pytest.mark.parametrize(
    ("language", "schemes"), [("en", ("light", "dark")), pytest.param("ja", ("dark", "light"), marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("path", PAGES)
def test_every_page_is_without_a_fault(show, check, path, language, schemes):
    page = show(path, scheme=schemes[0], language=language)
    wait_until_filled(page, path)
    assert check(page) == []
    page.resize(390, 844)
    page.paint(schemes[1])
    assert page.run(f"return matchMedia('(prefers-color-scheme: {schemes[1]})').matches")
    assert check(page) == []


def check_both(check, page):
    """Faults of what is shown, in light and in dark."""
    found = []
    for scheme in ("light", "dark"):
        page.paint(scheme)
        found += check(page)
    return found


def test_what_is_opened_on_the_library_is_without_a_fault(show, check):
    page = show("/library", width=1600, height=900)
    wait_until_filled(page, "/library")
    page.find(".cell").click()
    page.run("for (const one of document.querySelectorAll('details')) one.open = true;")
    assert check_both(check, page) == []
    page.find("#jobs-button").click()
    assert check_both(check, page) == []
    page.press(KEYS.ESCAPE)
    page.find("#add-button").click()
    page.wait("return document.querySelector('dialog[open]')")
    assert check_both(check, page) == []
    page.press(KEYS.ESCAPE)


def test_an_evaluation_is_without_a_fault(show, check, running):
    wanted = {"references": [{"motion": "clip:1"}], "performance": {"motion": "clip:2"}}
    job = running.app.state.studio.jobs.submit("evaluate", wanted, "one")
    page = show(f"/evaluate?job={job.id}")
    page.wait("return document.querySelector('#adjust-score')?.textContent")
    page.run("for (const one of document.querySelectorAll('details')) one.open = true;")
    assert check_both(check, page) == []
