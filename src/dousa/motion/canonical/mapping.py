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

from dousa.motion.canonical.anthropometry import measure_proportions, walks_on_fours
from dousa.motion.canonical.geometry import body_points
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.naming import group_owners, named_by_estimators
from dousa.motion.canonical.recipes import Recipe, named_recipes, on_the_skin, partial_recipes
from dousa.motion.canonical.tree_shape import shape_recipe, spread_frames
from dousa.motion.types import Trajectories


@dataclass(frozen=True, slots=True, eq=False)
class ChosenMap:
    """A map, and whether it gives the body of a person.

    Parameters
    ----------
    recipe : the map.
    is_person : whether the proportions are possible.
    passed_over : tables that cover as much but give no person.
    is_odd : whether only the names suggest a person.
    bodies : owners of the markers, if there are several people; the map is that of the first.
    """

    recipe: Recipe
    is_person: bool
    passed_over: tuple[str, ...] = ()
    is_odd: bool = False
    bodies: tuple[str, ...] = ()


def choose_map(sample: Trajectories, unseen: tuple[int, ...] = ()) -> ChosenMap | None:
    """Choose the map of a file from some frames; None if neither names nor tree give a body or a limb.

    ``unseen`` : indices of points that are never seen: they do not count.
    """
    names = names_of_seen(sample.names, unseen)
    bodies = group_owners(sample.names) if sample.parents is None else {}
    if bodies:  # the others keep their places but lose their names
        first = next(iter(bodies.values()))
        names = names_of_seen(names, tuple(index for own in bodies.values() if own != first for index in own))
    found = _choose(names, sample, unseen)
    return found if found is None or not bodies else dataclasses.replace(found, bodies=tuple(bodies))


def _choose(names: tuple[str, ...], sample: Trajectories, unseen: tuple[int, ...]) -> ChosenMap | None:
    first: Recipe | None = None
    failed: list[str] = []
    for candidate in _candidates(names, sample, use_tree=not unseen):
        recipe = on_the_skin(candidate) if _marks_the_skin(candidate, sample) else candidate
        if _is_person(recipe, sample):
            return ChosenMap(recipe, True, tuple(failed))
        first = first or recipe
        failed.append(recipe.table)
    if first is None:
        return None
    is_odd = named_by_estimators(names)
    return ChosenMap(first, is_odd, is_odd=is_odd)


def names_of_seen(names: tuple[str, ...], unseen: tuple[int, ...]) -> tuple[str, ...]:
    """Blank the names of unseen points, so that no rule finds them; the points keep their places."""
    return tuple("" if index in unseen else name for index, name in enumerate(names)) if unseen else names


def _candidates(names: tuple[str, ...], sample: Trajectories, *, use_tree: bool) -> Iterator[Recipe]:
    yield from named_recipes(names)
    if use_tree and sample.parents is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            recipe = shape_recipe(sample.parents, sample.positions)
        if recipe is not None:
            yield recipe
    if not named_recipes(names):
        yield from partial_recipes(names)


def _marks_the_skin(recipe: Recipe, sample: Trajectories, wide_hips: float = 0.34) -> bool:
    """Whether joints are in fact markers on their outer side: hips are as wide as the trochanters.

    ``wide_hips`` : share of the leg; hip joints of people are at most 0.3 of it apart, trochanters 0.4.
    """
    if sample.parents is not None or "left_hip" not in recipe.sources or recipe.skin:
        return False
    points = body_points(recipe, spread_frames(sample.positions))
    return measure_proportions(points).ratios["hips_per_leg"] > wide_hips


_TAIL = re.compile(r"(?<![A-Za-z])tail|(?<=[a-z])Tail", re.IGNORECASE)


def _is_animal(recipe: Recipe, sample: Trajectories) -> bool:
    tailed = any(_TAIL.search(name) for name in sample.names)
    points = body_points(recipe, spread_frames(sample.positions))
    return walks_on_fours(points, fore_legs=0.6) if tailed else walks_on_fours(points)


def _is_person(recipe: Recipe, sample: Trajectories) -> bool:
    """Whether the bones are a person's: those of the skeleton, else those in motion (files may replace the offsets)."""
    if set(CANONICAL_JOINTS) <= set(sample.names):
        return True  # the names are a person's already
    if _is_animal(recipe, sample):
        return False
    points = body_points(recipe, spread_frames(sample.positions))
    rest = sample.rest_positions
    if rest is not None and _rests_as_person(recipe, rest.tobytes()):
        return True
    return measure_proportions(points).is_person


@lru_cache(maxsize=256)
def _rests_as_person(recipe: Recipe, rest_bytes: bytes) -> bool:
    rest = np.frombuffer(rest_bytes).reshape(1, -1, 3)
    return measure_proportions(body_points(recipe, rest)).is_person
