# SPDX-License-Identifier: GPL-3.0-or-later
"""A dousa studio on this machine: one that runs already, or one that is started here. No Blender in this module."""

from __future__ import annotations

import contextlib
import json
import queue
import re
import shutil
import subprocess
import threading
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_ADDRESS = re.compile(r"http://(127\.0\.0\.1|localhost):(\d+)/\?token=([\w-]+)")
_START_S, _ANSWER_S, _STOP_S = 60.0, 120.0, 5.0
_MOST_BYTES = 500_000_000
_MINIATURE_BYTES = 1456


class StudioError(Exception):
    """One sentence for the person: what is wrong and what to do."""


@dataclass(frozen=True)
class Hit:
    """A clip that was found.

    motion: its name in the studio; clip_id: its number; name: of its file; category: or nothing; mirrored: whether
    the mirror image of the query is like it.
    """

    motion: str
    clip_id: int
    name: str
    category: str
    mirrored: bool


@dataclass(frozen=True)
class Found:
    """What a search answered: category of the query (nothing if unknown), the nearest one, and the hits."""

    category: str
    guess: str
    hits: tuple[Hit, ...]


class Studio:
    """A connection.

    address: as `dousa studio` prints it, with the token; process: the studio, where it was started here.
    """

    def __init__(self, address: str, process: subprocess.Popen[str] | None = None) -> None:
        match = _ADDRESS.search(address)
        if match is None:
            raise StudioError(
                "This is not the address of a studio on this machine: paste the line that `dousa studio` prints, "
                "http://127.0.0.1:8765/?token=..."
            )
        host, port, self._token = match.groups()
        self._base = f"http://{host}:{port}"
        self._process = process
        # A proxy of the system must not be asked for this machine.
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    @classmethod
    def start(cls, library: str | Path, command: str = "dousa") -> Studio:
        """Start `dousa studio` with a library that exists, and wait until it answers."""
        path = Path(library)
        if not path.is_file():
            raise StudioError(f"There is no library {path}: make one with `dousa add {path.name} FOLDER`.")
        program = shutil.which(command)
        if program is None:
            raise StudioError(
                f"{command} was not found: install it (pip install 'dousa[studio]') and set its full path in the "
                "preferences of this extension."
            )
        process = subprocess.Popen(
            [program, "--lang", "en", "studio", str(path), "--no-browser", "--port", "0"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace",
        )  # fmt: skip
        try:
            studio = cls(_wait_for_address(process), process)
            studio.info()
        except StudioError:
            _stop(process)
            raise
        return studio

    def close(self) -> None:
        """Stop the studio if it was started here."""
        if self._process is not None:
            _stop(self._process)
            self._process = None

    def info(self) -> dict[str, Any]:
        """The library in numbers."""
        answer: dict[str, Any] = self._ask("/api/info")
        return answer

    def upload(self, name: str, content: bytes) -> str:
        """Hand a motion file over; its name in the studio."""
        answer = self._ask(f"/api/uploads?name={urllib.parse.quote(name)}", content)
        if answer["refused"]:
            raise StudioError(answer["refused"][0]["reason"])
        motion: str = answer["files"][0]["motion"]
        return motion

    def discard(self, motion: str) -> None:
        """Take an uploaded file away again; it is no harm if it cannot be."""
        batch = motion.removeprefix("file:").partition("/")[0]
        with contextlib.suppress(StudioError):
            self._ask(f"/api/uploads/{batch}", method="DELETE")

    def search(self, bvh: str, n_hits: int = 12, *, mirror: bool = False) -> Found:
        """The clips most like a motion."""
        motion = self.upload("query.bvh", bvh.encode())
        try:
            request = {"query": {"motion": motion}, "k": n_hits, "mirror": mirror}
            answer = self._ask("/api/search", json.dumps(request).encode())
        finally:
            self.discard(motion)
        hits = tuple(
            Hit(hit["motion"], hit["clip_id"], Path(hit["path"]).name, hit["category"] or "", hit["mirrored"])
            for hit in answer["results"]
        )
        return Found(answer["category"] or "", answer["guess"] or "", hits)

    def thumbnails(self, clip_ids: list[int]) -> list[bytes]:
        """A small moving figure of each clip, see `thumbnails.draw`."""
        content: bytes = self._ask("/api/clips/thumbnails", json.dumps({"clips": clip_ids}).encode(), raw=True)
        return [content[i * _MINIATURE_BYTES : (i + 1) * _MINIATURE_BYTES] for i in range(len(clip_ids))]

    def bvh(self, motion: str, onto: str | None = None) -> str:
        """A motion as BVH; `onto`, a character as BVH, gives it that skeleton."""
        if onto is None:
            return self._bvh({"motion": motion})
        character = self.upload("character.bvh", onto.encode())
        try:
            return self._bvh({"motion": motion, "onto": character})
        finally:
            self.discard(character)

    def _bvh(self, asked: dict[str, str]) -> str:
        content: bytes = self._ask(f"/api/motions/file?{urllib.parse.urlencode(asked)}", raw=True)
        return content.decode()

    def _ask(self, where: str, body: bytes | None = None, *, method: str | None = None, raw: bool = False) -> Any:
        headers = {"Authorization": f"Bearer {self._token}", "Accept-Language": "en"}
        if body is not None:
            is_upload = where.startswith("/api/uploads")
            headers["Content-Type"] = "application/octet-stream" if is_upload else "application/json"
        request = urllib.request.Request(self._base + where, body, headers, method=method)
        try:
            with self._opener.open(request, timeout=_ANSWER_S) as answer:
                content = answer.read(_MOST_BYTES)
        except urllib.error.HTTPError as error:
            raise StudioError(_read_problem(error)) from error
        except OSError as error:
            raise StudioError(f"The studio does not answer ({error}): start it again.") from error
        return content if raw else json.loads(content)


def _read_problem(error: urllib.error.HTTPError) -> str:
    try:
        return str(json.loads(error.read())["problem"])
    except (ValueError, KeyError, TypeError):
        return f"The studio answered {error.code}: is its dousa as new as this extension?"


def _wait_for_address(process: subprocess.Popen[str]) -> str:
    """The line with the address; what comes after it is read and dropped, so that the studio never waits for us."""
    lines: queue.Queue[str | None] = queue.Queue()

    def listen() -> None:
        for line in process.stderr or ():
            lines.put(line)
        lines.put(None)

    threading.Thread(target=listen, daemon=True).start()
    said: list[str] = []
    while True:
        try:
            line = lines.get(timeout=_START_S)
        except queue.Empty:
            raise StudioError(f"dousa studio did not start within {_START_S:.0f} s.") from None
        if line is None:
            raise StudioError(f"dousa studio ended: {' '.join(' '.join(said).split()) or 'it said nothing'}")
        if _ADDRESS.search(line):
            return line
        said.append(line)


def _stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
