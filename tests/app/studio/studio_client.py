"""Asks a studio that listens, as a program would."""

import json
import time
import urllib.request
from pathlib import Path
from typing import Any

from patience import PATIENCE


class Client:
    """A program with the token.

    Parameters
    ----------
    running : the studio.
    """

    def __init__(self, running: Any) -> None:
        self.running = running

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        """The answer as JSON; `body` is sent as bytes or JSON."""
        data = body if isinstance(body, bytes) else None if body is None else json.dumps(body).encode()
        kind = "application/octet-stream" if isinstance(body, bytes) else "application/json"
        headers = {"authorization": f"Bearer {self.running.token}", "content-type": kind}
        request = urllib.request.Request(self.running.url + path, data, headers, method=method)
        with urllib.request.urlopen(request) as answer:
            return json.loads(answer.read())

    def upload(self, path: Path) -> str:
        """The name of a motion that was sent."""
        found: str = self.ask("POST", f"/api/uploads?name={path.name}", path.read_bytes())["files"][0]["motion"]
        return found

    def wait(self, job: str, seconds: float = PATIENCE) -> dict[str, Any]:
        """A job when it is over."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found: dict[str, Any] = self.ask("GET", f"/api/jobs/{job}")
            if found["state"] not in ("queued", "running", "stopping"):
                return found
            time.sleep(0.1)
        raise AssertionError(f"job {job} is not over after {seconds} s")
