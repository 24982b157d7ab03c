"""The tests of the library on a database server of their own, with a data folder and a port for itself.

With ``DOUSA_TEST_DATABASE=postgresql`` every library of these tests is a database of that server. Its path then holds a
small file that names the database, so that a library is copied as a file is: a copy becomes a database when it is
opened. What is asked about a file of SQLite has the mark ``sqlite``, and is left out.
"""

import getpass
import glob
import os
import re
import shutil
import socket
import sqlite3
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
import sqlalchemy as sa

from dousa.library import Library
from dousa.library.store import opening
from dousa.library.store.checksums import SEALS
from patience import PATIENCE

WANTED = os.environ.get("DOUSA_TEST_DATABASE", "")
_START = "postgresql+psycopg://"
_OPTIONS = "-c listen_addresses=127.0.0.1 -c fsync=off -c max_connections=40 -c wal_level=minimal -c max_wal_senders=0"
# What SQLite calls so, for statements that the tests change a library with.
_FUNCTIONS = (
    "CREATE FUNCTION zeroblob(n integer) RETURNS bytea LANGUAGE sql IMMUTABLE "
    "AS $$ SELECT decode(repeat('00', n), 'hex') $$",
)


def find_program(name: str) -> str | None:
    """Path of a program of PostgreSQL; Debian keeps those of a server out of the way."""
    folders = sorted(glob.glob("/usr/lib/postgresql/*/bin"), reverse=True)
    return shutil.which(name) or shutil.which(name, path=os.pathsep.join(folders))


def why_no_server() -> str | None:
    """What is missing here for a server of our own."""
    if find_program("initdb") is None:
        return "PostgreSQL is not installed"
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "the driver psycopg is not installed"
    return None


@contextmanager
def run_server() -> Iterator[str]:
    """The start of the URLs of a server's databases, which is stopped and removed afterwards."""
    folder = Path(tempfile.mkdtemp())
    owner = getpass.getuser()
    as_owner = {}
    if os.geteuid() == 0:  # it refuses to run as root
        owner = "postgres"
        shutil.chown(folder, owner)
        as_owner = {"user": owner}
    data, log = folder / "data", folder / "log"
    control = [find_program("pg_ctl"), "-D", data, "-w", "-t", str(round(PATIENCE))]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder, **as_owner}
    make = [find_program("initdb"), "-D", data, "-A", "trust", "-U", owner, "-E", "UTF8", "--no-sync"]
    subprocess.run(make, check=True, **quiet)
    for _ in range(10):  # somebody may take the port before the server does
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        options = f"{_OPTIONS} -c port={port} -c unix_socket_directories={folder}"
        if not subprocess.run([*control, "-l", log, "-o", options, "start"], check=False, **quiet).returncode:
            break
    else:
        raise RuntimeError(f"PostgreSQL does not start: {log.read_text(errors='replace')}")
    try:
        yield f"{_START}{owner}@127.0.0.1:{port}"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], check=True, **quiet)
        shutil.rmtree(folder)


def connect_plainly(url: str, **options):
    """A connection of the driver alone."""
    import psycopg

    return psycopg.connect(url.replace("+psycopg", ""), **options)


class Server:
    """Databases of a server, each under the path of a library.

    Parameters
    ----------
    url : the start of their URLs.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._numbers = count()
        self._lock = threading.Lock()
        with connect_plainly(f"{url}/template1", autocommit=True) as connection:
            for statement in _FUNCTIONS:
                connection.execute(statement)

    def make(self, template: str = "template1") -> str:
        """URL of a new database, a copy of another one."""
        name = f"library_{next(self._numbers)}"
        with connect_plainly(f"{self.url}/postgres", autocommit=True) as connection:
            # A database that somebody is connected to cannot be copied.
            connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", (template,))
            connection.execute(f"CREATE DATABASE {name} TEMPLATE {template}")
        return f"{self.url}/{name}"

    def address(self, path: Path | str, create: bool = False) -> Path | str:
        """URL of the library of a path; the path itself where a file of SQLite is, or nothing and nothing is made."""
        with self._lock:
            return self._find(Path(path), create)

    def _find(self, path: Path, create: bool) -> Path | str:
        if path.is_file() and path.stat().st_size < 4096:
            text = path.read_bytes().decode(errors="replace")
            if not text.startswith(_START):
                return path
            url, owner = text.splitlines()
            if owner != str(path.absolute()):
                url = self.make(url.rpartition("/")[2])
                path.write_text(f"{url}\n{path.absolute()}", encoding="utf-8")
            return url
        if create and not path.exists() and path.parent.is_dir():
            url = self.make()
            path.write_bytes(f"{url}\n".encode() + os.fsencode(path.absolute()))
            return url
        return path

    def open_database(self, path_or_url, *, create: bool, read_only: bool, timeout: float):
        """As in ``dousa.library.store.opening``, of the library of a path."""
        known = path_or_url
        if "://" not in os.fspath(path_or_url):
            known = self.address(path_or_url, create and not read_only)
        database = opening.open_database(known, create=create, read_only=read_only, timeout=timeout)
        return replace(database, where=os.fspath(path_or_url))

    def drop_below(self, folder: Path) -> None:
        """Remove the databases of the libraries in a folder."""
        with connect_plainly(f"{self.url}/postgres", autocommit=True) as connection:
            for path in folder.rglob("*"):
                if path.is_file() and path.stat().st_size < 4096:
                    text = path.read_bytes().decode(errors="replace")
                    if text.startswith(_START):
                        url, owner = text.splitlines()
                        if owner == str(path.absolute()):  # else it is a copy that nobody opened
                            name = url.rpartition("/")[2]
                            connection.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")


_RUNNING: list[Server] = []


@contextmanager
def use_server() -> Iterator[None]:
    """Libraries are opened in databases of a server of our own, as long as this lasts."""
    from dousa.library import contents

    with run_server() as url, pytest.MonkeyPatch.context() as patch:
        server = Server(url)
        patch.setattr(contents, "open_database", server.open_database)
        _RUNNING.append(server)
        try:
            yield
        finally:
            _RUNNING.pop()


def drop_below(folder: Path) -> None:
    """Remove the databases of the libraries in a folder, where these are in databases."""
    for server in _RUNNING:
        server.drop_below(folder)


def address(path: Path, create: bool = False) -> Path | str:
    """What a program of its own must open for the library of this path."""
    return _RUNNING[-1].address(path, create) if _RUNNING else path


def _ask_server(url: str, statement: str, values: tuple) -> list[tuple]:
    text = re.sub(r"x'([0-9a-f]*)'", r"'\\x\1'::bytea", statement.replace("?", "%s"))
    text = re.sub(r"^(DROP TABLE \w+)$", r"\1 CASCADE", text)
    with connect_plainly(url) as connection:
        cursor = connection.execute(text, values or None)
        return [] if cursor.description is None else cursor.fetchall()


def run_sql(path: Path, statement: str, *values: object) -> list[tuple]:
    """Rows of a query about the library of a path, or what a statement changes there, past all that looks after it."""
    known = address(path)
    if isinstance(known, str):
        return _ask_server(known, statement, values)
    with closing(sqlite3.connect(path)) as connection, connection:
        return connection.execute(statement, values).fetchall()


def seal_again(path: Path) -> None:
    """Give every row of the library of a path the checksum of what it holds now, as if dousa had written that."""
    with closing(Library.open(path)) as library, library.database.writing() as connection:
        for seal in SEALS:
            key, table = seal.covered[0], seal.checksum.table
            for row in connection.execute(sa.select(*seal.covered)).all():
                own = sa.update(table).where(key == row[0])
                connection.execute(own.values({seal.checksum.name: seal.compute(row)}))


def has_table(path: Path, name: str) -> bool:
    """Whether the library of a path has a table of this name."""
    known = address(path)
    made = sa.create_engine(known if isinstance(known, str) else f"sqlite:///{path}")
    try:
        return sa.inspect(made).has_table(name)
    finally:
        made.dispose()
