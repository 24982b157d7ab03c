"""Every page of the studio in a real Firefox: opened without an error, in both languages, wide and narrow."""

import pytest

PAGES = ("library", "search?motion=clip:1", "takes", "evaluate?references=clip:1", "estimate", "live", "api")

pytestmark = pytest.mark.browser


@pytest.fixture
def go(firefox, running, one_address):
    """``go("library")``: a page of a studio in the browser."""

    def open_page(path, language="en", width=1280, height=800):
        firefox.open("about:blank")  # a page that is left tells of what it was still asking for
        firefox.said.clear()
        firefox.resize(width, height)
        joint = "&" if "?" in path else "?"
        firefox.open(f"{running.url}/{path}{joint}token={running.token}&lang={language}")
        return firefox

    yield open_page
    one_address.leave_firefox(firefox)


@pytest.mark.parametrize("path", PAGES)
def test_every_page_opens_without_a_word_in_the_console_and_fits(go, path):
    page = go(path)
    page.wait("document.querySelector('h1')?.checkVisibility()")
    page.wait("performance.getEntriesByType('resource').every((one) => one.responseEnd > 0)")
    for width, height in ((1280, 800), (390, 844)):
        page.resize(width, height)
        assert page.run("document.documentElement.scrollWidth") <= width
    assert page.said == []
    go(path, "ja")
    assert page.run("document.documentElement.lang") == "ja"
    assert page.said == []
