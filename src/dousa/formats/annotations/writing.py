"""Writing of labels: dousa's CSV, which ``read_label_file`` reads, and ELAN's .eaf."""

from __future__ import annotations

import csv
import io
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

from dousa.files.disk import atomic_write
from dousa.motion.annotation import Stretch

COLUMNS = ("start_s", "end_s", "category")


def format_labels_csv(segments: Iterable[Stretch]) -> str:
    """Format a row per segment: start_s, end_s, category (empty where nothing happens).

    If some are unclear, they have a question mark in a column ``perhaps``.
    """
    rows = list(segments)
    doubtful = not all(one.counted for one in rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, *(("perhaps",) if doubtful else ())))
    for one in rows:
        perhaps = ("" if one.counted else "?",) if doubtful else ()
        writer.writerow((f"{one.start:.3f}", f"{one.stop:.3f}", one.category or "", *perhaps))
    return text.getvalue()


def write_labels_csv(segments: Iterable[Stretch], path: str | os.PathLike[str]) -> None:
    """Write ``format_labels_csv`` to a file; MotionWriteError if it cannot be written."""
    with atomic_write(path) as file:
        file.write(format_labels_csv(segments).encode())


def format_eaf(segments: Sequence[Stretch], tier: str = "category", media: str = "") -> bytes:
    """Format an ELAN document (EAF 3.0) with one tier; segments without a category are left out."""
    head = {
        "AUTHOR": "dousa",
        "DATE": datetime.now(UTC).isoformat(timespec="seconds"),
        "FORMAT": "3.0",
        "VERSION": "3.0",
        "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
        "xsi:noNamespaceSchemaLocation": "http://www.mpi.nl/tools/elan/EAFv3.0.xsd",
    }
    root = ET.Element("ANNOTATION_DOCUMENT", head)
    header = ET.SubElement(root, "HEADER", {"MEDIA_FILE": "", "TIME_UNITS": "milliseconds"})
    if media:
        ET.SubElement(header, "PROPERTY", {"NAME": "take"}).text = media
    order = ET.SubElement(root, "TIME_ORDER")
    body = ET.SubElement(root, "TIER", {"LINGUISTIC_TYPE_REF": "default-lt", "TIER_ID": tier})
    named = sorted((one for one in segments if one.category), key=lambda one: (one.start, one.stop))
    for number, one in enumerate(named):
        slots = [f"ts{2 * number + which}" for which in (1, 2)]
        for slot, seconds in zip(slots, (one.start, one.stop), strict=True):
            ET.SubElement(order, "TIME_SLOT", {"TIME_SLOT_ID": slot, "TIME_VALUE": str(round(1000 * seconds))})
        refs = {"ANNOTATION_ID": f"a{number + 1}", "TIME_SLOT_REF1": slots[0], "TIME_SLOT_REF2": slots[1]}
        node = ET.SubElement(ET.SubElement(body, "ANNOTATION"), "ALIGNABLE_ANNOTATION", refs)
        ET.SubElement(node, "ANNOTATION_VALUE").text = one.category
    kind = {"GRAPHIC_REFERENCES": "false", "LINGUISTIC_TYPE_ID": "default-lt", "TIME_ALIGNABLE": "true"}
    ET.SubElement(root, "LINGUISTIC_TYPE", kind)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def write_eaf(segments: Sequence[Stretch], path: str | os.PathLike[str], tier: str = "category") -> None:
    """Write ``format_eaf`` to a file; MotionWriteError if it cannot be written."""
    with atomic_write(path) as file:
        file.write(format_eaf(segments, tier))
