"""Lists of actions of CMU's subject 86 (``mocap.txt``).

After a line with the numbers of subject and take, each line has the name of an action and the earliest, likely and
latest frame of its end, where the next begins. The part between the earliest and the latest end is unclear.
"""

from __future__ import annotations

import re

from dousa.errors import MotionFileError
from dousa.formats.annotations.label_file import LabelFile, LabelSpan, LabelTier, check_category, decode_text
from dousa.messages import Message

_TAKE = re.compile(r"\s*(\d+)[\s_]+(\d+)\s*")
_ACTION = re.compile(r"\s*(\S*[^\W\d]\S*)\s+(\d+)\s+(\d+)\s+(\d+)\s*")


def is_cmu_list(text: str) -> bool:
    """Return whether the first lines of a text are those of such a list."""
    lines = [line for line in text.splitlines()[:20] if line.strip()][:2]
    return len(lines) == 2 and bool(_TAKE.fullmatch(lines[0])) and bool(_ACTION.fullmatch(lines[1]))


def read_cmu_list(path: str, data: bytes) -> LabelFile:
    """Read labels of several takes, in frames; MotionFileError for a line that is neither a take nor an action."""
    takes: dict[str, tuple[LabelTier, ...]] = {}
    name, begin = "", 0.0
    spans: list[LabelSpan] = []
    unclear: list[tuple[float, float]] = []
    warnings: list[Message] = []
    for number, line in enumerate(decode_text(path, data).splitlines(), 1):
        take, action = _TAKE.fullmatch(line), _ACTION.fullmatch(line)
        if take:
            name, begin, spans, unclear, warnings = f"{take[1]}_{take[2]}", 0.0, [], [], []
        elif action and name:
            earliest, likely, latest = sorted(float(action[k]) for k in (2, 3, 4))
            if earliest <= begin < likely:  # a typing error: only the likely end is used
                note = Message("label_files.cmu_order", frame=earliest, before=begin, likely=likely)
                warnings.append(Message("text.in_line", path=path, line=number, problem=note))
                earliest = likely
            if earliest <= begin:
                raise MotionFileError(path, "label_files.cmu_backwards", number, frame=latest, before=begin)
            check_category(path, action[1], number)
            spans.append(LabelSpan(begin, earliest, action[1], number))
            if latest > earliest:
                unclear.append((earliest, latest))
            begin = latest
        elif line.strip():
            raise MotionFileError(path, "label_files.cmu_line", number, found=line.strip()[:60])
        if name:
            takes[name] = (LabelTier("", tuple(spans), tuple(unclear), warnings=tuple(warnings)),)
    return LabelFile(path, takes, counts_frames=True)
