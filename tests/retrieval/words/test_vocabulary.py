"""Names and queries are taken apart into words, and words name concepts in both languages."""

import pytest

from dousa.retrieval.words.vocabulary import inflect, load_vocabulary, read_words, split_name, stem

TABLE = load_vocabulary()


def concepts(text, *, name=False):
    return [word.meanings[0] for word in read_words(TABLE, text, name=name) if word.meanings]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("punchLFront1Reps", "punch L Front 1 Reps"),
        ("a07_tennis_serve", "a07 tennis serve"),
        ("raise-up-both-hands/active", "raise up both hands active"),
        ("HDM_bd_kickLFront1Reps_009_120", "HDM bd kick L Front 1 Reps 009 120"),
        ("Male1_C08_RunBackToStand", "Male 1 C08 Run Back To Stand"),
        ("蹴るhigh2", "蹴る high 2"),
        ("...", ""),
    ],
)
def test_names_are_taken_apart(name, words):
    assert split_name(name) == words.split()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kicking with the left foot", ["kick", "left", "foot"]),
        ("左足で蹴っている", ["left", "foot", "kick"]),
        ("clapping", ["clap"]),
        ("手を叩いた", ["clap"]),
        ("手をたたく", ["clap"]),
        ("getting up", ["stand_up"]),
        ("overhead", ["above", "head"]),
        ("両手を頭の上に", ["both", "hand", "head", "above"]),
        ("しゃがんでいる人", ["squat"]),
        ("速く走る", ["fast", "run"]),
        ("ﾃﾆｽ", ["tennis"]),  # narrow letters
        ("TENNIS", ["tennis"]),
    ],
)
def test_words_name_concepts(text, expected):
    assert concepts(text) == expected


def test_sides_in_names_are_read():
    assert concepts("elbowToKnee1RepsLelbowStart", name=True) == ["elbow", "knee", "left", "elbow"]
    assert concepts("sit_to_stand", name=True) == ["stand_up"]
    assert concepts("Lift", name=True) == ["raise"]  # not l, ift


@pytest.mark.parametrize("forms", ["kick kicking kicks kicked", "jump jumping jumps", "wave waving waves"])
def test_forms_of_a_word_share_their_stem(forms):
    assert len({stem(form) for form in forms.split()}) == 1


@pytest.mark.parametrize(
    ("verb", "forms"), [("叩く", "叩き 叩い 叩か"), ("上げる", "上げ"), ("走る", "走っ 走り"), ("速い", "速く")]
)
def test_japanese_words_are_inflected(verb, forms):
    assert set(forms.split()) <= inflect(verb)


def test_what_the_table_relates_is_there():
    names = {name for pair in (*TABLE.related, *TABLE.opposites, *TABLE.implied) for name in pair}
    assert names <= set(TABLE.concepts)
    assert all(0 < value <= 1 for value in TABLE.related.values())
    meant = {
        name for meanings in (*TABLE.english.values(), *TABLE.japanese.values()) for one in meanings for name in one
    }
    assert meant - {"stop"} <= set(TABLE.concepts)


@pytest.mark.parametrize("text", ["", "   ", "の", "!?", "\u200b", "🙂", "a" * 400, "ー" * 50])
def test_texts_without_words_are_read(text):
    read_words(TABLE, text)
    read_words(TABLE, text, name=True)
