"""Files of two people, Anna and Ben, who walk beside each other, in all formats that can hold them."""

import dataclasses
import json

import numpy as np

from dousa.formats.gltf.document import load_document, pack_document
from dousa.formats.registry import write_motion
from dousa.motion import Motion, Skeleton, canonicalise, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.motion.types import freeze

FRAMES = 20


def make_person(seed, category="walk"):
    motion = make_motion(category, draw_performer(seed))
    moved = motion.translations[:FRAMES] + np.where(np.arange(motion.skeleton.n_joints) > 0, 0.0, 1.0)[:, None] * [
        1.5 * seed, 0, 0
    ]  # fmt: skip
    return dataclasses.replace(motion, rotations=motion.rotations[:FRAMES], translations=moved)


ANNA, BEN = make_person(0), make_person(1)


def join(motions, names):
    """One motion of several people, each with roots and names of their own."""
    skeletons = [motion.skeleton for motion in motions]
    starts = np.cumsum([0, *(skeleton.n_joints for skeleton in skeletons)])
    parents = [np.where(s.parents < 0, -1, s.parents + start) for s, start in zip(skeletons, starts, strict=False)]
    skeleton = Skeleton(
        tuple(name(joint) for name, s in zip(names, skeletons, strict=True) for joint in s.names),
        np.concatenate(parents),
        np.concatenate([s.offsets for s in skeletons]),
        np.concatenate([s.end_sites for s in skeletons]),
    )
    rotations, translations = (
        np.concatenate([getattr(motion, key) for motion in motions], axis=1) for key in ("rotations", "translations")
    )
    return Motion(skeleton, freeze(rotations), freeze(translations), 30.0)


def prefixed(mark=":"):
    return [(lambda joint, owner=owner: f"{owner}{mark}{joint}") for owner in ("Anna", "Ben")]


def write_points(path, mark):
    write_motion(compute_trajectories(join([ANNA, BEN], prefixed(mark))), path)
    return ["Anna", "Ben"]


def write_bvh(path):
    write_motion(join([ANNA, BEN], prefixed()), path)
    return ["Anna", "Ben"]


def write_equal_names(path):
    write_motion(join([ANNA, BEN], [str, str]), path)
    return [ANNA.skeleton.names[0], f"{ANNA.skeleton.names[0]} 2"]


def write_glb(path):
    """Two armatures with joints of equal names, moved by one animation."""
    write_motion(join([ANNA, BEN], [str, str]), path)
    return [ANNA.skeleton.names[0], f"{ANNA.skeleton.names[0]} 2"]


def write_json(path, numbers=(None, None)):
    people = [compute_trajectories(motion) for motion in (ANNA, BEN)]
    frames = []
    for frame in range(FRAMES):
        entries = []
        for number, person in zip(numbers, people, strict=True):
            named = canonicalise(person).to_trajectories()
            points = [
                {"name": name, "x": x, "y": y, "z": z, "score": 0.9}
                for name, (x, y, z) in zip(named.names, named.positions[frame].tolist(), strict=True)
            ]
            entries.append({"keypoints3D": points} | ({} if number is None else {"track_id": number}))
        frames.append(entries)
    path.write_text(json.dumps(frames))
    return ["1", "2"] if numbers[0] is None else [f"id {number}" for number in numbers]


def write_motive(path):
    """Bones of two skeletons: as Motive writes them, with the owner before a colon."""
    both = join([ANNA, BEN], [lambda joint: f"Anna_{joint}", lambda joint: f"Ben_{joint}"])
    write_motion(both, path)
    path.write_text(path.read_text().replace("Anna_", "Anna:").replace("Ben_", "Ben:"))
    return ["Anna", "Ben"]


def write_armatures(path):
    """Two armatures that one animation moves, and another that moves the second alone."""
    write_glb(path)
    document = load_document(path)
    tree, nodes = document.tree, document.tree["nodes"]
    roots = [node for node in tree["scenes"][0]["nodes"] if nodes[node]["name"] == ANNA.skeleton.names[0]]
    nodes += [{"name": name, "children": [root]} for name, root in zip(("Anna", "Ben"), roots, strict=True)]
    rest = [node for node in tree["scenes"][0]["nodes"] if node not in roots]
    tree["scenes"][0]["nodes"] = [len(nodes) - 2, len(nodes) - 1, *rest]
    duet = tree["animations"][0] | {"name": "duet"}
    own = [channel for channel in duet["channels"] if channel["target"]["node"] >= roots[1]]
    solo = {
        "name": "solo",
        "samplers": [duet["samplers"][channel["sampler"]] for channel in own],
        "channels": [{**channel, "sampler": number} for number, channel in enumerate(own)],
    }
    tree["animations"] = [duet, solo]
    path.write_bytes(pack_document(tree, document.buffers[0]))


SEGMENTS = {"Pelvis": "pelvis", "T8": "spine", "Neck": "neck", "Head": "head"} | {
    f"{side}{segment}": f"{side.lower()}_{joint}"
    for side in ("Left", "Right")
    for segment, joint in (
        ("UpperArm", "shoulder"), ("ForeArm", "elbow"), ("Hand", "wrist"),
        ("UpperLeg", "hip"), ("LowerLeg", "knee"), ("Foot", "ankle"), ("Toe", "toe"),
    )
}  # fmt: skip


def write_mvnx(path):
    """Two subjects, with the positions of their segments, Z up."""
    subjects = []
    labels = "".join(f'<segment label="{name}"/>' for name in SEGMENTS)
    for label, motion in (("Anna", ANNA), ("Ben", BEN)):
        joints = canonicalise(motion).to_trajectories()
        places = joints.positions[:, [joints.names.index(joint) for joint in SEGMENTS.values()]][..., [0, 2, 1]] * [
            1,
            -1,
            1,
        ]
        numbers = [" ".join(f"{value:.9f}" for value in frame.ravel()) for frame in places]
        frames = "".join(f'<frame type="normal"><position>{row}</position></frame>' for row in numbers)
        content = f"<segments>{labels}</segments><frames>{frames}</frames>"
        subjects.append(f'<subject label="{label}" frameRate="30">{content}</subject>')
    path.write_text(f'<mvnx version="4">{"".join(subjects)}</mvnx>')
    return ["Anna", "Ben"]
