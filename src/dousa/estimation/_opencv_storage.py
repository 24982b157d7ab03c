"""The files of OpenCV's FileStorage (YAML, XML, JSON) as plain dictionaries.

Read here and not by OpenCV, whose parser does not take YAML from other programs (ROS, calibration scripts), and whose
failures on damaged files cannot all be caught. Of YAML this is the part that calibration files use: mappings and lists
by indentation or in brackets, numbers, words, quoted words, tags (ignored), comments, several documents.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from typing import Any

from dousa.errors import CalibrationError

__all__ = ["read_json", "read_xml", "read_yaml"]

_DEEPEST = 20
# No pattern may try the same letters twice: a line can be megabytes long.
_KEY = re.compile(r"""("[^"]*"|'[^']*'|[^\s:\[\]{}#'"-][^:\[\]{}#]*):(?:\s+(.*))?""")
_TAG = re.compile(r"!\S*\s*")
_TOKEN = re.compile(r"""\s*([\[\]{},]|"(?:[^"\\]|\\.)*"|'[^']*'|[^\[\]{},"'\s][^\[\]{},]*)""")
_QUOTED_OR_HASH = re.compile(r"""(?<!\S)(?:"[^"]*"|'[^']*'|\#)""")

_Line = tuple[int, int, str]  # number from 1, indentation, text


def read_json(text: str) -> dict[str, Any]:
    """The document; CalibrationError if it is no JSON object."""
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(
            f"line {error.lineno}: not whole JSON ({error.msg}); is the file truncated?"
        ) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"not whole JSON ({error})") from error
    if not isinstance(found, dict):
        raise CalibrationError("expected a JSON object with the cameras, got something else")
    return found


def read_xml(root: ET.Element) -> dict[str, Any]:
    """The document below ``<opencv_storage>``."""
    return {child.tag: _read_element(child, 0) for child in root}


def _read_element(element: ET.Element, depth: int) -> Any:
    if depth > _DEEPEST:
        raise CalibrationError(f"<{element.tag}>: elements lie too deep inside each other")
    if len(element) == 0:
        text = (element.text or "").strip()
        words = [_scalar(word) for word in text.split()]
        if words and all(isinstance(word, float) for word in words):
            return words[0] if len(words) == 1 else words
        return text.strip('"')
    if all(child.tag == "_" for child in element):
        return [_read_element(child, depth + 1) for child in element]
    return {child.tag: _read_element(child, depth + 1) for child in element}


def _scalar(text: str) -> Any:
    """A number, or the text without its quotes."""
    text = text.strip()
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1]
    if text.lower() in (".nan", ".inf", "-.inf", "+.inf"):
        return float(text.lower().replace(".", "", 1))
    try:
        return text if "_" in text else float(text)
    except ValueError:
        return text


def read_yaml(text: str) -> list[dict[str, Any]]:
    """The documents of a YAML file.

    Raises
    ------
    CalibrationError : a line that is none of the part of YAML that is read.
    """
    documents: list[list[_Line]] = [[]]
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        bare = _strip_comment(line).rstrip()
        if bare.startswith("---") or bare == "...":
            documents.append([])
            bare = bare[3:].strip()
        if bare and not bare.startswith("%"):
            content = bare.lstrip(" ")
            if content.startswith("\t"):
                raise CalibrationError(f"line {number}: expected spaces before the text, got a tab")
            documents[-1].append((number, len(bare) - len(content), content))
    found = []
    for lines in documents:
        if lines:
            value, rest = _read_block(lines, 0, 0)
            if rest < len(lines) or not isinstance(value, dict):
                raise _unread(lines[min(rest, len(lines) - 1)])
            found.append(value)
    return found


def _strip_comment(line: str) -> str:
    marks = _QUOTED_OR_HASH.finditer(line) if "#" in line else ()
    return next((line[: mark.start()] for mark in marks if mark[0] == "#"), line)


def _unread(line: _Line) -> CalibrationError:
    return CalibrationError(f"line {line[0]}: expected 'key: value', got {line[2][:40]!r}")


def _read_block(lines: list[_Line], start: int, depth: int) -> tuple[Any, int]:
    """The mapping or list that begins in a line, and the index of the line after it."""
    if depth > _DEEPEST:
        raise CalibrationError(f"line {lines[start][0]}: blocks lie too deep inside each other")
    indent = lines[start][1]
    if lines[start][2].startswith(("- ", "-\n")) or lines[start][2] == "-":
        return _read_list(lines, start, indent, depth)
    found: dict[str, Any] = {}
    at = start
    while at < len(lines) and lines[at][1] == indent:
        match = _KEY.fullmatch(lines[at][2])
        if match is None:
            raise _unread(lines[at])
        key = match[1].strip("\"' ")
        if key in found:
            raise CalibrationError(f"line {lines[at][0]}: the key '{key}' stands here twice")
        found[key], at = _read_value(lines, at, _TAG.sub("", match[2] or "", count=1), indent, depth)
    return found, at


def _read_list(lines: list[_Line], start: int, indent: int, depth: int) -> tuple[list[Any], int]:
    found: list[Any] = []
    at = start
    while at < len(lines) and lines[at][1] == indent and lines[at][2].startswith("-"):
        number, _, text = lines[at]
        item = (
            _TAG.sub("", text[1:].lstrip(), count=1)
            if text[1:].lstrip().startswith("!")
            else text[1:].lstrip()
        )
        if _KEY.fullmatch(item):  # a mapping that begins beside its dash
            lines[at] = (number, indent + len(text) - len(text[1:].lstrip()), item)
            value, at = _read_block(lines, at, depth + 1)
        else:
            value, at = _read_value(lines, at, item, indent, depth)
        found.append(value)
    return found, at


def _read_value(lines: list[_Line], at: int, text: str, indent: int, depth: int) -> tuple[Any, int]:
    """The value that begins with ``text`` in a line, and the index of the line after it."""
    if not text:
        deeper = at + 1 < len(lines) and (
            lines[at + 1][1] > indent or (lines[at + 1][1] == indent and lines[at + 1][2].startswith("- "))
        )
        return _read_block(lines, at + 1, depth + 1) if deeper else (None, at + 1)
    if text[0] not in "[{":
        return _scalar(text), at + 1
    parts, first = [text], at
    opened = _balance(text)
    while opened > 0 and at + 1 < len(lines):
        at += 1
        parts.append(lines[at][2])
        opened += _balance(lines[at][2])
    if opened != 0:
        raise CalibrationError(f"line {lines[first][0]}: brackets that do not close; is the file truncated?")
    tokens = _TOKEN.findall(" ".join(parts))
    value, rest = _read_flow(tokens, 0, depth)
    if rest != len(tokens):
        raise CalibrationError(f"line {lines[first][0]}: expected values parted by commas in brackets")
    return value, at + 1


def _balance(text: str) -> int:
    return sum(text.count(bracket) for bracket in "[{") - sum(text.count(bracket) for bracket in "]}")


def _read_flow(tokens: list[str], at: int, depth: int) -> tuple[Any, int]:
    """The value at a token of ``[1, {a: 2}]``, and the index of the token after it; -1 if it is broken."""
    if depth > _DEEPEST or at >= len(tokens):
        return None, -1
    opening = tokens[at]
    if opening not in "[{":
        return (None, -1) if opening in "]},:" else (_scalar(opening), at + 1)
    closing = "]" if opening == "[" else "}"
    items: list[Any] = []
    pairs: dict[str, Any] = {}
    at += 1
    while at < len(tokens) and tokens[at] != closing:
        if closing == "}":
            key, _, inline = tokens[at].partition(":")
            at += 1
            if inline.strip():
                value: Any = _scalar(inline)
            else:
                value, at = _read_flow(tokens, at, depth + 1)
            pairs[key.strip("\"' ")] = value
        else:
            value, at = _read_flow(tokens, at, depth + 1)
            items.append(value)
        if at < 0:
            return None, -1
        if at < len(tokens) and tokens[at] == ",":
            at += 1
    if at >= len(tokens):
        return None, -1
    return (items if closing == "]" else pairs), at + 1
