"""Where less motion is wished for nothing moves by itself, on any page; and where it is not, what is chosen does."""

import pytest

pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")

PAGES = {
    "/library": "window.dousa.miniatures.drawn > 3",
    "/search?motion=clip:1": "document.querySelectorAll('.hit canvas').length > 3 && window.dousa.miniatures.drawn > 3",
    "/takes?motion=clip:1": "document.querySelector('.dousa-player canvas')",
    "/evaluate?references=clip:1&performance=clip:2": "window.dousa.miniatures.drawn > 1",
    "/estimate": "document.querySelector('#material')",
    "/live": "document.querySelector('main')",
}
# What moves by itself: small figures, players, and what the style sheets turn without an end.
MOVING = """
const endless = document.getAnimations().filter((one) => one.playState === 'running' && one.effect.getTiming().iterations === Infinity);
const players = [...document.querySelectorAll('.dousa-player button')].filter((one) => one.ariaLabel === 'Pause');
return [window.dousa?.miniatures.alive ?? 0, players.length, endless.length];
"""  # noqa: E501


@pytest.fixture
def calm(show):
    """``calm(path)``: a page where less motion is wished for."""

    def open_page(path):
        page = show(path)
        features = [{"name": "prefers-reduced-motion", "value": "reduce"}]
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        page.driver.refresh()
        return page

    return open_page


@pytest.mark.parametrize("path", PAGES)
def test_nothing_moves_by_itself(calm, path):
    page = calm(path)
    page.wait(f"return {PAGES[path]}")
    page.run("document.querySelector('#jobs-button').classList.add('busy')")
    page.settle()
    assert page.run(MOVING) == [0, 0, 0]
