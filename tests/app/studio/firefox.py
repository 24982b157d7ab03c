"""A headless Firefox for tests of the studio, driven over its own WebDriver BiDi: no driver program is needed."""

import json
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from patience import PATIENCE


class Firefox:
    """One page of a Firefox.

    Parameters
    ----------
    socket : to the browser.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._number = socket, 0
        self.said: list[str] = []  # errors and warnings of the console
        self._ask("session.new", {"capabilities": {}})
        self._ask("session.subscribe", {"events": ["log.entryAdded"]})
        self._page = self._ask("browsingContext.getTree", {})["contexts"][0]["context"]

    def _ask(self, method: str, parameters: dict[str, Any]) -> Any:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            came = json.loads(self._socket.recv())
            if came.get("method") == "log.entryAdded" and came["params"]["level"] in ("error", "warn"):
                self.said.append(str(came["params"]["text"]))
            if came.get("id") == self._number:
                assert came["type"] == "success", came
                return came["result"]

    def resize(self, width: int, height: int) -> None:
        """Change the size of the view, CSS pixels."""
        size = {"width": width, "height": height}
        self._ask("browsingContext.setViewport", {"context": self._page, "viewport": size})

    def open(self, address: str) -> None:
        """Show a page, until it is loaded."""
        self._ask("browsingContext.navigate", {"context": self._page, "url": address, "wait": "complete"})

    def run(self, expression: str) -> Any:
        """The value of an expression of the page, through JSON."""
        asked = {
            "expression": f"JSON.stringify({expression} ?? null)",
            "target": {"context": self._page},
            "awaitPromise": True,
        }
        came = self._ask("script.evaluate", asked)
        assert came["type"] == "success", came["exceptionDetails"]["text"]
        return json.loads(came["result"]["value"])

    def wait(self, expression: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is something true; that."""
        end = time.monotonic() + seconds
        pause = 0.02  # s; who waits long asks less often
        while not (value := self.run(expression)):
            assert time.monotonic() < end, expression
            time.sleep(pause)
            pause = min(1.1 * pause, 0.25)
        return value


@contextmanager
def open_firefox(profile: Path) -> Iterator[Firefox]:
    """A Firefox with a fresh profile folder; skips the test where there is none."""
    websocket = pytest.importorskip("websocket", reason="selenium is not installed: pip install selenium")
    firefox = shutil.which("firefox-esr") or shutil.which("firefox")
    if not firefox:
        pytest.skip("no Firefox here: apt-get install firefox-esr")
    profile.mkdir()
    command = [firefox, "--headless", "--no-remote", "--profile", str(profile), "--remote-debugging-port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    reader = threading.Thread(target=process.stderr.read, daemon=True)
    try:
        address = next(
            (found[0] for line in process.stderr if (found := re.search(r"ws://127\.0\.0\.1:\d+", line))), None
        )
        assert address is not None, "Firefox ended"
        reader.start()  # else its pipe fills up
        socket = websocket.create_connection(f"{address}/session", timeout=PATIENCE, suppress_origin=True)
        try:
            yield Firefox(socket)
        finally:
            socket.close()
    finally:
        process.terminate()
        process.wait(timeout=PATIENCE)
        if reader.is_alive():
            reader.join(timeout=PATIENCE)
        process.stderr.close()
