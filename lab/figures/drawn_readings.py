"""A diagram of the five readings of eq. 2: which pixels count for a forearm partly before the trunk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pictures.canvas import BLUE, VERMILLION
from dousa.estimation import READINGS

__all__ = ["count_mismatch", "draw_readings"]

Mask = NDArray[np.bool_]

_PIXEL = 5.0  # of the diagram, each pixel of a mask
_SLIDE = 4  # pixels along the forearm
_TURN = 42  # degrees outward, of the true forearm


def draw_readings(path: Path) -> None:
    """estimation_readings.svg: which pixels count, where the limb is and where each reading would have it."""
    silhouette, placed, draw_limb = _make_limb()
    turns = np.arange(-30, 121)
    true = _TURN
    formulas = ("(S xor P) outside F", "(S minus F) xor P", "(S or F) xor P", "S xor P", "(S and F) xor P")
    wide, high = 40 * _PIXEL + 14, 46 * _PIXEL
    parts = [_place_text(8, 20, "Five readings of eq. 2: a forearm partly before the trunk", "title")]
    key = "grey: silhouette S;  dashed: part already placed F;  blue line: candidate P;  squares: pixels that count"
    parts.append(_place_text(8, 40, key, "note"))
    for column, reading in enumerate(READINGS):
        left = 8 + column * wide
        counts = [count_mismatch(reading, silhouette, placed, draw_limb(turn)).sum() for turn in turns]
        best = int(turns[int(np.argmin(counts))])
        parts += [_place_text(left, 68, reading, "name"), _place_text(left, 85, formulas[column], "note")]
        for row, turn in enumerate((true, best)):
            wrong = count_mismatch(reading, silhouette, placed, draw_limb(turn))
            body = _draw_cell(silhouette, placed, draw_limb(turn), wrong)
            top = 112 + row * (high + 44)
            says = f"at the true angle: {wrong.sum()} pixels"
            if row:
                off = abs(turn - true)
                says = f"liked best: {wrong.sum()} pixels, " + (f"{off} deg off" if off else "the true angle")
            parts.append(_place_text(left, top - 8, says, "small"))
            parts.append(f'<g transform="translate({left:g} {top:g})">{body}</g>')
        slid, held = (
            int(count_mismatch(reading, silhouette, placed, draw_limb(true, out)).sum()) for out in (_SLIDE, 0)
        )
        text = f"true angle, slid {_SLIDE} pixels outward: {slid - held:+d}"
        parts.append(_place_text(left, 112 + 2 * high + 62, text, "small"))
    style = (
        "text { font-family: sans-serif; fill: #222; } .title { font-size: 16px; font-weight: 600; }"
        ".name { font-size: 14px; font-weight: 600; } .note { font-size: 12px; fill: #555; }"
        f".small {{ font-size: 11.5px; }} .s {{ fill: #c9c9c9; }} .w {{ fill: {VERMILLION}; }}"
        f".p {{ fill: none; stroke: {BLUE}; stroke-width: 2.2; }}"
        ".f { fill: none; stroke: #222; stroke-width: 1.6; stroke-dasharray: 4 3; }"
    )
    width, height = 8 + 5 * wide, 112 + 2 * high + 76
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}">'
    text = f'{head}<style>{style}</style><rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    path.write_text(text, encoding="utf-8")


def _make_limb() -> tuple[Mask, Mask, Any]:
    """Silhouette, trunk as placed (a little thinner than the true one), and forearm at so many degrees outward."""
    y, x = np.mgrid[:46, :40] + 0.0

    def capsule(one: tuple[float, float], other: tuple[float, float], radius: float) -> Mask:
        (a, b), (c, d) = one, other
        along = np.clip(((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2), 0.0, 1.0)
        return np.asarray(np.hypot(x - a - along * (c - a), y - b - along * (d - b)) <= radius)

    def draw_limb(turn: float, out: float = 0.0) -> Mask:
        way = np.array([np.sin(np.radians(turn)), np.cos(np.radians(turn))])
        one, other = np.array([16.0, 17.0]) + out * way, np.array([16.0, 17.0]) + (17.0 + out) * way
        return capsule((one[0], one[1]), (other[0], other[1]), 2.6)

    trunk = capsule((13.0, 9.0), (13.0, 27.0), 8.6)
    legs = capsule((9.0, 30.0), (8.0, 46.0), 4.2) | capsule((17.0, 30.0), (18.0, 46.0), 4.2)
    return trunk | legs | draw_limb(_TURN), capsule((10.8, 9.0), (10.8, 27.0), 7.8), draw_limb


def count_mismatch(reading: str, silhouette: Mask, placed: Mask, candidate: Mask) -> Mask:
    """The pixels that count, see `READINGS`."""
    if reading == "masked":
        return (silhouette ^ candidate) & ~placed
    if reading == "residual":
        return (silhouette & ~placed) ^ candidate
    if reading == "union":
        return (silhouette | placed) ^ candidate
    return silhouette ^ candidate if reading == "plain" else (silhouette & placed) ^ candidate


def _draw_cell(silhouette: Mask, placed: Mask, candidate: Mask, wrong: Mask) -> str:
    squares = "".join(
        f"M{_PIXEL * j + 0.9:g} {_PIXEL * i + 0.9:g}h{_PIXEL - 1.8:g}v{_PIXEL - 1.8:g}h{1.8 - _PIXEL:g}z"
        for i, j in np.argwhere(wrong)
    )
    return (
        f'<path class="s" d="{_trace(silhouette)}"/><path class="w" d="{squares}"/>'
        f'<path class="f" d="{_trace(placed)}"/><path class="p" d="{_trace(candidate)}"/>'
    )


def _trace(mask: Mask) -> str:
    """The outline of a mask without holes along the edges of its pixels: right side of each row down, left side up."""
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) and (np.abs(np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(int), axis=1)).sum(axis=1) > 2).any():
        runs = [(i, *span) for i in rows for span in _runs(mask[i])]
        return "".join(
            f"M{_PIXEL * a:g} {_PIXEL * i:g}h{_PIXEL * (b - a):g}v{_PIXEL:g}h{_PIXEL * (a - b):g}z" for i, a, b in runs
        )
    spans = [_runs(mask[i])[0] for i in rows]
    right = [(b, i + k) for i, (_, b) in zip(rows, spans, strict=True) for k in (0, 1)]
    left = [(a, i + k) for i, (a, _) in zip(rows[::-1], spans[::-1], strict=True) for k in (1, 0)]
    return "M" + "L".join(f"{_PIXEL * x:g} {_PIXEL * y:g}" for x, y in right + left) + "z"


def _runs(row: Mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.pad(row, 1).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _place_text(x: float, y: float, text: str, css_class: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" class="{css_class}">{text}</text>'
