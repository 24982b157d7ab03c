"""Every code of the program has its words in both languages, with the same values; no words stand in the program."""

import ast
import re
import string
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

import dousa
from dousa import errors
from dousa.messages import LANGUAGES, Message
from dousa.messages.tables import load_table

SOURCE = Path(dousa.__file__).parent
ROOT = SOURCE.parents[1]
FILE_ERRORS = {
    name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, errors.MotionFileError)
} | {"RefusedError"}  # of the studio: the status comes first
ERRORS = {
    name
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.DousaError) and name != "MissingExtraError"
} | {"RefusedError", "WorkError"}
SPEAKERS = {"_say"}  # functions that print a message
OWN_VALUES = {"line", "joints"}  # what errors keep for themselves besides the values of the sentence
# Rendered by their number (system), kept for old data (text), or by the errors themselves.
BUILT_IN = {"text.verbatim", "joints.has", "extras.missing"}
# Rendered by the number of an error, and the words of pages: tests of these hold that they are used.
FOUND_BY_NAME = (
    "system.",
    "report.",
    "report_beats.",
    "report_exercise.",
    "player.",
    "player_single.",
    "player_pair.",
    "relations.",
    "body_part.",
    "body_segments.",
    "error_kinds.",
    "error_causes.",
    "lapse_kinds.",
    "advice_parts.",
    "advice_corrections.",
    "joint_angles.",
    "fault_joint.",
    "exercise_table.",
    "offset_ways.",
)
WITHOUT_ENTRY = {"system.error"}


@pytest.mark.parametrize("language", LANGUAGES)
def test_sections_are_those_of_the_files(language: str):
    table = {}
    for file in (SOURCE / "messages" / language).glob("*.toml"):
        for section, entries in tomllib.loads(file.read_text(encoding="utf-8")).items():
            table |= {f"{section}.{key}": text for key, text in entries.items()}
    assert load_table(language) == table


@dataclass(frozen=True)
class Call:
    """A message in the program: where, the codes it may have, and the names of its values (None: handed over whole)."""

    place: str
    codes: tuple[str, ...]
    values: frozenset[str] | None

    @property
    def is_sentence(self) -> bool:
        return any(" " in code for code in self.codes)


def list_fields(template: str) -> set[str]:
    """The names of the values that a template uses."""
    return {name.split(".")[0].split("[")[0] for _, name, _, _ in string.Formatter().parse(template) if name}


def list_literals(node: ast.expr, constants: dict[str, list[ast.expr]]) -> Iterator[str]:
    """The strings that an expression can be: literals, conditionals of them, look-ups in a table of the module."""
    if isinstance(node, ast.Constant):
        yield from [node.value] if isinstance(node.value, str) else []
    elif isinstance(node, ast.JoinedStr | ast.BinOp) and " " in ast.unparse(node):  # else a code put together
        yield f"a sentence made on the spot: {ast.unparse(node)}"
    for part in list_alternatives(node, constants):
        hidden = node.id if isinstance(node, ast.Name) else None  # a name may be assigned to itself
        yield from list_literals(part, {name: found for name, found in constants.items() if name != hidden})


def list_alternatives(node: ast.expr, constants: dict[str, list[ast.expr]]) -> list[ast.expr]:
    """The expressions that an expression chooses from."""
    if isinstance(node, ast.IfExp):
        return [node.body, node.orelse]
    if isinstance(node, ast.Dict):
        return node.values
    if isinstance(node, ast.List | ast.Tuple | ast.Set):
        return node.elts
    if isinstance(node, ast.Subscript):
        return [node.value]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
        return [node.func.value, *node.args[1:]]
    return constants.get(node.id, []) if isinstance(node, ast.Name) else []


def walk_calls(
    scope: ast.AST, known: dict[str, list[ast.expr]]
) -> Iterator[tuple[ast.Call, dict[str, list[ast.expr]]]]:
    """Every call, and what the names of the functions around it and of the module stand for."""
    known = dict(known)
    inner: list[ast.AST] = []
    calls: list[ast.Call] = []
    own: dict[str, list[ast.expr]] = {}
    waiting = list(ast.iter_child_nodes(scope))
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            inner.append(node)
            continue
        if isinstance(node, ast.Call):
            calls.append(node)
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(target, ast.Name):
                    own.setdefault(target.id, []).append(node.value)
        waiting += ast.iter_child_nodes(node)
    known |= own
    yield from ((call, known) for call in calls)
    for function in inner:
        yield from walk_calls(function, known)


def list_sources() -> list[Path]:
    """Files whose messages come from the tables: of the package, and of the lab."""
    return sorted([*SOURCE.rglob("*.py"), *(ROOT / "lab").rglob("*.py")])


HOLDS_CALL = re.compile(rf"\b(?:{'|'.join(sorted(ERRORS | SPEAKERS | {'Message'}))})\(")


def list_calls(path: Path) -> Iterator[Call]:
    text = path.read_text(encoding="utf-8")
    if not HOLDS_CALL.search(text):
        return
    for node, constants in walk_calls(ast.parse(text), {}):
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        position = 1 if name in FILE_ERRORS | SPEAKERS else 0
        if name not in ERRORS | SPEAKERS | {"Message"} or len(node.args) <= position:
            continue
        names = [keyword.arg for keyword in node.keywords]
        values = None if None in names else frozenset(name for name in names if name)
        place = f"{path.relative_to(ROOT)}:{node.lineno}"
        codes = tuple(dict.fromkeys(list_literals(node.args[position], constants)))
        if codes:
            yield Call(place, codes, values)


@cache
def all_calls() -> list[Call]:
    """Every message in the program. Read when a test asks: whoever collects the tests need not wait for it."""
    return [call for path in list_sources() for call in list_calls(path)]


def coded_calls() -> list[Call]:
    return [call for call in all_calls() if not call.is_sentence]


@cache
def all_texts() -> str:
    return "\n".join(path.read_text(encoding="utf-8") for path in list_sources())


@pytest.mark.slow
def test_no_sentence_stands_in_the_program():
    assert [call.place for call in all_calls() if call.is_sentence] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_has_its_words(language):
    table = {*load_table(language), *WITHOUT_ENTRY}
    assert [f"{call.place}: {code}" for call in coded_calls() for code in call.codes if code not in table] == []


def test_both_tables_have_the_same_entries():
    first, second = (load_table(language) for language in LANGUAGES)
    assert set(first) == set(second)


def test_both_languages_use_the_same_values():
    first, second = (load_table(language) for language in LANGUAGES)
    differing = [code for code in first if list_fields(first[code]) != list_fields(second[code])]
    assert differing == []


def test_every_value_of_the_words_is_given():
    table = load_table(LANGUAGES[0])
    missing = [
        f"{call.place}: {code} lacks {sorted(list_fields(table[code]) - call.values)}"
        for call in coded_calls()
        for code in call.codes
        if code in table and call.values is not None and not list_fields(table[code]) <= call.values
    ]
    assert missing == []


def test_every_value_given_is_used():
    """By one at least of the codes that a call chooses from."""
    table = load_table(LANGUAGES[0])
    unused = []
    for call in coded_calls():
        used = OWN_VALUES.union(*(list_fields(table.get(code, "")) for code in call.codes))
        if call.values is not None and not call.values <= used and not set(call.codes) & WITHOUT_ENTRY:
            unused.append(f"{call.place}: {call.codes} does not use {sorted(call.values - used)}")
    assert unused == []


def is_used(code: str, used: set[str]) -> bool:
    """Whether a call has this code; one in a table of literals for a call elsewhere stands in quotes somewhere."""
    return code in used or code.startswith(FOUND_BY_NAME) or f'"{code}"' in all_texts()


def test_every_entry_is_used():
    used = {code for call in coded_calls() for code in call.codes} | BUILT_IN
    unused = [code for code in load_table(LANGUAGES[0]) if not is_used(code.removeprefix("studio_instead."), used)]
    assert [code for code in unused if not is_used(code, used)] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_words_of_the_studio_need_no_other_values(language):
    table = load_table(language)
    for code, template in table.items():
        plain = code.removeprefix("studio_instead.")
        if plain != code and plain in table:
            assert list_fields(template) <= list_fields(table[plain]), code


def make_value(specification: str) -> object:
    """Something that this format takes."""
    kind, _, inner = specification.partition(" ")
    if kind in ("list", "and", "or"):
        return (make_value(inner), make_value(inner))
    if kind in ("count", "plural") or specification.endswith("d"):
        return 3
    return 2.5 if specification else "word"


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_template_can_be_filled(language):
    for code, template in load_table(language).items():
        fields = [(name, spec or "") for _, name, spec, _ in string.Formatter().parse(template) if name]
        text = Message(code, **{name: make_value(spec) for name, spec in fields}).render(language)
        assert bool(text) == bool(template), code
