"""XML of unknown origin: no document types, so that no entity can grow or fetch anything."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from dousa.errors import CalibrationError

__all__ = ["parse_xml"]


class _Builder(ET.TreeBuilder):
    def doctype(self, _name: str, _public: str | None, _system: str | None) -> None:
        """Called before any entity is declared."""
        raise CalibrationError("expected XML without a DOCTYPE; entities are not read")


def parse_xml(content: bytes) -> ET.Element:
    """The root element.

    Raises
    ------
    CalibrationError : no XML, cut off, or with a document type.
    """
    parser = ET.XMLParser(target=_Builder())
    try:
        return ET.fromstring(content, parser=parser)
    except ET.ParseError as error:
        line = error.position[0]
        raise CalibrationError(f"line {line}: not whole XML ({error}); is the file truncated?") from error
    except (ValueError, LookupError) as error:  # an encoding that nobody knows
        if isinstance(error, CalibrationError):
            raise
        raise CalibrationError(f"not XML: {error}") from error
