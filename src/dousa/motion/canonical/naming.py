"""Mapping of the names in a file to canonical joints.

A name is normalised to a side and a core. The namespace before ``:`` and what nearly all names of the file begin or end
with (``Character1_``, ``Bip01 ``, ``_JNT``, ``bind``) says nothing and is dropped, words are split at separators and
capitals, a word such as ``Left``, ``l`` or ``RGT`` is the side, and the rest is joined in lower case. A side in the
first or last letter (``lfemur``, ``LASI``) is found by its twin (``rfemur``). Then the table of ``name_tables.toml``
that covers most joints is taken.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from itertools import product

from dousa.motion.canonical.joints import CANONICAL_JOINTS

REQUIRED_JOINTS: tuple[str, ...] = tuple(
    f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)
"""What a body needs to be recognised; the other canonical joints can be made from these."""

_SKIN = "_skin"  # places of a table that stand for a joint if the table finds no centre of it
_CENTRAL = ("pelvis", "spine", "neck", "head", "sacrum")
_HAN = r"(?:(?![左右])[\u3005-\u30ff\u3400-\u9fff])+"  # kana and kanji; the sides are words of their own
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-zäöüßéèêà])|[A-Z]?[a-zäöüßéèêà]+\d*|[A-Z]+\d*|\d+|[左右]|" + _HAN)
_SIDES = {
    **dict.fromkeys(("left", "lft", "lt", "l", "li", "links", "sx", "gauche", "izq", "izquierda", "esq", "左"), "l"),
    "c": "",  # the centre
    **dict.fromkeys(("right", "rgt", "rt", "r", "re", "rechts", "dx", "droite", "der", "derecha", "dir", "右"), "r"),
}


def _load_tables() -> dict[str, dict[str, str]]:
    """Place on the body -> rule, for each family of ``name_tables.toml`` and ``marker_tables.toml``."""
    read: dict[str, dict[str, str]] = {}
    for file in ("name_tables.toml", "marker_tables.toml"):
        read |= tomllib.loads(resources.files(__package__).joinpath(file).read_text(encoding="utf-8"))
    words = {word: choices.split("|") for word, choices in read.pop("words").items()}
    families: dict[str, dict[str, str]] = {}
    for name, table in read.items():
        shared = table.pop("as", None)
        rules = {**(read[shared] if shared else {}), **table}
        families[name] = {place: _expand(rule, words) for place, rule in rules.items()}
    return {name: table for name, table in families.items() if not name.startswith("named ")}


_CHOICE = re.compile(r"<(\w+)>")


def _expand(rule: str, words: dict[str, list[str]]) -> str:
    """Write out every term of a rule that holds ``<word>`` for all choices of the word."""
    terms = []
    for term in rule.split("|"):
        parts = _CHOICE.split(term)
        chosen = dict.fromkeys(parts[1::2])  # the same word twice in a term is chosen once
        for choice in product(*(words[word] for word in chosen)):
            spelled = dict(zip(chosen, choice, strict=True))
            terms.append("".join(spelled[part] if odd % 2 else part for odd, part in enumerate(parts)))
    return "|".join(dict.fromkeys(terms))


TABLES: dict[str, dict[str, str]] = _load_tables()

_CORES = frozenset(
    word.lstrip("*@") for table in TABLES.values() for rule in table.values() for word in re.split(r"[|+]", rule)
)

Key = tuple[str, str]


@dataclass(frozen=True, slots=True)
class NameMatch:
    """Joints found by a name table in a list of names.

    Parameters
    ----------
    table : name of the family.
    sources : place -> indices of the points whose mean it is; places are canonical joints, and ``left_asis``,
        ``left_psis``, ``left_trochanter`` (and right), ``sacrum`` for marker sets that do not mark the hips.
    missing : required joints that were not found.
    skin : joints with a marker on one side only: `joint_centres` puts them inside the body.
    """

    table: str
    sources: dict[str, tuple[int, ...]]
    missing: tuple[str, ...]
    skin: frozenset[str] = frozenset()


_FEWEST, _NEARLY_ALL = 5, 0.8
"""How many names show what names share, and the share of them that have it."""


def _without_affixes(names: Iterable[str]) -> list[str]:
    """Drop namespaces, running numbers, and what nearly all names begin or end with; ``_end`` of a bone's end stays."""
    bare = [re.split(r"[:|]", unicodedata.normalize("NFKC", str(name)))[-1].strip(" _-.") for name in names]
    known = set(bare)
    ends = [name[-4:] if name[-4:].lower() == "_end" and name[:-4] in known else "" for name in bare]
    stems = [name.removesuffix(end) for name, end in zip(bare, ends, strict=True)]
    before: list[str] = []
    while before != stems:
        before = stems
        for part in (_without_numbers, _without_affix):
            stems = part(part(stems, 1), -1)
    return [stem + end for stem, end in zip(stems, ends, strict=True)]


def _without_numbers(names: list[str], step: int) -> list[str]:
    """Drop the numbers that count nearly all names: ``23 left hip`` and ``left hip 23``."""
    cut = [re.sub(r"^\d+[\W_]*(?=.)" if step > 0 else r"(?<=.)[\W_]+\d+$", "", name) for name in names]
    counted = sum(map(str.__ne__, names, cut))
    enough = counted >= max(_FEWEST, _NEARLY_ALL * sum(map(bool, names)))
    return cut if enough and len(set(cut)) == len(set(names)) else names


def _without_affix(names: list[str], step: int, glued: int = 3, longest: int = 64) -> list[str]:
    """Drop what nearly all names begin with (step 1) or end with (-1): ``Bip01_``, ``_JNT``; never a side.

    Parameters
    ----------
    glued : letters from which on an affix needs no separator.
    longest : letters that are looked at.
    """
    turned = [name[::step] for name in names]
    least = max(_FEWEST, _NEARLY_ALL * sum(map(bool, names)))
    affix = ""
    while len(affix) < longest:
        starts = Counter(name[: len(affix) + 1] for name in turned if len(name) > len(affix) + 1)
        longer, count = starts.most_common(1)[0] if starts else ("", 0)
        if count < least:
            break
        affix = longer
        if len(affix) == glued:  # a letter that fewer have is the end of a joint's name: left_JNT, right_JNT
            least = count
    if side := _SIDE.search(affix[::step]):
        affix = affix[: side.start() if step > 0 else len(affix) - side.end()]
    at_word = affix[-1:].islower() and step > 0 and all(name[len(affix) :][:1].isupper() for name in turned)
    if len(affix) < glued and (not affix or affix[-1].isalnum()) and not at_word:
        return names
    return [name.removeprefix(affix)[::step] if len(name) > len(affix) else name[::step] for name in turned]


_SIDE = re.compile(r"(?i:left|right)|[左右]|(?<![A-Za-z])[LRlr](?![A-Za-z])|(?<=[a-z])[LR](?![A-Za-z])")


def _list_groups(names: tuple[str, ...]) -> Iterator[list[str]]:
    """The names that share a first or last word, without any others: the bones among the helpers of a rig."""
    for pattern in (r"^[^\W_]+[\W_]+", r"[\W_]+[^\W_]+$"):
        words = [found[0] if (found := re.search(pattern, name)) else "" for name in names]
        for word, count in Counter(words).most_common():
            if word and count >= _FEWEST and not _SIDE.search(word):
                yield [name if own == word else "" for name, own in zip(names, words, strict=True)]


def _split(name: str) -> list[str]:
    """Words of a name in lower case: ``"LeftUpLeg_01"`` -> ``["left", "up", "leg", "1"]``."""
    return [re.sub(r"(?<!\d)0+(?=\d)", "", word).lower() for word in _WORDS.findall(name)]


def _split_side(words: list[str]) -> Key:
    for index, word in enumerate(words):
        if word in _SIDES and len(words) > 1:
            return _SIDES[word], "".join(words[:index] + words[index + 1 :])
    return "", "".join(words)


def _hidden_side(core: str, cores: frozenset[str], letters: bool) -> Key:
    """Side of a name of one word: ``lfemur`` beside ``rfemur``, or a remainder in the tables.

    ``letters`` : whether first letters are sides in this file; else ``lkne`` may be the lateral marker of a knee.
    """
    for mark, other, side in (
        ("left", "right", "l"),
        ("right", "left", "r"),
        ("l", "r", "l"),
        ("r", "l", "r"),
    ):
        if core.startswith(mark) and len(core) > len(mark) + 1:
            rest = core[len(mark) :]
            is_side = core not in _CORES or (letters and "m" + rest not in cores)
            if other + rest in cores or (rest in _CORES and is_side):
                return side, rest
        if core.endswith(mark) and len(core) > len(mark) + 1 and core[: -len(mark)] + other in cores:
            return side, core[: -len(mark)]
    for mark, other, side in (("g", "d", "l"), ("d", "g", "r")):  # gauche, droite
        if core[-1:] == mark and len(core) > 2 and core[:-1] + other in cores:
            return side, core[:-1]
    return _inner_side(core, cores)


def _inner_side(core: str, cores: frozenset[str]) -> Key:
    """The side of ``waistlfront`` beside ``waistrfront``, and of ``la`` (left acromion) beside ``ra``."""
    for place, letter in enumerate(core):
        if letter in "lr":
            before, after = core[:place], core[place + 1 :]
            if before + after in _CORES and before + ("r" if letter == "l" else "l") + after in cores:
                return letter, before + after
    return "", core


def normalise_names(names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Return the side (``"l"``, ``"r"`` or ``""``) and core of every name: ``mixamorig:LeftUpLeg`` is ("l", "upleg").

    ``names`` : all names of one file, for shared prefixes and twins.
    """
    keys = [_split_side(_split(name)) for name in _without_affixes(names)]
    cores = frozenset(core for side, core in keys if not side)
    letters = _mark_sides(cores)
    return tuple((side, core) if side else _hidden_side(core, cores, letters) for side, core in keys)


def _mark_sides(cores: frozenset[str], mostly: float = 0.5) -> bool:
    """Whether l and r as first letters are sides: ``mostly`` the other side is there too, or the rest is known."""
    lettered = [core for core in cores if core[:1] in ("l", "r")]
    other = {"l": "r", "r": "l"}
    known = (core[1:] in _CORES and "m" + core[1:] not in cores for core in lettered)
    twins = (other[core[0]] + core[1:] in cores for core in lettered)
    return sum(map(max, known, twins)) >= mostly * len(lettered)


def _find(term: str, side: str, index: dict[Key, int], table: dict[str, str]) -> tuple[int, ...] | None:
    """Indices of one averaged term, ``a+*b``; None if a point of it is missing."""
    found: list[int] = []
    for word in term.split("+"):
        sides = ("l", "r") if word.startswith("*") else (side,)
        name = word.removeprefix("*")
        for one in sides:
            if name.startswith("@"):
                points = _apply_rule(table[name[1:]], one, index, table)
            else:
                points = (index[one, name],) if (one, name) in index else None
            if points is None:
                return None
            found += points
    return tuple(found)


def _apply_rule(rule: str, side: str, index: dict[Key, int], table: dict[str, str]) -> tuple[int, ...] | None:
    for term in rule.split("|"):
        found = _find(term, side, index, table)
        if found is not None:
            return found
    return None


def _apply_table(name: str, table: dict[str, str], index: dict[Key, int]) -> NameMatch | None:
    if "with" in table and all(_apply_rule(table["with"], side, index, table) is None for side in ("", "l", "r")):
        return None
    sources: dict[str, tuple[int, ...]] = {}
    skin = set()
    for place, rule in table.items():
        if place == "with":
            continue
        sides = (("", ""),) if place in _CENTRAL else (("l", "left_"), ("r", "right_"))
        for side, prefix in sides:
            joint = prefix + place.removesuffix(_SKIN)
            if joint in sources:
                continue
            found = _apply_rule(rule, side, index, table)
            if found is not None:
                sources[joint] = found
                if place.endswith(_SKIN):
                    skin.add(joint)
    return NameMatch(name, sources, find_missing(sources), frozenset(skin))


def find_missing(sources: Container[str]) -> tuple[str, ...]:
    """Return the required joints missing in some places; hips can be made from markers on the pelvis."""
    has_hips = has_pelvis_markers(sources)
    return tuple(j for j in REQUIRED_JOINTS if j not in sources and not (has_hips and "hip" in j))


def has_pelvis_markers(sources: Container[str]) -> bool:
    """Return whether hips can be made from markers on the pelvis, or on the trochanters."""
    spines = all(marker in sources for marker in ("left_asis", "right_asis", "sacrum"))
    return spines or all(marker in sources for marker in ("left_trochanter", "right_trochanter"))


_LIMBS = (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))


def holds_limb(missing: Container[str]) -> bool:
    """Return whether a whole arm or leg is there although these required joints are missing."""
    sides = ("left", "right")
    return any(all(f"{side}_{joint}" not in missing for joint in limb) for limb in _LIMBS for side in sides)


@lru_cache(maxsize=256)
def named_by_estimators(names: tuple[str, ...]) -> bool:
    """Return whether the names are those of pose estimators.

    Toes as MediaPipe or OpenPose call them, all joints with nose and eyes of COCO, or with the thorax of Human3.6M.
    """
    cores = {core for _, core in normalise_names(names)}
    return any(signs <= cores for signs in _ESTIMATED)


_OWNER = re.compile(r"^\s*(?:(.+):|([^:_. -]+)[_. -])\s*(?=\S)")


@lru_cache(maxsize=256)
def group_owners(names: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    """Return the points of each of several people by owner: ``Anna:LASI`` and ``Ben:LASI``, or ``S1_LASI`` ...

    {} if there is at most one. Without a colon an owner is one only if the points are those of a body: fingers have
    prefixes too.
    """
    points: dict[str, list[int]] = {}
    sure = set()
    for index, name in enumerate(names):
        found = _OWNER.match(name)
        owner = (found[1] or found[2]).strip() if found is not None else ""
        if owner and owner.lower() not in _SIDES:
            points.setdefault(owner, []).append(index)
            if found is not None and found[1]:
                sure.add(owner)
    if len(points) < 2:
        return {}
    bare = [tuple(_OWNER.sub("", names[index]) for index in own) for own in points.values()]
    shared = share_joints(bare, [owner in sure for owner in points])
    people = {owner: tuple(own) for (owner, own), like in zip(points.items(), shared, strict=True) if like}
    return people if len(people) > 1 else {}


def shared_owner(names: Sequence[str]) -> str:
    """Return the owner that all names begin with; "" if there is none."""
    found = [_OWNER.match(name) for name in names]
    owners = {match[1] or match[2] if match is not None else "" for match in found}
    return owners.pop().strip() if len(owners) == 1 else ""


def share_joints(
    bodies: Sequence[tuple[str, ...]],
    by_name: Sequence[bool] | None = None,
    *,
    least: int = 8,
    similar: float = 0.6,
    limb: int = 3,
) -> list[bool]:
    """Return which sets of names are those of one more body: a person has each joint once.

    Parameters
    ----------
    bodies : names of each set, without owners.
    by_name : whether equal names are enough; else, and of different ones, the canonical joints found in them count.
    least : names of a body.
    similar : share of the names of one set that another one has.
    limb : canonical joints that two sets share.
    """
    keys = [set(normalise_names(names)) if len(names) >= least else set() for names in bodies]
    large = [index for index, own in enumerate(keys) if own]
    result = [False] * len(bodies)
    if len(large) < 2:
        return result
    matches = {index: match_names(bodies[index]) for index in large}
    joints = {index: set(match.sources) if match is not None else set() for index, match in matches.items()}
    for one in large:
        named = by_name is None or by_name[one]
        result[one] = any(
            (named and len(keys[one] & keys[other]) >= similar * len(keys[one]))
            or len(joints[one] & joints[other] & set(CANONICAL_JOINTS)) >= limb
            for other in large
            if other != one
        )
    return result


_JOINTS = {"shoulder", "elbow", "wrist", "hip", "knee"}
_ESTIMATED = ({"footindex"}, {"bigtoe"}, _JOINTS | {"nose", "eye", "ankle"}, _JOINTS | {"thorax"})


@lru_cache(maxsize=256)
def rank_matches(names: tuple[str, ...]) -> tuple[NameMatch, ...]:
    """Match every table with the names of a file, the one that covers most first.

    ``names`` : (K,) as in the file; the first of equal names counts. Matches without a joint are left out.
    """
    best = _rank(normalise_names(names))
    for group in _list_groups(names) if not best or best[0].missing else ():
        found = _rank(normalise_names(group))
        if found and (not best or len(found[0].missing) < len(best[0].missing)):
            best = found
    return best


def _rank(keys: tuple[Key, ...]) -> tuple[NameMatch, ...]:
    index: dict[Key, int] = {}
    for position, key in enumerate(keys):
        index.setdefault(key, position)
    found = []
    for name, table in TABLES.items():
        match = _apply_table(name, table, index)
        joints = 0 if match is None else sum(joint in match.sources for joint in CANONICAL_JOINTS)
        if match is not None and (joints or len(match.missing) < len(REQUIRED_JOINTS)):
            found.append((len(match.missing), -joints, len(match.skin), match))
    return tuple(match for *_, match in sorted(found, key=lambda row: row[:3]))


def match_names(names: tuple[str, ...]) -> NameMatch | None:
    """Return the match of the table that covers most of the names of a file; None if no table has any."""
    matches = rank_matches(names)
    return matches[0] if matches else None
