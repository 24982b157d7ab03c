"""Draw the pictures of docs/evaluation.md again and paste the output that it shows; part of ``make figures``.

Everything is the demonstration's own dance: no recording is needed. Pages are photographed by a headless Chromium;
where there is none their pictures stay as they are.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

from dousa.app.demo import write_dance
from dousa.app.pictures.canvas import FAINT, GREY, INK, VERMILLION, new_figure, save_figure, write
from dousa.app.pipelines.evaluate import evaluate_files
from dousa.app.player.data import (
    encode_player_data,
    format_player_data,
    read_player_script,
    read_player_style,
)
from dousa.app.report.figures import (
    compute_swings,
    draw_moment,
    draw_shapes,
    estimate_mean_heading,
    pick_worst,
    view_moment,
)
from dousa.app.report.page import write_report
from dousa.app.tables.evaluation import print_assessment
from dousa.evaluation import Assessment, ErrorEvent, compute_correlation_matrix
from dousa.evaluation.words import KINDS, describe_segments
from dousa.formats import ReadOptions
from dousa.messages import load_section
from lab.injection.injection import Error
from lab.places import DOCS

FIGURES = DOCS / "figures"
COMMAND = "dousa evaluate demo-output/dance_reference.bvh --performance demo-output/dance_pupil.bvh"

_REPORT, _PLAYER = (1180, 1228), (760, 760)  # pixels
_STILL = "* { transition: none !important; animation: none !important; }"
_ROUNDING = 3  # of 255: a photograph that differs by no more is the same
_SHORT_LINE = 150  # characters of the answer
_PIXELS = 225  # of the matrix, each side
_LETTERS = {"global": "G", "partial": "P", "incomplete": "I", "shift": "S"}
_STYLE = """
svg { font-family: sans-serif; } path { fill: none; stroke-linecap: round; stroke-linejoin: round; }
text { font-size: 12px; fill: #566072; text-anchor: middle; } text.name { fill: #1b2130; font-weight: 600; }
.limb, .trunk { stroke-width: 5; fill-opacity: .25; stroke-linejoin: round; } .head { stroke-width: 0; }
.reference { stroke: #857d6d; } .trunk.reference, .head.reference { fill: #857d6d; }
.performance { stroke: #3a78b0; } .trunk.performance, .head.performance { fill: #3a78b0; }
.ghost-body { stroke: #857d6d; stroke-width: 2; stroke-dasharray: 2 5; fill: none; }
.edge { stroke: #1b213099; stroke-width: 12; } .wrong { stroke: #e8762c; stroke-width: 9.5; }
.stripes { stroke: #1b2130; stroke-width: 9.5; stroke-dasharray: 1.6 4.4; stroke-linecap: butt; }
.shown { stroke: #e3c07a; stroke-width: 9.5; } .floor { stroke: #dde1e7; stroke-width: 1.5; }
.ghost { stroke: #1b2130; stroke-width: 2; stroke-dasharray: 2 4.5; }
.shape .limb, .shape .trunk { stroke-width: 3.5; } .mean { stroke: #857d6d; } .behind { opacity: .4; }
.head.mean, .trunk.mean { fill: #857d6d; } .shape .plus { stroke: #12807a; stroke-width: 2; }
.shape .minus { stroke: #b8460a; stroke-width: 2; stroke-dasharray: 4 4; }
.head.plus, .head.minus, .trunk.plus, .trunk.minus { fill: none; stroke-width: 1.6; }
"""


def make_all() -> None:
    """The dance of ``dousa demo``, its assessment, all pictures and the output."""
    with TemporaryDirectory() as folder:
        home = Path(folder)
        reference, pupil, errors = write_dance(home)
        assessment = evaluate_files([reference], pupil, options=ReadOptions()).assessment
        draw_matrix(assessment)
        draw_distances(assessment, errors)
        draw_axes(assessment)
        draw_worst(assessment)
        photograph_report(assessment, home)
        photograph_player(assessment, home)
    paste_output(assessment)


# The matrix and the curves


def draw_matrix(assessment: Assessment) -> None:
    """Correlation matrix with path, straight lines, cuts and figures."""
    ours, theirs = assessment.performance, assessment.reference
    columns, rows = (_choose(motion.n_frames) for motion in (ours, theirs))
    matrix = compute_correlation_matrix(theirs.segments[rows], ours.segments[columns])
    figure = new_figure(6.9, 6.5)
    axes = figure.add_axes((0.09, 0.08, 0.76, 0.84))
    low = float(np.percentile(matrix, 2.0))
    image = axes.imshow(
        matrix, cmap="viridis", vmin=low, vmax=1.0, origin="lower", aspect="auto", interpolation="nearest",
        extent=(0.0, ours.duration, 0.0, theirs.duration),
    )  # fmt: skip
    for one in assessment.furi:
        axes.axhline(one.reference_end_s, color="white", linewidth=0.8, linestyle=":")
        middle = 0.5 * (one.reference_start_s + one.reference_end_s)
        write(axes, 1.01 * ours.duration, middle, one.label, 9.0, va="center")
    axes.plot(assessment.times, assessment.same_time, color="white", linewidth=1.6, linestyle=(0, (4, 3)))
    across, up = assessment.path.T / assessment.frame_rate
    axes.plot(across, up, color="#1b2130", linewidth=3.2)
    axes.plot(across, up, color="#ff8c3a", linewidth=1.6)
    axes.set(xlim=(0.0, ours.duration), ylim=(0.0, theirs.duration))
    axes.set_xlabel("performance, s")
    axes.set_ylabel("reference, s")
    bar = figure.colorbar(image, cax=figure.add_axes((0.905, 0.08, 0.025, 0.84)))
    bar.outline.set_visible(False)
    write(figure, 0.09, 0.965, "How alike the poses of each two moments are (S)", 12.0)
    write(figure, 0.09, 0.935, "solid: path; dashed: same time; dotted: cuts, letters: furi", 9.5, color=GREY)
    save_figure(figure, FIGURES / "evaluation_matrix.png")


def _choose(n_frames: int) -> np.ndarray:
    return np.arange(0, n_frames, -(-n_frames // _PIXELS))


def draw_distances(assessment: Assessment, errors: Sequence[Error]) -> None:
    """d# and d* over time above the lag, with what was injected and what was found."""
    figure = new_figure(10.4, 6.4)
    times, end = assessment.times, assessment.performance.duration
    rows = (
        ("d#\nfrom the space", assessment.d_space, assessment.d_space_limit),
        ("d*\ninside it", assessment.d_within, assessment.d_within_limit),
        ("lag, ms\nlate is above", 1000.0 * assessment.lag, None),
    )
    for row, (name, values, limit) in enumerate(rows):
        axes = figure.add_axes((0.1, 0.535 - 0.215 * row, 0.88, 0.185))
        axes.plot(times, values, color=INK, linewidth=1.1)
        if limit is None:
            axes.axhline(0.0, color=GREY, linewidth=0.8)
        else:
            axes.plot(times, limit, color=VERMILLION, linewidth=1.2, linestyle=(0, (5, 3)))
            over = values > limit
            axes.fill_between(times, limit, values, where=over, color=VERMILLION, alpha=0.35, linewidth=0.0)
            axes.set_ylim(0.0, None)
        for error in errors:
            axes.axvspan(error.start_s, error.end_s, color=FAINT, alpha=0.45, linewidth=0.0)
        axes.set(xlim=(0.0, end), ylabel=name)
        axes.yaxis.set_label_coords(-0.055, 0.5)
        axes.spines[["top", "right"]].set_visible(False)
        if row < len(rows) - 1:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("performance, s")
    _draw_spans(figure.add_axes((0.1, 0.735, 0.88, 0.15)), errors, assessment.events, end)
    write(figure, 0.1, 0.955, "Distances, lag, and the errors of the pupil", 12.0)
    note = "grey: done wrong on purpose; outlined: found; dashed: limits"
    write(figure, 0.1, 0.915, note, 9.5, color=GREY)
    save_figure(figure, FIGURES / "evaluation_distances.png")


def _draw_spans(axes: Any, errors: Sequence[Error], events: Sequence[ErrorEvent], end: float) -> None:
    """Two lanes of bars: injected and found."""
    for lane, items, style in (
        (1.0, errors, {"facecolor": FAINT}),
        (0.0, events, {"facecolor": "white", "edgecolor": INK, "linewidth": 1.2}),
    ):
        for item in items:
            axes.barh(lane, item.end_s - item.start_s, left=item.start_s, height=0.7, **style)
            middle = 0.5 * (item.start_s + item.end_s)
            write(axes, middle, lane, _LETTERS[item.kind], 9.0, ha="center", va="center")
    key = "   ".join(f"{letter} {KINDS[kind]}" for kind, letter in _LETTERS.items())
    write(axes, end, 2.05, key, 8.5, ha="right", color=GREY)
    axes.set(xlim=(0.0, end), ylim=(-0.6, 1.6), yticks=[0.0, 1.0], yticklabels=["found", "injected"], xticks=[])
    axes.tick_params(left=False)
    axes.spines[:].set_visible(False)


# Drawings of the report


def draw_axes(assessment: Assessment) -> None:
    """Mean posture and first eigen axes of the furi that is danced most often, front above side."""
    labels = [one.label for one in assessment.furi]
    furi = assessment.furi[labels.index(max(labels, key=labels.count))]
    cells = draw_shapes(furi, estimate_mean_heading(assessment, furi), load_section("report", "en"), "en")
    width, height, head = 200, 180, 40
    parts = []
    for column, views in enumerate(cells):
        middle = column * width + width / 2
        parts.append(_text(middle, 16, "mean posture" if column == 0 else f"axis {column}", "name"))
        if column:
            swing = compute_swings(furi)[column - 1]
            most = f"{describe_segments(swing.segments[:1])} {swing.degrees[0]:.0f} deg"
            parts.append(_text(middle, 32, f"{100.0 * swing.share:.0f} %, {most}"))
        left = middle - 65
        parts += [_nest(view, left, head + row * height, 130, height) for row, view in enumerate(views)]
    _save_drawing("evaluation_axes.svg", len(cells) * width, head + 2 * height, parts)


def draw_worst(assessment: Assessment) -> None:
    """Reference and performance at the worst moment of the two most severe errors of form."""
    formal = [k for k in pick_worst(assessment, len(assessment.events)) if assessment.events[k].kind != "shift"]
    parts = []
    for column, k in enumerate(sorted(formal[:2])):
        event = assessment.events[k]
        picture = draw_moment(assessment, event, view_moment(assessment, event), load_section("report", "en"), "en")
        left = column * 440
        who, _, what = str(event.message).rpartition(": ")
        parts += [
            _text(left + 210, 18, who or str(KINDS[event.kind]), "name"),
            _text(left + 210, 36, what),
        ]
        parts.append(_nest(picture, left, 44, 420, 250))
    _save_drawing("evaluation_moments.svg", 860, 298, parts)


def _text(x: float, y: float, text: str, css_class: str = "") -> str:
    safe = text.replace("&", "&amp;").replace("<", "&lt;")
    return f'<text x="{x:g}" y="{y:g}" class="{css_class}">{safe}</text>'


def _nest(markup: str, x: float, y: float, width: float, height: float) -> str:
    """A drawing of the report as part of a larger one."""
    return markup.replace("<svg", f'<svg x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"', 1)


def _save_drawing(name: str, width: float, height: float, parts: Sequence[str]) -> None:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}">'
    ground = '<rect width="100%" height="100%" fill="white"/>'
    text = f"{head}<style>{_STYLE}</style>{ground}{''.join(parts)}</svg>\n"
    (FIGURES / name).write_text(text, encoding="utf-8")


# Photographs of pages


def photograph_report(assessment: Assessment, home: Path) -> None:
    """The top of the report, at the worst moment."""
    page = write_report(assessment, home / "report")
    share = _worst(assessment).worst_s / assessment.performance.duration
    go = f"""<style>{_STILL}</style><script>
const lanes = document.getElementById("lanes"), box = lanes.getBoundingClientRect();
lanes.dispatchEvent(new PointerEvent("pointerdown", {{bubbles: true, pointerType: "touch",
  clientX: box.left + {share:.6f} * box.width, clientY: box.top + 5}}));
</script></body>"""
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", go), encoding="utf-8")
    _photograph(page, "evaluation_report.png", _REPORT)


def photograph_player(assessment: Assessment, home: Path) -> None:
    """The player, both figures over each other at the worst moment."""
    data = format_player_data(encode_player_data(assessment))
    page = home / "player.html"
    page.write_text(
        '<!doctype html><html lang="en"><meta charset="utf-8"><style>'
        f"body {{ margin: 16px; font-family: sans-serif; }} {read_player_style()} {_STILL}</style>"
        f'<div id="player"></div><script type="application/json" id="data">{data}</script>'
        f"<script>{read_player_script()}</script><script>"
        'const data = JSON.parse(document.getElementById("data").textContent);'
        'const player = dousa.createPlayer(document.getElementById("player"), data);'
        f'player.setView({{mode: "over"}}); player.seek({_worst(assessment).worst_s:.3f});</script></html>',
        encoding="utf-8",
    )
    _photograph(page, "evaluation_player.png", _PLAYER)


def _worst(assessment: Assessment) -> ErrorEvent:
    """The most severe error of a limb, else of any kind."""
    events = [assessment.events[k] for k in pick_worst(assessment, len(assessment.events))]
    return next((event for event in events if event.kind == "partial"), events[0])


def _photograph(page: Path, name: str, size: tuple[int, int]) -> None:
    from PIL import Image

    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        print(f"no chromium here: {name} stays as it is")
        return
    shot = page.with_suffix(".png")
    command = [
        browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
        "--disable-dev-shm-usage", "--disable-background-networking", "--force-color-profile=srgb",
        f"--user-data-dir={page.parent / 'profile'}", "--virtual-time-budget=4000",
        f"--window-size={size[0]},{size[1]}", f"--screenshot={shot}", page.resolve().as_uri(),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    new, path = Image.open(shot).convert("RGB"), FIGURES / name
    if path.exists():
        old = Image.open(path).convert("RGB")
        if old.size == new.size and np.ptp([old, new], axis=0).max() <= _ROUNDING:
            return
    new.save(path, optimize=True)


# Output in the pages


def paste_output(assessment: Assessment) -> None:
    """Put what the command really says between the marks of the pages."""
    out = io.StringIO()
    print_assessment(Console(file=out, width=4000), assessment)
    lines = [line.rstrip() for line in out.getvalue().splitlines()]
    short = [line for line in lines if line != str(assessment.score_formula)]
    _paste(DOCS / "evaluation.md", "table", f"```\n$ {COMMAND}\n" + "\n".join(lines) + "\n```")
    _paste(DOCS.parent / "README.md", "table", "```\n" + "\n".join(short) + "\n```")
    _paste(DOCS / "evaluation.md", "json", f"```json\n{_shorten(assessment.to_json())}\n```")


def _shorten(answer: dict[str, Any]) -> str:
    """JSON with one furi and the event that has most to say, short lists on one line."""
    events = sorted(answer["events"], key=lambda event: (event["shortfall_deg"] or 0.0, event["severity"]))
    answer = {**answer, "furi": answer["furi"][:1], "events": events[-1:]}
    text = json.dumps(answer, indent=1)
    return re.sub(r"[{[][^][{}]*[]}]", lambda found: _join_lines(found[0]), text)


def _join_lines(text: str) -> str:
    """A list or dictionary on one line, if it is short enough."""
    joined = " ".join(text.split())
    joined = re.sub(r"(?<=[{[]) | (?=[]}])", "", joined)
    return joined if len(joined) <= _SHORT_LINE else text


def _paste(page: Path, mark: str, text: str) -> None:
    begin, end = f"<!-- {mark}: by make figures -->", f"<!-- end of {mark} -->"
    old = page.read_text(encoding="utf-8")
    before, _, rest = old.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise SystemExit(f"{page}: no place for the {mark}: expected the lines '{begin}' and '{end}'")
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    make_all()
