"""The map of all clips: what lies together, that it is the same each time, and the command."""

import csv
import sys

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'dousa[map]'")

from typer.testing import CliRunner

from dousa.app.cli.main import main, make_application
from dousa.formats import write_motion
from dousa.formats.motion_files import read_canonical
from dousa.library.care import clip_map

CATEGORIES = ("kick_left", "squat", "wave_right", "walk")
N = 24
ARMS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hand"))
UPPER = ("spine", "neck", "head", *ARMS)


@pytest.fixture(scope="module")
def made(make_clips):
    """24 clips."""
    return make_clips(N // len(CATEGORIES), CATEGORIES)


def share_of_own(library, found):
    """Share of clips whose nearest one on the map has their category."""
    labels = {clip.id: clip.category for clip in library.clips()}
    apart = np.linalg.norm(found.points[:, None] - found.points, axis=2) + 9 * np.eye(len(found.points))
    nearest = found.clip_ids[apart.argmin(axis=1)]
    return np.mean([labels[one] == labels[other] for one, other in zip(found.clip_ids, nearest, strict=True)])


def test_clips_lie_among_those_that_they_resemble(library):
    steps = []
    found = library.map(progress=lambda done, total, what: steps.append((done, total)))
    assert sorted(found.clip_ids.tolist()) == sorted(clip.id for clip in library.clips())
    assert found.points.shape == (N, 2) and np.abs(found.points).max() == pytest.approx(1)
    assert (found.n_laid_out, found.left_out) == (N, ())
    assert share_of_own(library, found) > 0.85
    assert steps == [(done, 5) for done in range(6)]


def test_the_same_clips_give_the_same_map_whatever_they_are_called(library):
    first = library.map()
    library.relabel([clip.id for clip in library.clips()][:9], category="other")
    again = library.map()
    assert np.array_equal(first.clip_ids, again.clip_ids) and np.array_equal(first.points, again.points)


def test_of_a_large_library_the_others_are_placed_beside_those_that_they_resemble(library, monkeypatch):
    monkeypatch.setitem(clip_map.map_clips.__kwdefaults__, "most", 16)
    found = library.map()
    assert (len(found.clip_ids), found.n_laid_out) == (N, 16)
    assert np.isfinite(found.points).all() and share_of_own(library, found) > 0.75


@pytest.mark.parametrize("left", [0, 1, 3])
def test_few_clips_stand_in_a_row(library, left):
    library.remove([clip.id for clip in library.clips()][left:])
    found = library.map()
    assert found.points.shape == (left, 2) and len(np.unique(found.points[:, 0])) == left


def test_clips_that_are_all_the_same_lie_on_one_point():
    assert not clip_map._lay_out(np.ones((9, 4), np.float32) * 0, 3, lambda part: None).any()


def test_bodies_that_lack_joints_and_takes_are_not_on_it(library, made, tmp_path):
    for name, kind in (("walk", "clip"), ("squat", "take")):
        points = read_canonical(next((made.parent / "motions" / name).glob("*.bvh")))[0].to_trajectories()
        kept = [row for row, joint in enumerate(points.names) if joint not in UPPER]
        names, positions = [points.names[row] for row in kept], points.positions[:, kept]
        legs = points.replace(names=names, positions=positions, parents=None, rest_positions=None)
        write_motion(legs, tmp_path / f"{name}.trc")
        assert not library.add([tmp_path / f"{name}.trc"], kind=kind, category_from=None).skipped
    found = library.map()
    lacking = [clip.id for clip in library.clips() if clip.absent and clip.kind == "clip"]
    assert len(found.clip_ids) == N and list(found.left_out) == lacking and len(lacking) == 1


def test_the_command_writes_a_table(library, tmp_path):
    answer = CliRunner().invoke(make_application(), ["plot", library.name, "-o", str(tmp_path / "map.csv")])
    assert answer.exit_code == 0
    with open(tmp_path / "map.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == N
    assert list(rows[0]) == ["clip_id", "path", "category", "performer", "x", "y"]
    kept = {clip.id: clip.category for clip in library.clips()}
    assert {int(row["clip_id"]): row["category"] for row in rows} == kept


def test_the_command_draws_a_picture_with_a_legend(library, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'dousa[pictures]'")
    answer = CliRunner().invoke(make_application(), ["plot", library.name, "-o", str(tmp_path / "map.svg")])
    assert f"{N} clips" in answer.stdout
    drawn = (tmp_path / "map.svg").read_text(encoding="utf-8")
    assert "walk (6)" in drawn or drawn.count("<use") >= N


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["-o", "map.txt"], "got '.txt'"), ([], "--output is missing"), (["-o", "x.csv"], "no clips yet")],
)
def test_what_cannot_be_done_is_said(library, words, expected, tmp_path, monkeypatch, capsys):
    library.remove([clip.id for clip in library.clips()])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["dousa", "plot", library.name, *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and expected in capsys.readouterr().err
    assert not (tmp_path / "x.csv").exists()
