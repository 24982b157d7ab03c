"""Choosing clips, and going through all of them, a page at a time."""

import pytest

from dousa.errors import LibraryError
from dousa.library import Library
from dousa.library.store import selection
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion

NAMES = ("/a/b/one", "/a/b/two", "/a/bc/three", "/a/B/four", "/a/b_/five", "/a/bx/six", "/a/%/seven", "八/九", "plain")


def open_named(folder):
    """Motions whose names are paths that are easily taken for one another."""
    with Library.open(folder / "named.dousa", create=True) as library:
        for number, name in enumerate(NAMES):
            motion = canonicalise(compute_trajectories(make_motion("walk", draw_performer(number))))
            library.add_motion(motion, name, ("x", "y")[number % 2], performer="ann" if number < 4 else None)
        library.tag([1, 5], add=["good"])
        yield library


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """Such a library for all tests that change nothing."""
    yield from open_named(tmp_path_factory.mktemp("named"))


@pytest.fixture
def own_named(tmp_path):
    """One for a test that does."""
    yield from open_named(tmp_path)


def test_going_through_all_is_listing_all(named, monkeypatch):
    monkeypatch.setitem(selection.read_page.__kwdefaults__, "most", 2)
    pages = []
    plain = selection.read_page

    def read_page(*own):
        pages.append(plain(*own))
        return pages[-1]

    monkeypatch.setattr(selection, "read_page", read_page)
    listed = named.clips()
    assert [*named.iterate_clips()] == sorted(listed, key=lambda clip: clip.id)
    assert max(map(len, pages)) == 2
    assert [clip.path for clip in listed] == sorted(NAMES)
    assert [clip.id for clip in named.iterate_clips(category="y", performer="ann")] == [2, 4]
    assert [clip.tags for clip in named.iterate_clips(category="x")] == [("good",), (), ("good",), (), ()]


def test_clips_that_go_meanwhile_are_left_out(own_named, monkeypatch):
    monkeypatch.setitem(selection.read_page.__kwdefaults__, "most", 2)
    found = []
    for clip in own_named.iterate_clips():
        found.append(clip.id)
        if clip.id == 2:
            own_named.remove([3, 4])
    assert found == [1, 2, 5, 6, 7, 8, 9]


@pytest.mark.parametrize(
    "chosen, expected",
    [
        (["/a/b"], [1, 2]), (["/a/b/"], [1, 2]), (["/a/b/one"], [1]), (["/a/b_"], [5]), (["/a/%"], [7]),
        (["/a"], [1, 2, 3, 4, 5, 6, 7]), (["plain", 3], [3, 9]), (["/a/../a/B"], [4]), (["/"], [1, 2, 3, 4, 5, 6, 7]),
    ],
)  # fmt: skip
def test_a_folder_stands_for_what_is_below_it(named, chosen, expected):
    assert sorted(clip.id for clip in named.clips(chosen)) == expected


def test_only_those_of_a_label_or_tag(named):
    assert sorted(clip.id for clip in named.clips(["/a"], category="y")) == [2, 4, 6]
    assert sorted(clip.id for clip in named.clips(["/a"], category="y", performer="ann")) == [2, 4]
    assert sorted(clip.id for clip in named.clips(tag="good")) == [1, 5]
    assert sorted(clip.id for clip in named.clips(["/a/b", 5], tag="good")) == [1, 5]


@pytest.mark.parametrize(
    "chosen, labels",
    [(["/nowhere"], {}), ([10], {}), ([1], {"category": "y"}), (["/a/b/two"], {"category": "x"}),
     (["\udcff"], {}), ([0], {}), ([2**40], {}), ([], {"tag": "bad"}), ([3], {"tag": "good"})],
)  # fmt: skip
def test_what_fits_no_clip_is_one_error(named, chosen, labels):
    with pytest.raises(LibraryError, match=r"named\.dousa"):
        named.clips(chosen, **labels)
