"""What is wrong with files and commands is said in Japanese where that is asked for, without English sentences."""

import re
from pathlib import Path

import numpy as np
import pytest

from dousa.formats.registry import write_motion
from dousa.motion import Trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion

JAPANESE = re.compile(r"[ぁ-んァ-ヶ一-龠]")
# Three words of small letters in a row are no name, option or unit any more.
ENGLISH = re.compile(r"(?<![\w./-])[a-z]{2,}(?: [a-z]{2,}){2,}(?![\w/-])")

# What Python and PyYAML say of an expression and a file is theirs.
FOREIGN = ("missing ), unterminated subpattern at position 0", "did not find expected ',' or ']'")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A good motion, and files that are damaged in every way that readers look for."""
    folder = tmp_path_factory.mktemp("damaged")
    write_motion(make_motion("walk", draw_performer(1)), folder / "good.bvh")
    bvh = (folder / "good.bvh").read_text()
    rows = bvh.splitlines()
    first = next(number for number, row in enumerate(rows) if row.startswith("Frame Time")) + 1
    write_motion(make_motion("walk", draw_performer(1)), folder / "good.trc")
    write_motion(make_motion("walk", draw_performer(1)), folder / "good.c3d")
    write_motion(make_motion("walk", draw_performer(1)), folder / "good.npz")
    write_motion(Trajectories(("foo", "bar"), np.zeros((5, 2, 3)), 30), folder / "dots.trc")
    texts = {
        "empty.bvh": "",
        "head.bvh": "HIERARCHY\n",
        "open.bvh": "HIERARCHY\nROOT hips\n{\n",
        "nonsense.bvh": "HIERARCHY\nnonsense\n",
        "few.bvh": "\n".join([*rows[:first], rows[first].rsplit(" ", 4)[0], *rows[first + 1 :]]),
        "cut.bvh": "\n".join(rows[: first + 3]),
        "letters.bvh": bvh.replace(rows[first].split()[0], "abc", 1),
        "rate.bvh": re.sub(r"Frame Time: \S+", "Frame Time: 0", bvh),
        "alone.amc": "#!comment\n1\nroot 0 0 0 0 0 0\n",
        "bad.asf": ":version 1.10\n:root\n",
        "empty.trc": "",
        "text.trc": "nothing of a table\n" * 5,
        "text.c3d": "no C3D at all",
        "text.npz": "no npz at all",
        "name.xyz": "x",
        "map.toml": "left_knee = ",
        "weights.toml": "arms = many\n",
        "furi.txt": "first to last\n",
        "cameras.toml": "[cam]\nmatrix = 3\n",
        "cameras.xml": "<calibration><cameras></cameras></calibration>",
        "cameras.yaml": "%YAML:1.0\n---\nK: [1, 2\n",
        "body.toml": "nonsense = 1\n",
        "lib.dousa": "no library",
        "table.csv": "a,b\n1,2\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name in ("good.trc", "good.c3d", "good.npz"):
        whole = (folder / name).read_bytes()
        (folder / f"cut{name[4:]}").write_bytes(whole[: len(whole) // 3])
    (folder / "folder.bvh").mkdir()
    np.savez(folder / "seen.npz", mask_packed=np.zeros((1, 2, 8, 1), np.uint8), width=8, height=8)
    return folder


READ = [
    *("empty.bvh", "head.bvh", "open.bvh", "nonsense.bvh", "few.bvh", "letters.bvh", "rate.bvh"),
    *("alone.amc", "bad.asf", "empty.trc", "text.trc", "text.c3d", "text.npz", "cut.npz"),
    *("name.xyz", "folder.bvh", "none.bvh"),
]

COMMANDS = [
    *(f"info {name}" for name in READ),
    "info good.bvh --unit furlong",
    "info good.bvh --up w",
    "info good.bvh --read joint_map=map.toml",
    "info good.bvh --read joint_map=none.toml",
    "convert good.bvh out.fbx",
    "convert good.bvh none/out.bvh",
    "convert good.bvh out.bvh --frame-rate 0",
    "convert dots.trc out.bvh",
    "plot good.bvh -o out.jpg",
    "add new.dousa none",
    "add new.dousa good.bvh --category-from mood",
    "add new.dousa good.bvh --category-from name:(",
    "add new.dousa good.bvh --category-from csv:table.csv",
    "add new.dousa good.bvh --takes --category-from name:(.)",
    "add lib.dousa good.bvh",
    "search lib.dousa good.bvh",
    "search none.dousa good.bvh",
    "train none.dousa",
    "find none.dousa good.bvh",
    "label none.dousa good.bvh --height 2",
    "remove none.dousa 1",
    "relabel none.dousa 1",
    "check none.dousa",
    "compact none.dousa",
    "check lib.dousa --repair",
    "evaluate good.bvh",
    "evaluate none.bvh -p good.bvh",
    "evaluate good.bvh -p none.bvh",
    "evaluate good.bvh -p folder.bvh",
    "evaluate good.bvh -p few.bvh",
    "evaluate good.bvh -p good.bvh --weights weights.toml",
    "evaluate good.bvh -p good.bvh --furi furi.txt",
    "evaluate good.bvh -p good.bvh -o good.bvh",
    "evaluate good.bvh -p good.bvh --tempo slow",
    "experiment folder.bvh",
    "experiment good.bvh --takes --figure a.png",
    "--jobs 0 experiment good.bvh",
    "experiment good.bvh --jobs 2",
    "demo -o good.bvh/out",
    "info good.bvh --read mood=glad",
    "info good.bvh --read unit",
    "info good.bvh --unit cm --read unit=m",
    "info good.bvh --read frame-rate=fast",
    "info good.bvh --read any_skeleton=perhaps",
    "estimate seen.npz --settings none.toml",
    "estimate seen.npz --settings body.toml",
    "estimate seen.npz -o a.bvh -o b.bvh",
    "estimate none.npz",
    "estimate text.npz",
    "estimate good.npz",
    "estimate good.bvh",
    "estimate seen.npz",
    "estimate seen.npz --cameras cameras.toml",
    "estimate seen.npz --cameras cameras.xml",
    "estimate seen.npz --cameras cameras.yaml",
    "estimate seen.npz --start none.bvh:3",
    "estimate seen.npz --body body.toml --stature 1.7",
    "estimate seen.npz -o out.xyz",
    "estimate seen.npz -o none/out.bvh",
    "estimate seen.npz --frames 5:5",
    "render good.bvh",
    "render good.bvh -o out.mp4",
    "render good.bvh -o out.npz --size big",
    "render good.bvh -o out.npz --stature 172",
    "render good.bvh -o out.npz --body body.toml",
    "render good.bvh -o out.npz --cameras cameras.toml --ring 3",
    "render few.bvh -o out.npz",
    "render good.bvh -o out.npz --rate 0",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_errors_are_in_japanese(dousa, files, tmp_path, monkeypatch, command):
    """Also that each is one line, exit code 2, and that English is what the other table has."""
    monkeypatch.chdir(tmp_path)
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)
    code, out, err = dousa("--lang", "ja", *command.split())
    assert code == 2 and out == ""
    (line,) = [line for line in err.splitlines() if not line.startswith("dousa: 注意: ")]
    for foreign in FOREIGN:
        line = line.replace(foreign, "")
    words = re.sub(r"'[^']*'|dousa [a-z]+( \S+)*$", "", line)
    assert JAPANESE.search(words) and not ENGLISH.search(words), line
    code, _, english = dousa(*command.split())
    assert code == 2 and not JAPANESE.search(english)


@pytest.mark.parametrize("name", ["cut.bvh", "cut.trc", "cut.c3d"])
def test_what_is_left_of_a_cut_file_is_read_with_a_note_in_japanese(dousa, files, name):
    code, out, _ = dousa("--lang", "ja", "info", str(files / name))
    assert code == 0
    assert re.search(r"注意.*途中で切れ", out), out
    code, english, _ = dousa("info", str(files / name))
    assert code == 0 and re.search(r"note .*truncated", english) and not JAPANESE.search(english), english
