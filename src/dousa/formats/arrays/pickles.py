"""Pickled content: SMPL bodies of several people, joint positions, samples of text-to-motion."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.files.pickles import load_pickle
from dousa.formats.arrays.bodies import Body, as_array, list_bodies, name_people
from dousa.formats.arrays.joints import build_joints, find_joints, is_joint_array, list_layouts
from dousa.formats.parts import choose, distinguish, load_once
from dousa.formats.smpl import AIST_RATE, build_smpl, read_rate
from dousa.formats.smpl_poses import are_poses, find_roles, rank_place
from dousa.messages import Message
from dousa.motion import Motion, Trajectories


def read_pickle(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    person: str | None = None,
    animation: str | None = None,
) -> Motion | Trajectories:
    """Read a pickled dictionary of SMPL bodies or of joint positions: a pickle, a dump of joblib, a file of torch.

    Parameters
    ----------
    path : the file; nothing in it is executed.
    unit, up, skeleton, frame_rate : as for `build_smpl`; joint positions take no skeleton.
    person : name or number of one of several people; by default the one seen in most frames.
    animation : name or number of one of several samples of text-to-motion; by default the longest.

    Raises
    ------
    MotionFileError : missing, damaged, something other than arrays, no poses, no such person.
    """
    return build_content(
        path, load_once(load_pickle, path, person or animation), unit=unit, up=up, skeleton=skeleton,
        frame_rate=frame_rate, person=person, animation=animation,
    )  # fmt: skip


def build_content(
    path: str | os.PathLike[str],
    content: Mapping[Any, Any],
    *,
    unit: float | str | None,
    up: str | None,
    skeleton: str | os.PathLike[str] | None,
    frame_rate: float | None,
    person: str | None,
    animation: str | None,
) -> Motion | Trajectories:
    """Build the motion of a dictionary of arrays, numbers, texts, lists and dictionaries.

    Parameters
    ----------
    path : for messages and provenance.
    content : as `load_pickle` gives it.
    unit, up, skeleton, frame_rate, person, animation : as for `read_pickle`.
    """
    arrays = {str(key): array for key, value in content.items() if (array := as_array(value)) is not None}
    bodies = list_bodies(content)
    if not bodies and are_poses(find_roles(arrays)):  # damaged ones
        bodies = [Body("", arrays, None, False)]
    if bodies:
        names = distinguish(body.name or "1" for body in bodies)
        seen = [0 if body.turns is None else len(body.turns) for body in bodies]
        chosen, notes = choose(path, "person", names, person, seen)
        body = bodies[chosen]
        # A film says no up axis: bodies by person stand in the axes of a camera, or of the program's own world.
        filmed = bool(body.name) or any(rank_place(name) == 2 for name in body.arrays)
        if filmed and not body.in_world:
            notes += (Message("smpl.camera"),)
        return build_smpl(
            path, body.arrays.get, body.arrays, unit=unit, up=up, skeleton=skeleton, frame_rate=frame_rate,
            default_up=None if filmed else "z", notes=notes, turns=body.turns,
        )  # fmt: skip
    options: dict[str, Any] = {"unit": unit, "up": up, "frame_rate": frame_rate}
    return _build_joints(path, content, arrays, person, animation, options)


def _build_joints(
    path: str | os.PathLike[str],
    content: Mapping[Any, Any],
    arrays: Mapping[str, NDArray[Any]],
    person: str | None,
    animation: str | None,
    options: dict[str, Any],
) -> Trajectories:
    """The joints of a dictionary without bodies: samples, people, nested takes, or one array."""
    kind = os.path.splitext(os.fspath(path))[1].lower().lstrip(".")
    samples = _list_samples(content, arrays)
    if samples:
        names = distinguish(text or f"sample {number}" for number, (_, text, _) in enumerate(samples, 1))
        chosen, notes = choose(path, "animation", names, animation, [len(points) for points, _, _ in samples])
        points, text, declared = samples[chosen]
        if declared > len(points):
            notes += (Message("guard.frame_count", declared=f"{declared:,}", found=len(points)),)
        notes += (Message("arrays.text", text=text),) if text else ()
        return build_joints(path, kind, points, notes=notes, **options)
    people = name_people(arrays)
    nested = people if all(is_joint_array(array.shape) for array in people.values()) else {}
    part, wanted = ("person", person) if nested else ("animation", animation)
    name = find_joints(arrays)
    if not nested and name is None:
        found = dict(_walk(content))
        counts = {len(layout.names) for layout in list_layouts()}
        nested = {t: array for t, array in found.items() if is_joint_array(array.shape) and counts & {*array.shape}}
        if len(nested) > 1 and len({title.partition(" ")[0] for title in nested}) == 1:
            nested = {title.partition(" ")[2]: array for title, array in nested.items()}
        if not nested and any(array.ndim > 2 and array.shape[-1] == 2 for array in (*arrays.values(), *found.values())):
            raise MotionFileError(path, "guard.flat")
    if nested:
        chosen, notes = choose(path, part, [*nested], wanted, [len(array) for array in nested.values()])
        return build_joints(path, kind, [*nested.values()][chosen], notes=notes, **options)
    if name is None:
        raise MotionFileError(path, "pickles.no_motion", found=tuple(map(str, content))[:12])
    rate = options["frame_rate"] or read_rate(arrays.get) or (AIST_RATE if name.startswith("keypoints3d") else None)
    lists = (one for key in ("joint_names", "names") if isinstance(one := content.get(key), list | tuple | np.ndarray))
    texts = next((one for one in lists if getattr(one, "ndim", 1) == 1), ())
    named = tuple(map(str, texts)) if len(texts) and all(isinstance(text, str) for text in texts) else None
    return build_joints(path, kind, arrays[name], names=named, **(options | {"frame_rate": rate}))


def _walk(content: Any, title: str = "", depth: int = 0, most: int = 5000) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays in dictionaries and lists within others, by their way from the outermost, such as ``S1 Walking``."""
    array = None if depth < 2 else as_array(content)
    if array is not None:
        yield title, array
    elif depth < 6 and isinstance(content, list | dict):
        items = content.items() if isinstance(content, dict) else enumerate(content[:most], 1)
        for key, value in items:
            yield from _walk(value, f"{title} {key}".strip(), depth + 1)


def _list_samples(
    content: Mapping[Any, Any], arrays: Mapping[str, NDArray[Any]]
) -> list[tuple[NDArray[Any], str, int]]:
    """Places (T, J, 3), text, length of samples of text-to-motion: ``motion`` (N, J, 3, T), ``text``, ``lengths``."""
    motion = arrays.get("motion")
    if motion is None or motion.ndim != 4 or 3 not in motion.shape[2:]:
        return []
    if motion.shape[2] == 3 and motion.shape[3] != 3:
        motion = np.moveaxis(motion, 3, 1)
    lengths, texts = arrays.get("lengths"), content.get("text")
    known = lengths is not None and lengths.shape == (len(motion),) and np.isfinite(lengths).all()
    counts = [int(count) for count in lengths] if known and lengths is not None else [0] * len(motion)
    texts = texts if isinstance(texts, list) and len(texts) == len(motion) else [""] * len(motion)
    rows = zip(motion, texts, counts, strict=True)
    return [(own[:count] if count > 0 else own, str(text)[:200], count) for own, text, count in rows]
