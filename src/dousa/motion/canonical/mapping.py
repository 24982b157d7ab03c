"""Choice of the map from a file's points to the canonical joints: the first that gives the body of a person.

Maps by names come first (the table that covers most), then by the shape of the tree, then parts of a body by names. If
none passes the check of `anthropometry`, the first whole one is taken and marked as no person.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.anthropometry import Proportions, find_medians, measure_proportions, walks_on_fours
from dousa.motion.canonical.geometry import body_points
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.naming import named_by_estimators
from dousa.motion.canonical.recipes import Recipe, named_recipes, on_the_skin, partial_recipes
from dousa.motion.canonical.tree_shape import compute_forward, shape_recipe, spread_frames
from dousa.motion.types import Trajectories


@dataclass(frozen=True, slots=True, eq=False)
class ChosenMap:
    """A map, and whether it gives the body of a person.

    Parameters
    ----------
    recipe : the map.
    points : (T, 20, 3) of at most 32 frames, in the file's unit and axes; NaN where absent.
    is_person : whether the proportions are possible.
    is_odd : whether only the names suggest a person.
    markers : whether points named like joints were taken for markers on the skin, by the width of the hips alone; None
        if the names or a point inside the body decide.
    """

    recipe: Recipe
    points: FloatArray
    is_person: bool = True
    is_odd: bool = False
    markers: bool | None = None


def choose_map(sample: Trajectories, unseen: tuple[int, ...] = (), markers: bool | None = None) -> ChosenMap | None:
    """Choose the map of a file from some frames; None if neither names nor tree give a body or a limb.

    Parameters
    ----------
    sample : some frames.
    unseen : indices of points that are never seen: they do not count.
    markers : whether points named like joints are markers on the skin; None to decide it.
    """
    names, frames = names_of_seen(sample.names, unseen), spread_frames(sample.positions)
    first: ChosenMap | None = None
    for candidate in _candidates(names, sample, use_tree=not unseen):
        recipe = candidate
        points = body_points(recipe, frames)
        measured = measure_proportions(points)
        wide = None
        if sample.parents is None and "left_hip" in recipe.sources and not recipe.skin:
            # Points without a tree, no marker of the pelvis among them, may be on the skin.
            wide = None if named_by_estimators(names) else _marks_the_skin(recipe, points, measured)
            if wide if markers is None else markers:
                recipe = on_the_skin(recipe)
                points = body_points(recipe, frames)
                measured = measure_proportions(points)
        if first is not None and recipe.table == "tree shape" and _is_odd_person(first, sample):
            break  # the names of a whole body that stands upright say more
        if _is_person(recipe, sample, points, measured):
            return ChosenMap(recipe, points, True, markers=wide)
        first = first or ChosenMap(recipe, points, False, markers=wide)
    if first is None:
        return None
    is_odd = named_by_estimators(names) or _is_odd_person(first, sample)
    return dataclasses.replace(first, is_person=is_odd, is_odd=is_odd)


def names_of_seen(names: tuple[str, ...], unseen: tuple[int, ...]) -> tuple[str, ...]:
    """Blank the names of unseen points, so that no rule finds them; the points keep their places."""
    return tuple("" if index in unseen else name for index, name in enumerate(names)) if unseen else names


def _candidates(names: tuple[str, ...], sample: Trajectories, *, use_tree: bool) -> Iterator[Recipe]:
    rig = sample.parents is not None  # markers are not joints of a tree
    yield from sorted(named_recipes(names), key=lambda recipe: rig and bool(recipe.estimated))
    if use_tree and sample.parents is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            recipe = shape_recipe(sample.parents, sample.positions)
        if recipe is not None:
            yield recipe
    if not named_recipes(names):
        yield from sorted(partial_recipes(names), key=lambda recipe: rig and bool(recipe.estimated))


def _marks_the_skin(
    recipe: Recipe, points: FloatArray, measured: Proportions, wide_hips: float = 0.34, inside: float = 0.08
) -> bool | None:
    """Whether joints are in fact markers on their outer side: hips are as wide as the trochanters.

    None if that is not the question: a pelvis between the hips is inside the body.

    Parameters
    ----------
    wide_hips : share of the leg; hip joints of people are at most 0.3 of it apart, trochanters 0.4.
    inside : share of the leg by which a pelvis may lie before or behind the hips; a marker on the sacrum is 0.12
        behind, Kinects see it 0.03 to 0.055 behind, and other makers put it between the hips.
    """
    if "pelvis" in recipe.sources:
        hips = 0.5 * (points[:, J["left_hip"]] + points[:, J["right_hip"]])
        behind = np.einsum("tk,tk->t", points[:, J["pelvis"]] - hips, compute_forward(points))
        legs = np.linalg.norm(points[:, _UPPER] - points[:, _LOWER], axis=2).sum(axis=1) / 2
        if abs(float(find_medians((behind / legs)[:, None])[0])) < inside:
            return None
    return measured.ratios["hips_per_leg"] > wide_hips


_UPPER, _LOWER = (
    [J[f"{side}_{joint}"] for joint in joints for side in ("left", "right")]
    for joints in (("hip", "knee"), ("knee", "ankle"))
)


_TAIL = re.compile(r"(?<![A-Za-z])tail|(?<=[a-z])Tail", re.IGNORECASE)


@lru_cache(maxsize=256)
def _has_tail(names: tuple[str, ...]) -> bool:
    return any(_TAIL.search(name) for name in names)


def _is_animal(names: tuple[str, ...], points: FloatArray, measured: Proportions) -> bool:
    return walks_on_fours(points, measured, 0.6) if _has_tail(names) else walks_on_fours(points, measured)


def _is_person(recipe: Recipe, sample: Trajectories, points: FloatArray, measured: Proportions) -> bool:
    """Whether the bones are a person's: those of the skeleton, else those in motion (files may replace the offsets)."""
    if set(CANONICAL_JOINTS) <= set(sample.names):
        return True  # the names are a person's already
    if _is_animal(sample.names, points, measured):
        return False
    rest = sample.rest_positions
    if rest is not None and _rests_as_person(recipe, rest.tobytes()):
        return True
    return measured.is_person


def _is_odd_person(
    chosen: ChosenMap,
    sample: Trajectories,
    mostly: float = 0.5,
    upright: float = 0.5,
    narrowest: float = 0.04,
    longest_arms: float = 1.1,
) -> bool:
    """Whether a body of strange proportions is a person's all the same: only people wear markers and stand upright.

    Parameters
    ----------
    mostly : share of the frames.
    upright : cosine between trunk and legs from which on the one stands on the others, as no animal's does.
    narrowest : distance of the hips as a share of the legs; points that coincide are no hips.
    longest_arms : share of the legs; those of apes and four-legged rigs are longer.
    """
    recipe, points = chosen.recipe, chosen.points
    if recipe.table == "tree shape":
        return False
    found = measure_proportions(points)
    if _is_animal(sample.names, points, found):
        return False
    if sample.parents is None and recipe.estimated:
        return True
    hips, arms = found.ratios["hips_per_leg"], found.ratios["arm_per_leg"]
    if (
        not hips > narrowest
        or not arms < longest_arms
        or {"thigh_per_shank", "upper_arm_per_forearm"} & set(found.faults)
    ):
        return False
    trunk = points[:, J["neck"]] - points[:, J["pelvis"]]
    legs = (points[:, _UPPER[:2]] - points[:, _LOWER[2:]]).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosines = (trunk * legs).sum(axis=1) / np.sqrt((trunk * trunk).sum(axis=1) * (legs * legs).sum(axis=1))
    return bool((cosines > upright).mean() > mostly)


@lru_cache(maxsize=256)
def _rests_as_person(recipe: Recipe, rest_bytes: bytes) -> bool:
    rest = np.frombuffer(rest_bytes).reshape(1, -1, 3)
    return measure_proportions(body_points(recipe, rest)).is_person


def find_clusters(sample: Trajectories, least: int = 3, mostly: float = 0.5, rigid: float = 0.02) -> tuple[str, ...]:
    """Return the names, without their numbers, of clusters of markers on segments: points that keep their distances.

    Parameters
    ----------
    sample : some frames.
    least : points of a cluster.
    mostly : share of the points that clusters have; else ().
    rigid : share by which the distances in a cluster mostly change: those of plates on the skin.
    """
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(sample.names):
        stem = re.sub(r"[\W_]*\d+$", "", name)
        if stem != name:
            groups.setdefault(stem.upper(), []).append(index)
    found = {}
    for stem, points in groups.items():
        if least <= len(points) <= len(sample.names) / 2:
            places = sample.positions[:, points]
            lengths = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)[:, *np.triu_indices(len(points), 1)]
            lengths = lengths[~np.isnan(lengths).any(axis=1)]
            if len(lengths):
                usual = np.median(lengths, axis=0)
                if np.median(np.median(np.abs(lengths - usual), axis=0) / usual) <= rigid:
                    found[stem] = len(points)
    return tuple(found) if sum(found.values()) >= mostly * len(sample.names) else ()
