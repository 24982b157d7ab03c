"""Categories that mean the same, by their names: of different producers, languages or styles."""

from __future__ import annotations

from collections.abc import Iterable

from dousa.retrieval.words.vocabulary import load_vocabulary, read_words

_KINDS = ("action", "side", "direction")


def find_meanings(categories: Iterable[str]) -> dict[str, str]:
    """What each category means: one word for all whose names tell of the same actions, sides and directions.

    "squat1Reps", "squat" and "しゃがむ" mean the same, and so do "walk/active" and "walk/tired"; "wave-left-hand" and
    "wave-right-hand" do not. A name that tells of no action stands for itself.
    """
    vocabulary = load_vocabulary()
    kinds = {name: concept.kind for name, concept in vocabulary.concepts.items()}
    meanings = {}
    for category in categories:
        named = {word.meanings[0] for word in read_words(vocabulary, category, name=True) if word.meanings}
        told = sorted(name for name in named if kinds[name] in _KINDS)
        is_action = any(kinds[name] == "action" for name in told)
        meanings[category] = f"({' '.join(told)})" if is_action else category
    return meanings
