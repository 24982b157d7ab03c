"""Draw the pictures of the chain in docs/tutorial.md again from what `measure_chain` made; part of ``make figures``.

They show real recordings (UTD-MHAD) and are left as they are where these, or the answers about them, are not there:

    python -m lab.figures.measure_chain ../shared/data/utd_mhad -o chain-output --people 1,3,5,7
    python -m lab.figures.make_chain_figures [../shared/data/utd_mhad] [chain-output]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dousa.app.pictures.canvas import BLUE, FAINT, GREEN, GREY, PURPLE, new_figure, save_figure, write
from dousa.app.pictures.overlay_view import ViewPainter, to_rgb
from dousa.app.requests.estimation import Outputs
from dousa.arrays import FloatArray
from dousa.estimation import Estimate
from dousa.evaluation import assess
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS
from lab.figures.make_estimation_figures import _make_small
from lab.figures.measured_chain import PEOPLE, Chain, read_one, read_takes, run_estimate
from lab.figures.measured_kinect import CAMERA, LAG, Clip
from lab.places import DOCS

FIGURES = DOCS / "figures"
DATA, KEPT = DOCS.parents[1] / "shared/data/utd_mhad", DOCS.parent / "chain-output"

Mask = NDArray[np.bool_]

_N_MOMENTS = 6
_N_BARS = 5
_ZOOM = 3  # of the silhouettes' pixels
_WIDTH = 1200  # px
_SHOWN = (
    ("a20_s1_t1", "chain_works.png", "Where it works: a catch"),
    ("a18_s1_t1", "chain_fails.png", "Where it fails: a push towards the camera"),
)
_PANELS = {
    "skeletons": ("library of skeletons", "as the Kinect recorded the others"),
    "rendered": ("seen by one camera", "the others' skeletons, rendered and estimated"),
    "filmed": ("filmed", "the others' silhouettes, estimated"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A clip, what was estimated of it, and the answers about it.

    Parameters
    ----------
    clip, found, row : recording, estimate and answers.
    masks : (T, H, W) turned over, as the camera of the calibration sees them.
    joints : (T, 20, 3) m of the estimate, in the order of the canonical joints.
    truth : (T', 20, 3) m of the Kinect.
    moments : frames that are drawn.
    """

    clip: Clip
    found: Estimate
    row: dict[str, Any]
    masks: Mask
    joints: FloatArray
    truth: FloatArray
    moments: tuple[int, ...]


def make_all(data: Path = DATA, kept: Path = KEPT) -> None:
    """All pictures, if there is something to draw."""
    folder = kept / "answers_told"
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    if not rows or not data.exists():
        print(f"no answers in {folder}, or no {data}: the pictures of the chain stay as they are")
        return
    actions = tuple(sorted({row["action"] for row in rows}))
    chain = Chain(data, kept, ("1",), actions, 0)
    clips = {clip.name: clip for clip in chain.clips(PEOPLE)}
    by_name = {row["clip"]: row for row in rows}
    for name, file, title in _SHOWN:
        if name in by_name:
            draw_clip(chain, prepare(chain, clips[name], by_name[name]), title, FIGURES / file)
    draw_actions(rows, FIGURES / "chain_actions.png")


def prepare(chain: Chain, clip: Clip, row: dict[str, Any]) -> Shown:
    """Estimate the clip again, for the poses of the model, and choose moments that differ."""
    silhouettes, truth, _ = clip.read()
    masks = np.stack([view for k in range(len(truth)) for view in silhouettes.read(k)])
    with TemporaryDirectory() as folder:
        done = run_estimate(chain, clip, "told", Outputs((Path(folder) / "motion.bvh",)))
    points = done.estimate.points
    joints = points.positions[:, [points.names.index(name) for name in CANONICAL_JOINTS]]
    n_frames = min(len(joints), len(truth))
    moments = tuple(int(k) for k in np.linspace(0.08, 0.92, _N_MOMENTS) * (n_frames - 1))
    return Shown(clip, done.estimate, row, masks, joints, truth, moments)


# One clip


def draw_clip(chain: Chain, shown: Shown, title: str, path: Path) -> None:
    """Silhouettes with the model, figures from the front and the side, votes, and degrees off the teacher."""
    figure = new_figure(11.0, 8.6)
    write(figure, 0.02, 0.966, title, 14.0)
    note = f"UTD-MHAD, action '{shown.clip.action}', person {shown.clip.subject}: one camera, silhouettes of 320 x 240"
    write(figure, 0.02, 0.941, note, 9.5, color=GREY)
    draw_film(figure, shown)
    draw_figures(figure, shown)
    draw_votes(figure, shown)
    draw_off(figure, chain, shown)
    save_figure(figure, path)
    _make_small(path, _WIDTH)


def _cell(column: int, bottom: float, height: float) -> tuple[float, float, float, float]:
    return 0.145 + column * 0.141, bottom, 0.137, height


def draw_film(figure: Any, shown: Shown) -> None:
    """The model over the silhouettes, cut out round the person."""
    painter = ViewPainter(shown.found.body, CAMERA, _ZOOM * CAMERA.width, _ZOOM * CAMERA.height)
    rows, columns = (np.flatnonzero(shown.masks.any(axis=(0, axis))) for axis in (2, 1))
    height = rows[-1] - rows[0] + 24
    middle, half = (columns[0] + columns[-1]) / 2.0, max(columns[-1] - columns[0] + 16, 0.66 * height) / 2.0
    box = [
        slice(max(int(_ZOOM * low), 0), int(_ZOOM * high))
        for low, high in ((rows[0] - 12, rows[-1] + 12), (middle - half, middle + half))
    ]
    for column, frame in enumerate(shown.moments):
        axes = figure.add_axes(_cell(column, 0.665, 0.25))
        picture = painter.paint(
            shown.found.poses[frame], shown.masks[frame], None, np.zeros(shown.found.body.n_parts, bool)
        )
        axes.imshow(to_rgb(picture[box[0], box[1]]), interpolation="antialiased")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_color(FAINT)
        axes.set_title(f"{(frame + LAG) / 30:.1f} s", fontsize=8.5, color=GREY, pad=3)
    _name_row(figure, 0.86, "1 film", ("silhouette: black line", "model: left blue,", "right orange, dashed"))


def draw_figures(figure: Any, shown: Shown) -> None:
    """Estimate over the Kinect's skeleton, as the camera sees it and from the side."""
    views = ((0, ("as the camera", "sees it")), (2, ("from the side:", "what it cannot see")))
    for row, (axis, words) in enumerate(views):
        bottom = 0.46 - 0.195 * row
        for column, frame in enumerate(shown.moments):
            axes = figure.add_axes(_cell(column, bottom, 0.19))
            for joints, colour, style, width in (
                (shown.truth, GREY, (0, (2, 1.2)), 1.6),
                (shown.joints, BLUE, "-", 2.2),
            ):
                pose = joints[frame] - joints[frame, 0]
                draw_bones(axes, -pose[:, axis], pose[:, 1], colour, style, width)
            axes.set(xlim=(-0.85, 0.85), ylim=(-0.95, 0.85), xticks=[], yticks=[], aspect="equal")
            axes.spines[:].set_visible(False)
        _name_row(figure, bottom + 0.13, "2 motion" if row == 0 else "", words)
    write(figure, 0.02, 0.325, "blue: estimated", 8.5, color=BLUE)
    write(figure, 0.02, 0.305, "dashed: Kinect", 8.5, color=GREY)


def draw_bones(axes: Any, x: FloatArray, y: FloatArray, colour: str, style: Any, width: float) -> None:
    """A stick figure with a round head."""
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            axes.plot(x[[parent, joint]], y[[parent, joint]], color=colour, linestyle=style, linewidth=width)
    head = CANONICAL_JOINTS.index("head")
    axes.plot(x[head], y[head], "o", color=colour, markersize=5.0 if style == "-" else 3.5)


def draw_votes(figure: Any, shown: Shown) -> None:
    """The first categories of the histogram, the true one marked, for two libraries."""
    _name_row(figure, 0.215, "3 which figure?", ("votes of the forest;", "> the true one"))
    for column, (kind, (title, _)) in enumerate(_PANELS.items()):
        answer = shown.row["estimate"][kind]
        votes = list(answer["histogram"].items())[:_N_BARS]
        left = 0.165 + 0.195 * column
        axes = figure.add_axes((left + 0.098, 0.03, 0.085, 0.135))
        for place, (name, share) in enumerate(votes):
            is_true = name == shown.clip.action
            axes.barh(-place, share, height=0.66, color=GREEN if is_true else FAINT)
            text, weight = ("> " if is_true else "") + name.replace("_", " "), "bold" if is_true else "normal"
            write(axes, -0.01, -place, text, 8.5, ha="right", va="center", weight=weight)
            write(axes, share + 0.008, -place, f"{100 * share:.0f} %", 8.0, va="center", color=GREY)
        axes.set(xlim=(0.0, max(0.3, 1.35 * votes[0][1])), ylim=(-_N_BARS + 0.4, 0.6), xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        where = "comes first" if answer["rank"] == 1 else f"on place {answer['rank']} of 27"
        verdict = "said to be known" if answer["category"] else "said to be unknown"
        write(figure, left, 0.215, title, 9.5)
        write(figure, left, 0.194, f"the true one {where},", 8.5, color=GREY)
        write(figure, left, 0.173, verdict, 8.5, color=GREY)


def draw_off(figure: Any, chain: Chain, shown: Shown) -> None:
    """Grades, and degrees off another person's take over time: the estimate against skeletons and against film, and
    the Kinect's skeleton."""
    axes = figure.add_axes((0.795, 0.062, 0.19, 0.095))
    estimated = chain.kept / "filmed_told" / shown.clip.action / f"{shown.clip.name}.bvh"
    lines: tuple[tuple[str, Path, str, Any, str], ...] = (
        ("skeletons", estimated, BLUE, "-", "against skeletons"),
        ("filmed", estimated, PURPLE, "-.", "against film, estimated"),
        ("skeletons", shown.clip.skeleton, GREY, (0, (2, 1.2)), "the Kinect's skeleton"),
    )
    write(figure, 0.765, 0.237, "4 grade", 9.5, weight="bold")
    for row, (reference, path, colour, style, words) in enumerate(lines):
        takes = read_takes(chain, shown.clip.action, shown.row["teacher"], reference)
        judged = assess(takes, read_one(path), tempo="free")
        off = np.degrees(np.sqrt((judged.residual**2).mean(axis=1)))  # nan where there is nothing to compare
        axes.plot(judged.times, off, color=colour, linestyle=style, linewidth=1.8)
        top = 0.215 - 0.019 * row
        figure.add_artist(Line2D([0.765, 0.787], [top + 0.005] * 2, color=colour, linestyle=style, linewidth=1.8))
        write(figure, 0.815, top, f"{judged.score:.0f}", 8.5, ha="right", weight="bold")
        write(figure, 0.821, top, words, 8.5, color=GREY)
    axes.set(ylim=(0.0, 75.0), xlim=(0.0, None), yticks=[0, 30, 60])
    axes.set_xlabel(f"seconds; degrees off person {shown.row['teacher']}", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _name_row(figure: Any, top: float, name: str, words: Sequence[str]) -> None:
    write(figure, 0.02, top, name, 9.5, weight="bold")
    for line, text in enumerate(words):
        write(figure, 0.02, top - 0.021 * (line + 1), text, 8.5, color=GREY)


# All actions


def draw_actions(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """On which place the true action comes, action by action, in three libraries; a dot for each person."""
    actions = sorted({row["action"] for row in rows}, key=lambda action: _mean_place(rows, action))
    figure = new_figure(11.0, 7.6)
    write(figure, 0.02, 0.962, "On which place does the true figure come?", 13.0)
    note = f"{len(rows)} motions estimated from one camera, each asked of the other people; a circle for each person"
    write(figure, 0.02, 0.936, note, 9.5, color=GREY)
    for column, (kind, lines) in enumerate(_PANELS.items()):
        axes = figure.add_axes((0.145 + 0.29 * column, 0.07, 0.265, 0.785))
        axes.axvspan(0.6, 3.5, color=GREEN, alpha=0.12, linewidth=0.0)
        for height, action in enumerate(reversed(actions)):
            axes.axhline(height, color=FAINT, linewidth=0.5, zorder=0)
            places = sorted(row["estimate"][kind]["rank"] for row in rows if row["action"] == action)
            for number, place in enumerate(places):  # equal places side by side
                shift = 0.16 * (places[:number].count(place) - (places.count(place) - 1) / 2)
                axes.plot(place, height + shift, "o", color=BLUE, markersize=4.2, markeredgewidth=0.0)
            if column == 0:
                write(axes, 0.5, height, action.replace("_", " ") + " ", 8.5, ha="right", va="center")
        axes.set(xscale="log", xlim=(0.6, 34), ylim=(-0.7, len(actions) - 0.3), yticks=[])
        axes.set_xticks([1, 2, 3, 5, 10, 27], ["1", "2", "3", "5", "10", "27"], fontsize=8.5)
        axes.minorticks_off()
        axes.spines[["top", "right", "left"]].set_visible(False)
        first, three = (np.mean([row["estimate"][kind]["rank"] <= n for row in rows]) for n in (1, 3))
        left = 0.145 + 0.29 * column
        write(figure, left, 0.903, lines[0], 9.5, weight="bold")
        write(figure, left, 0.884, lines[1], 8.5, color=GREY)
        text = f"first {100 * first:.0f} %, of the first three {100 * three:.0f} %"
        write(figure, left, 0.865, text, 9.0)
    save_figure(figure, path)
    _make_small(path, _WIDTH)


def _mean_place(rows: Sequence[dict[str, Any]], action: str) -> float:
    """Mean logarithm of the places, in the second library: where there is most to tell apart."""
    places = [row["estimate"]["rendered"]["rank"] for row in rows if row["action"] == action]
    return float(np.log(places).mean())


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    make_all(*(Path(word) for word in sys.argv[1:]))
