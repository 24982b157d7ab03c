"""Draw the pictures of docs/estimation.md and of the README's way from video to motion again; part of ``make figures``.

Everything is made by the package itself: synthetic performers whose limbs and girths are 5 to 7 % off those of the
model that the tracker is given, and silhouettes that are spoiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.drawing.body import THREE_QUARTER, extent, to_figurine
from dousa.app.pictures.canvas import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    PURPLE,
    VERMILLION,
    new_figure,
    save_figure,
    write,
)
from dousa.app.pictures.overlay_sheet import draw_overlay_sheet
from dousa.app.pictures.overlay_view import ViewPainter, to_rgb
from dousa.app.pictures.sheets import draw_poses
from dousa.app.pipelines.render import ring_around
from dousa.arrays import FloatArray
from dousa.estimation import (
    PAPER,
    BodyModel,
    Camera,
    Estimate,
    PackedSilhouettes,
    TrackerSettings,
    body_from_motion,
    clean_mask,
    estimate,
    fit_poses,
    make_human,
    make_view,
    render,
    spoil,
)
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.raster.rasteriser import draw_parts
from dousa.estimation.silhouettes.background import learn_background, subtract_background
from dousa.motion import Motion, canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer, make_motion
from lab.estimation.clips import constant_velocity, frozen_first_pose
from lab.estimation.metrics import compare_with_truth
from lab.figures.drawn_film import draw_film, draw_plate
from lab.figures.drawn_readings import draw_readings
from lab.places import DOCS

FIGURES = DOCS / "figures"

Mask = NDArray[np.bool_]

_ARMS, _LEGS, _GIRTH = 1.06, 0.95, 1.07  # of the performers, as shares of what the model has
_DANCE = (135, 315)  # frames
_WALK = (18, 54)  # frames: the near arm comes from the front, passes the trunk, and comes back
_MOMENTS = ((5, "before"), (15, "during"), (21, "after"), (35, "and once more"))  # frames of the walk
_OTHER_WALKS = (4, 12, 20, 28, 36, 44, 52, 60)  # first frames
_MOSTLY = 0.7  # of the arm's pixels
_FILM = (228, 268)  # frames of the dance
_FILMED = 30  # of these, the frame that is shown


@dataclass(frozen=True, slots=True, eq=False)
class Act:
    """What a performer does: body, poses (T, 7 + A), frame rate, stature, and the joints (T, K, 3) by name."""

    body: BodyModel
    poses: FloatArray
    frame_rate: float
    stature: float

    @property
    def names(self) -> tuple[str, ...]:
        return point_names(self.body)

    @property
    def points(self) -> FloatArray:
        return compute_points(self.body, self.poses)


def make_all() -> None:
    """All five pictures."""
    draw_readings(FIGURES / "estimation_readings.svg")
    dance = perform(make_dance(_performer(5)).motion, _performer(5), _DANCE)
    draw_dance(dance)
    walker = _performer(3)
    draw_occlusion(perform(make_motion("walk", walker), walker))
    draw_way(perform(make_dance(_performer(5)).motion, _performer(5), _FILM))


def _performer(seed: int) -> Performer:
    return Performer("performer", seed=seed, arms=_ARMS, legs=_LEGS)


def perform(motion: Motion, performer: Performer, frames: tuple[int, int] | None = None) -> Act:
    """The performer's own bones under wider solids."""
    canonical = canonicalise(motion)
    body = body_from_motion(canonical)
    body = replace(body, spheres=body.spheres * np.array([1.0, 1.0, 1.0, _GIRTH]))
    positions = canonical.positions[slice(*(frames or (0, None)))]
    return Act(body, fit_poses(body, positions)[0], motion.frame_rate, performer.stature)


def _make_small(path: Path, width: int) -> None:
    """At most so many pixels wide, in 256 colours: pages load faster."""
    from PIL import Image

    picture = Image.open(path).convert("RGB")
    if picture.width > width:
        picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    few = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


# A dance seen by four cameras: contact sheet and curves


def draw_dance(act: Act) -> None:
    """estimation_sheet.png and estimation_curve.png: one estimate, the start found by itself."""
    cameras = ring_around(act.points, 4, (320, 240))
    masks = [spoil(view, np.random.default_rng(k)) for k, view in enumerate(render(act.body, act.poses, cameras))]
    seen = PackedSilhouettes(masks, act.frame_rate)
    model = make_human(act.stature)
    found = estimate(seen, cameras, model)
    title = "A synthetic dancer, four noisy views"
    draw_overlay_sheet(found, seen, cameras, FIGURES / "estimation_sheet.png", n_frames=8, title=title)
    _make_small(FIGURES / "estimation_sheet.png", 1300)
    told, _ = fit_poses(model, act.points[:2], act.names)
    first = PackedSilhouettes(masks[:1], act.frame_rate)
    alone = estimate(first, cameras[:1], model, told[0])
    held = frozen_first_pose(told[0], len(act.poses))
    going = constant_velocity(told[0], told[1], len(act.poses), model.angle_limits)
    curves = (
        ("four views, the start found", INK, "-", found.body, found.poses),
        ("one view, the start told", BLUE, "-.", alone.body, alone.poses),
        ("the true first pose held", GREEN, "--", model, held),
        ("constant velocity, two poses told", PURPLE, ":", model, going),
    )
    draw_curves(act, curves, found)


def draw_curves(act: Act, curves: Sequence[tuple[str, str, str, BodyModel, FloatArray]], found: Estimate) -> None:
    """Mean joint error over time above the overlap."""
    figure = new_figure(10.4, 5.4)
    times = np.arange(len(act.poses)) / act.frame_rate
    axes = figure.add_axes((0.08, 0.4, 0.66, 0.48))
    ends = []
    for name, colour, style, body, poses in curves:
        joints = compute_points(body, poses)
        off = 1000.0 * np.nanmean(compare_with_truth(point_names(body), joints, act.names, act.points).errors, axis=1)
        axes.plot(times, off, color=colour, linestyle=style, linewidth=2.2 if colour == INK else 1.5)
        ends.append((name, colour, float(off[-1]), float(off.mean())))
    axes.set(
        yscale="log",
        xlim=(0.0, times[-1]),
        ylabel="mean joint error, mm",
        yticks=[10, 30, 100, 300, 1000, 3000],
    )
    axes.set_yticklabels(["10", "30", "100", "300", "1000", "3000"])
    axes.minorticks_off()
    axes.tick_params(labelbottom=False)
    axes.grid(axis="y", color=FAINT, linewidth=0.6)
    places = _spread([np.log10(end) for _, _, end, _ in ends], 0.42)
    for (name, colour, _, mean), place in zip(ends, places, strict=True):
        write(axes, 1.015 * times[-1], 10.0 ** (place + 0.02), name, 9.0, color=colour)
        write(axes, 1.015 * times[-1], 10.0 ** (place - 0.14), f"mean {mean:.0f} mm", 9.0, color=colour)
    lower = figure.add_axes((0.08, 0.12, 0.66, 0.22))
    lower.plot(times, np.nanmean(found.iou, axis=1), color=INK, linewidth=2.0)
    lower.set(xlim=(0.0, times[-1]), ylim=(0.0, 1.0), yticks=[0.0, 0.5, 1.0], ylabel="IoU")
    lower.set_xlabel("seconds")
    for row, text in enumerate(("overlap of the model", "and the spoiled", "silhouettes, four views")):
        write(lower, 1.015 * times[-1], 0.8 - 0.2 * row, text, 9.0)
    for each in (axes, lower):
        each.spines[["top", "right"]].set_visible(False)
    write(figure, 0.08, 0.945, "How far the joints are off while a synthetic performer dances", 12.0)
    note = "limbs and girths 5 to 7 % off the model's, silhouettes spoiled; poses that are told are the true ones"
    write(figure, 0.08, 0.905, note, 9.0, color=GREY)
    save_figure(figure, FIGURES / "estimation_curve.png")


def _spread(places: Sequence[float], apart: float) -> list[float]:
    """The same places, moved until labels there do not touch."""
    order, moved = np.argsort(places), list(places)
    for below, above in pairwise(order):
        moved[above] = max(moved[above], moved[below] + apart)
    return moved


# The paper's figures 1 and 2


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """A walk and what two cameras see of it, the first from the side; the model's poses nearest to the truth."""

    act: Act
    cameras: tuple[Camera, Camera]
    masks: tuple[Mask, Mask]
    model: BodyModel
    told: FloatArray


def draw_occlusion(act: Act) -> None:
    """estimation_occlusion.png: the near arm passes the trunk, four ways of searching."""
    middle = (act.points.min(axis=(0, 1)) + act.points.max(axis=(0, 1))) / 2.0
    side = make_view(middle + np.array([6.0, 0.2, 0.0]), middle, size=(400, 240), focal=700.0)
    front = make_view(middle + np.array([0.8, 0.3, 7.0]), middle, size=(400, 240), focal=700.0)
    model = make_human(act.stature)
    masks = render(act.body, act.poses, (side, front))
    walk = Walk(act, (side, front), (masks[0], masks[1]), model, fit_poses(model, act.points, act.names)[0])
    better = replace(PAPER, reading="masked", evidence="log", damping=(0.5,))
    ways = (
        ("as printed, overline restored", "residual, global, with W", PAPER),
        ("masked, log, without W", "inertia 0; velocity damped", replace(better, inertia=0.0)),
        ("masked, log, with W", "inertia 1; velocity damped", better),
        ("the defaults", "revisits, beam, whole limbs", TrackerSettings()),
    )
    figure = new_figure(12.4, 11.2)
    for row, (name, note, settings) in enumerate(ways):
        usual = [measure_arm(walk, first, settings)[2] for first in _OTHER_WALKS]
        poses, angles, off = measure_arm(walk, _WALK[0], settings)
        top = 0.9 - 0.222 * row
        for column, (frame, _) in enumerate(_MOMENTS):
            axes = figure.add_axes((0.012 + 0.142 * column, top - 0.2, 0.138, 0.2))
            show_walker(axes, walk, _WALK[0] + frame, poses[frame])
        texts = (name, f"{note}; off by {off:.0f} deg here, {np.mean(usual):.0f} in the mean of {len(usual)}")
        draw_angles(figure.add_axes((0.645, top - 0.172, 0.335, 0.125)), walk, angles, texts)
    for column, (frame, when) in enumerate(_MOMENTS):
        text = f"{when}, frame {frame}"
        write(figure, 0.081 + 0.142 * column, 0.91, text, 9.5, ha="center")
    write(figure, 0.012, 0.965, "A walker's near arm passes the trunk (the paper's figures 1 and 2)", 13.0)
    note = "tracked from this view and one from the front, first pose told; grey: silhouette; blue: left, the near side"
    write(figure, 0.012, 0.942, note, 9.5, color=GREY)
    write(figure, 0.645, 0.91, "angle of the near arm, degrees before the vertical", 9.5)
    save_figure(figure, FIGURES / "estimation_occlusion.png")
    _make_small(FIGURES / "estimation_occlusion.png", 1364)


def measure_arm(walk: Walk, first: int, settings: TrackerSettings) -> tuple[FloatArray, FloatArray, float]:
    """Poses of 36 frames, the arm's angles in them, and the mean by which these are off, in degrees."""
    stop = min(first + _WALK[1] - _WALK[0], len(walk.act.poses))
    seen = PackedSilhouettes([view[first:stop] for view in walk.masks], walk.act.frame_rate)
    found = estimate(seen, walk.cameras, walk.model, walk.told[first], settings=settings, girths="keep")
    angles = swing(point_names(found.body), found.points.positions)
    off = np.abs((angles - swing(walk.act.names, walk.act.points[first:stop]) + 180.0) % 360.0 - 180.0)
    return found.poses, angles, float(off.mean())


def swing(names: Sequence[str], points: FloatArray) -> FloatArray:
    """(T,) degrees of the left arm before the vertical, seen from the side."""
    arm = points[:, names.index("left_wrist")] - points[:, names.index("left_shoulder")]
    return np.degrees(np.arctan2(arm[:, 2], -arm[:, 1]))


def show_walker(axes: Any, walk: Walk, frame: int, pose: FloatArray) -> None:
    """The side view cut out round the walker, the model over the silhouette."""
    side, mask = walk.cameras[0], walk.masks[0][frame]
    painter = ViewPainter(walk.model, side, 2 * side.width, 2 * side.height)
    picture = painter.paint(pose, mask, None, np.zeros(walk.model.n_parts, bool))
    columns = np.flatnonzero(mask.any(axis=0))
    left = int(np.clip(columns[0] + columns[-1] - 150, 0, 2 * side.width - 300))
    axes.imshow(to_rgb(picture[30:465, left : left + 300]), aspect="auto", interpolation="antialiased")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_color(FAINT)


def draw_angles(axes: Any, walk: Walk, angles: FloatArray, texts: tuple[str, str]) -> None:
    """The arm's angle over the frames beside the true one, the overlap shaded."""
    true = swing(walk.act.names, walk.act.points[_WALK[0] : _WALK[1]])
    axes.fill_between(
        np.arange(len(true)), 0.0, 1.0, where=cover_trunk(walk) > _MOSTLY, color=FAINT, alpha=0.5, linewidth=0.0,
        transform=axes.get_xaxis_transform(),
    )  # fmt: skip
    axes.plot(true, color=GREY, linewidth=1.4, linestyle="--")
    axes.plot(np.clip(angles, -170.0, 170.0), color=VERMILLION, linewidth=2.0)
    for frame, _ in _MOMENTS:
        axes.axvline(frame, color=FAINT, linewidth=0.8, zorder=0)
    axes.set(xlim=(0, len(true) - 1), ylim=(-60.0, 90.0), yticks=[-40, 0, 40, 80])
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    write(axes, 0.0, 112.0, texts[0], 10.5, weight="bold")
    write(axes, 0.0, 97.0, texts[1], 8.5, color=GREY)
    write(
        axes,
        35.0,
        -52.0,
        "dashed: true; shaded: most of the arm before the trunk",
        7.5,
        ha="right",
        color=GREY,
    )


def cover_trunk(walk: Walk) -> FloatArray:
    """(36,) share of the near arm's pixels that lie before trunk and hips in the side view."""
    body, side = walk.act.body, walk.cameras[0]
    drawn = draw_parts(body, walk.act.poses[slice(*_WALK)], side)
    arm, trunk = (
        drawn[:, [body.names.index(name) for name in names]].any(axis=1)
        for names in (("left_upper_arm", "left_forearm", "left_hand"), ("pelvis", "trunk"))
    )
    return np.asarray((arm & trunk).sum(axis=(1, 2)) / arm.sum(axis=(1, 2)))


# From film to motion


def _write_moving(
    painter: ViewPainter, found: Estimate, film: NDArray[np.uint8], masks: NDArray[np.bool_], corner: tuple[int, int]
) -> None:
    """estimation_moving.webp: the film, and the model over it, a third of the frames."""
    from PIL import Image

    seen = np.zeros(found.body.n_parts, bool)
    pages = []
    for frame in range(0, found.n_frames, 3):
        model = painter.paint(found.poses[frame], masks[frame], film[frame], seen)
        window, large = (tuple(slice(scale * start, scale * (start + 250)) for start in corner) for scale in (1, 2))
        page = Image.new("RGB", (508, 250), "white")
        page.paste(Image.fromarray(to_rgb(film[frame][window])), (0, 0))
        page.paste(Image.fromarray(to_rgb(model[large])).resize((250, 250)), (258, 0))
        pages.append(page)
    shown_ms = round(3000 / found.frame_rate)
    pages[0].save(FIGURES / "estimation_moving.webp", save_all=True, append_images=pages[1:], duration=shown_ms, loop=0,
                  quality=60, method=6)  # fmt: skip


def draw_way(act: Act) -> None:
    """estimation_way.png: a drawn film, the silhouettes cut out of it, the model over it, the motion."""
    cameras = ring_around(act.points, 4, (480, 360))
    films = [np.stack(list(draw_film(act.body, act.poses, camera, k))) for k, camera in enumerate(cameras)]
    masks = [cut_out(film, draw_plate(camera)) for film, camera in zip(films, cameras, strict=True)]
    found = estimate(PackedSilhouettes(masks, act.frame_rate), cameras, make_human(act.stature))
    film, mask = films[0][_FILMED], masks[0][_FILMED]
    painter = ViewPainter(found.body, cameras[0], 960, 720)
    model = painter.paint(found.poses[_FILMED], mask, film, np.zeros(found.body.n_parts, bool))
    outline = np.where(mask[..., None], np.uint8(235), np.uint8(28)) * np.ones(3, np.uint8)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    left, top = (int(places[0] + places[-1] - 250) // 2 for places in (columns, rows))
    figure = new_figure(13.0, 3.05)
    for number, (picture, scale, name) in enumerate(
        ((film, 1, "film"), (outline, 1, "silhouette"), (model, 2, "model"))
    ):
        axes = figure.add_axes((0.006 + 0.212 * number, 0.02, 0.19, 0.86))
        window = [slice(scale * start, scale * (start + 250)) for start in (max(top, 0), max(left, 0))]
        axes.imshow(to_rgb(picture[window[0], window[1]]), aspect="auto")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_color(FAINT)
        write(figure, 0.101 + 0.212 * number, 0.915, name, 13.0, ha="center", weight="bold")
        write(figure, 0.207 + 0.212 * number, 0.42, "\N{RIGHTWARDS ARROW}", 17.0, ha="center", color=GREY)
    _write_moving(painter, found, films[0], masks[0], (max(top, 0), max(left, 0)))
    figurine = to_figurine(found.motion)
    frames = np.linspace(0, found.n_frames - 1, 4).astype(int).tolist()
    spacing, _ = extent(figurine, frames, THREE_QUARTER)
    axes = figure.add_axes((0.645, 0.02, 0.35, 0.86))
    draw_poses(axes, figurine, frames, THREE_QUARTER, spacing)
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.axis("off")
    write(figure, 0.82, 0.915, "motion", 13.0, ha="center", weight="bold")
    save_figure(figure, FIGURES / "estimation_way.png")
    _make_small(FIGURES / "estimation_way.png", 1430)


def cut_out(film: NDArray[np.uint8], plate: NDArray[np.uint8]) -> Mask:
    """(T, H, W) silhouettes, as the reader of videos makes them."""
    background = learn_background(film[::2], "plate", plate)
    masks: list[Mask] = []
    for frame in film:
        masks.append(clean_mask(subtract_background(frame, background), previous=masks[-1] if masks else None))
    return np.stack(masks)


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    make_all()
