"""The demonstration's third act: a performer is seen by cameras only, and the rest of the chain works on what they saw.

The performer has another build than the model that the tracker is given, and the silhouettes are spoiled. What is
estimated is looked up in the library of the first act, and held against a teacher's takes of the same motion.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.demo.demo import LIBRARY
from dousa.app.demo.takes import say
from dousa.app.output import make_folder, progress_bar, warn
from dousa.app.pipelines.estimate import estimate_files
from dousa.app.requests.estimation import EstimationRequest, Outputs

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.app.pipelines.estimate import Estimation

PERFORMED, SEEN, ESTIMATED = "performed.bvh", "seen.npz", "estimated.bvh"
OVERLAY, SHEET, REPORT = "estimated.mp4", "estimated.png", "report_estimated"

_CATEGORY = "kick_left"
_PERFORMER = 61  # number of the performer
_GIRTH = 1.07  # of the performer, as a share of what the model has
_ARMS, _LEGS = 1.06, 0.95  # likewise
_N_VIEWS = 4


def run_estimation_demo(console: Console, output: Path, *, seed: int = 0) -> None:
    """Render a performer, estimate the motion from the silhouettes, find it in the library and evaluate it.

    Can be run again into the same folder; the ``demo.dousa`` of the first act is searched if it is there.
    """
    make_folder(output)
    started = time.perf_counter()
    performed, seen, estimated, overlay, sheet = (
        output / name for name in (PERFORMED, SEEN, ESTIMATED, OVERLAY, SHEET)
    )
    stature = write_performance(performed, seen, seed)
    say(
        console,
        f"\nA performer seen by {_N_VIEWS} cameras only: {seen}, with bones and girths 5 to 7 % off those of the "
        f"model, and spoiled silhouettes",
    )
    outputs = Outputs(motion=estimated, overlay=overlay, sheet=sheet)
    with progress_bar() as progress:
        done = estimate_files(EstimationRequest((seen,), outputs=outputs, stature=stature), progress, warn)
    for text in done.warnings:
        warn(text)
    _print_accuracy(console, done, seen)
    say(console, f"Look at it: {overlay} and {sheet}")
    if (output / LIBRARY).exists():
        _search(console, output / LIBRARY, estimated)
    _evaluate(console, performed, estimated, output, seed)
    console.print(f"Seen, estimated, found and judged in {time.perf_counter() - started:.0f} s. The same again:")
    say(console, f"  dousa estimate {seen} --stature {stature:.2f} -o {estimated} -o {overlay}")


def write_performance(performed: Path, seen: Path, seed: int = 0) -> float:
    """Write what a synthetic performer does, and what cameras see of it.

    Parameters
    ----------
    performed : BVH file to write.
    seen : npz of silhouettes to write.
    seed : of performer and noise.

    Returns
    -------
    The performer's stature in m, the only thing that the tracker gets to know.
    """
    from dousa.app.pipelines.render import ring_around
    from dousa.estimation.body.kinematics import compute_points, point_names
    from dousa.estimation.body.posing import fit_poses
    from dousa.estimation.body.skeleton_body import body_from_motion
    from dousa.estimation.raster.rendering import NOISY, render, spoil
    from dousa.estimation.silhouettes.mask_npz import write_silhouettes
    from dousa.formats.registry import write_motion
    from dousa.motion import CANONICAL_JOINTS, canonicalise
    from dousa.motion.synthetic.performers import draw_performer, make_motion

    performer = dataclasses.replace(draw_performer(1000 * seed + _PERFORMER, "performer"), arms=_ARMS, legs=_LEGS)
    motion = make_motion(_CATEGORY, performer)
    write_motion(motion, performed)
    canonical = canonicalise(motion)
    body = body_from_motion(canonical)  # the performer's bones under wider solids than the model's
    body = dataclasses.replace(body, spheres=body.spheres * np.array([1.0, 1.0, 1.0, _GIRTH]))
    poses, _ = fit_poses(body, canonical.positions)
    names, points = point_names(body), compute_points(body, poses)
    cameras = ring_around(points, _N_VIEWS, (320, 240))
    # Holes and specks take long to make, and change less than these.
    amounts = dataclasses.replace(NOISY, holes=0.0, speckle=0.0)
    masks = [
        spoil(view, np.random.default_rng([seed, number]), amounts)
        for number, view in enumerate(render(body, poses, cameras))
    ]
    truth = points[:, [names.index(name) for name in CANONICAL_JOINTS]]
    write_silhouettes(
        seen, masks, cameras, motion.frame_rate, stature=performer.stature, truth=(CANONICAL_JOINTS, truth)
    )
    return performer.stature


def _print_accuracy(console: Console, done: Estimation, seen: Path) -> None:
    """Print how far off the joints are, which is known here and in no real recording."""
    from dousa.estimation.silhouettes.mask_npz import read_true_joints

    found = done.estimate
    true_joints = read_true_joints(seen)
    assert true_joints is not None
    names, truth = true_joints
    estimated = dict(zip(found.points.names, np.moveaxis(found.points.positions, 1, 0), strict=True))
    off = [estimated[name] - truth[:, place] for place, name in enumerate(names) if name in estimated]
    error = np.nanmean(np.linalg.norm(off, axis=-1))
    held = np.linalg.norm(truth - truth[:1], axis=-1).mean() * 1000.0
    say(
        console,
        f"Estimated {found.n_frames} frames at {found.frames_per_second:.0f} frames/s, the start found by itself: "
        f"overlap {np.nanmean(found.iou):.2f}, mean joint error {1000 * error:.0f} mm (holding the true "
        f"first pose: {held:.0f} mm), {int(found.lost.sum())} frames lost",
    )


def _search(console: Console, library_path: Path, estimated: Path) -> None:
    from dousa.app.tables.search import describe_verdict
    from dousa.library import Library

    with Library.open(library_path, read_only=True) as library:
        result = library.search(estimated, 5)
    right = sum(hit.category == _CATEGORY for hit in result.results)
    say(
        console,
        f"In the library: in truth {_CATEGORY}, the forest says {describe_verdict(result.verdict)}; "
        f"{right} of the {len(result.results)} nearest clips are {_CATEGORY}",
    )


def _evaluate(console: Console, performed: Path, estimated: Path, output: Path, seed: int) -> None:
    from dousa.app.pipelines.evaluate import evaluate_files
    from dousa.app.report import write_report
    from dousa.evaluation.grade.score import round_grade
    from dousa.formats.motion_files import ReadOptions
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.performers import Performer, make_motion

    teacher = Performer(name="teacher", seed=1000 * seed)
    takes = [output / f"teacher_{take + 1}.bvh" for take in range(5)]
    for take, path in enumerate(takes):
        write_motion(make_motion(_CATEGORY, teacher, take), path)
    with progress_bar() as progress:
        seen, true = (
            evaluate_files(takes, path, options=ReadOptions(), tempo="free", progress=progress).assessment
            for path in (estimated, performed)
        )
        page = write_report(seen, output / REPORT)
    kinds = [", ".join(dict.fromkeys(event.kind for event in found.events)) or "no error" for found in (seen, true)]
    say(
        console,
        f"Held against {len(takes)} takes of a teacher: grade {round_grade(seen.score):.0f} ({kinds[0]}); "
        f"the motion as it really was: {round_grade(true.score):.0f} ({kinds[1]})",
    )
    say(console, f"Open the report in a browser: {page}")
