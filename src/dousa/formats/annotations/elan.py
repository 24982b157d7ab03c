"""ELAN's .eaf files (EAF 2.7 to 3.0, Max Planck Institute for Psycholinguistics): tiers of annotations in XML.

Times are slots in ms. A slot without a time lies evenly between neighbours with one; at either end it has none. An
annotation that refers to another has its time, or an equal share of it where several do.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from dousa.errors import CalibrationError, MotionFileError
from dousa.files.disk import atomic_write
from dousa.files.markup import parse_xml
from dousa.formats.annotations.label_file import LabelFile, LabelTier, clean_category, finish_tier, make_span
from dousa.motion.annotation import Stretch

_Times = dict[str, tuple[float, float]]


def read_eaf(path: str, data: bytes) -> LabelFile:
    """Read the labels of an ELAN document; MotionFileError for invalid XML, times or references."""
    try:
        root = parse_xml(data)
    except CalibrationError as error:
        raise MotionFileError(path, error.message) from error
    if root.tag != "ANNOTATION_DOCUMENT":
        raise MotionFileError(path, "label_files.not_elan", found=root.tag[:40])
    slots = _read_slots(path, root)
    times: _Times = {}
    for node in root.iter("ALIGNABLE_ANNOTATION"):
        ends = [node.get(f"TIME_SLOT_REF{which}", "") for which in (1, 2)]
        missing = [end for end in ends if end not in slots]
        if missing:
            raise MotionFileError(
                path, "label_files.no_slot", slot=missing[0], annotation=node.get("ANNOTATION_ID", "?")
            )
        untimed = [end for end in ends if slots[end] is None]
        if untimed:
            raise MotionFileError(path, "label_files.no_slot_time", found=untimed[0])
        start, stop = slots[ends[0]], slots[ends[1]]
        if start is not None and stop is not None:
            times[node.get("ANNOTATION_ID", "")] = start, stop
    _add_references(path, root, times)
    tiers = []
    for tier in root.iter("TIER"):
        spans = []
        for node in tier.iter():
            if node.tag not in ("ALIGNABLE_ANNOTATION", "REF_ANNOTATION"):
                continue
            category = clean_category(node.findtext("ANNOTATION_VALUE") or "")
            start, stop = times[node.get("ANNOTATION_ID", "")]
            if category:
                spans.append(make_span(path, start, stop, category, None))
        tiers.append(finish_tier(path, LabelTier(tier.get("TIER_ID", ""), tuple(spans))))
    return LabelFile(path, {"": tuple(tiers)})


def _read_slots(path: str, root: ET.Element) -> dict[str, float | None]:
    """Seconds by the name of the slot; None before the first and after the last with a time."""
    slots = list(root.iter("TIME_SLOT"))
    known: dict[int, float] = {}
    for place, node in enumerate(slots):
        text = node.get("TIME_VALUE")
        if text is None:
            continue
        try:
            known[place] = int(text) / 1000.0
        except ValueError:
            raise MotionFileError(path, "label_files.no_slot_time", found=text[:40]) from None
    filled = (
        np.interp(np.arange(len(slots)), list(known), list(known.values())).tolist() if known else [0.0] * len(slots)
    )
    return {
        node.get("TIME_SLOT_ID", ""): value if known and min(known) <= place <= max(known) else None
        for place, (node, value) in enumerate(zip(slots, filled, strict=True))
    }


def _add_references(path: str, root: ET.Element, times: _Times) -> None:
    """Add times of annotations that refer to others, at any depth."""
    waiting: dict[str, list[str]] = {}
    for tier in root.iter("TIER"):
        children: dict[str, list[str]] = {}
        for node in tier.iter("REF_ANNOTATION"):
            children.setdefault(node.get("ANNOTATION_REF", ""), []).append(node.get("ANNOTATION_ID", ""))
        for parent, some in children.items():
            waiting.setdefault(parent, []).append("\n".join(some))
    while waiting:
        ready = [parent for parent in waiting if parent in times]
        if not ready:
            raise MotionFileError(path, "label_files.no_parent", annotation=next(iter(waiting)))
        for parent in ready:
            start, stop = times[parent]
            for group in waiting.pop(parent):
                own = group.split("\n")
                step = (stop - start) / len(own)
                for number, name in enumerate(own):
                    times[name] = start + number * step, start + (number + 1) * step


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
