"""The server under attack: requests that are none, many at once."""

import asyncio
import io
import socket
import threading
import time
import zipfile
from contextlib import ExitStack, suppress
from types import SimpleNamespace

import pytest

from app.studio.conftest import TOKEN, list_below, send
from app.studio.one_address import run_app
from dousa.app.studio import Settings
from dousa.app.studio.core.answers import Gate, RefusedError, status_of
from dousa.app.studio.jobs import lanes
from dousa.app.studio.server import PatientProtocol
from patience import PATIENCE

GOOD = b"HIERARCHY\nROOT Hips\n"


# --- requests


@pytest.mark.parametrize(
    "path",
    ["/%E6%97%A5%E6%9C%AC", "/%ff%fe", "/%0d%0aX-Evil:%20y/", "//evil.example/", "/%09/evil.example/",
     "/%5Cevil.example/"],
)  # fmt: skip
def test_the_token_in_an_odd_address_leads_nowhere_else(studio, path):
    del studio.headers["authorization"]
    answer = studio.get(f"http://127.0.0.1:8765{path}?token={TOKEN}", follow_redirects=False)
    assert answer.status_code == 303
    place = answer.headers["location"]
    assert place.startswith("/")
    assert not place.startswith(("//", "/\\", "/\t"))
    assert "x-evil" not in answer.headers


@pytest.mark.parametrize("name", ["host", "origin", "sec-fetch-site"])
def test_a_header_that_decides_stands_once(studio, name):
    values = {"host": "127.0.0.1:8765", "origin": "http://127.0.0.1:8765", "sec-fetch-site": "same-origin"}
    headers = [(name, values[name]), (name, "evil.example")]
    request = studio.build_request("GET", "/api/info")
    raw = [(key, value) for key, value in request.headers.raw if key.lower() != name.encode()]
    request.headers = type(request.headers)(raw + [(key.encode(), value.encode()) for key, value in headers])
    assert studio.send(request).status_code == 400


def test_web_sockets_are_closed(studio):
    sent = []

    async def ask():
        async def send_message(message):
            sent.append(message)

        async def receive():
            return {"type": "websocket.connect"}

        scope = {"type": "websocket", "path": "/api/info", "headers": [], "query_string": b""}
        await studio.app(scope, receive, send_message)

    asyncio.run(ask())
    assert sent == [{"type": "websocket.close"}]


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 100_000, b'{"query": ' + b"9" * 5000 + b"}", b'{"query": {"motion": "clip:1"}, "threshold": NaN}',
        b'{"query": {"motion": "clip:1", "joint_map": {"\\ud800": "\\udfff"}}}', b"\xff\xfe", b"",
        b'{"query": {"motion": "clip:1"}, "query": {"motion": "clip:-1"}}', b'{"k": 1e999, "query": null}',
    ],
)  # fmt: skip
def test_json_that_is_a_bomb_is_refused(studio, content):
    answer = studio.post("/api/search", content=content, headers={"content-type": "application/json"})
    assert answer.status_code in (200, 400, 422), answer.text
    assert answer.status_code == 200 or answer.json()["problem"]


@pytest.fixture
def caller(library_copy):
    """Opens connections to a studio that listens as the command does."""
    from dousa.app.studio import create_app

    with socket.socket(proto=socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        app = create_app(Settings(library_copy, token=TOKEN, port=port))
        with run_app(app, listener, "critical", http=PatientProtocol, ws="none"):
            yield lambda: socket.create_connection(("127.0.0.1", port), timeout=PATIENCE), port


def read_all(connection) -> bytes:
    content = b""
    while part := connection.recv(65536):
        content += part
    return content


def test_a_request_that_is_not_ended_is_given_up(caller, monkeypatch):
    from dousa.app.studio import server as connections

    monkeypatch.setattr(connections.PatientProtocol, "patience_s", 2.0)
    call, port = caller
    with call() as silent, call() as slow, call() as good:
        slow.sendall(b"GET /api/info HTTP/1.1\r\nX: ")
        head = f"GET /api/info HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {TOKEN}\r\n"
        good.sendall((head + "Connection: close\r\n\r\n").encode())
        assert read_all(good).startswith(b"HTTP/1.1 200")
        assert read_all(silent) == b""
        assert read_all(slow) == b""


def test_half_open_connections_keep_nobody_out(caller):
    call, port = caller
    with ExitStack() as opened:
        for _ in range(250):
            connection = opened.enter_context(call())
            with suppress(OSError):  # given up already
                connection.sendall(b"GET /api/info HTTP/1.1\r\nX: ")
        good = opened.enter_context(call())
        head = f"GET /api/info HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {TOKEN}"
        start = time.monotonic()
        good.sendall(f"{head}\r\nConnection: close\r\n\r\n".encode())
        assert read_all(good).startswith(b"HTTP/1.1 200")
        assert time.monotonic() - start < PatientProtocol.patience_s  # it waited for none of them


def test_an_upload_that_stands_still_is_given_up(caller, tmp_path, monkeypatch):
    from dousa.app.studio import server as connections

    monkeypatch.setattr(connections.PatientProtocol, "patience_s", 3.0)
    call, port = caller
    head = f"POST /api/uploads?name=a.bvh HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {TOKEN}"
    with call() as stalled, call() as going_on:
        stalled.sendall(f"{head}\r\nContent-Length: 100000\r\n\r\n".encode() + GOOD[:50])
        body = GOOD + b"\n" * 8000
        going_on.sendall(f"{head}\r\nConnection: close\r\nContent-Length: {len(body)}\r\n\r\n".encode())
        for start in range(0, len(body), 2000):  # slow, but it goes on
            going_on.sendall(body[start : start + 2000])
            time.sleep(0.8)
        assert read_all(stalled) == b""
        assert read_all(going_on).startswith(b"HTTP/1.1 201")
    end = time.monotonic() + PATIENCE  # the connection is closed first
    while any(name.endswith(".part") for name in list_below(tmp_path)):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_strangers_are_not_listened_to_any_longer(caller):
    call, port = caller
    with call() as stranger:
        head = f"POST /api/uploads?name=a.bvh HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 400000000"
        stranger.sendall(f"{head}\r\n\r\n".encode() + b"a" * 1000)
        assert read_all(stranger).startswith(b"HTTP/1.1 401")  # and the connection ends


@pytest.mark.parametrize(
    "request_line",
    [b"\0\xff garbage", b"GET /", b"PRI * HTTP/2.0", b"GET /api/info HTTP/1.1\r\nHost: a\r\nHost: b",
     b"POST /api/search HTTP/1.1\r\nHost: a\r\nContent-Length: -5",
     b"GET http://evil.example/api/info HTTP/1.1\r\nHost: a"],
)  # fmt: skip
def test_what_is_no_request_gets_an_answer_and_the_studio_lives(caller, request_line):
    call, _ = caller
    with call() as odd:
        odd.sendall(request_line + b"\r\n\r\n")
        odd.shutdown(socket.SHUT_WR)
        assert read_all(odd).split(b" ")[1][:1] == b"4"


def test_an_upload_that_breaks_off_leaves_nothing(caller, tmp_path):
    call, port = caller
    before = list_below(tmp_path)
    with call() as broken:
        head = f"POST /api/uploads?name=a.bvh HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {TOKEN}"
        broken.sendall(f"{head}\r\nContent-Length: 100000\r\n\r\n".encode() + GOOD)
        time.sleep(0.3)
    for _ in range(1000):
        left = {name for name in list_below(tmp_path) - before if not name.endswith(("-wal", "-shm"))}
        if not left:
            break
        time.sleep(0.05)
    assert not left


# --- many at once


def test_a_gate_sends_away_whom_it_cannot_hold():
    gate, inside = Gate(1, 1, "too many"), threading.Event()
    go, waited = threading.Event(), []

    def hold():
        with gate.enter(PATIENCE):
            inside.set()
            go.wait(PATIENCE)

    def wait():
        with gate.enter(PATIENCE):
            waited.append(1)

    first = threading.Thread(target=hold)
    first.start()
    inside.wait(PATIENCE)
    second = threading.Thread(target=wait)
    second.start()
    while gate._known._value:
        time.sleep(0.01)
    with pytest.raises(RefusedError, match="too many") as caught, gate.enter(PATIENCE):
        pass
    assert status_of(caught.value) == 429
    go.set()
    first.join()
    second.join()
    assert waited == [1]
    with gate.enter(0.1):
        pass


def test_many_previews_do_not_take_all_threads(studio, monkeypatch):
    go, batch = threading.Event(), send(studio, "a.bvh", GOOD)["batch"]
    process = SimpleNamespace(poll=lambda: 0, wait=lambda timeout=None: 0, stdin=None, stdout=None)
    monkeypatch.setattr(lanes.Reader, "_begin", lambda reader: process)
    monkeypatch.setattr(lanes, "_converse", lambda *_: (go.wait(PATIENCE), (True, {}))[1])
    codes = []

    def ask():
        codes.append(studio.post("/api/estimations/preview", json={"batch": batch}).status_code)

    threads = [threading.Thread(target=ask) for _ in range(50)]
    for thread in threads:
        thread.start()
    while len(codes) < 42:  # those that are sent away; the others wait
        time.sleep(0.01)
    assert set(codes) == {429}
    assert studio.get("/api/info").status_code == 200
    go.set()
    for thread in threads:
        thread.join()
    assert sorted(codes) == [200] * 8 + [429] * 42


def test_a_batch_is_counted_once(studio, monkeypatch):
    workspace = studio.app.state.studio.workspace
    looks = []
    files = workspace.files
    monkeypatch.setattr(workspace, "files", lambda batch: looks.append(batch) or files(batch))
    batch = send(studio, "0.bvh", GOOD)["batch"]
    for number in range(1, 20):
        send(studio, f"{number}.bvh", GOOD, batch)
    assert len(looks) == 1


def test_what_was_refused_takes_no_room(library_copy):
    from dataclasses import replace

    from starlette.testclient import TestClient

    from dousa.app.studio import create_app

    settings = replace(Settings(library_copy, token=TOKEN), most_files=3)
    with TestClient(create_app(settings), "http://127.0.0.1:8765") as client:
        client.headers["authorization"] = f"Bearer {TOKEN}"
        batch = send(client, "0.bvh", GOOD)["batch"]
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as packed:
            for number in range(3):
                packed.writestr(f"x{number}.bvh", GOOD)
        for _ in range(3):
            answer = client.post(f"/api/uploads?name=a.zip&batch={batch}", content=buffer.getvalue())
            assert answer.status_code == 413
            assert client.post(f"/api/uploads?name=0.bvh/x.bvh&batch={batch}", content=GOOD).status_code == 422
        for number in (1, 2):
            send(client, f"{number}.bvh", GOOD, batch)
