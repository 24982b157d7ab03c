"""Words in columns against what is said of one motion at a time."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import slow_words

from dousa.retrieval.words.matching import KnownWords, Matcher, MotionWords, WordColumns, make_unit, read_query
from dousa.retrieval.words.vocabulary import load_vocabulary, read_words

CATEGORIES = ("kick_left", "wave_right", "walk", "", "sit down", "クロール", "throw/overhead", "a07")
NAMES = ("performer01_3", "kickHighL", "hdm_bd_clap5Reps", "take_000123", "left hand wave", "蹴り_右", "x")
RELATIONS = (
    "both hands raised above the head", "the left foot kicks forward", "walking", "the right hand waves", "歩く",
)  # fmt: skip
QUERIES = ("kick with the left foot", "performer", "performer 3", "both hands up", "蹴る", "kikc", "walk, hands raised",
    "no such thing", "right", "take 000123 wave", "left hand kick", "the")  # fmt: skip


@pytest.fixture(scope="module")
def motions():
    vocabulary, chance = load_vocabulary(), np.random.default_rng(4)

    def unit(texts, *, name=True):
        return make_unit(vocabulary, read_words(vocabulary, str(chance.choice(texts)), name=name))

    def relations():
        return tuple((unit(RELATIONS, name=False), float(chance.uniform())) for _ in range(chance.integers(0, 4)))

    return [MotionWords(unit(CATEGORIES), unit(NAMES), relations()) for _ in range(300)]


@pytest.mark.parametrize("text", QUERIES)
def test_all_at_once_says_what_is_said_of_each(motions, text):
    vocabulary = load_vocabulary()
    known = KnownWords(word for one in motions for unit in (one.category, one.name) for word in unit.words)
    matcher = Matcher(vocabulary, read_query(vocabulary, text, known))
    columns = WordColumns(motions)
    expected = [slow_words.fit(matcher, one.category, one.name, one.relations) for one in motions]
    fits = columns.fit(matcher)
    np.testing.assert_allclose(fits.scores, [one.score for one in expected], rtol=0, atol=1e-9)
    for row, one in enumerate(expected):
        assert replace(fits.of(row), score=one.score) == one


def test_nothing_is_no_motion():
    vocabulary = load_vocabulary()
    matcher = Matcher(vocabulary, read_query(vocabulary, "kick", KnownWords(())))
    assert WordColumns([]).fit(matcher).scores.shape == (0,)
