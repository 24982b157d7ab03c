"""Clips that were cut out of takes and named by hand: what takes are labelled with learns from each at once."""

import pytest

from dousa.library import Library

KNOWN = ("walk", "squat", "wave_right", "kick_left")
STRANGE = "lunge"


def read(category, performer, seed=5):
    """A made motion as a clip."""
    from dousa.motion import canonicalise
    from dousa.motion.synthetic.performers import draw_performer, make_motion
    from dousa.retrieval import LabelledClip

    motion = canonicalise(make_motion(category, draw_performer(1000 * seed + performer)))
    return LabelledClip(category, category, None, motion.positions, motion.frame_rate, motion.height)


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    """A library, and a take with a motion twice that the library does not know; the middles of both."""
    from dousa.app.demo import write_library, write_take

    root = tmp_path_factory.mktemp("examples")
    write_library(root / "motions", n_performers=5, categories=KNOWN)
    with Library.open(root / "moves.dousa", create=True) as library:
        library.add(root / "motions", performer_from=r"name:^(performer\d+)_", n_jobs=1)
        library.train(n_trees=30)
    clips = [read("walk", 1), read(STRANGE, 1), read("squat", 1), read(STRANGE, 2), read("kick_left", 1)]
    take = write_take(clips, KNOWN, root / "take.bvh")
    middles = [0.5 * (piece.start + piece.stop) for piece in take.truth if piece.category is None]
    (root / STRANGE).mkdir()
    write_take([read(STRANGE, 3)], (), root / STRANGE / "own.bvh")
    (root / "labels.csv").write_text(f"file,category\nown.bvh,{STRANGE}\n", encoding="utf-8")
    return root, take.path, middles


@pytest.fixture
def library(material, tmp_path):
    path = tmp_path / "moves.dousa"
    path.write_bytes((material[0] / "moves.dousa").read_bytes())
    with Library.open(path) as opened:
        yield opened


def add_example(library, root):
    """Number of a clip of the strange motion, by somebody else than in the take."""
    report = library.add(root / STRANGE, category_from=f"csv:{root / 'labels.csv'}", n_jobs=1)
    assert report.new_categories == (STRANGE,)
    return library.clips(list(report.added))[0].id


def test_an_example_is_learned_without_learning_everything_again(library, material):
    root, take, middles = material
    first = library.label(take).timeline
    assert [first.category_at(when) for when in middles] == [None] * 2
    clip = add_example(library, root)
    steps = []
    after = library.label(take, examples=[clip], progress=lambda *step: steps.append(step)).timeline
    assert not steps
    assert [after.category_at(when) for when in middles] == [STRANGE] * 2
    assert library.label(take, examples=[clip]).timeline == after


@pytest.mark.slow
def test_an_example_is_learned_by_a_program_that_starts_anew(library, material, tmp_path):
    root, take, middles = material
    clip = add_example(library, root)
    with Library.open(tmp_path / "moves.dousa") as other:
        after = other.label(take, examples=[clip]).timeline
    assert [after.category_at(when) for when in middles] == [STRANGE] * 2


def test_an_example_that_is_gone_or_nameless_teaches_nothing(library, material):
    root, take, middles = material
    library.label(take)  # what is learned later knows all clips that have names then
    clip = add_example(library, root)
    library.label(take, examples=[clip])
    library.relabel([clip], category=None)
    nameless = library.label(take, examples=[clip]).timeline
    assert STRANGE not in [nameless.category_at(when) for when in middles]
    library.remove([clip])
    gone = library.label(take, examples=[clip, -1, 10**30]).timeline
    assert gone == nameless
