"""What others on the network reach, asked as somebody who wants more than they are shown."""

import http.client
import os
import re
import socket
import ssl
import stat
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path

import pytest

from app.studio.conftest import TOKEN, wait_for
from app.studio.evaluation_cases import upload
from dousa.app.studio import Settings, create_app, find_share_address
from dousa.app.studio.server import PatientProtocol, answer_problems
from dousa.errors import OptionError

pytest.importorskip("cryptography", reason="pip install 'dousa[share]'")
pytest.importorskip("segno", reason="pip install 'dousa[share]'")

from dousa.app.studio import shared as sharing_server
from dousa.app.studio.content.sharing import provide_certificate
from dousa.app.studio.shared import create_shared_app, make_sharing, router
from patience import PATIENCE

HERE = IPv4Address("127.0.0.1")
HOST = "192.168.1.20:8865"


@pytest.fixture
def judged(studio, trained_library):
    """Two evaluations of that studio: their jobs."""
    files = sorted((trained_library.parent / "motions" / "kick_left").glob("*.bvh"))[:3]
    first, second, third = upload(studio, *files)
    jobs = []
    for performance in (second, third):
        request = {"references": [first], "performance": performance}
        jobs.append(wait_for(studio, studio.post("/api/jobs/evaluate", json=request).json()["id"]))
    assert [job["state"] for job in jobs] == ["done", "done"]
    return [job["id"] for job in jobs]


@dataclass
class Visitor:
    """Somebody on the network, and the links of the studio that they look at."""

    client: object
    links: object

    def come_by(self, report=None, inbox=None):
        self.client.cookies.clear()
        link = self.links.add(report, inbox)
        answer = self.client.get("/", params={"key": link.token}, follow_redirects=False)
        assert answer.status_code == 303
        return link


@pytest.fixture
def visitor(studio):
    from starlette.testclient import TestClient

    from dousa.app.studio.content.sharing import ShareLinks

    links = ShareLinks()
    app = create_shared_app(studio.app.state.studio, HOST, links, answer_problems)
    with TestClient(app, f"https://{HOST}") as client:
        yield Visitor(client, links)


def list_routes(app):
    """(method, path) of every route, those of routers that hang on routers too."""
    found = set()
    for path, said in app.openapi()["paths"].items():
        found |= {(method.upper(), path) for method in said}
    return found


def fill(path, job):
    return re.sub(r"\{(\w+)\}", lambda match: {"job_id": job, "clip_id": "1"}.get(match[1], "1"), path)


# --- nothing is written, whoever asks


def test_no_route_of_the_studio_writes_from_the_network(studio, visitor, judged, library_copy):
    """Route by route over the whole table, by every method: only the few that read are there."""
    routes = list_routes(studio.app)
    assert len(routes) > 60
    visitor.come_by()
    before = library_copy.read_bytes()
    changes = studio.get("/api/journal").json()
    answered = set()
    for path in {path for _, path in routes} | {"/code", "/enter", "/library", "/evaluate", "/api/openapi.json"}:
        for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "X"):
            answer = visitor.client.request(method, fill(path, judged[0]))
            if method in ("GET", "HEAD"):
                assert answer.status_code in (200, 404, 405, 422), (method, path, answer.status_code)
                if answer.status_code == 200:
                    answered.add(path)
            else:
                assert answer.status_code == 405, (method, path, answer.status_code)
    assert answered == {"/api/clips"}  # of the studio's addresses; the others have names of their own
    assert library_copy.read_bytes() == before
    assert studio.get("/api/journal").json() == changes
    assert {job["id"] for job in studio.get("/api/jobs").json()["jobs"]} == set(judged)


def test_every_route_that_is_shared_only_reads_but_for_the_inbox():
    assert len(router.routes) == 9
    for route in router.routes:
        assert route.methods == {"GET"} or (route.methods, route.path) == ({"POST"}, "/api/inbox"), route.path


def test_a_body_is_not_taken(visitor):
    visitor.come_by()
    assert visitor.client.request("GET", "/api/clips", content=b"x" * 10).status_code == 413
    assert visitor.client.request("GET", "/api/clips", content=iter([b"x"] * 10)).status_code == 413


def test_one_can_look(visitor, judged):
    visitor.come_by()
    assert {one["id"] for one in visitor.client.get("/api/reports").json()["reports"]} == set(judged)
    report = visitor.client.get(f"/api/reports/{judged[0]}").json()
    assert report["parts"]["advice"]
    assert set(report) == {"frame", "notes", "parts", "data", "player"}
    page = visitor.client.get(f"/api/reports/{judged[0]}/report.html")
    assert page.headers["content-type"].startswith("text/html")
    assert "attachment" in page.headers["content-disposition"]
    clips = visitor.client.get("/api/clips?text=squat&limit=2").json()
    assert clips["total"] == 6
    assert set(clips["items"][0]) == {"id", "name", "category", "duration"}
    assert visitor.client.get("/api/motions/player?motion=clip:1").json()["performance"]
    assert visitor.client.get("/api/motions/miniature?motion=clip:1").content
    for page in ("/", f"/report?job={judged[0]}"):
        assert visitor.client.get(page).status_code == 200


# --- who comes in


@pytest.mark.parametrize("path", ["/", "/report", "/api/reports", "/api/clips", "/static/x/player.js", "/nothing"])
def test_without_a_link_nothing_is_seen(visitor, path):
    visitor.links.add(None)
    answer = visitor.client.get(path)
    assert answer.status_code == 401
    assert "<form" not in answer.text  # there is no token to give


@pytest.mark.parametrize(
    "headers", [{"authorization": f"Bearer {TOKEN}"}, {"cookie": f"__Host-dousa_share_8865={TOKEN}"}]
)
def test_the_owners_token_opens_nothing_here(visitor, headers):
    assert visitor.client.get("/api/reports", headers=headers).status_code == 401
    assert visitor.client.get("/", params={"key": TOKEN}).status_code == 401
    assert visitor.client.get("/", params={"token": TOKEN}).status_code == 401


def test_a_link_opens_nothing_of_the_owner(studio, visitor):
    token = visitor.links.add(None).token
    del studio.headers["authorization"]
    assert studio.get("/api/info", headers={"authorization": f"Bearer {token}"}).status_code == 401
    for name in ("token", "code", "key"):
        assert studio.get("/library", params={name: token}, follow_redirects=False).status_code == 401
    cookie = {"cookie": f"dousa_8765={token}; __Host-dousa_share_8865={token}"}
    assert studio.get("/api/info", headers=cookie).status_code == 401


def test_the_cookie_is_for_this_address_and_its_pages_alone(visitor):
    link = visitor.links.add(None)
    answer = visitor.client.get("/", params={"key": link.token}, follow_redirects=False)
    cookie = answer.headers["set-cookie"].lower()
    assert answer.headers["location"] == "/"
    assert cookie.startswith("__host-dousa_share_8865=")
    for rule in ("httponly", "secure", "samesite=lax", "path=/"):
        assert rule in cookie
    assert "domain" not in cookie


def test_a_link_that_was_taken_back_opens_nothing_any_more(visitor):
    link = visitor.come_by()
    assert visitor.client.get("/api/reports").status_code == 200
    visitor.links.revoke(link.number)
    assert visitor.client.get("/api/reports").status_code == 401
    assert visitor.client.get("/", params={"key": link.token}).status_code == 401


def test_the_link_of_a_report_shows_that_report_only(visitor, judged):
    visitor.come_by(judged[0])
    seen = visitor.client.get("/api/reports").json()
    assert [one["id"] for one in seen["reports"]] == [judged[0]]
    assert visitor.client.get(f"/api/reports/{judged[0]}").status_code == 200
    for path in (
        f"/api/reports/{judged[1]}", f"/api/reports/{judged[1]}/report.html", f"/api/reports/{judged[1]}/exercise",
        "/api/clips", "/api/motions/player?motion=clip:1", "/api/motions/miniature?motion=clip:1",
    ):  # fmt: skip
        assert visitor.client.get(path).status_code == 403, path


def test_uploads_and_jobs_are_not_shown(studio, visitor, bvh):
    visitor.come_by()
    motion = upload(studio, bvh)[0]["motion"]
    assert studio.get("/api/motions/player", params={"motion": motion}).status_code == 200
    for name in (motion, "job:0123456789abcdef"):
        for path in ("/api/motions/player", "/api/motions/miniature"):
            assert visitor.client.get(path, params={"motion": name}).status_code == 403
    for part in ("../../etc/passwd", "%2e%2e/%2e%2e/", "report.html/../curves.csv", "..%2f..%2fjob.json"):
        assert visitor.client.get(f"/api/reports/{part}").status_code in (404, 422)
        assert visitor.client.get(f"/static/x/{part}").status_code == 404


def test_the_page_of_visitors_loads_nothing_that_asks_for_jobs():
    """A module that polls jobs does so wherever it is loaded; visitors have no such address."""
    static = Path(sharing_server.__file__).parent / "static"
    loaded, waiting = set(), [static / "shared" / "main.js"]
    while waiting:
        module = waiting.pop()
        if module not in loaded:
            loaded.add(module)
            found = re.findall(
                r"""^import [^;]*?["'](\.[^"']+)["'];""", module.read_text(encoding="utf-8"), re.MULTILINE
            )
            waiting += [(module.parent / name).resolve() for name in found]
    assert {"main.js", "dom.js"} <= {module.name for module in loaded} and static / "core" / "jobs.js" not in loaded


# --- an inbox


FILM = b"\0\0\0\x18ftypisom" + b"\0" * 100


def inbox_of(studio, visitor):
    inbox = studio.app.state.studio.workspace.new_inbox()
    return visitor.come_by(inbox=inbox).inbox


def send(visitor, name="film.mp4", content=FILM, **headers):
    return visitor.client.post("/api/inbox", params={"name": name}, content=content, headers=headers)


def test_one_films_into_an_inbox_of_ones_own_and_sees_nothing_else(studio, visitor, judged, bvh):
    inbox = inbox_of(studio, visitor)
    assert visitor.client.get("/api/inbox").json()["files"] == []
    for content, name in ((FILM, "image.mov"), (FILM + b"2", "image.mov"), (bvh.read_bytes(), "walk.bvh")):
        assert send(visitor, name, content).status_code == 201
    names = [one["name"] for one in visitor.client.get("/api/inbox").json()["files"]]
    assert len(set(names)) == 3 and sum(name.endswith("image.mov") for name in names) == 2
    assert visitor.client.get("/film").status_code == 200
    assert visitor.client.get("/api/reports").json() == {"reports": [], "everything": False, "page": "/film"}
    for path in (
        f"/api/reports/{judged[0]}", "/api/clips", "/api/motions/player?motion=clip:1",
        f"/api/motions/player?motion=file:{inbox}/{names[0]}", f"/api/reports/{judged[0]}/report.html",
    ):  # fmt: skip
        assert visitor.client.get(path).status_code in (403, 404), path
    # The owner sees what came; another inbox is empty.
    (seen,) = studio.get("/api/share").json()["inboxes"]
    assert seen["batch"] == inbox and len(seen["files"]) == 3
    assert [one["motion"] is None for one in seen["files"]] == [not name.endswith("bvh") for name in names]
    inbox_of(studio, visitor)
    assert visitor.client.get("/api/inbox").json()["files"] == []


def test_an_inbox_that_is_emptied_goes_on(studio, visitor, monkeypatch):
    inbox = inbox_of(studio, visitor)
    monkeypatch.setattr(sharing_server, "_MOST_FILES", 1)
    name = "動" * 60 + ".mp4"  # 184 bytes, with its number more than a name may have
    assert send(visitor, name).status_code == 201
    assert send(visitor).status_code == 413
    studio.post("/api/uploads", params={"name": "cameras.toml", "batch": inbox}, content=b"a = 1")
    (sent,) = visitor.client.get("/api/inbox").json()["files"]  # the owner's file beside it is not told
    assert sent["name"].endswith("動.mp4")
    workspace = studio.app.state.studio.workspace
    os.utime(workspace.batch_folder(inbox), (0, 0))
    assert workspace.list_unused("") == []
    assert studio.delete(f"/api/uploads/{inbox}").status_code == 200
    assert visitor.client.get("/api/inbox").json()["files"] == []
    assert send(visitor).status_code == 201


@pytest.mark.parametrize(
    ("name", "content", "status"),
    [
        ("a.zip", b"PK\3\4", 415), ("a.pkl", b"\x80", 415), ("a.toml", b"a=1", 415), ("a", FILM, 415),
        ("a.npz", b"PK\3\4", 415), ("a.html", b"<p>", 415), ("a.mp4", b"#EXTM3U\nfile:///etc/passwd", 415),
        ("a.mp4", b"", 415), ("../a.mp4", FILM, 422), ("/a.mp4", FILM, 422), (".a.mp4", FILM, 422),
        ("con.mp4", FILM, 422), ("a\n.mp4", FILM, 422), ("a" * 201 + ".mp4", FILM, 422),
    ],
)  # fmt: skip
def test_an_inbox_refuses(studio, visitor, name, content, status):
    inbox = inbox_of(studio, visitor)
    answer = send(visitor, name, content)
    assert answer.status_code == status, answer.text
    assert studio.app.state.studio.workspace.files(inbox) == []


def test_only_a_link_with_an_inbox_sends(studio, visitor, judged):
    for report in (None, judged[0]):
        visitor.come_by(report)
        assert send(visitor).status_code == 405
        assert visitor.client.get("/api/inbox").status_code == 403
    visitor.client.cookies.clear()
    assert send(visitor).status_code == 401
    inbox_of(studio, visitor)
    for method in ("PUT", "PATCH", "DELETE"):
        assert visitor.client.request(method, "/api/inbox", content=FILM).status_code == 405
    assert visitor.client.post("/api/clips", content=FILM).status_code == 405
    assert send(visitor, **{"origin": "https://evil.example"}).status_code == 403
    assert send(visitor, **{"sec-fetch-site": "cross-site"}).status_code == 403


def test_an_inbox_has_an_end(studio, visitor, monkeypatch):
    inbox = inbox_of(studio, visitor)
    monkeypatch.setattr(sharing_server, "_MOST_FILES", 2)
    monkeypatch.setattr(sharing_server, "_MOST_BYTES", 300)
    assert send(visitor).status_code == 201
    assert send(visitor, content=FILM + b"\0" * 200).status_code == 413  # bytes of both
    assert send(visitor).status_code == 201
    assert send(visitor).status_code == 413  # files
    assert visitor.client.post("/api/inbox?name=a.mp4", content=iter([FILM])).status_code == 411
    most = studio.app.state.studio.settings.most_bytes
    assert send(visitor, **{"content-length": str(most + 1)}).status_code == 413
    for _ in range(4):
        sharing_server._sending.acquire(blocking=False)
    assert send(visitor).status_code == 429
    for _ in range(4):
        sharing_server._sending.release()
    visitor.links.clear()
    assert send(visitor).status_code == 401
    left = [path for path in studio.app.state.studio.workspace.batch_folder(inbox).iterdir() if "part" in path.name]
    assert left == []


def test_inboxes_are_made_only_where_they_were_asked_for(open_studio):
    assert open_studio.get("/api/share").json()["films"] is False
    assert open_studio.post("/api/share/links", json={"films": True}).status_code == 409
    open_studio.app.state.studio.sharing.takes_films = True
    one, other = (open_studio.post("/api/share/links", json={"films": True}).json() for _ in range(2))
    assert one["inbox"] != other["inbox"] and one["url"] != other["url"]
    state = open_studio.get("/api/share").json()
    phone = Phone(state["address"])
    assert phone.get(one["url"].removeprefix(state["address"])) == 303
    assert phone.get("/film") == 200
    assert phone.get("/api/clips") == 403


# --- other pages in the same browser, and names that lead here


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": "evil.example"}, 421),
        ({"host": "evil.example:8865"}, 421),
        ({"host": "127.0.0.1:8865"}, 421),
        ({"host": "localhost:8765"}, 421),
        ({"host": "192.168.1.20"}, 421),
        ({"host": "192.168.1.20:8866"}, 421),
        ({"host": "192.168.1.20.evil.example:8865"}, 421),
        ({"host": ""}, 421),
        ({"origin": "https://evil.example"}, 403),
        ({"origin": f"http://{HOST}"}, 403),
        ({"origin": f"{HOST}"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "https://192.168.1.20:8765"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, 200),  # a link in a message
        ({"origin": f"https://{HOST}", "sec-fetch-site": "same-origin"}, 200),
    ],
)
def test_others_are_kept_out_by_name(visitor, headers, status):
    visitor.come_by()
    answer = visitor.client.get("/api/reports", headers=headers)
    assert answer.status_code == status
    assert "access-control-allow-origin" not in answer.headers


def test_the_studio_does_not_answer_to_the_shared_name(studio):
    for host in (HOST, "192.168.1.20:8765"):
        assert studio.get("/api/info", headers={"host": host}).status_code == 421
    assert studio.get("/api/info", headers={"origin": f"https://{HOST}"}).status_code == 403


def test_pages_run_nothing_from_elsewhere(visitor):
    visitor.come_by()
    policy = visitor.client.get("/").headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy


# --- the owner's side


def test_nothing_is_shared_unless_it_was_asked_for(studio):
    assert studio.get("/api/share").json()["possible"] is False
    for path, body in (("begin", {}), ("end", {}), ("links", {"report": None}), ("revoke", {"number": "x"})):
        assert studio.post(f"/api/share/{path}", json=body).status_code == 409
    assert 'id="share-button"' not in studio.get("/library").text


@pytest.fixture
def open_studio(studio):
    """A studio that shares at this machine's own address."""
    inner = studio.app.state.studio
    inner.sharing = make_sharing(inner, HERE, answer_problems, PatientProtocol)
    inner.sharing.begin()
    yield studio
    inner.sharing.end()


class Phone:
    """Asks over TLS; the cookie is kept."""

    def __init__(self, address):
        self.host = address.removeprefix("https://")
        self.cookie = ""

    def get(self, path):
        trust = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
        connection = http.client.HTTPSConnection(self.host, context=trust, timeout=PATIENCE)
        connection.request("GET", path, headers={"cookie": self.cookie, "connection": "close"})
        answer = connection.getresponse()
        answer.read()
        if answer.getheader("set-cookie"):
            self.cookie = answer.getheader("set-cookie").split(";")[0]
        connection.close()
        return answer.status


def test_a_link_from_its_making_to_its_end(open_studio, judged):
    state = open_studio.get("/api/share").json()
    assert state["possible"] and state["address"].startswith("https://127.0.0.1:")
    link = open_studio.post("/api/share/links", json={"report": judged[0]}).json()
    assert link["code"].startswith("data:image/svg+xml")
    assert link == open_studio.post("/api/share/links", json={"report": judged[0]}).json()
    phone = Phone(state["address"])
    assert phone.get(link["url"].removeprefix(state["address"])) == 303
    assert phone.get(f"/api/reports/{judged[0]}") == 200
    assert phone.get(f"/api/reports/{judged[1]}") == 403
    left = open_studio.post("/api/share/revoke", json={"number": link["number"]}).json()
    assert left["links"] == []
    assert phone.get(f"/api/reports/{judged[0]}") == 401

    everything = open_studio.post("/api/share/links", json={"report": None}).json()
    assert phone.get(everything["url"].removeprefix(state["address"])) == 303
    assert open_studio.post("/api/share/end").json()["address"] is None
    with suppress(OSError):  # unless another studio has the port by now
        assert phone.get("/api/reports") == 401
    assert open_studio.post("/api/share/links", json={"report": None}).status_code == 409
    # Begun again, it has the same certificate, and earlier links open nothing.
    again = open_studio.post("/api/share/begin").json()
    assert again["fingerprint"] == state["fingerprint"]
    phone = Phone(again["address"])
    assert phone.get(everything["url"].partition("/?")[2] and "/?" + everything["url"].partition("/?")[2]) == 401
    assert open_studio.post("/api/share/links", json={"report": "0123456789abcdef"}).status_code == 404
    assert 'id="share-button"' in open_studio.get("/library").text


def test_the_link_ends_with_the_studio(library_copy):
    app = create_app(Settings(library_copy, token=TOKEN))
    inner = app.state.studio
    inner.sharing = make_sharing(inner, HERE, answer_problems, PatientProtocol)
    phone = Phone(inner.sharing.begin().address)
    assert phone.get("/") == 401
    inner.close()
    with pytest.raises(OSError):
        phone.get("/")


def test_who_speaks_without_encryption_hears_nothing(open_studio):
    host, port = open_studio.get("/api/share").json()["address"].removeprefix("https://").split(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        assert not plain.recv(1000).startswith(b"HTTP")


def test_who_says_nothing_is_not_waited_for_and_takes_no_room(open_studio, monkeypatch):
    """More connections than one address may have: the others are closed at once, and the studio goes on."""
    monkeypatch.setattr(sharing_server, "_MOST_OF_ONE", 5)
    monkeypatch.setitem(sharing_server._serve.__kwdefaults__, "handshake_s", 5.0)
    open_studio.post("/api/share/end")
    host, port = open_studio.post("/api/share/begin").json()["address"].removeprefix("https://").split(":")
    silent = [socket.create_connection((host, int(port)), timeout=PATIENCE) for _ in range(12)]
    try:
        for one in silent[5:]:
            assert one.recv(1) == b""
        assert open_studio.get("/api/info").status_code == 200
        for one in silent[:5]:  # after the time for a handshake
            assert one.recv(1) == b""
        assert Phone(f"https://{host}:{port}").get("/") == 401
    finally:
        for one in silent:
            one.close()


def test_the_certificate_is_of_one_address_and_nobody_else_reads_it(tmp_path):
    from cryptography import x509

    one = provide_certificate(tmp_path, HERE)
    assert stat.S_IMODE(one.path.stat().st_mode) == 0o600
    signed = x509.load_pem_x509_certificate(one.path.read_bytes())
    assert (signed.not_valid_after_utc - signed.not_valid_before_utc).days <= 398
    assert signed.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False
    assert provide_certificate(tmp_path, HERE) == one
    other = provide_certificate(tmp_path, IPv4Address("192.168.1.20"))
    assert other.fingerprint != one.fingerprint
    other.path.write_bytes(b"damaged")
    assert provide_certificate(tmp_path, HERE).fingerprint not in (one.fingerprint, other.fingerprint)
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(one.path)


@pytest.mark.parametrize(
    ("address", "code"),
    [("8.8.8.8", "public"), ("0.0.0.0", "no_address"), ("224.0.0.1", "no_address"), ("::1", "no_address"),
     ("evil.example", "no_address"), ("192.168.1", "no_address")],
)  # fmt: skip
def test_only_an_address_of_a_network_of_ones_own_is_taken(address, code):
    with pytest.raises(OptionError) as caught:
        find_share_address(address)
    assert caught.value.code.startswith(f"studio_share.{code}")


def test_an_address_of_another_machine_is_refused(studio):
    inner = studio.app.state.studio
    with pytest.raises(OptionError) as caught:
        make_sharing(inner, IPv4Address("192.168.254.253"), answer_problems, PatientProtocol).begin()
    assert caught.value.code == "studio_share.cannot_listen"
