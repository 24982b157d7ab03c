"""A page with a player, or with miniatures, alone; for tests in a real browser."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.browser import Page
from dousa.app.player.data import format_player_data, read_player_script, read_player_style
from dousa.motion.canonical.tree_shape import compute_forward

_PAGE = """<!doctype html>
<html lang="{language}"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:">
<meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="data:,">
<style>body {{ margin: 12px; font-family: sans-serif; background: Canvas; color-scheme: light dark }}
{style}</style></head>
<body><input id="field" aria-label="field"><div id="here"></div>
<script type="application/json" id="data">{data}</script>
<script>{script}</script>
<script>
const data = JSON.parse(document.getElementById("data").textContent);
{start}
</script></body></html>
"""

_PLAYER = """
window.player = dousa.createPlayer(document.getElementById("here"), data);
window.heard = [];
player.onTime((time) => heard.push(time));
window.pixels = (side) => { // of both halves, or of one
  const from = document.querySelector("canvas");
  const width = side === undefined ? from.width : Math.floor(from.width / 2);
  const copy = Object.assign(document.createElement("canvas"), {width, height: from.height});
  const context = copy.getContext("2d", {willReadFrequently: true});
  context.drawImage(from, side === 1 ? -width : 0, 0);
  return context.getImageData(0, 0, width, from.height).data;
};
"""

_MINIATURES = """
window.loops = data.loops.map((text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
window.add = (loop, options) => { // each in a button of its own, 300 px high
  const host = Object.assign(document.createElement("button"), {style: "display: block; height: 300px"});
  const canvas = document.createElement("canvas");
  host.append(canvas);
  document.getElementById("here").append(host);
  return dousa.createMiniature(canvas, loop, options);
};
window.pixels = (index = 0) => {
  const from = document.querySelectorAll("canvas")[index];
  const copy = Object.assign(document.createElement("canvas"), {width: from.width, height: from.height});
  const context = copy.getContext("2d", {willReadFrequently: true});
  context.drawImage(from, 0, 0);
  return context.getImageData(0, 0, from.width, from.height).data;
};
"""

_PICTURE = """
const data = pixels(...arguments);
let sum = 0;
for (let k = 0; k < data.length; k += 4) sum = (sum * 31 + data[k] + 256 * data[k + 1] + 7 * data[k + 2]) % 4294967291;
return sum;
"""


def decode(text: str, kind: str) -> Any:
    """Numbers of the data of a player."""
    return np.frombuffer(base64.b64decode(text), kind)


def positions_of(figure: Any) -> Any:
    """(T, joints, 3) m."""
    return decode(figure["positions"], "<i2").reshape(figure["shape"]) / 1000


def heading_of(positions: Any) -> Any:
    """Where a figure looks on the whole, rad."""
    forward = compute_forward(positions)
    return np.angle((forward[:, 2] + 1j * forward[:, 0]).sum())


def write_player_page(data: Mapping[str, Any], path: Path) -> Path:
    """A page with one ``player``, its ``data``, the times that it told, ``heard``, and ``pixels(side)``."""
    return _write(path, _PLAYER, format_player_data(data), str(data["language"]))


def write_miniatures_page(loops: Sequence[bytes], path: Path) -> Path:
    """A page with the ``loops`` as bytes, ``add(loop, options)`` for miniatures below each other, ``pixels(index)``."""
    texts = {"loops": [base64.b64encode(loop).decode("ascii") for loop in loops]}
    return _write(path, _MINIATURES, format_player_data(texts), "en")


def _write(path: Path, start: str, data: str, language: str) -> Path:
    style, script = read_player_style(), read_player_script()
    page = _PAGE.format(language=language, style=style, data=data, script=script, start=start)
    path.write_text(page, encoding="utf-8")
    return path


def picture(page: Page, *which: int) -> int:
    """A number that tells pictures of the player apart, or of its half, or of one of the miniatures."""
    page.settle()
    return int(page.run(_PICTURE, *which))
