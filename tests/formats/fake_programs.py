"""Programs that stand for Blender and assimp in the tests: an "FBX" of theirs is a mark and then a GLB."""

import sys

FBX_MARK = b"Kaydara FBX Binary  \x00\x1a\x00"
DAE_MARK = b"<COLLADA>".ljust(len(FBX_MARK))

_SCRIPT = """#!{python}
import sys, time
words = sys.argv[1:]
behaviour = {behaviour!r}
if "--" in words:
    task, source, target = words[words.index("--") + 1 :][:3]
else:
    task, source, target = "read", words[1], words[2]
data = open(source, "rb").read()
mark = {mark!r}
if behaviour == "hang":
    time.sleep(3600)
elif behaviour == "crash":
    print("Error: no such\\nbone\\a")
    sys.exit(1)
elif behaviour == "garbage":
    open(target, "wb").write(b"hello")
elif behaviour == "flood":
    while True:
        print("x" * 1_000_000)
elif behaviour == "works":
    open(target, "wb").write(data[len(mark):] if task == "read" else mark + data)
"""


def install(folder, monkeypatch, *, blender=None, assimp=None):
    """Programs of a behaviour ("works", "hang", "crash", "garbage", "silent", "flood"); None for no such program."""
    bin_folder = folder / "bin"
    bin_folder.mkdir(exist_ok=True)
    monkeypatch.setenv("PATH", str(bin_folder))
    for name, behaviour in (("blender", blender), ("assimp", assimp)):
        monkeypatch.delenv(f"DOUSA_{name.upper()}", raising=False)
        path = bin_folder / name
        path.unlink(missing_ok=True)
        if behaviour is not None:
            path.write_text(_SCRIPT.format(python=sys.executable, behaviour=behaviour, mark=FBX_MARK))
            path.chmod(0o755)


def install_quick(folder, monkeypatch):
    """An assimp that works and starts at once, for the fuzzer."""
    path = folder / "quick-assimp"
    path.write_text(f'#!/bin/sh\ntail -c +{len(FBX_MARK) + 1} "$2" > "$3"\n')
    path.chmod(0o755)
    monkeypatch.setenv("DOUSA_ASSIMP", str(path))
    monkeypatch.setenv("DOUSA_BLENDER", "")
