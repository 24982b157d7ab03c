"""What one version of dousa answers, as named values that can be compared with those of another version.

Every answer is taken apart into leaves, ``place -> text``: numbers as Python writes them (to the last bit), arrays and
files as SHA-256 of their bytes. Sentences, of three words and more, are kept apart from the rest: they may be reworded.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import io
import json
import os
import re
import runpy
import sqlite3
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

__all__ = ["Record"]

_LONG = 24  # numbers of a list that are one leaf
_SENTENCE_WORDS = 3
# Keys of answers and fields that change from run to run, and a moment in a sentence.
_VOLATILE = re.compile(r"(.*_)?(milli)?seconds|(.*_)?frames_per_second|times_faster.*|(trained|added)_at|revision")
_MOMENT = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+(Z|[+-]\d\d:\d\d)?")
# Times and counters of writes: portions of an addition end after a second.
_VOLATILE_COLUMNS = {
    "applied_at", "added_at", "trained_at", "dousa_version", "revision", "clips_revision", "learned",
}  # fmt: skip


class Record:
    """Probes of one version: for each its leaves, its sentences and its time.

    Parameters
    ----------
    folders : what stands for the name of each folder in answers, as ``{"<work>": Path(...)}``.
    """

    def __init__(self, folders: dict[str, Path]) -> None:
        self.probes: dict[str, dict[str, Any]] = {}
        self._folders = folders
        self._name = ""

    @contextmanager
    def probe(self, name: str) -> Iterator[None]:
        """Whatever is put within is of this probe; an error ends the probe and is one of its leaves."""
        self._name = name
        self.probes[name] = {"leaves": {}, "words": {}, "seconds": 0.0}
        start = time.perf_counter()
        try:
            yield
        except Exception as error:  # an unexpected one: the other version must have it too
            self.put("error", type(error).__name__)
            self.probes[name]["failed"] = f"{type(error).__name__}: {error}"
        self.probes[name]["seconds"] = time.perf_counter() - start

    def put(self, place: str, value: Any, keep: Collection[str] = ()) -> None:
        """Add a value and all that is in it, without times; ``keep`` names keys that only look like times."""
        if isinstance(value, enum.Enum):
            value = value.value
        if isinstance(value, np.ndarray):
            self._leaf(place, _digest_array(value))
        elif value is None or isinstance(value, bool | int | float | np.generic):
            self._leaf(place, repr(value.item() if isinstance(value, np.generic) else value))
        elif isinstance(value, bytes):
            self._leaf(place, hashlib.sha256(value).hexdigest())
        elif isinstance(value, str | os.PathLike):
            self._text(place, os.fspath(value))
        elif isinstance(value, dict):
            for key in value:
                if key in keep or not _VOLATILE.fullmatch(str(key)):
                    self.put(f"{place}.{key}", value[key], keep)
        elif isinstance(value, list | tuple | set | frozenset):
            self._list(place, sorted(value) if isinstance(value, set | frozenset) else list(value), keep)
        elif dataclasses.is_dataclass(value):
            fields = [field.name for field in dataclasses.fields(value) if not field.name.startswith("_")]
            self.put(place, {name: getattr(value, name) for name in fields}, keep)
        elif hasattr(value, "code") and hasattr(value, "values"):  # a message, which tells its sentence
            self._words(place, str(value))
        else:
            self._leaf(place, f"an object of class {type(value).__name__}")

    def file(self, place: str, path: Path) -> None:
        """Add the bytes of a file."""
        self.put(place, path.read_bytes() if path.exists() else None)

    def command(
        self,
        place: str,
        *words: object,
        keep: Collection[str] = (),
        stdin: str = "",
        prose: bool = False,
        exit_code: int = 0,
    ) -> None:
        """Run the command line in this process and add its answer.

        Parameters
        ----------
        place : where its leaves stand.
        words : of the command, without ``dousa``; or a program of the lab, such as ``lab.errors``, and its words.
        keep : as in `put`.
        stdin : what it reads.
        prose : the answer is a table for people; else JSON, or JSON lines.
        exit_code : the one that is right.

        Raises
        ------
        RuntimeError : the command ended with another exit code; the probe asks wrongly, or the command fails.
        """
        from dousa.app.cli import main

        out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
        given = io.TextIOWrapper(io.BytesIO(stdin.encode()), "utf-8")
        arguments = list(map(str, words))
        if not arguments[0].startswith("lab."):
            arguments.insert(0, "dousa")
        code: object = 0
        with (
            redirect_stdout(out),
            redirect_stderr(err),
            mock.patch.multiple(sys, argv=arguments, stdin=given),
        ):
            try:
                if str(words[0]).startswith("lab."):
                    runpy.run_module(str(words[0]), run_name="__main__", alter_sys=True)
                else:
                    main()
            except SystemExit as ended:
                code = ended.code or 0
        answer, notes = (stream.buffer.getvalue().decode() for stream in (out, err))  # type: ignore[attr-defined]
        self.put(f"{place}.exit", code)
        for number, line in enumerate(notes.splitlines()):
            self._words(f"{place}.stderr.{number}", line)
        if prose:
            self._words(f"{place}.stdout", answer)
        elif answer.strip():
            self.put(place, _parse(answer), keep)
        if code != exit_code:
            raise RuntimeError(f"exit code {code} of {' '.join(arguments)}: {notes}")

    def library(self, place: str, path: Path) -> None:
        """Add all columns of all tables of a library, apart from times and counters of writes."""
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            names = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite%' ORDER BY 1"
            for (table,) in connection.execute(names).fetchall():
                rows = connection.execute(f"SELECT * FROM {table} ORDER BY 1")
                columns = [column[0] for column in rows.description]
                for column, values in zip(columns, zip(*rows.fetchall(), strict=True), strict=False):
                    if table != "dousa_migrations" and column not in _VOLATILE_COLUMNS:
                        self._column(f"{place}.{table}.{column}", values)

    def _column(self, place: str, values: tuple[Any, ...]) -> None:
        if all(isinstance(value, bytes) for value in values):
            lengths = ",".join(str(len(value)) for value in values)
            joined = hashlib.sha256(lengths.encode() + b"".join(values)).hexdigest()
            self._leaf(place, f"{len(values)} blobs {joined}")
            return
        self.put(place, [_parse(value) if _is_json(value) else value for value in values])

    def _list(self, place: str, items: list[Any], keep: Collection[str]) -> None:
        self._leaf(f"{place}.#", str(len(items)))
        flat = _flatten_numbers(items)
        if flat is not None and len(flat) >= _LONG:
            self._leaf(place, f"{len(flat)} numbers {hashlib.sha256(repr(items).encode()).hexdigest()}")
            return
        for number, item in enumerate(items):
            self.put(f"{place}.[{number}]", item, keep)

    def _text(self, place: str, text: str) -> None:
        text = self._anonymous(text)
        if len(text.split()) >= _SENTENCE_WORDS:
            self._words(place, text)
        else:
            self._leaf(place, repr(text))

    def _leaf(self, place: str, text: str) -> None:
        self.probes[self._name]["leaves"][self._anonymous(place)] = text

    def _words(self, place: str, text: str) -> None:
        self.probes[self._name]["words"][self._anonymous(place)] = _MOMENT.sub("<moment>", self._anonymous(text))

    def _anonymous(self, text: str) -> str:
        for name, folder in self._folders.items():
            text = text.replace(str(folder), name)
        return text


def _digest_array(array: np.ndarray) -> str:
    plain = np.ascontiguousarray(array)
    return f"{plain.dtype.str} {plain.shape} {hashlib.sha256(plain.tobytes()).hexdigest()}"


def _flatten_numbers(items: list[Any]) -> list[Any] | None:
    """All numbers of nested lists; None if there is anything else."""
    flat: list[Any] = []
    for item in items:
        if isinstance(item, list | tuple):
            inner = _flatten_numbers(list(item))
            if inner is None:
                return None
            flat += inner
        elif item is None or isinstance(item, int | float):
            flat.append(item)
        else:
            return None
    return flat


def _is_json(value: object) -> bool:
    return isinstance(value, str) and value[:1] in ("{", "[")


def _parse(text: str) -> Any:
    """A JSON document, JSON lines, or the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        return [json.loads(line) for line in text.splitlines() if line]
    except ValueError:
        return text
