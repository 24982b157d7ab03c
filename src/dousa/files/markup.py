"""XML without document types, so that no entity can expand or fetch anything; and TOML."""

from __future__ import annotations

import json
import re
import tomllib
import xml.etree.ElementTree as ET
from typing import Any

from dousa.errors import CalibrationError


class _Builder(ET.TreeBuilder):
    def doctype(self, _name: str, _public: str | None, _system: str | None) -> None:
        """Called before any entity is declared."""
        raise CalibrationError("markup.doctype")


def parse_xml(content: bytes) -> ET.Element:
    """Parse XML and return the root element; CalibrationError if it is no XML, cut off, or has a document type."""
    parser = ET.XMLParser(target=_Builder())
    try:
        return ET.fromstring(content, parser=parser)
    except ET.ParseError as error:
        line = error.position[0]
        raise CalibrationError("markup.broken_xml", line=line, reason=error) from error
    except (ValueError, LookupError) as error:  # an unknown encoding
        if isinstance(error, CalibrationError):
            raise
        raise CalibrationError("markup.not_xml", reason=error) from error


_DECIMAL = re.compile(r"(?<![\w.])\d+\.\d+(?:[eE][-+]?\d+)?(?![\w.])")  # by definition of TOML; no dotted key


def parse_toml(text: str, most_dots: int = 200) -> dict[str, Any]:
    """Parse TOML with any line ends; ``most_dots`` : in a line, without those of decimal numbers.

    Raises
    ------
    tomllib.TOMLDecodeError : no TOML.
    RecursionError : brackets or keys are nested too deep.
    """
    lines = text.replace("\r\n", "\n")
    dotted = (line for line in lines.split("\n") if line.count(".") > most_dots)
    if any(_DECIMAL.sub("", line).count(".") > most_dots for line in dotted):
        raise RecursionError("a line with more dots than any key or list of numbers needs")
    return tomllib.loads(lines)


def quote_toml(text: str) -> str:
    """Quote a text as a basic string of TOML: JSON's, except for one control character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
