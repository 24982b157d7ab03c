"""Searching a library in words."""

import random
from pathlib import Path

import pytest

from dousa.errors import LibraryDamagedError, OptionError
from dousa.formats.registry import write_motion
from dousa.library import Library, TextResult
from dousa.library.search import text as text_index
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.words import vocabulary as vectors
from library.database_server import run_sql, seal_again

NAMES = {
    "kickLFront1Reps": "kick_left", "a07_clap": "clap", "しゃがむ": "squat", "x17": "kick_right", "x18": "clap",
    "walk": "walk", "x19": "raise_hands",
}  # fmt: skip


@pytest.fixture(autouse=True)
def without_vectors(monkeypatch):
    """These answers must not depend on whether the extra is installed."""
    monkeypatch.setattr("dousa.library.search.text.load_replacement", lambda: None)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("words")
    for category, move in NAMES.items():
        (folder / category).mkdir()
        for number in range(2):
            motion = make_motion(move, draw_performer(number), seed=number + 10 * len(category))
            write_motion(motion, folder / category / f"m{number}.bvh")
    with Library.open(folder / "words.dousa", create=True) as library:
        library.add(folder, performer_from=r"name:(m\d)", n_jobs=1)
        yield library


def found(library, text, **options) -> set[str]:
    return {hit.category for hit in library.search_text(text, None, **options).results}


@pytest.mark.parametrize(
    ("text", "category"),
    [
        ("kicking", "kickLFront1Reps"), ("蹴る", "kickLFront1Reps"), ("キック", "kickLFront1Reps"),
        ("clap", "a07_clap"), ("手を叩く", "a07_clap"), ("拍手", "a07_clap"), ("applause", "a07_clap"),
        ("squats", "しゃがむ"), ("crouching", "しゃがむ"), ("しゃがんでいる", "しゃがむ"),
        ("walking", "walk"), ("歩いている", "walk"),
    ],
)  # fmt: skip
def test_categories_are_found_in_both_languages(made, text, category):
    answer = made.search_text(text)
    assert answer.results[0].category == category
    assert {hit.category for hit in answer.results} <= {category, "x17", "x18"}
    assert [hit.rank for hit in answer.results] == list(range(1, len(answer.results) + 1))


def test_an_opaque_category_is_found_by_what_is_done(made):
    assert "x17" in found(made, "kick with the right leg")
    assert "kickLFront1Reps" not in found(made, "kick with the right leg")
    assert "x18" in found(made, "手を叩く")
    hit = next(hit for hit in made.search_text("right leg kick").results if hit.category == "x17")
    assert [str(one.message) for one in hit.relations][:1] == ["right leg kicking forward"]
    assert not hit.in_category
    assert 0 <= hit.relations[0].start < hit.relations[0].end


@pytest.mark.parametrize(
    ("text", "meant"), [("aplaud", "applaud"), ("kickin", "kick"), ("sqaut", "squat"), ("clapp", "clap")]
)
def test_typos_are_forgiven_and_told(made, text, meant):
    answer = made.search_text(text)
    assert answer.results
    assert answer.corrections.get(text) == meant


@pytest.mark.parametrize("text", ["swimming", "ピアノを弾く", "xqzzv", "left tennis serve", "!!", "の"])
def test_nothing_is_found_where_nothing_fits(made, text):
    answer = made.search_text(text, None)
    assert answer.results == () and answer.n_found == 0
    assert answer.n_searched == 14


def test_near_words_are_offered(made):
    assert made.search_text("xqzzv").unknown == ("xqzzv",)
    assert "kickLFront1Reps" in made.search_text("high kick of a footballer playing polo on ice").near


@pytest.mark.parametrize(("text", "whole"), [
    ("hands overhead", "both hands overhead"), ("hands over her head", "both hands overhead"),
    ("手を頭の上に", "両手を頭の上に"), ("arms above the head", "both arms above the head"),
])  # fmt: skip
def test_limbs_without_a_side_are_both(made, text, whole):
    wanted = [(hit.category, hit.performer) for hit in made.search_text(whole, None).results]
    assert wanted
    assert {(hit.category, hit.performer) for hit in made.search_text(text, None).results} == set(wanted)


@pytest.mark.parametrize(("text", "category"), [("clap hands", "a07_clap"), ("kick the legs", "kickLFront1Reps")])
def test_a_side_that_nobody_asked_for_contradicts_nothing(made, text, category):
    assert category in found(made, text)


@pytest.mark.parametrize("text", ["walk or clap", "歩くまたは拍手", "clap OR walk"])
def test_alternatives(made, text):
    assert found(made, text) == found(made, "walk") | found(made, "clap")
    assert set(made.match_text(text).ids) == {hit.clip_id for hit in made.search_text(text, None).results}


def test_no_alternatives_without_an_action(made):
    assert found(made, "left or right leg kick") == found(made, "left right leg kick")


@pytest.mark.parametrize("text", ["not walking", "walking without arms", "don't kick", "歩かない", "歩く以外"])
def test_what_is_not_shown_cannot_be_asked_for(made, text):
    with pytest.raises(OptionError, match="does not"):
        made.search_text(text)


def test_filters_and_limits(made):
    assert made.search_text("kicking", 1).n_found >= 2
    assert len(made.search_text("kicking", 1).results) == 1
    assert {hit.performer for hit in made.search_text("kicking", performer="m1").results} == {"m1"}
    assert found(made, "kicking", category="x17") == {"x17"}
    assert found(made, "kicking", kind="take") == set()
    assert found(made, "kicking", category="walk") == set()


def test_letters_of_a_name_are_found(made):
    assert found(made, "LFront1R") == {"kickLFront1Reps"}
    assert found(made, "a07") == {"a07_clap"}


def test_segments_of_takes_are_found_by_what_they_are_called_and_not_by_their_times(tmp_path):
    """A library of labelled takes only, with a category that no table of words has."""
    write_motion(make_motion("walk", draw_performer(0), seed=1), tmp_path / "day03.bvh")
    (tmp_path / "day03.labels.csv").write_text("start_s,end_s,category\n0,1.25,flumphing\n1.25,1.75,walk\n")
    with Library.open(tmp_path / "takes.dousa", create=True) as library:
        library.add(tmp_path / "day03.bvh", kind="take", labels_from="beside", n_jobs=1)
        assert found(library, "flumphing") == {"flumphing"}
        for text in ("250", "bvh", "t=1.25"):
            assert not library.search_text(text, None).results, text
        assert len(library.search_text("day03", None).results) == 3


def test_the_answer_is_json(made):
    answer = made.search_text("手を叩く", 2)
    assert isinstance(answer, TextResult)
    told = answer.to_json()
    assert told["text"] == "手を叩く" and len(told["results"]) == 2
    assert {"rank", "clip_id", "path", "category", "performer", "kind", "score", "relations"} <= set(told["results"][0])


@pytest.mark.parametrize(("text", "k"), [("", 1), ("  ", 1), ("x" * 501, 1), ("kick", 0)])
def test_what_cannot_be_asked(made, text, k):
    with pytest.raises(OptionError):
        made.search_text(text, k)


def test_words_choose_among_clips_for_a_motion(tmp_path, made):
    with Library.open(tmp_path / "own.dousa", create=True) as library:
        library.add(Path(made.name).parent, n_jobs=1)
        library.train(n_trees=10)
        kick = library.clips(category="kickLFront1Reps")[0].id
        chosen = [hit.clip_id for hit in library.search_text("clap").results]
        hits = library.search(kick, 20, among=chosen).results
        assert {hit.clip_id for hit in hits} == set(chosen)
        assert library.search(kick, 20, among=[]).results == ()


def test_new_clips_and_labels_are_found(tmp_path):
    with Library.open(tmp_path / "new.dousa", create=True) as library:
        library.add_motion(make_motion("walk", draw_performer(1), seed=1), "one", "walk")
        assert found(library, "bow") == set()
        library.add_motion(make_motion("bow", draw_performer(1), seed=1), "two", "q")
        assert found(library, "bend forward") == {"q"}
        library.relabel([1], category="tennis_serve")
        assert found(library, "テニス") == {"tennis_serve"}
        library.remove([2])
        assert found(library, "bend forward") == set()


def test_of_a_change_what_changed_is_read(tmp_path, monkeypatch):
    """Whatever is changed, answers are those of a program that reads everything."""
    read = []
    plain = text_index.load_relations

    def load(connection, ids=None):
        read.append(ids)
        return plain(connection, ids)

    monkeypatch.setattr(text_index, "load_relations", load)
    chance = random.Random(5)
    with Library.open(tmp_path / "new.dousa", create=True) as library:
        for number in range(8):
            move = list(NAMES.values())[number % len(NAMES)]
            library.add_motion(make_motion(move, draw_performer(number), seed=number), f"{move} {number}", move)
        found(library, "walk")
        assert read == [None]
        for turn in range(8):
            ids = [clip.id for clip in library.clips()]
            changed = chance.sample(ids, 2)
            if turn == 3:
                removed = changed
                library.remove(removed)
            elif turn == 4:
                changed = removed
                library.undo()
            elif turn == 5:
                library.add_motion(make_motion("bow", draw_performer(9), seed=9), "a bow", "bend")
                changed = [max(clip.id for clip in library.clips())]
            elif turn == 6:
                library.tag(changed, add=["good"])  # which is none of the words
                changed = []
            else:
                library.relabel(changed, category=chance.choice(["tennis serve", "しゃがむ", "walk", f"new {turn}"]))
            del read[:]
            for text in ("walk", "しゃがむ", "serve", "bow", "new", "arm up"):
                own = library.search_text(text, None)
                with Library.open(tmp_path / "new.dousa") as other:
                    assert other.search_text(text, None) == own
            again = {number for ids in read if ids is not None for number in ids}
            assert again <= set(changed) and (again or turn in (3, 6))


def test_relations_of_another_version_are_computed_again(library, library_file):
    before = library.search_text("bending forward", None)
    run_sql(library_file, "UPDATE clip_relations SET version = 0")
    seal_again(library_file)
    with Library.open(library_file) as again:
        assert again.search_text("bending forward", None) == before
        again.train(n_trees=5)
        assert run_sql(library_file, "SELECT count(*) FROM clip_relations WHERE version > 0") == [(15,)]
        assert again.search_text("bending forward", None) == before


def test_damaged_relations_are_told(tmp_path):
    path = tmp_path / "damaged.dousa"
    with Library.open(path, create=True) as library:
        library.add_motion(make_motion("walk", draw_performer(1), seed=1), "one", "walk")
    run_sql(path, "UPDATE clip_relations SET relations = '[[1]]'")
    seal_again(path)
    with Library.open(path) as library, pytest.raises(LibraryDamagedError, match="in words is damaged"):
        library.search_text("walk")


def test_vectors_stand_in_for_words_that_no_table_has():
    if vectors.find_vectors() is None:
        pytest.skip("needs the extra dousa[words]")
    replace = vectors.load_replacement()
    assert replace is not None
    word, cosine = replace("strolling")
    assert word in ("stroll", "walk") and cosine > 0.5
    assert replace("qqqq")[1] < 0.6
