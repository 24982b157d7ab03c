"""Several people in what was read of a file: each has a tree, or an owner before the names."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from dousa.arrays import BoolArray, IndexArray
from dousa.formats.parts import choose, distinguish
from dousa.messages import Message
from dousa.motion import Motion, Provenance, Skeleton, Trajectories
from dousa.motion.canonical.naming import group_owners, share_joints, shared_owner


def take_person(
    motion: Motion | Trajectories, path: str | os.PathLike[str], wanted: str | None
) -> Motion | Trajectories:
    """Take one of several people, who have roots of their own, or names with prefixes.

    Parameters
    ----------
    motion : all that was read; that of one person stays as it is.
    path : for the messages.
    wanted : as of `choose`.
    """
    people = list_people(motion)
    if len(people) < 2:
        return motion if wanted is None else _name_one(motion, path, wanted)
    lengths = {name: _count_seen(motion, indices) for name, indices in people.items()}
    still = tuple(name for name, frames in lengths.items() if not frames)
    names = [name for name, frames in lengths.items() if frames] or list(people)
    chosen, notes = choose(path, "person", names, wanted, [lengths[name] for name in names])
    if 0 < len(still) < len(people):
        notes += (Message("parts.still", read=names[chosen], others=still),)
    return _take(motion, path, people[names[chosen]], notes)


def _name_one(motion: Motion | Trajectories, path: str | os.PathLike[str], wanted: str) -> Motion | Trajectories:
    """The motion of a single person, with a note about the owner of all names, if there is one, who was asked for."""
    owner = shared_owner(motion.skeleton.names if isinstance(motion, Motion) else motion.names)
    if not owner:
        return motion
    origin = motion.provenance or Provenance(os.fspath(path), "")
    notes = (*choose(path, "person", [owner], wanted)[1], *origin.notes)
    return dataclasses.replace(motion, provenance=dataclasses.replace(origin, notes=notes))


def list_people(motion: Motion | Trajectories) -> dict[str, IndexArray]:
    """Return the joints or points of each of several people by name; {} if there is at most one."""
    names, parents = (
        (motion.skeleton.names, motion.skeleton.parents)
        if isinstance(motion, Motion)
        else (motion.names, motion.parents)
    )
    trees = split_trees(names, parents) if parents is not None else {}
    if len(trees) > 1 and isinstance(motion, Motion):
        trees = _name_trees(motion, trees)
    return trees or {owner: np.array(points) for owner, points in group_owners(tuple(names)).items()}


def split_trees(names: Sequence[str], parents: Any) -> dict[str, IndexArray]:
    """Return the joints of each tree that is a person's, by name; {} if fewer than two are.

    Two trees are two people if their joints are the same ones of a body. A prop, a camera and a foot that hangs on
    nothing are not.
    """
    roots = np.array(parents)
    if (roots < 0).sum() < 2:
        return {}
    for joint, parent in enumerate(parents):
        roots[joint] = joint if parent < 0 else roots[parent]
    trees: list[IndexArray] = [np.flatnonzero(roots == root) for root in np.flatnonzero(np.array(parents) < 0)]
    shared = share_joints([tuple(names[joint] for joint in tree.tolist()) for tree in trees])
    people = [tree for tree, like in zip(trees, shared, strict=True) if like]
    titles = [shared_owner([names[joint] for joint in tree.tolist()]) for tree in people]
    if "" in titles or len(set(titles)) < len(titles):
        titles = [names[tree[0]] for tree in people]
    return dict(zip(distinguish(titles), people, strict=True)) if len(people) > 1 else {}


def _name_trees(motion: Motion, trees: dict[str, IndexArray]) -> dict[str, IndexArray]:
    """The trees under the names that the file gives to whole skeletons, if its layout knows any."""
    layout = motion.provenance.layout if motion.provenance is not None else None
    if layout is None or not hasattr(layout, "name_tree"):
        return trees
    titles = [layout.name_tree(int(tree[0])) or name for name, tree in trees.items()]
    return dict(zip(distinguish(titles), trees.values(), strict=True))


def _count_seen(motion: Motion | Trajectories, indices: IndexArray) -> int:
    """Frames in which someone is seen; 0 for a skeleton that never moves, such as one that another animation has."""
    if isinstance(motion, Trajectories):
        seen: BoolArray = np.isfinite(motion.positions[:, indices, 0])
        return int(seen.any(axis=1).sum())
    turns, moves = motion.rotations[:, indices], motion.translations[:, indices]
    still = motion.n_frames > 1 and not ((turns != turns[:1]).any() or (moves != moves[:1]).any())
    return 0 if still else int(np.isfinite(turns[..., 0]).any(axis=1).sum())


def _take(
    motion: Motion | Trajectories, path: str | os.PathLike[str], indices: IndexArray, notes: tuple[Message, ...]
) -> Motion | Trajectories:
    """The motion of some joints, whole trees of them, without the file's own numbers."""
    origin = motion.provenance
    if origin is None:
        origin = Provenance(os.fspath(path), "", notes=notes)
    else:
        layout = origin.layout.take(indices.tolist()) if hasattr(origin.layout, "take") else None
        origin = dataclasses.replace(origin.derive(), layout=layout, notes=(*notes, *origin.notes))
    place = {int(joint): number for number, joint in enumerate(indices)}

    def moved(parents: Any) -> IndexArray:
        return np.array([place.get(int(parents[joint]), -1) for joint in indices], np.intp)

    if isinstance(motion, Trajectories):
        return dataclasses.replace(
            motion,
            names=tuple(motion.names[point] for point in indices),
            positions=motion.positions[:, indices],
            parents=None if motion.parents is None else moved(motion.parents),
            rest_positions=None if motion.rest_positions is None else motion.rest_positions[indices],
            provenance=origin,
        )
    old = motion.skeleton
    skeleton = Skeleton(
        tuple(old.names[joint] for joint in indices), moved(old.parents), old.offsets[indices], old.end_sites[indices]
    )
    return dataclasses.replace(
        motion,
        skeleton=skeleton,
        rotations=motion.rotations[:, indices],
        translations=motion.translations[:, indices],
        provenance=origin,
    )
