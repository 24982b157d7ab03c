"""A headless Chromium for tests of pages, driven through selenium; Debian's packages chromium and chromium-driver."""

import base64
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from patience import PATIENCE

_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # CI runs as root
    "--disable-gpu",
    "--in-process-gpu",  # one process less that what is drawn goes through: a fifth of what the browser itself does
    "--disable-dev-shm-usage",
    "--no-first-run",
    # Nothing is asked of the network, so that a closed one holds up nothing.
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-proxy-server",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
    # A made-up camera, which pages may use without anybody being asked.
    "--use-fake-device-for-media-stream",
    "--use-fake-ui-for-media-stream",
)

# Energy is saved as on a battery: what moves while a test waits is drawn 30 times a second, not 60.
_STATE = {"performance_tuning.battery_saver_mode.state": 3}


class Page:
    """The page that the browser shows, with what tests ask of it."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(self, path: Path, width: int = 1000, height: int = 900, scheme: str = "light") -> None:
        """Show a file in a window of that size; `scheme` is ``"light"`` or ``"dark"``."""
        self.resize(width, height)
        self.paint(scheme)
        self.driver.get_log("browser")
        self.driver.get(path.resolve().as_uri())

    def resize(self, width: int, height: int, ratio: float = 1.0) -> None:
        """Change the size of the view, CSS pixels; `ratio` is the device's pixels per CSS pixel."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def paint(self, scheme: str) -> None:
        """Let the page be ``"light"`` or ``"dark"``."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def run(self, script: str, *values: Any) -> Any:
        """What a piece of script returns; it sees the values as ``arguments``."""
        return self.driver.execute_script(script, *values)

    def wait(self, script: str, *values: Any, seconds: float = PATIENCE) -> Any:
        """Wait until the script returns something true, and return that; fewer seconds than `PATIENCE` are not kept."""
        from selenium.common.exceptions import TimeoutException

        end = time.monotonic() + max(seconds, PATIENCE)
        pause = 0.02  # s; who waits long asks less often, as each question costs 10 ms of a processor
        while not (found := self.run(script, *values)):
            if time.monotonic() > end:
                raise TimeoutException(script)
            time.sleep(pause)
            pause = min(1.1 * pause, 0.25)
        return found

    def settle(self) -> None:
        """Wait until two frames were drawn."""
        self.driver.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()));"
        )

    def find(self, selector: str) -> Any:
        """The first element of a CSS selector, as soon as there is one."""
        return self.wait("return document.querySelector(arguments[0])", selector)

    def point(self, element: Any, right: float = 0, down: float = 0) -> None:
        """Move the pointer over an element, so many CSS pixels from its middle."""
        from selenium.webdriver import ActionChains

        ActionChains(self.driver, duration=0).move_to_element_with_offset(element, right, down).perform()

    def press(self, *keys: str, held: str = "") -> None:
        """Press keys one after the other where the focus is, all the time holding another."""
        from selenium.webdriver import ActionChains

        for key in keys:
            actions = ActionChains(self.driver, duration=0)
            if held:
                actions.key_down(held).send_keys(key).key_up(held).perform()
            else:
                actions.send_keys(key).perform()
        self.settle()

    def messages(self) -> list[str]:
        """What the console holds since the last call, errors and warnings."""
        entries = self.driver.get_log("browser")
        return [entry["message"] for entry in entries if entry["level"] in ("SEVERE", "WARNING")]

    def screenshot(self, path: Path, whole: bool = False) -> Path:
        """Write what is shown as PNG; the whole page, not only the window, if asked for."""
        answer = self.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": whole})
        path.write_bytes(base64.b64decode(answer["data"]))
        return path


@contextmanager
def open_browser(profile: Path) -> Iterator[Page]:
    """A Chromium with a fresh profile folder; skips the test where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    chromedriver = shutil.which("chromedriver")
    if not chromium or not chromedriver:
        pytest.skip("no chromium with chromedriver here: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*_FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.add_experimental_option("localState", _STATE)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    environment = {key: value for key, value in os.environ.items() if "proxy" not in key.lower()}
    service = webdriver.ChromeService(chromedriver, env=environment, log_output=subprocess.DEVNULL)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        driver.set_script_timeout(PATIENCE)
        yield Page(driver)
    finally:
        driver.quit()
