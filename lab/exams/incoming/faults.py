"""What goes wrong in files: each kind, made in every format that can have it."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lab.exams.incoming.writers import N_FRAMES, NAMES, Format, Scene

LOST = [(t, NAMES.index("LeftLeg")) for t in range(10, 15)] + [(20, NAMES.index("RightArm"))]
FLOAT32 = ("c3d", "glb")  # their numbers have 24 bits: 2 km are held to 0.2 mm
COUNT = r"bytes?|header|left over|left out|truncat|damaged|breaks? off|ends after|follow|expect|too (many|few)|" \
        r"rows?|declares \d|says \d|frames? of \d|columns?|values?|cells?|count|lack|extra|surplus"  # fmt: skip
RATE = r"rate|Hz|time|second"


@dataclasses.dataclass
class Case:
    """A file and what is known of it."""

    scene: Scene
    words: str = ""  # what a note about it speaks of
    must_say: bool = True  # even right values need a word
    lost: list[tuple[int, int]] = dataclasses.field(default_factory=list)
    rate: float | None = None
    harm: Callable[[bytes], bytes] = bytes
    shape: bool = False
    frames: np.ndarray | None = None
    check: str = ""


def scene_of(form: Format, **what: Any) -> Scene:
    return Scene(**{"rate": form.rate, "unit": form.unit, **what})


def times_of(scene: Scene, times: np.ndarray) -> Scene:
    scene.times = times
    return scene


def rows_of(scene: Scene, rows: list[int]) -> Scene:
    scene.rows = rows
    return scene


def controls(form: Format) -> Iterator[tuple[str, Case]]:
    """Unharmed files, each unusual in one respect."""

    def make(**what: Any) -> Case:
        return Case(scene_of(form, **what), must_say=False)

    yield "plain", make()
    if form.name not in {"bvh", "npy", "npz", "json"}:  # without a unit a child is an adult in another unit
        yield "child", make(size=0.7)
    yield "still", make(still=True)
    yield "one second", make(n=31)
    if form.says:
        yield "starts at 100", make(first=100) if set("nt") & set(form.says) else make()
    if "r" in form.says or "t" in form.says:
        for rate in (10.0, 119.88, 1000.0):
            yield f"{rate:g} Hz", make(rate=rate)
        if form.name not in {"glb", "mvnx"}:
            yield "short times", make(rate=120.0, time_digits=3)
    if "w" in form.says:
        yield "CRLF", make(newline="\r\n")
    if form.name in {"trc", "motive csv", "c3d"}:
        yield "metres", make(unit="m")


def insert(data: bytes) -> bytes:
    at = len(data) * 6 // 10
    return data[:at] + data[at // 2 : at // 2 + 37] + data[at:]


def delete(data: bytes) -> bytes:
    at = len(data) * 6 // 10
    return data[:at] + data[at + 37 :]


HARMS: dict[str, Callable[[bytes], bytes]] = {
    "cut to 2/3": lambda data: data[: len(data) * 2 // 3],
    "last 7 bytes cut": lambda data: data[:-7],
    "37 bytes inserted": insert,
    "37 bytes deleted": delete,
    "64 bytes at the end": lambda data: data + b"1 2 3 4 5 6 7 8\n" * 4,
}


def cases(form: Format) -> Iterator[tuple[str, Case]]:  # noqa: PLR0912
    """Make all kinds of faults that a format can have."""
    says = set(form.says)
    make = functools.partial(scene_of, form)
    points = "p" in says or form.name in {"npy", "json"}
    n = N_FRAMES

    def lost(value: object, where: list[tuple[int, int]], unit: str) -> Case:
        words = r"missing|lost|zero|not seen|sentinel|gap|absent|invisible"
        return Case(make(unit=unit, cells={at: value for at in where}), words, must_say=False, lost=where)

    for unit in ("mm", "m") if form.name in {"trc", "motive csv", "c3d"} else (form.unit,):
        for value in (0.0, 9999999.0, -9999.0, 1e9) if points else ():
            yield ("zeros" if value == 0 else f"sentinel {value:g}"), lost(value, LOST, unit)
        if points:
            yield "all zero in a frame", lost(0.0, [(t, j) for t in (10, 11) for j in range(len(NAMES))], unit)
    for word in ("NaN", "nan", "NULL", "N/A", "-") if points and "w" in says else ():
        yield f"spelled {word}", lost(word, LOST, form.unit)
    if says & set("nt"):
        every = [(t, j) for t in range(10, 18) for j in range(len(NAMES))]
        order = list(range(n))
        words = r"gap|missing|row|order|sort|repeat|twice|duplicate|same|number|time|declares|\d frames"
        yield "gap", Case(rows_of(make(), order[:10] + order[18:]), words, must_say=False, lost=every)
        swapped = order[:5] + order[25:30] + order[10:25] + order[5:10] + order[30:]
        yield "rows exchanged", Case(rows_of(make(), swapped), words, must_say=False)
        yield "rows repeated", Case(rows_of(make(), order[:12] + [12] * 4 + order[12:]), words, must_say=False)
    if {"t", "r"} <= says:
        scene = times_of(make(), np.arange(n) / (2 * form.rate))
        yield "time against rate", Case(scene, RATE, rate=2 * form.rate)
    if form.name == "c3d":
        yield "time against rate", Case(make(header_rate=60.0, tree="two rates"), RATE, rate=30.0)
    if "r" in says:
        for kind, rate in (
            ("duration", 1 / form.rate),
            ("zero", 0.0),
            ("negative", -30.0),
            ("not a number", np.nan),
            ("20 kHz", 2e4),
        ):
            yield f"rate is {kind}", Case(make(header_rate=rate), RATE, must_say=kind == "20 kHz" and "t" not in says)
    elif "t" in says:
        yield "rate is duration", Case(times_of(make(), np.arange(n) * 1000 / form.rate), RATE, must_say=False)
    for kind, harm in HARMS.items():
        yield kind, Case(make(), COUNT, harm=harm, must_say=kind == "64 bytes at the end")
    for kind, letter, what in (("frames", "f", "declared_frames"), ("points", "k", "declared_points")):
        for word, by in (("more", 1), ("fewer", -1)) if letter in says else ():
            if by > 0 or form.name not in {"bvh", "amc"} or letter == "f":
                yield f"declares {word} {kind}", Case(make(**{what: by * (10 if letter == "f" else 1)}), COUNT)
    for shift in (2e3,) if form.name in FLOAT32 else (5e5, 4.5e6, 1e7):
        yield (
            f"far {shift:.1e} m",
            Case(make(shift=shift), r"origin|far|shift|cent|moved|away|offset", must_say=False, shape=True),
        )
    for value in (np.inf, 1e308, 3e38):
        where = [(7, j) for j in (range(len(NAMES)) if not points else [5])]
        words = r"infinit|finite|missing|too large|too far|beyond|lost"
        yield f"{value:g}", Case(make(cells={(7, 5): value}), words, must_say=False, lost=where)
    for tree in form.trees:
        words = r"root|tree|parent|circle|cycl|loop|bone|hierarch|skelet|name|joint"
        held = tree == "twice" or (tree == "all roots" and form.name == "mvnx")
        yield f"tree: {tree}", Case(make(tree=tree), words, must_say=not held, check="one root")
    if form.name == "bvh":
        yield (
            "position channels zero",
            Case(make(tree="zero channels"), r"OFFSET|offset|channel|zero|size", must_say=False),
        )
    yield "all in one point", Case(make(size=0.0), r"size|one point|zero|height|same place|body|length")
    for suffix in ("_JNT", "_bind") if "j" in says else ():
        yield (
            f"names end in {suffix}",
            Case(make(suffix=suffix), r"suffix|ending|end site", must_say=False, check="stature"),
        )
    if "p" in says or form.name in {"bvh", "glb"}:
        words = r"person|people|skeleton|several|subject|left out|Anna|Ben|roots"
        yield "two people", Case(make(people=("Anna", "Ben")), words)


def signature(form: Format, data: bytes) -> bytes:
    """Reduce a text to its structure: each number or word to one letter, blanks beside separators dropped."""
    text = re.sub(rb"[0-9A-Za-z_+.-]+", b"x", data)
    if form.name in {"bvh", "amc", "mvnx"}:
        return re.sub(rb"[ \t]*(\n)[ \t]*|[ \t]+", lambda m: m[1] or b" ", text).replace(b"< ", b"<").strip()
    text = re.sub(rb" *([\t,\n\[\]]) *| +", lambda m: m[1] or b" ", text).strip()
    return re.sub(rb"(?<=[\t,\n])(?=[\t,\n])", b"x", text)  # a blank cell is a missing value


def random_harms(form: Format, data: bytes, count: int, rng: np.random.Generator) -> Iterator[tuple[bool, str, bytes]]:
    """Insert, delete and flip bytes at random places; says whether structure was hit."""
    starts = {"c3d": 512 * (data[512 + 2] + 1), "npy": 128, "glb": data.find(b"BIN\0") + 4}  # of what is not structure
    start = starts.get(form.name, len(data))
    text = form.name not in {"c3d", "npy", "npz"}
    for index in range(count):
        at, size = int(rng.integers(len(data) - 48)), int(rng.integers(1, 40))
        source = int(rng.integers(len(data) - 48))
        new = (
            data[source : source + size]
            if rng.random() < 0.5
            else rng.integers(33, 127, size, dtype=np.uint8).tobytes()
        )
        new = rng.integers(0, 256, size, dtype=np.uint8).tobytes() if not text and rng.random() < 0.5 else new
        kind = index % 3
        old = b"" if kind == 0 else data[at : at + (1 if kind == 2 else size)]
        new = b"" if kind == 1 else new[:1] if kind == 2 else new
        harmed = data[:at] + new + data[at + len(old) :]
        if harmed == data:
            continue
        if (
            text and form.name != "glb"
        ):  # what leaves the structure as it was is another valid value, which no reader can know
            structure = signature(form, data) != signature(form, harmed)
        else:
            letters = form.name == "glb" and (old + new).isalnum()
            structure = kind < 2 or (at < start and not letters)
        yield structure, f"{('insert', 'delete', 'flip')[kind]} at {at}: {old!r} -> {new!r}", harmed
