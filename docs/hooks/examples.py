"""The scripts of docs/examples: read, run, and what came out kept.

A script runs in an empty folder and writes one PNG there; one that fails, or writes none, is an error. What it printed
and drew is kept in build/gallery under a key made of the script, the version of dousa and its source, so that it is run
again only when one of them changed.
"""

from __future__ import annotations

import ast
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import dousa

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
CACHE = ROOT / "build" / "gallery"
N_AT_A_TIME = 2
TIMEOUT = 900  # s for one script, compiling on a busy machine included


@dataclass(frozen=True, slots=True)
class Example:
    """A script of the gallery.

    Parameters
    ----------
    path : ``NN_name.py``; the number is its place.
    title : first sentence of its docstring, without the full stop.
    text : the rest of the docstring, Markdown.
    code : the script below the docstring.
    """

    path: Path
    title: str
    text: str
    code: str

    @property
    def name(self) -> str:
        """The name without the number, as in the address of its page."""
        return self.path.stem.partition("_")[2]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a script printed, and its picture."""

    printed: str
    picture: bytes


class ExampleError(RuntimeError):
    """An example that does not do what it should."""


def read_examples(folder: Path = EXAMPLES) -> list[Example]:
    """All examples in their order.

    Raises
    ------
    ExampleError : a script without a docstring.
    """
    return [read_example(path) for path in sorted(folder.glob("[0-9][0-9]_*.py"))]


def read_example(path: Path) -> Example:
    """One example."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source, path.name)
    docstring = ast.get_docstring(tree)
    if not docstring:
        raise ExampleError(f"{path.name}: expected a docstring whose first line is the title of the example")
    title, _, text = docstring.partition("\n")
    below = source.splitlines()[tree.body[0].end_lineno :]
    return Example(path, title.rstrip("."), text.strip(), "\n".join(below).strip())


def run_examples(examples: Iterable[Example]) -> list[Outcome]:
    """What each of the examples makes, from the cache where nothing changed.

    Raises
    ------
    ExampleError : a script failed, took too long, or did not write one picture.
    """
    source = _digest_source()
    with ThreadPoolExecutor(N_AT_A_TIME) as workers:
        return list(workers.map(lambda example: _recall_or_run(example, source), examples))


def _digest_source() -> bytes:
    """A digest of the version and of every file of the package."""
    digest = hashlib.sha256(dousa.__version__.encode())
    home = Path(dousa.__file__).parent
    for path in sorted(home.rglob("*.py")):
        digest.update(path.relative_to(home).as_posix().encode() + path.read_bytes())
    return digest.digest()


def _recall_or_run(example: Example, source: bytes) -> Outcome:
    key = hashlib.sha256(source + example.path.read_bytes()).hexdigest()[:16]
    stem = CACHE / f"{example.name}-{key}"
    printed, picture = stem.with_suffix(".txt"), stem.with_suffix(".png")
    if printed.exists() and picture.exists():
        return Outcome(printed.read_text(encoding="utf-8"), picture.read_bytes())
    outcome = run_example(example)
    CACHE.mkdir(parents=True, exist_ok=True)
    for old in CACHE.glob(f"{example.name}-*"):
        old.unlink()
    picture.write_bytes(outcome.picture)
    printed.write_text(outcome.printed, encoding="utf-8")
    return outcome


def run_example(example: Example) -> Outcome:
    """Run a script by itself, in an empty folder."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "MPLBACKEND": "Agg", "COLUMNS": "100", "DOUSA_LANG": "en", "PATH": path}
    with TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                [sys.executable, str(example.path)],
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                timeout=TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise ExampleError(f"{example.path.name} ran for more than {TIMEOUT} s") from error
        if done.returncode != 0:
            raise ExampleError(f"{example.path.name} failed:\n{done.stderr}")
        pictures = sorted(Path(folder).glob("*.png"))
        if len(pictures) != 1:
            raise ExampleError(f"{example.path.name}: expected one picture (PNG), found {len(pictures)}")
        printed = done.stdout.replace(f"{Path(folder).resolve()}{os.sep}", "")
        return Outcome(printed, pictures[0].read_bytes())
