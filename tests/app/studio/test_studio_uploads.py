"""Hostile uploads: none gets through, nothing is written outside the studio's folder."""

import io
import os
import stat
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from dousa.app.studio import Settings, create_app
from dousa.app.studio.core.workspace import safe_parts
from dousa.errors import DousaError

GOOD = b"HIERARCHY\nROOT Hips\n"
NOT_MOTIONS = {
    "program.bvh": b"\x7fELF\x02\x01\x01" + b"\0" * 100,
    "page.bvh": b"<!doctype html><script>alert(1)</script>",
    "program.c3d": b"MZ\x90\0" + b"\0" * 600,
    "short.c3d": b"\x02\x50",
    "page.npz": b"<html>",
    "page.amc": b"<html>",
    "page.trc": b"hello",
    "page.glb": b"<html>",
    "binary.gltf": b"glTF\x02\0\0\0",
    "page.npy": b"<html>",
    "program.mvnx": b"\x7fELF\x02\x01\x01" + b"\0" * 100,
    "binary.tsv": b"NO_OF_FRAMES\0",
    "binary.toml": b"a = 1\0\0",
    "empty.bvh": b"",
    "run.sh": b"#!/bin/sh\n",
    "page.html": b"<html>",
    "noname": GOOD,
    "library.dousa": b"SQLite format 3\0",
}


def everything_below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def make_zip(members, **options) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members:
            packed.writestr(name, content, **options)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "name",
    [
        "../evil.bvh", "a/../../evil.bvh", "/etc/evil.bvh", "\\\\server\\evil.bvh", "C:\\evil.bvh", "C:evil.bvh",
        "..\\evil.bvh", "a/..", ".", "", "/", ".hidden.bvh", "a/.ssh/x.bvh", "x\0.bvh", "x\n.bvh", "x" * 300 + ".bvh",
        "a/" * 20 + "x.bvh", "aux:x.bvh", "x.bvh ", "x.bvh.", "a\u202e\x7f.bvh", "__MACOSX/x.bvh",
    ],
)  # fmt: skip
def test_names_that_lead_elsewhere_are_refused(studio, name, tmp_path):
    before = everything_below(tmp_path)
    answer = studio.post("/api/uploads", params={"name": name}, content=GOOD)
    assert 400 <= answer.status_code < 500, answer.text
    assert everything_below(tmp_path) == before


@pytest.mark.parametrize("name", ["kick/anna_1.bvh", "動作/蹴り.bvh", "./a/b.bvh", "a b (1).bvh", "a\\b.bvh"])
def test_ordinary_names_are_taken(studio, name):
    answer = studio.post("/api/uploads", params={"name": name}, content=GOOD)
    assert answer.status_code == 201, answer.text
    assert answer.json()["files"][0]["name"] == "/".join(safe_parts(name))


@pytest.mark.parametrize("name", NOT_MOTIONS)
def test_what_is_no_motion_is_refused(studio, name, tmp_path):
    before = everything_below(tmp_path)
    answer = studio.post("/api/uploads", params={"name": name}, content=NOT_MOTIONS[name])
    assert answer.status_code == 415, answer.text
    assert answer.json()["problem"]
    assert everything_below(tmp_path) == before


def test_an_upload_over_the_limit_is_refused_while_it_comes(library_copy, tmp_path):
    from starlette.testclient import TestClient

    settings = Settings(library_copy, token="x", most_bytes=1000)
    with TestClient(create_app(settings), "http://127.0.0.1:8765", headers={"authorization": "Bearer x"}) as client:
        before = everything_below(tmp_path)
        said = client.post("/api/uploads?name=a.bvh", content=GOOD + b" " * 2000)
        assert said.status_code == 413

        def endless():  # without a length, so that only counting helps
            for _ in range(100):
                yield GOOD * 10

        assert client.post("/api/uploads?name=a.bvh", content=endless()).status_code in (400, 413)
        assert client.post("/api/jobs/train", content=b" " * 3_000_000).status_code == 413
        assert everything_below(tmp_path) == before


def test_a_zip_keeps_its_folders_and_says_what_it_left_out(studio):
    packed = make_zip([("kick/a.bvh", GOOD), ("walk/b.bvh", GOOD), ("notes.exe", b"MZ"), ("../x.bvh", GOOD)])
    answer = studio.post("/api/uploads?name=all.zip", content=packed).json()
    assert {file["name"] for file in answer["files"]} == {"kick/a.bvh", "walk/b.bvh"}
    assert {item["name"] for item in answer["refused"]} == {"notes.exe", "../x.bvh"}
    assert studio.get(f"/api/uploads/{answer['batch']}").json()["files"] == answer["files"]
    added = studio.post(
        f"/api/uploads?name=all.zip&batch={answer['batch']}",
        content=make_zip(
            [
                ("c.bvh", GOOD),
                ("kick/a.bvh", GOOD),
                ("kick/a.bvh/d.bvh", GOOD),
                ("./c.bvh", GOOD + b"twice"),
            ]
        ),
    ).json()
    assert [(file["name"], file["bytes"]) for file in added["files"]] == [("c.bvh", 25), ("kick/a.bvh", 20)]
    assert [item["code"] for item in added["refused"]] == ["studio_files.folder_is_file"]
    workspace = studio.app.state.studio.workspace
    assert [path.name for path in workspace.root.glob("files/[!.]*")] == [answer["batch"]]


def link_zip() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        member = zipfile.ZipInfo("link.bvh")
        member.external_attr = (stat.S_IFLNK | 0o777) << 16
        packed.writestr(member, "/etc/passwd")
    return buffer.getvalue()


def lying_zip() -> bytes:
    """A member that unpacks to more than the directory says."""
    content = bytearray(make_zip([("a.bvh", GOOD + b" " * 5_000_000)]))
    at = content.rfind(b"PK\x01\x02")
    content[at + 24 : at + 28] = struct.pack("<I", 100)
    return bytes(content)


HOSTILE_ARCHIVES = {
    "a bomb": lambda: make_zip([("a.bvh", GOOD + b" " * 60_000_000)]),
    "many bombs": lambda: make_zip([(f"{k}.bvh", GOOD + b" " * 3_000_000) for k in range(30)]),
    "a bomb in an archive": lambda: make_zip([("inner.zip", make_zip([("a.bvh", GOOD)]))]),
    "a link": link_zip,
    "a lie about the size": lying_zip,
    "only ways out": lambda: make_zip([("../a.bvh", GOOD), ("/b.bvh", GOOD), ("..\\c.bvh", GOOD)]),
    "folder upon folder": lambda: make_zip([("a/" * 400 + "b.bvh", GOOD)]),
    "endless names": lambda: make_zip([("a" * 60_000 + ".bvh", GOOD)]),
    "more files than can be": lambda: make_zip([(f"{k}.bvh", b"") for k in range(20_001)]),
    "nothing": lambda: make_zip([]),
    "no archive": lambda: b"PK\x03\x04 not really",
    "half an archive": lambda: make_zip([("a.bvh", os.urandom(5000))])[:3000],
    "no motions": lambda: make_zip([("a.bvh", b"MZ\0\0"), ("b.exe", b"MZ")]),
}


@pytest.mark.parametrize("kind", HOSTILE_ARCHIVES)
def test_hostile_archives_are_refused(studio, kind, tmp_path):
    before = everything_below(tmp_path)
    answer = studio.post("/api/uploads?name=all.zip", content=HOSTILE_ARCHIVES[kind]())
    assert answer.status_code in (413, 415), answer.text
    assert everything_below(tmp_path) == before


def test_a_batch_holds_only_so_many_files(library_copy, tmp_path):
    from starlette.testclient import TestClient

    settings = replace(Settings(library_copy, token="x"), most_files=3)
    with TestClient(create_app(settings), "http://127.0.0.1:8765", headers={"authorization": "Bearer x"}) as client:
        batch = client.post("/api/uploads?name=0.bvh", content=GOOD).json()["batch"]
        codes = [client.post(f"/api/uploads?name={k}.bvh&batch={batch}", content=GOOD).status_code for k in (1, 2, 3)]
        assert codes == [201, 201, 413]
        packed = make_zip([(f"{k}.bvh", GOOD) for k in range(4)])
        before = everything_below(tmp_path)
        assert client.post("/api/uploads?name=all.zip", content=packed).status_code == 413
        assert everything_below(tmp_path) == before


@pytest.mark.parametrize("batch", ["0" * 16, "../../../../etc", "0" * 15, "G" * 16, "%2e%2e"])
def test_batches_that_are_not_there(studio, batch):
    assert studio.get(f"/api/uploads/{batch}").status_code == 404
    assert studio.post("/api/uploads", params={"name": "a.bvh", "batch": batch}, content=GOOD).status_code in (404, 422)
    assert studio.post("/api/jobs/add", json={"batch": batch}).status_code in (404, 422)


def test_a_file_that_looks_like_a_motion_and_is_none_is_told_by_the_job(studio, wait_job):
    batch = studio.post("/api/uploads?name=kick/bad.bvh", content=GOOD + b"nonsense").json()["batch"]
    job = wait_job(studio, studio.post("/api/jobs/add", json={"batch": batch}).json()["id"])
    assert job["state"] == "done"
    assert job["result"]["added"] == []
    (skipped,) = job["result"]["skipped"]
    assert skipped["path"] == "kick/bad.bvh"
    assert "/" not in skipped["reason"].split(":")[0].replace("kick/bad.bvh", "")


def test_forms_are_told_apart_from_files(studio):
    answer = studio.post("/api/uploads?name=a.bvh", files={"file": ("a.bvh", GOOD)})
    assert answer.status_code == 415
    assert "--data-binary" in answer.json()["problem"]


def test_links_in_the_studios_folder_are_not_followed(studio, tmp_path):
    batch = studio.post("/api/uploads?name=a.bvh", content=GOOD).json()["batch"]
    folder = studio.app.state.studio.workspace.batch_folder(batch)
    (folder / "out").symlink_to(tmp_path)
    answer = studio.post(f"/api/uploads?name=out/x.bvh&batch={batch}", content=GOOD)
    assert answer.status_code == 422
    assert not (tmp_path / "x.bvh").exists()


def test_safe_parts_refuses_or_stays_below():
    """Whatever text comes, what is let through stays below the folder."""
    from hypothesis import given
    from hypothesis import strategies as st

    pieces = st.sampled_from(["..", ".", "/", "\\", "a", "b.bvh", "C:", "\0", "~", "%2e", " ", "."])

    @given(st.lists(pieces, max_size=8).map("".join))
    def check(name):
        try:
            parts = safe_parts(name)
        except DousaError:
            return
        root = Path("/root/of/it")
        assert Path(os.path.normpath(root.joinpath(*parts))).is_relative_to(root)
        assert all(part not in ("", ".", "..") for part in parts)

    check()
