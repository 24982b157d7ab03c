"""What a body does in words: hand-made poses of which it is plain, and the invariances."""

import json
from pathlib import Path

import numpy as np
import pytest

from dousa.messages import LANGUAGES
from dousa.messages.tables import load_section
from dousa.motion import canonicalise
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion
from dousa.retrieval import LabelledClip
from dousa.retrieval.words.relations import find_relations
from dousa.retrieval.words.vocabulary import load_vocabulary

ANSWERS = Path(__file__).with_name("answers.json")
STANDING = {
    "pelvis": (0, 0.95, 0), "spine": (0, 1.2, 0), "neck": (0, 1.45, 0), "head": (0, 1.6, 0),
    "shoulder": (0.18, 1.4, 0), "elbow": (0.2, 1.1, 0), "wrist": (0.2, 0.85, 0.02), "hand": (0.2, 0.78, 0.03),
    "hip": (0.1, 0.92, 0), "knee": (0.1, 0.5, 0), "ankle": (0.1, 0.08, 0), "toe": (0.1, 0.02, 0.12),
}  # fmt: skip


def pose(**changed):
    """(20, 3) m of somebody who stands, facing +z, with other places of some joints."""
    points = np.zeros((len(CANONICAL_JOINTS), 3))
    for joint, index in JOINT_INDEX.items():
        side, _, bare = joint.rpartition("_")
        x, y, z = STANDING[bare or joint]
        points[index] = (-x if side == "right" else x, y, z)
    for joint, place in changed.items():
        points[JOINT_INDEX[joint]] = place
    return points


def clip(*poses, seconds=1.0, rate=30.0):
    """A motion that goes from pose to pose, evenly."""
    keys = np.array(poses if len(poses) > 1 else poses * 2)
    places = np.linspace(0, len(keys) - 1, round(seconds * rate))
    below = np.minimum(places.astype(int), len(keys) - 2)
    share = (places - below)[:, None, None]
    return LabelledClip("x", "x", None, keys[below] * (1 - share) + keys[below + 1] * share, rate, 1.7)


def said(motion):
    return {f"{one.part} {one.name}".strip() for one in find_relations(motion)}


def arm(side, hand, elbow):
    """Changes that put a hand and an elbow of the left side, or their mirror images, somewhere."""
    sign = 1 if side == "left" else -1
    hand, elbow = (np.array(place) * (sign, 1, 1) for place in (hand, elbow))
    return {f"{side}_hand": hand, f"{side}_wrist": 0.8 * hand + 0.2 * elbow, f"{side}_elbow": elbow}


UP = ((0.2, 1.95, 0), (0.2, 1.65, 0))
ASIDE = ((0.75, 1.4, 0), (0.45, 1.4, 0))
AHEAD = ((0.2, 1.4, 0.55), (0.2, 1.4, 0.28))


def test_standing_still_is_all_that_somebody_does_who_stands():
    assert said(clip(pose())) == {"stands_still"}


@pytest.mark.parametrize(
    ("places", "expected"), [(UP, "hand above_head"), (ASIDE, "arm arm_aside"), (AHEAD, "arm arm_ahead")]
)
def test_arms_are_told_by_their_side(places, expected):
    part, name = expected.split()
    both = said(clip(pose(**arm("left", *places), **arm("right", *places))))
    assert f"both_{part}s {name}" in both
    assert not {f"left_{part} {name}", f"right_{part} {name}"} & both
    for side in ("left", "right"):
        one = said(clip(pose(**arm(side, *places))))
        assert f"{side}_{part} {name}" in one
        assert f"both_{part}s {name}" not in one


def test_when_it_happens_is_told():
    down, up = pose(), pose(**arm("left", *UP))
    motion = clip(down, down, up, up, down, down, seconds=4.0)
    (raised,) = [one for one in find_relations(motion) if one.name == "above_head"]
    assert 0.8 < raised.start < 1.7
    assert 2.3 < raised.end < 3.2
    assert raised.share == pytest.approx((raised.end - raised.start) / 4.0, abs=0.02)


def test_a_foot_that_is_kicked_forward():
    high = {"left_ankle": (0.1, 0.6, 0.6), "left_knee": (0.1, 0.8, 0.35), "left_toe": (0.1, 0.7, 0.65)}
    assert {"left_leg kicks_forward"} <= said(clip(pose(), pose(**high), pose(), seconds=0.7))


@pytest.mark.parametrize(
    ("category", "expected"),
    [
        ("walk", "walks"), ("squat", "body_low"), ("bow", "bent_forward"), ("clap", "hands_meet"),
        ("kick_left", "left_leg kicks_forward"), ("kick_right", "right_leg kicks_forward"),
    ],
)  # fmt: skip
def test_everyday_motions_are_told(category, expected):
    found = [expected in said(canonicalise(make_motion(category, draw_performer(n), seed=n))) for n in range(4)]
    assert sum(found) >= 3


def test_where_somebody_stands_faces_and_how_tall_does_not_matter():
    motion = canonicalise(make_motion("kick_left", draw_performer(1), seed=1))
    turn = np.array([[np.cos(2.0), 0, np.sin(2.0)], [0, 1, 0], [-np.sin(2.0), 0, np.cos(2.0)]])
    moved = 1.3 * motion.positions @ turn.T + (4.0, 0.0, -2.0)
    other = LabelledClip("x", "x", None, moved, motion.frame_rate, 1.3 * motion.height)
    assert said(other) == said(motion)


def test_the_mirror_image_has_the_other_side():
    motion = canonicalise(make_motion("kick_left", draw_performer(2), seed=2))
    mirrored = LabelledClip("x", "x", None, mirror_positions(motion.positions), motion.frame_rate, motion.height)
    exchanged = {"left": "right", "right": "left"}
    assert said(mirrored) == {
        " ".join("_".join(exchanged.get(bit, bit) for bit in word.split("_")) for word in one.split())
        for one in said(motion)
    }


def test_missing_joints_and_single_frames_give_no_error():
    points = clip(pose(**arm("left", *UP))).positions.copy()
    points[:, JOINT_INDEX["right_hand"]] = np.nan
    assert "left_hand above_head" in said(LabelledClip("x", "x", None, points, 30.0, 1.7))
    find_relations(LabelledClip("x", "x", None, pose()[None], 30.0, 1.7))


def every_question():
    """Motions of all made categories, as they are, mirrored, with joints missing, at other rates, and cut short."""
    for number, category in enumerate(CATEGORIES):
        motion = canonicalise(make_motion(category, draw_performer(number), seed=number))
        yield LabelledClip(category, category, None, motion.positions, motion.frame_rate, motion.height)
        yield LabelledClip(category, category, None, mirror_positions(motion.positions), 100.0, motion.height)
        yield LabelledClip(category, category, None, motion.positions[: 1 + number % 5], 12.0, motion.height)
        for joints in (("left_hand", "right_ankle"), ("pelvis", "head"), ("left_ankle", "right_ankle"), ("neck",)):
            points = motion.positions.copy()
            points[:, [JOINT_INDEX[joint] for joint in joints]] = np.nan
            yield LabelledClip(category, category, None, points, motion.frame_rate, motion.height)
    generator = np.random.default_rng(0)
    for _ in range(40):  # the body falls, turns and reaches everywhere
        waves = np.sin(np.outer(np.linspace(0, 1, 90), np.arange(1, 6) * np.pi))
        moved = np.einsum("tw,wjk->tjk", waves, generator.normal(0, 0.15, (5, len(CANONICAL_JOINTS), 3)))
        walked = 0.4 * np.cumsum(np.einsum("tw,wk->tk", waves, generator.normal(0, 0.1, (5, 3))), axis=0)
        points = pose() + moved + walked[:, None] * (1, 0.02, 1)
        yield LabelledClip("x", "x", None, points, 30.0, 1.7)


def test_the_answers_are_those_of_plain_numpy():
    """``answers.json`` holds what one question after the other, with whole arrays of NumPy, said of these motions; who
    gives a question another meaning shows by the poses above that it is right, and runs this file to write it again."""
    kept = json.loads(ANSWERS.read_text(encoding="utf-8"))
    assert [[[*answer] for answer in answers] for answers in list_answers()] == kept
    assert len({name for answers in kept for name, *_ in answers}) >= 28


def list_answers():
    """What is said of each motion; times and shares to a thousandth."""
    for motion in every_question():
        found = find_relations(motion)
        yield [(one.name, one.part, *(round(value, 3) for value in (one.share, one.start, one.end))) for one in found]


def test_every_relation_has_words_that_the_table_understands():
    import inspect
    import re

    from dousa.retrieval.words import relations
    from dousa.retrieval.words.vocabulary import read_words

    source = inspect.getsource(relations)
    for language in LANGUAGES:
        words = load_section("relations", language)
        parts = {
            f"{side}_{limb}" for side in ("left", "right") for limb in ("hand", "arm", "elbow", "foot", "knee", "leg")
        }
        parts |= {f"both_{limb}" for limb in ("hands", "arms", "elbows", "feet", "knees", "legs")}
        assert parts <= set(words)
        for name, text in words.items():
            assert name in parts or re.search(rf'"{name}"', source), f"nobody says {name}"
            read = read_words(load_vocabulary(), text.replace("{part}", ""))
            assert read and all(word.meanings for word in read), (language, text)


if __name__ == "__main__":
    ANSWERS.write_text("[\n" + ",\n".join(map(json.dumps, list_answers())) + "\n]\n", encoding="utf-8")
