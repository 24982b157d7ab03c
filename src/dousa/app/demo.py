"""The material of the demonstration: synthetic motions, an uncut take, a dance and its pupil, a kick seen by cameras.

``dousa demo`` writes it with `write_material` and then runs the commands of the main jobs on it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dousa.app.output import ProgressCallback, make_folder
from dousa.app.pipelines.render import ring_around
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_poses
from dousa.estimation.body.skeleton_body import body_from_motion
from dousa.estimation.raster.rendering import Spoiling, render, spoil
from dousa.estimation.silhouettes.mask_npz import write_silhouettes
from dousa.experiments.metrics import TrueSegment
from dousa.formats.registry import read_motion, write_motion
from dousa.messages import Message
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories, canonicalise, fit_motion
from dousa.motion.synthetic import (
    Mistake,
    Performer,
    draw_performer,
    make_dance,
    make_library,
    make_mistakes,
    make_motion,
)
from dousa.motion.synthetic.performers import CATEGORIES
from dousa.retrieval import LabelledClip
from dousa.retrieval.takes.made_takes import join_clips

LIBRARY = "demo.dousa"
PERFORMER_RULE = r"name:^(performer\d+)_"
KICK = "kick_left"


@dataclass(frozen=True, slots=True)
class Take:
    """A recording and its true segments, whose category is None where the library has none for them."""

    path: Path
    truth: tuple[TrueSegment, ...]


@dataclass(frozen=True, slots=True)
class Material:
    """What `write_material` wrote into a folder, with the truth about it.

    Parameters
    ----------
    query : a kick by a performer of whom the library ``motions`` has nothing.
    take : motions of that performer, joined; in the middle one that is of no category.
    reference, pupil : a dance, and a performance of it with ``mistakes``.
    seen : silhouettes of a kick, ``performed``, by a performer of that ``stature``, in m.
    teacher : takes of the same kick by another performer.
    """

    motions: Path
    query: Path
    take: Take
    reference: Path
    pupil: Path
    mistakes: tuple[Mistake, ...]
    seen: Path
    performed: Path
    stature: float
    teacher: tuple[Path, ...]


def write_material(
    folder: Path, seed: int = 0, n_performers: int = 10, progress: ProgressCallback | None = None
) -> Material:
    """Write the material of the demonstration.

    Parameters
    ----------
    folder : made if missing; files of the same name are replaced.
    seed : of performers, take, dance, mistakes and noise.
    n_performers : of the library.
    progress : of the library.

    Raises
    ------
    OptionError, MotionWriteError : the folder cannot be made or written.
    """
    make_folder(folder)
    write_library(folder / "motions", n_performers, 1, seed, progress=progress)
    stranger = draw_performer(1000 * seed + n_performers, f"performer{n_performers:02d}")
    queries = {name: folder / "queries" / name / f"{stranger.name}_1.bvh" for name in (*CATEGORIES, "dance")}
    for name, path in queries.items():
        make_folder(path.parent)
        if name == "dance":
            write_dance_figure(stranger, path, seed)
        else:
            write_motion(make_motion(name, stranger), path)
    teacher = tuple(folder / f"teacher_{number}.bvh" for number in range(1, 6))
    for number, path in enumerate(teacher):
        write_motion(make_motion(KICK, Performer(name="teacher", seed=1000 * seed), number), path)
    performed, seen = folder / "performed.bvh", folder / "seen.npz"
    take = write_take(_choose_clips(queries, seed), CATEGORIES, folder / "take.bvh", seed)
    stature = write_performance(performed, seen, seed)
    return Material(
        folder / "motions", queries[KICK], take, *write_dance(folder, seed), seen, performed, stature, teacher
    )


def _choose_clips(queries: dict[str, Path], seed: int, most: int = 9) -> list[LabelledClip]:
    """Read the kick and other queries in a random order, and in their middle the figure of a dance."""
    generator = np.random.default_rng(seed)
    others = sorted(name for name in queries if name not in (KICK, "dance"))
    chosen = [KICK, *(others[k] for k in generator.permutation(len(others))[: most - 1])]
    names = [chosen[k] for k in generator.permutation(len(chosen))]
    names.insert((len(names) + 1) // 2, "dance")
    clips = []
    for name in names:
        motion = canonicalise(read_motion(queries[name]))
        clips.append(LabelledClip(name, name, None, motion.positions, motion.frame_rate, motion.height))
    return clips


def write_library(
    folder: str | os.PathLike[str],
    n_performers: int = 10,
    takes: int = 1,
    seed: int = 0,
    categories: Sequence[str] | None = None,
    progress: ProgressCallback | None = None,
) -> list[Path]:
    """Write a library of synthetic motions as ``folder/category/performer_take.bvh``.

    Parameters
    ----------
    folder : made if missing; files of the same name are replaced.
    n_performers, takes, seed : as in `dousa.motion.synthetic.performers.make_library`.
    categories : all by default.
    progress : called with (files done, files, path).

    Returns
    -------
    Paths of the files, by category, performer and take.

    Raises
    ------
    OptionError : an unknown category, a number out of range.
    MotionWriteError : the folder cannot be written.
    """
    chosen = CATEGORIES if categories is None else tuple(categories)
    paths: list[Path] = []
    for category, performer, take, motion in make_library(n_performers, takes, seed, chosen):
        path = Path(folder) / category / f"{performer.name}_{take + 1}.bvh"
        make_folder(path.parent)
        write_motion(motion, path)
        paths.append(path)
        if progress is not None:
            progress(len(paths), len(chosen) * n_performers * takes, Message("demo.making_motions"))
    return paths


def write_dance_figure(performer: Performer, path: Path, seed: int = 0, figure: str = "point") -> None:
    """Write one figure of the synthetic dance that is none of the synthetic categories, as its kicks are.

    Raises
    ------
    MotionWriteError : the file cannot be written.
    """
    dance = make_dance(performer, seed)
    chosen = next(one for one in dance.figures if one.name == figure)
    frames = slice(chosen.start, chosen.end)
    rotations, translations = dance.motion.rotations[frames], dance.motion.translations[frames]
    write_motion(replace(dance.motion, rotations=rotations, translations=translations), path)


def write_take(clips: Sequence[LabelledClip], known: Sequence[str], path: Path, seed: int = 0) -> Take:
    """Join clips of one performer into a take and write it.

    Parameters
    ----------
    clips : in the order in which they are played.
    known : categories that the library has.
    path : of the take.
    seed : of the lengths of the blends between clips.

    Raises
    ------
    TrainingError : no clips.
    MotionWriteError : the file cannot be written.
    """
    joined = join_clips(clips, np.random.default_rng(seed))
    rate, parents = joined.frame_rate, np.array(CANONICAL_PARENTS)
    write_motion(fit_motion(Trajectories(CANONICAL_JOINTS, joined.positions, rate, parents)), path)
    truth = tuple(
        TrueSegment(piece.start / rate, piece.stop / rate, piece.category if piece.category in known else None)
        for piece in joined.pieces
    )
    return Take(path, truth)


def write_dance(output: Path, seed: int = 0) -> tuple[Path, Path, tuple[Mistake, ...]]:
    """Write the reference dance and the pupil's as BVH files.

    Parameters
    ----------
    output : folder, must exist.
    seed : of the dancers, their takes and the mistakes.

    Returns
    -------
    reference, pupil : the files.
    mistakes : what was done wrong on purpose, in order of time.

    Raises
    ------
    MotionWriteError : the files cannot be written.
    OptionError : a negative seed.
    """
    reference = make_dance(Performer(name="teacher", seed=1000 * seed), seed)
    # Another body and posture, but someone who has learned the dance: the mistakes are put in afterwards.
    pupil = replace(draw_performer(1000 * seed + 41, "pupil"), amplitude=1.0, noise=1.0, left_handed=False)
    performed, mistakes = make_mistakes(make_dance(pupil, seed + 1), seed)
    paths = output / "dance_reference.bvh", output / "dance_pupil.bvh"
    write_motion(reference.motion, paths[0])
    write_motion(performed, paths[1])
    return *paths, mistakes


def write_performance(performed: Path, seen: Path, seed: int = 0) -> float:
    """Write what a synthetic performer does, and what cameras see of it.

    The performer has another build than the model that the tracker is given, and the silhouettes are spoiled.

    Parameters
    ----------
    performed : BVH file to write.
    seen : npz of silhouettes to write.
    seed : of performer and noise.

    Returns
    -------
    The performer's stature in m, the only thing that the tracker gets to know.
    """
    performer = replace(draw_performer(1000 * seed + 61, "performer"), arms=1.06, legs=0.95)
    motion = make_motion(KICK, performer)
    write_motion(motion, performed)
    canonical = canonicalise(motion)
    body = body_from_motion(canonical)
    body = replace(body, spheres=body.spheres * np.array([1.0, 1.0, 1.0, 1.07]))  # wider than the model's
    poses, _ = fit_poses(body, canonical.positions)
    names, points = point_names(body), compute_points(body, poses)
    cameras = ring_around(points, 4, (320, 240))
    # Holes and specks take long to make, and change less than these.
    amounts = Spoiling(ragged=1.0, shadow=0.4, jitter=0.5)
    masks = [
        spoil(view, np.random.default_rng([seed, number]), amounts)
        for number, view in enumerate(render(body, poses, cameras))
    ]
    truth = (CANONICAL_JOINTS, points[:, [names.index(name) for name in CANONICAL_JOINTS]])
    write_silhouettes(seen, masks, cameras, motion.frame_rate, stature=performer.stature, truth=truth)
    return performer.stature
