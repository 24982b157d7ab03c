"""The demonstration's take: the truth that is written with it, what is told of it, and when it is left out."""

import io
import re

import numpy as np
import pytest
from rich.console import Console

from dousa.app.demo import choose_clips, show_take, write_dance_figure, write_take
from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_library, make_motion
from dousa.retrieval import LabelledClip

CATEGORIES = ("bow", "clap", "jumping_jack", "kick_left", "squat", "walk")
STRANGER = draw_performer(40, "stranger")


def make_clip(category):
    motion = canonicalise(make_motion(category, STRANGER))
    return LabelledClip(category, category, None, motion.positions, motion.frame_rate, motion.height)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A library of six categories by six performers."""
    folder = tmp_path_factory.mktemp("trained")
    for category, performer, _, motion in make_library(6, categories=CATEGORIES):
        path = folder / "motions" / category / f"{performer.name}.bvh"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_motion(motion, path)
    with Library.open(folder / "demo.dousa", create=True) as library:
        library.add(folder / "motions", performer_from="name:(performer.*)", n_jobs=1)
        library.train(n_jobs=1)
    return folder / "demo.dousa"


@pytest.fixture
def queries(tmp_path):
    """A motion of each category by a performer that the library does not know."""
    paths = {}
    for category in CATEGORIES:
        path = tmp_path / f"{category}.bvh"
        write_motion(make_motion(category, STRANGER), path)
        paths[path] = category
    return paths


def run(trained, queries, strange, output):
    console = Console(file=io.StringIO(), width=300)
    show_take(console, trained, queries, output / "kick_left.bvh", strange, output, n_jobs=1)
    return console.file.getvalue()


def test_a_take_is_as_long_as_its_truth_and_has_no_jump(tmp_path):
    clips = [make_clip(category) for category in ("walk", "bow", "clap")]
    take = write_take(clips, ("walk", "clap"), tmp_path / "take.bvh")
    assert [piece.category for piece in take.truth] == ["walk", None, "clap"]
    assert all(a.stop == b.start for a, b in zip(take.truth, take.truth[1:], strict=False))
    read = canonicalise(read_motion(take.path))
    assert read.duration == pytest.approx(take.truth[-1].stop, abs=0.05)
    steps = np.linalg.norm(np.diff(read.positions, axis=0), axis=2)
    assert steps.max() < 0.3  # m in a frame: nobody is faster than 9 m/s


def test_the_same_seed_writes_the_same_take(tmp_path):
    clips = [make_clip(category) for category in ("walk", "bow", "clap")]
    paths = [write_take(clips, (), tmp_path / f"{name}.bvh", 3).path for name in "ab"]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_dance_figure_is_one_figure(tmp_path):
    write_dance_figure(STRANGER, tmp_path / "dance.bvh")
    assert read_motion(tmp_path / "dance.bvh").n_frames == pytest.approx(8 * 0.45 * 30, abs=2)


def test_a_take_is_labelled_and_searched(trained, queries, tmp_path):
    strange = tmp_path / "dance.bvh"
    write_dance_figure(STRANGER, strange)
    for _ in range(2):  # it can be run again
        text = run(trained, queries, strange, tmp_path)
    assert "Joined 7 motions" in text
    found, right, unknown = re.search(
        r"(\d) of 6 motions found, (\d+)% of the frames right; .* unknown at (\d+)% of its time", text
    ).groups()
    assert int(found) >= 4 and int(right) > 60 and int(unknown) > 10  # a small library is easily deceived
    score, elsewhere = re.search(r"Most like kick_left.*score (\S+) .*elsewhere (\S+) at most", text).groups()
    assert float(score) > float(elsewhere)
    assert (tmp_path / "timeline.png").stat().st_size > 10_000
    with Library.open(trained, read_only=True) as library:
        takes = [clip for clip in library.clips() if clip.kind == "take"]
    assert [clip.path for clip in takes] == [str(tmp_path / "take.bvh")]


def test_what_cannot_be_read_is_left_out(trained, queries, tmp_path):
    (tmp_path / "walk.bvh").write_text("damaged")
    assert "Joined 5 motions" in run(trained, queries, None, tmp_path)


def test_few_queries_make_no_take(trained, queries, tmp_path):
    few = dict(item for item in queries.items() if item[1] in ("kick_left", "walk"))
    assert "No uncut take is shown" in run(trained, few, None, tmp_path)
    assert not (tmp_path / "take.bvh").exists()


def test_a_take_has_many_categories(queries, tmp_path):
    example = tmp_path / "kick_left.bvh"
    for number in range(20):
        again = tmp_path / f"kick_{number}.bvh"
        again.write_bytes(example.read_bytes())
        queries[again] = "kick_left"
    categories = [clip.category for clip in choose_clips(queries, example, None, seed=1)]
    assert len(categories) == 9 and set(categories) == set(CATEGORIES)
