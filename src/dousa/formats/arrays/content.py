"""Content of arrays and pickles: SMPL bodies of several people, joints, features, samples of text-to-motion."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.frame_files import natural_key
from dousa.files.npz_arrays import open_npz, parse_head, read_head
from dousa.files.pickles import load_pickle
from dousa.formats.arrays.bodies import Body, as_array, list_bodies, name_people
from dousa.formats.arrays.joints import build_joints, find_joints, is_joint_array, list_layouts, measure_unevenness
from dousa.formats.parts import choose, distinguish, load_once
from dousa.formats.smpl import AIST_RATE, build_smpl, mean_body, read_rate
from dousa.formats.smpl_poses import JOINTS_OF, are_poses, as_turns, find_roles, rank_place
from dousa.messages import Message
from dousa.motion import Motion, Trajectories
from dousa.motion.canonical.anthropometry import measure_proportions
from dousa.motion.canonical.recipes import named_recipes
from dousa.motion.canonical.tree_shape import spread_frames
from dousa.motion.rotations import rotate


def name_kind(path: str | os.PathLike[str]) -> str:
    """Return the name of a format of arrays: the suffix."""
    return os.path.splitext(os.fspath(path))[1].lower().lstrip(".")


def load_content(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Load the content of a file by its suffix; an array without a name is given under the name "".

    Raises
    ------
    MotionFileError : missing, damaged, objects that are no plain values.
    """
    return {"npy": _load_npy, "npz": _load_npz}.get(name_kind(path), load_pickle)(path)


def _load_npy(path: str | os.PathLike[str]) -> dict[Any, Any]:
    data = read_bytes(path)
    head = read_head(io.BytesIO(data))
    if head is None:
        raise MotionFileError(path, "arrays.no_npy")
    if b"'|O'" in head:
        return load_pickle(path, data[len(head) :])
    header, left = parse_head(head), len(data) - len(head)
    if header is None or header.dtype.kind not in "iuf":
        raise MotionFileError(path, "arrays.not_plain")
    if header.n_bytes != left:
        raise MotionFileError(path, "arrays.size", shape=str(header.shape), found=left)
    return {"": header.shape_data(np.frombuffer(data, header.dtype, offset=len(head)))}


def _load_npz(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """The arrays of numbers and texts, and the dictionaries in the place of one; other members are left out.

    Of a body neither are meshes read, nor anything else that has three axes and no part in its poses.
    """
    content: dict[Any, Any] = {}
    refused: MotionFileError | None = None
    with open_npz(path, partial(MotionFileError, path)) as file:
        roles = find_roles(file.names)
        poses = set(roles.values()) if are_poses(roles) else None
        for name in file.names:
            pickled = file.read_pickled(name)
            try:
                if pickled is not None:
                    content[name] = load_pickle(path, pickled)
                    continue
                with file.open(name) as (header, _):
                    is_mesh = poses is not None and name not in poses and len(header.shape) > 2
                if not is_mesh:
                    content[name] = file.read(name, "iufU", most=file.most)
            except MotionFileError as error:
                if error.code in ("npz.ends", "npz.size", "npz.large", "npz.damaged"):
                    raise
                refused = error
    if refused is not None and not content:
        raise refused
    return content


FEATURES = {263: 22, 251: 21}
"""Joints by the width of a row, by the definition of HumanML3D."""

MOTION_X = 322
"""Width of a row of Motion-X (Lin et al., 2023): the first 156 are rotation vectors of SMPL-H, 309 to 311 the place of
the root."""


def recover_joints(path: str | os.PathLike[str], rows: NDArray[np.floating], uneven: float = 0.1) -> FloatArray:
    """Compute the places of joints (T, J, 3) m, Y up, from rows (T, 263) or (T, 251).

    HumanML3D (Guo et al., Generating diverse and natural 3D human motions from text, CVPR 2022; ``recover_from_ric``):
    with J joints a row has 12 J - 1 numbers: half the turn of the root about Y in a frame, its velocity along X and Z
    in its own heading, its height, the places of the other joints seen from the root in its heading, and rotations,
    velocities and contacts, which say the same again. 263 are 22 joints, 251 the 21 of KIT-ML.

    Parameters
    ----------
    path : for the message.
    rows : as they are, not divided by their spread over a data set.
    uneven : share by which the shanks, left and right, vary at most (standard deviation): the bones of rows that were
        divided by their spread, or are of another kind, have no length.

    Raises
    ------
    MotionFileError : rows that make no body.
    """
    values = rows.astype(np.float64)
    n_joints = FEATURES[values.shape[1]]
    heading = np.concatenate(([0.0], np.cumsum(values[:-1, 0])))
    # The quaternion has the angle itself, not half of it: a row holds half of the turn.
    back = np.stack((np.cos(heading), 0 * heading, -np.sin(heading), 0 * heading), axis=1)
    steps = np.zeros((len(values), 3))
    steps[1:, 0], steps[1:, 2] = values[:-1, 1], values[:-1, 2]
    root = np.cumsum(rotate(back, steps), axis=0)
    others = values[:, 4 : 4 + 3 * (n_joints - 1)].reshape(len(values), n_joints - 1, 3)
    joints = rotate(back[:, None], others) + root[:, None]
    root[:, 1] = values[:, 3]
    joints = np.concatenate((root[:, None], joints), axis=1)
    lengths = np.linalg.norm(joints[:, _KNEES[n_joints]] - joints[:, _ANKLES[n_joints]], axis=-1)
    if not (np.isfinite(lengths).all() and lengths.mean() > 0 and lengths.std() <= uneven * lengths.mean()):
        raise MotionFileError(path, "arrays.features", found=rows.shape[1])
    return joints


# Left and right in the order of the joints (layouts.toml), by the definition of HumanML3D and KIT-ML.
_KNEES, _ANKLES = {22: [4, 5], 21: [17, 12]}, {22: [7, 8], 21: [18, 13]}


def read_arrays(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    person: str | None = None,
    animation: str | None = None,
) -> Motion | Trajectories:
    """Read SMPL bodies, joint positions or features: an npy, a pickle, a dump of joblib or torch.

    Parameters
    ----------
    path : the file; nothing in it is executed.
    unit, up, skeleton : as for `build_smpl`; joint positions take no skeleton.
    frame_rate : Hz; by default that of the file, else that of the data set whose joints these are.
    person : name or number of one of several people; by default the one seen in most frames.
    animation : name or number of one of several samples of text-to-motion; by default the longest.

    Raises
    ------
    MotionFileError : missing, damaged, something other than arrays, no poses, an unknown number of joints, no such
        person.
    """
    return build_content(
        path, load_once(load_content, path, person or animation), unit=unit, up=up, skeleton=skeleton,
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
    """Build the motion of a dictionary of arrays, numbers, texts, lists and dictionaries; "" names an array alone.

    Parameters
    ----------
    path : for messages and provenance.
    content : as `load_content` gives it.
    unit, up, skeleton, frame_rate, person, animation : as for `read_arrays`.
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
    if [*arrays] == [""]:
        return _build_bare(path, arrays[""], skeleton, person, animation, options)
    return _build_joints(path, content, arrays, person, animation, options)


def _build_bare(
    path: str | os.PathLike[str],
    array: NDArray[Any],
    skeleton: str | os.PathLike[str] | None,
    person: str | None,
    animation: str | None,
    options: dict[str, Any],
) -> Motion | Trajectories:
    """The motion of an array without a name: rows of features, rotations of SMPL, samples, or joints."""
    _refuse_pictures(path, array)
    rows = array.reshape([axis for axis in array.shape if axis != 1])
    if rows.ndim == 2 and rows.shape[1] == MOTION_X:
        parts = {"poses": rows[:, :156], "trans": rows[:, 309:312], "betas": rows[:, 312:]}
        return build_smpl(path, parts.get, parts, skeleton=skeleton, default_up="y", **options)
    if rows.ndim == 2 and rows.shape[1] in FEATURES:
        return build_joints(path, name_kind(path), recover_joints(path, rows), **options)
    if rows.ndim == 2 and rows.shape[1] % 3 == 0 and rows.shape[1] // 3 in JOINTS_OF:
        array = rows = rows.reshape(len(rows), -1, 3)
    if (turns := _read_turns(rows)) is not None:
        notes = (Message("arrays.poses", joints=turns.shape[1], model=JOINTS_OF[turns.shape[1]]),)
        poses: dict[str, Any] = {"skeleton": skeleton, "default_up": None, "notes": notes, "turns": turns}
        return build_smpl(path, lambda _name: None, (), **poses, **options)
    if rows.ndim == 4 and len(rows) and is_joint_array(rows.shape[1:]):
        return _build_joints(path, {}, {"motion": rows}, person, animation, options)
    return build_joints(path, name_kind(path), array, **options)


def _read_turns(array: NDArray[Any], uneven: float = 0.8) -> FloatArray | None:
    """Rotations (T, J, 4) of SMPL of an array without a name: matrices, or vectors that as places make no person.

    Of 278 recordings (bandai, HDM05, foreign) one has rotation vectors that would make a person; all places of Kinects
    do, with limbs that are ``uneven`` by 0.61 at most.
    """
    if array.ndim not in (3, 4) or array.shape[1] not in JOINTS_OF or array.shape[2:] not in ((3,), (3, 3)):
        return None
    if not array.any() or not np.isfinite(array).all():
        return None
    if array.ndim == 3:
        seen = array[array.any(axis=(1, 2))]  # in a frame of zeros nobody was seen, or the body is at rest
        names, places = mean_body(array.shape[1]).names, spread_frames(seen.astype(np.float64))
        is_person = measure_proportions(named_recipes(names)[0].apply(places)).is_person
        if np.abs(array).max() > 2 * np.pi or (is_person and measure_unevenness(places, names) < uneven):
            return None
    return as_turns(array, (array.shape[1],))


def _build_joints(
    path: str | os.PathLike[str],
    content: Mapping[Any, Any],
    arrays: Mapping[str, NDArray[Any]],
    person: str | None,
    animation: str | None,
    options: dict[str, Any],
) -> Trajectories:
    """The joints of a dictionary without bodies: samples, people, nested takes, or one array."""
    kind = name_kind(path)
    if (frames := _gather_frames(arrays)) is not None:
        return build_joints(path, kind, frames, notes=(Message("arrays.frames", n=len(frames)),), **options)
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


def _refuse_pictures(path: str | os.PathLike[str], array: NDArray[Any], far: float = 100.0) -> None:
    """Raise MotionFileError for points in pictures; of several cameras, as FreeMoCap saves them, with MediaPipe's z.

    ``far`` : of x or y, of which none is below 0: no data set in metres has such places, and every picture.
    """
    if array.ndim < 3 or not array.size:
        return
    low, high = (reduce(array[..., :2], axis=None) for reduce in (np.fmin.reduce, np.fmax.reduce))
    if array.shape[-1] == 2 or (array.ndim == 4 and low >= 0 and high > far):
        raise MotionFileError(path, "guard.flat")


def _gather_frames(arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    """Places (T, J, 3) of arrays (J, 3) of one frame each, whose names differ in their numbers only; else None."""
    shapes, names = {array.shape for array in arrays.values()}, {re.sub(r"\d+", "", name) for name in arrays}
    if len(arrays) < 2 or len(shapes) > 1 or len(names) > 1 or not is_joint_array((2, *shapes.pop())):
        return None
    return np.stack([arrays[name] for name in sorted(arrays, key=natural_key)])


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
