"""The form of this project's docstrings for mkdocstrings: ``name : what it is``, the type being in the signature.

An extension of Griffe, which reads the source without running it. Names that a package loads when they are used are in
the stub (``__init__.pyi``) beside it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from griffe import (
    Class,
    Docstring,
    DocstringParameter,
    DocstringRaise,
    DocstringReturn,
    DocstringSection,
    DocstringSectionExamples,
    DocstringSectionKind,
    DocstringSectionParameters,
    DocstringSectionRaises,
    DocstringSectionReturns,
    DocstringSectionText,
    DocstringSectionYields,
    DocstringYield,
    Extension,
    Function,
    Module,
    Object,
)

_HEADING = re.compile(r"^(Parameters|Attributes|Returns|Yields|Raises)\n-{3,}\n", re.MULTILINE)
_ENTRY = re.compile(r"^(?P<names>\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*)(?: : ?(?P<text>.*))?$")


class HouseStyle(Extension):
    """Docstrings become sections."""

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """After a package was read: once for the whole tree."""
        if pkg.name != "dousa":
            return
        objects = list(_walk(pkg))
        for one in [pkg, *objects]:
            if one.docstring is not None:
                one.docstring.parsed = split_docstring(one.docstring, one)


def _walk(obj: Object) -> Iterator[Object]:
    for member in obj.members.values():
        if isinstance(member, Object):
            yield member
            yield from _walk(member)


def split_docstring(docstring: Docstring, owner: Object) -> list[DocstringSection]:
    """The sections of a docstring.

    Parameters
    ----------
    docstring : text with underlined headings.
    owner : what it describes; gives the types.
    """
    pieces = _HEADING.split(docstring.value)
    sections = _split_text(pieces[0].strip())
    for heading, body in zip(pieces[1::2], pieces[2::2], strict=True):
        content, rest = _split_body(body, free=heading in ("Returns", "Yields"))
        sections.append(_make_section(heading, content, owner))
        sections += _split_text(rest)
    return sections


def _split_text(text: str) -> list[DocstringSection]:
    """Plain text, and the example that may follow it."""
    words, prompt, example = f"\n\n{text}".partition("\n\n>>> ")
    sections: list[DocstringSection] = [DocstringSectionText(words.strip())] if words.strip() else []
    if prompt:
        sections.append(DocstringSectionExamples([(DocstringSectionKind.examples, f">>> {example}")]))
    return sections


def _split_body(body: str, *, free: bool) -> tuple[str, str]:
    """What belongs to a heading, and the paragraphs after it that do not: entries end where a line is none."""
    if free:
        content, _, rest = body.strip().partition("\n\n")
        return content, rest.strip()
    lines = body.strip("\n").split("\n")
    for number, line in enumerate(lines):
        after_gap = number > 0 and not lines[number - 1].strip()
        if after_gap and line and not line.startswith(" ") and not _ENTRY.match(line):
            return "\n".join(lines[:number]).strip(), "\n".join(lines[number:]).strip()
    return "\n".join(lines).strip(), ""


def _make_section(heading: str, content: str, owner: Object) -> DocstringSection:
    returned = owner.returns if isinstance(owner, Function) else None
    if heading == "Returns":
        return DocstringSectionReturns([DocstringReturn(name="", annotation=returned, description=content)])
    if heading == "Yields":
        return DocstringSectionYields([DocstringYield(name="", annotation=returned, description=content)])
    entries = list(_split_entries(content))
    if heading == "Raises":
        return DocstringSectionRaises(
            [DocstringRaise(annotation=", ".join(names), description=text) for names, text in entries]
        )
    return DocstringSectionParameters([_make_parameter(names, text, owner) for names, text in entries])


def _split_entries(content: str) -> Iterator[tuple[list[str], str]]:
    """Names and text of each entry; names that are described together stay together."""
    names: list[str] = []
    text: list[str] = []
    for line in content.split("\n"):
        entry = _ENTRY.match(line)
        if entry is None:
            text.append(line.strip())
            continue
        if names:
            yield names, "\n".join(text).strip()
        names, text = entry["names"].split(", "), [entry["text"] or ""]
    if names:
        yield names, "\n".join(text).strip()


def _make_parameter(names: list[str], text: str, owner: Object) -> DocstringParameter:
    """Parameters that are described together, with the types and defaults of their signature."""
    known = _list_signed(owner)
    signed = [known[name.lstrip("*")] for name in names if name.lstrip("*") in known]
    types = list(dict.fromkeys(str(annotation) for annotation, _ in signed if annotation is not None))
    defaults = [str(default) for _, default in signed if default is not None]
    several = defaults if len(set(defaults)) > 1 else defaults[:1]
    annotation = signed[0][0] if len(types) == 1 else ", ".join(types) or None
    value = ", ".join(several) or None
    return DocstringParameter(", ".join(names), annotation=annotation, description=text, value=value)


def _list_signed(owner: Object) -> dict[str, tuple[Any, Any]]:
    """Type and default of each parameter by name; those of a dataclass are its fields."""
    signed: dict[str, tuple[Any, Any]] = {}
    if isinstance(owner, Class):
        signed = {name: (field.annotation, field.value) for name, field in owner.attributes.items()}
    if isinstance(owner, Function | Class):
        signed |= {one.name: (one.annotation, one.default) for one in owner.parameters}
    return signed
