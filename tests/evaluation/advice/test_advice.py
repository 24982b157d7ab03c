"""Advice on made postures, of which a teacher knows what to say, and on a real dance with one limb moved."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.fake_assessment import make_assessment
from dousa.errors import OptionError
from dousa.evaluation import SEGMENTS, Assessment, ErrorEvent, Lapse, PostureSequence, advise, describe_advice, praise
from dousa.evaluation.advice.directions import PairedDancers, find_corrections
from dousa.evaluation.posture.posture import compute_postures, compute_segments
from dousa.formats.registry import read_motion
from dousa.messages import Message
from dousa.motion import JOINT_INDEX as J
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories
from lab.injection.injection import simulate_performer

RATE, SECONDS = 30.0, 8.0
LEFT, UP, FRONT = np.eye(3)
ARMS = {"left": ("left_upper_arm", "left_forearm"), "right": ("right_upper_arm", "right_forearm")}
LEGS = {"left": ("left_thigh", "left_shank"), "right": ("right_thigh", "right_shank")}
# A person who stands with the arms out to the sides, facing +Z, the own left at +X; m.
STANDING = {
    "pelvis": (0, 1, 0), "spine": (0, 1.2, 0), "neck": (0, 1.5, 0), "head": (0, 1.7, 0),
    "left_shoulder": (0.2, 1.45, 0), "left_elbow": (0.5, 1.45, 0), "left_wrist": (0.75, 1.45, 0),
    "left_hand": (0.85, 1.45, 0), "left_hip": (0.1, 0.95, 0), "left_knee": (0.1, 0.5, 0), "left_ankle": (0.1, 0.08, 0),
    "left_toe": (0.1, 0, 0.15),
}  # fmt: skip
CHAINS = {"shoulder": ("elbow", "wrist", "hand"), "elbow": ("wrist", "hand"), "hip": ("knee", "ankle", "toe"),
          "knee": ("ankle", "toe")}  # fmt: skip
UPPER_BODY = [J[name] for name in J if not any(part in name for part in ("pelvis", "hip", "knee", "ankle", "toe"))]


def stand() -> np.ndarray:
    """(T, 20, 3) m, a person who does not move."""
    pose = np.zeros((20, 3))
    for name, place in STANDING.items():
        pose[J[name]] = place
        if name.startswith("left"):
            pose[J[name.replace("left", "right")]] = np.array(place) * [-1, 1, 1]
    return np.tile(pose, (round(RATE * SECONDS), 1, 1))


def rotate(positions: np.ndarray, joint: str, axis: np.ndarray, degrees: float) -> np.ndarray:
    """The limb beyond a joint, right-handed about an axis through it; joint "trunk" bends the body at the pelvis."""
    turned = positions.copy()
    if joint == "trunk":
        moved, root = UPPER_BODY, positions[:, [J["left_hip"], J["right_hip"]]].mean(axis=1, keepdims=True)
    else:
        side, name = joint.split("_")
        moved, root = [J[f"{side}_{part}"] for part in CHAINS[name]], positions[:, [J[joint]]]
    spin = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    turned[:, moved] = (positions[:, moved] - root) @ spin.T + root
    return turned


def face(positions: np.ndarray, degrees: float) -> np.ndarray:
    """The whole dancer turned to the own left, and somewhere else on the floor."""
    spin = Rotation.from_rotvec(np.radians(degrees) * UP).as_matrix()
    return positions @ spin.T + [3.0, 0.0, -2.0]


def sequence(positions: np.ndarray) -> PostureSequence:
    seen = np.ones((len(positions), 9), bool)
    return PostureSequence(compute_segments(positions), seen, positions, RATE, "made")


def event(kind: str = "partial", segments: tuple[str, ...] = SEGMENTS, start: float = 3.0, **fields) -> ErrorEvent:
    values = {"lag_ms": None, "shortfall_deg": None, "shortfall_percent": None, "severity": 2.0, "furi": None}
    values |= {"worst_s": start + 0.5, "reference_s": start + 0.5} | fields
    return ErrorEvent(kind=kind, start_s=start, end_s=start + 1.0, segments=segments, **values)


def judged(theirs: np.ndarray, ours: np.ndarray, *events: ErrorEvent, **changes) -> Assessment:
    """An assessment with these motions and events: what of it the advice needs."""
    made = make_assessment(seconds=SECONDS)
    count = len(ours)
    times = np.arange(count) / RATE
    fields = {
        "reference": sequence(theirs), "performance": sequence(ours), "same_time": times, "matched_time": times,
        "facing": np.zeros(count), "events": events, "lapses": (), "furi": (), "warnings": (),
    }  # fmt: skip
    return dataclasses.replace(made, **(fields | changes))


def say(theirs: np.ndarray, ours: np.ndarray, *events: ErrorEvent, language: str = "en", **changes) -> list[str]:
    """What is said, with moments in whole seconds."""
    said = (one.message.render(language) for one in advise(judged(theirs, ours, *events, **changes)))
    return [re.sub(r"(\d:\d\d)\.\d", r"\1", one) for one in said]


@pytest.mark.parametrize("heading", [0.0, 90.0, -135.0, 180.0])
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_lowered_arm_should_be_raised(side, sign, heading):
    low = rotate(stand(), f"{side}_shoulder", FRONT, -25.0 * sign)
    one = event(segments=ARMS[side])
    assert say(stand(), face(low, heading), one) == [f"raise the {side} arm 25 deg higher at 0:03"]
    assert say(face(stand(), heading), low, one, language="ja") == [
        f"0:03、{'左' if side == 'left' else '右'}腕をあと25度高く上げましょう"
    ]
    assert say(low, face(stand(), heading), one) == [f"lower the {side} arm by 25 deg at 0:03"]


@pytest.mark.parametrize(
    ("axis", "degrees", "says"),
    [(UP, 30.0, "bring the left arm 30 deg further forward"), (UP, -30.0, "take the left arm 30 deg further back")],
)
def test_an_arm_to_the_side_swings(axis, degrees, says):
    # About the vertical a positive turn takes +X (the left arm) to -Z, which is behind.
    theirs = rotate(stand(), "left_shoulder", axis, -degrees)
    assert say(theirs, face(stand(), 70.0), event(segments=ARMS["left"])) == [f"{says} at 0:03"]


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_an_arm_in_front_opens_and_closes(side, sign):
    ahead = rotate(stand(), f"{side}_shoulder", UP, -90.0 * sign)
    further_out = rotate(stand(), f"{side}_shoulder", UP, -60.0 * sign)
    one = event(segments=ARMS[side])
    assert say(further_out, ahead, one) == [f"open the {side} arm 30 deg further to the outside at 0:03"]
    assert say(ahead, further_out, one) == [f"bring the {side} arm 30 deg further in at 0:03"]


@pytest.mark.parametrize("facing", [0.0, 120.0])
def test_both_arms_are_one_correction(facing):
    low = rotate(rotate(stand(), "left_shoulder", FRONT, -38.0), "right_shoulder", FRONT, 42.0)
    found = say(stand(), face(low, facing), event("incomplete", ARMS["left"] + ARMS["right"], shortfall_deg=40.0))
    assert found == ["raise both arms 40 deg higher at 0:03"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_knee_bends_more(side):
    # The shank goes back, right-handed about the line to the left.
    bent = rotate(stand(), f"{side}_knee", LEFT, 20.0)
    one = event(segments=(LEGS[side][1],))
    assert say(bent, face(stand(), 45.0), one) == [f"bend the {side} knee 20 deg more at 0:03"]
    assert say(stand(), bent, one) == [f"straighten the {side} knee by 20 deg at 0:03"]


def squat(degrees: float) -> np.ndarray:
    """Thighs forward and shanks back by half of it each."""
    positions = stand()
    for side in ("left", "right"):
        positions = rotate(positions, f"{side}_hip", LEFT, -degrees / 2)
        positions = rotate(positions, f"{side}_knee", LEFT, degrees)
    return positions


def test_a_squat_goes_deeper():
    one = event("incomplete", LEGS["left"] + LEGS["right"], shortfall_deg=20.0)
    assert say(squat(100.0), face(squat(60.0), -80.0), one) == ["bend both knees 40 deg more at 0:03"]


def test_an_elbow_bends_whichever_way_the_arm_points():
    bent = rotate(stand(), "left_elbow", UP, -50.0)
    one = event(segments=("left_forearm",))
    assert say(bent, stand(), one) == ["bend the left elbow 50 deg more at 0:03"]
    assert say(stand(), bent, one, language="ja") == ["0:03、左ひじをあと50度伸ばしましょう"]


@pytest.mark.parametrize(
    ("axis", "degrees", "says"),
    [
        (LEFT, 30.0, "lean 30 deg further forward"),
        (LEFT, -30.0, "lean 30 deg further back"),
        (FRONT, -30.0, "lean 30 deg further to your left"),
        (FRONT, 30.0, "lean 30 deg further to your right"),
    ],
)
def test_the_trunk_leans(axis, degrees, says):
    theirs = rotate(stand(), "trunk", axis, degrees)
    one = event(segments=("trunk",))
    assert say(theirs, stand(), one) == [f"{says} at 0:03"]
    assert say(stand(), theirs, one) == ["hold the upper body 30 deg more upright at 0:03"]


def test_the_worst_sustained_moment_is_said_not_a_glitch():
    ours = stand()
    late = slice(round(3.6 * RATE), round(4.0 * RATE))
    ours[late] = rotate(stand(), "left_shoulder", FRONT, -30.0)[late]
    glitch = round(3.1 * RATE)
    ours[glitch] = rotate(stand(), "left_shoulder", FRONT, 80.0)[glitch]
    (found,) = advise(judged(stand(), ours, event(segments=ARMS["left"])))
    assert found.time_s == pytest.approx(3.8, abs=0.11)
    assert (found.direction, found.segments, found.event) == ("up", ARMS["left"], 0)
    assert found.amount_deg == pytest.approx(30.0, abs=3.0)


def test_no_direction_where_none_dominates():
    rng = np.random.default_rng(3)
    theirs = rotate(rotate(stand(), "left_shoulder", FRONT, 35.0), "left_shoulder", UP, -45.0)
    ours = theirs.copy()
    for frame in range(len(ours)):
        axis = rng.normal(size=3)
        ours[[frame]] = rotate(ours[[frame]], "left_shoulder", axis / np.linalg.norm(axis), 60.0)
    (found,) = advise(judged(theirs, ours, event(segments=ARMS["left"])))
    assert found.direction is None and found.amount_deg is None
    assert str(found.message) == "at 0:03.8, the left arm did something else: watch the reference there"
    (found,) = advise(judged(theirs, ours, event("incomplete", ARMS["left"], shortfall_deg=24.0)))
    assert str(found.message) == "make the movement of the left arm 25 deg larger at 0:03.8"


@pytest.mark.parametrize(
    ("lag", "segments", "says"),
    [
        (212.0, SEGMENTS, "you were 0.2 s late at 0:03"),
        (-160.0, SEGMENTS, "you were 0.15 s early at 0:03"),
        (200.0, LEGS["left"] + LEGS["right"], "you were 0.2 s late with both legs at 0:03"),
    ],
)
def test_late_and_early(lag, segments, says):
    one = event("shift", segments, lag_ms=lag)
    assert say(stand(), stand(), one) == [says]
    (found,) = describe_advice(advise(judged(stand(), stand(), one)))
    assert (found["direction"], found["lag_ms"], found["amount_deg"]) == ("late" if lag > 0 else "early", lag, None)


BOTH = ARMS["left"] + ARMS["right"]


@pytest.mark.parametrize(
    ("one", "english", "japanese"),
    [
        (("partial", BOTH, "exchanged"), "at 0:03, you exchanged left and right with both arms", "両腕の左右が"),
        (
            ("partial", BOTH, "left_for_right"),
            "you used the left arm instead of the right arm at 0:03",
            "右腕の代わりに左腕を",
        ),
        (("partial", ARMS["left"], "copied"), "at 0:03, the left arm did what the right arm should do", "左腕が右腕の"),
        (("partial", ("trunk",), "compensation"), "keep the upper body still at 0:03", "上体を動かさない"),
        (("shift", ARMS["left"], "late"), "you were late with the left arm at 0:03", "左腕が遅れて"),
        (
            ("global", SEGMENTS, "exchanged"),
            "at 0:03, you exchanged left and right with the whole body",
            "全身の左右が",
        ),
    ],
)
def test_a_cause_has_its_sentence(one, english, japanese):
    kind, segments, cause = one
    found = event(kind, segments, cause=cause)
    assert say(stand(), low_at((3.0, 4.0)), found) == [english]
    assert japanese in say(stand(), low_at((3.0, 4.0)), found, language="ja")[0]


def test_an_even_tempo_of_ones_own_is_told_first():
    slow = {"warnings": (Message("assessment.tempo", tempo=1.1),)}
    late = event("shift", SEGMENTS, lag_ms=400.0, severity=9.0)
    assert say(stand(), stand(), late, **slow) == [
        "you moved 10 % slower than the reference throughout: keep its tempo first"
    ]
    assert len(advise(judged(stand(), stand(), late, **slow), "full")) == 2


def low_at(*spans: tuple[float, float]) -> np.ndarray:
    ours, low = stand(), rotate(stand(), "left_shoulder", FRONT, -25.0)
    for start, end in spans:
        ours[round(start * RATE) : round(end * RATE)] = low[round(start * RATE) : round(end * RATE)]
    return ours


def figures(*labels: str) -> tuple:
    length = SECONDS / len(labels)
    made = make_assessment(seconds=SECONDS).furi[0]
    return tuple(
        dataclasses.replace(
            made, label=label, score=90.0, start_s=k * length, end_s=(k + 1) * length, reference_start_s=k * length,
            reference_end_s=(k + 1) * length,
        )
        for k, label in enumerate(labels)
    )  # fmt: skip


def test_a_fault_that_returns_is_said_once():
    ours = low_at((1.0, 2.0), (5.0, 6.0))
    events = tuple(event(segments=ARMS["left"], start=start, furi=k) for start, k in ((1.0, 0), (5.0, 2)))
    found = say(stand(), ours, *events, furi=figures("A", "B", "A", "C"))
    assert found == ["raise the left arm 25 deg higher every time in figures 1 and 3"]
    found = say(stand(), ours, *events, furi=figures("A", "B", "C", "A"))
    assert found == ["raise the left arm 25 deg higher in figures 1 and 3, first at 0:01"]
    (once,) = advise(judged(stand(), ours, *(dataclasses.replace(one, furi=None) for one in events)))
    assert len(once.times) == 2 and str(once.message) == "raise the left arm 25 deg higher at 0:01.8 and 0:05.8"
    full = advise(judged(stand(), ours, *events, furi=figures("A", "B", "C", "A")), "full")
    assert [one.event for one in full] == [0, 1, None]
    assert str(full[-1].message) == "figures 2 and 4 went well"


def test_the_most_important_three_come_first():
    events = [event("shift", start=float(k), lag_ms=100.0 * (k + 1), severity=1.0 + k) for k in range(2)]
    events += [event("global", start=3.0, severity=5.0), event(segments=ARMS["left"], start=5.0, severity=9.0)]
    events += [event("partial", ("trunk",), start=6.0, severity=1.1)]
    found = advise(judged(stand(), low_at((5.0, 6.0)), *events))
    assert [one.event for one in found] == [3, 2, 1]  # both shifts are one, of 2 + 1
    whole = advise(judged(stand(), low_at((5.0, 6.0)), *events), "full")
    assert sorted(one.event for one in whole) == [0, 1, 2, 3, 4]
    assert [one.importance for one in whole] == sorted((one.importance for one in whole), reverse=True)


def dance() -> np.ndarray:
    """Four seconds of raising the left arm, then four of squatting."""
    arms = np.concatenate([rotate(stand()[:1], "left_shoulder", FRONT, 60 * math.sin(k / 9)) for k in range(120)])
    knees = np.concatenate([squat(50.0 - 50.0 * math.cos(k / 11))[:1] for k in range(120)])
    return np.concatenate([arms, knees])


def test_the_figure_that_was_danced_instead_is_named():
    theirs, ours = dance(), dance()
    ours[30:75] = face(dance()[150:195], 33.0)
    one = event("global", start=1.0, furi=0)
    found = say(theirs, ours, dataclasses.replace(one, end_s=2.5), furi=figures("A", "B"))
    assert found == ["at 0:01 comes figure 1, but what you did looks like figure 2"]
    ours[30:75] = rotate(rotate(stand(), "trunk", LEFT, 80.0), "right_hip", LEFT, -70.0)[30:75]
    found = say(theirs, ours, dataclasses.replace(one, end_s=2.5), furi=figures("A", "B"))
    assert found == ["at 0:01 comes figure 1, but you did something else"]


def test_the_time_of_a_wrong_figure_is_inside_of_it():
    one = event("global", start=12.6, furi=1)  # it begins in the figure before; its worst moment is in figure 2
    (said,) = say(dance(), dance(), dataclasses.replace(one, worst_s=14.2, end_s=15.0), furi=figures("A", "B"))
    assert said.startswith("at 0:14 comes figure 2")


def test_lapses_are_said_too():
    lapses = (Lapse("stop", 2.0, 3.5, 2.0, 2.0), Lapse("lead-in", 0.0, 1.0, 0.0, 0.0))
    assert say(stand(), stand(), lapses=lapses) == ["keep going at 0:02: you stood still for 1.5 s"]


def test_a_turned_dancer_should_turn_back():
    facing = np.zeros(round(SECONDS * RATE))
    facing[90:150] = math.radians(60.0)  # to the own left
    full = advise(judged(stand(), stand(), facing=facing), "full")
    assert str(full[0].message) == "turn 60 deg further to your right at 0:04.0"
    assert full[0].event is None and full[0].about == "facing"


def test_nothing_wrong_and_another_dance():
    for detail in ("brief", "full"):
        (found,) = advise(judged(stand(), stand()), detail)
        assert str(found.message) == "nothing to correct: no error was found"
    unlike = (Message("assessment.unlike", mismatch=0.9),)
    (found,) = advise(judged(stand(), squat(80.0), event("global"), warnings=unlike))
    assert found.message == Message("advice.other_dance")
    assert praise(judged(stand(), stand(), warnings=unlike)) is None
    with pytest.raises(OptionError, match="brief"):
        advise(judged(stand(), stand()), "some")


def test_what_is_not_seen_gives_no_direction():
    low = rotate(stand(), "left_shoulder", FRONT, -25.0)
    made = judged(stand(), low, event(segments=ARMS["left"]))
    unseen = dataclasses.replace(made.performance, seen=np.zeros_like(made.performance.seen))
    (found,) = advise(dataclasses.replace(made, performance=unseen))
    assert found.direction is None
    (found,) = advise(dataclasses.replace(made, same_time=np.full(len(low), np.nan)))
    assert found.direction is None


DANCE = "bandai_dance/dataset-1_dance-short_normal_001.bvh"
ARM, LEG = ("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "toe")
N_TRIALS, HALF_S, FADE_S, AROUND_S, UNTIL_S = 60, 0.7, 0.25, 1.5, 40.0


@pytest.fixture(scope="module")
def real_dance() -> CanonicalMotion:
    path = Path(__file__).resolve().parents[3].parent / "shared" / "data" / DANCE
    if not path.exists():
        pytest.skip(f"{path} is not here")
    return canonicalise(compute_trajectories(read_motion(path)))


def turn(positions: np.ndarray, joint: str, moved: tuple[str, ...], vectors: np.ndarray) -> np.ndarray:
    """Joints turned about another one, by a rotation vector (T, 3) of each frame."""
    side = joint.split("_", maxsplit=1)[0]
    places, root = [J[f"{side}_{name}"] for name in moved], positions[:, [J[joint]]]
    spin = Rotation.from_rotvec(vectors).as_matrix()
    out = positions.copy()
    out[:, places] = np.einsum("tij,tkj->tki", spin, positions[:, places] - root) + root
    return out


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def spoil(
    positions: np.ndarray, what: str, side: str, limb: tuple[str, ...], degrees: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """A limb lowered, or an elbow or knee less bent, by an angle (T,); the wrong segments, and (T,) how the limb was:
    its elevation or bend, degrees."""
    root, middle, end = (f"{side}_{name}" for name in limb[:3])
    names = ("upper_arm", "forearm") if limb == ARM else ("thigh", "shank")
    segments = tuple(f"{side}_{name}" for name in names)
    upper, lower = positions[:, J[middle]] - positions[:, J[root]], positions[:, J[end]] - positions[:, J[middle]]
    if what == "up":
        axis = unit(np.cross((upper + lower) * [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
        before = np.degrees(np.arcsin(unit(upper + lower)[:, 1]))
        vectors = -axis * np.radians(degrees)[:, None]
        return turn(positions, root, limb[1:], vectors), segments, before
    before = np.degrees(np.arccos(np.clip((unit(upper) * unit(lower)).sum(axis=1), -1.0, 1.0)))
    vectors = -unit(np.cross(upper, lower)) * np.radians(degrees)[:, None]
    return turn(positions, middle, limb[2:], vectors), segments[1:], before


def test_the_direction_and_the_amount_are_found_again(real_dance: CanonicalMotion) -> None:
    rng = np.random.default_rng(7)
    performed = simulate_performer(real_dance, rng, noise_deg=3.0)
    reference, rate = compute_postures(real_dance), real_dance.frame_rate
    count = min(performed.n_frames, real_dance.n_frames)
    times = np.arange(count) / rate
    said, errors, tried = 0, [], 0
    while tried < N_TRIALS:
        what, side = rng.choice(["up", "bend"]), rng.choice(["left", "right"])
        limb = ARM if rng.random() < 0.6 else LEG
        middle, amount = (
            rng.uniform(AROUND_S, min(UNTIL_S, real_dance.duration) - AROUND_S - 0.1),
            rng.uniform(20.0, 45.0),
        )
        span = slice(round((middle - AROUND_S) * rate), round((middle + AROUND_S) * rate))
        share = np.clip((HALF_S - np.abs(times[span] - middle)) / FADE_S, 0.0, 1.0)
        ours, segments, before = spoil(performed.positions[span], what, side, limb, amount * share)
        there = before[share > 0.0]
        if np.abs(there).max() > 45.0 if what == "up" else there.min() < amount + 5.0:
            continue  # it would pass the vertical, or bend the wrong way
        tried += 1
        ours = ours @ Rotation.from_rotvec([0.0, rng.uniform(-3.0, 3.0), 0.0]).as_matrix().T
        postures = compute_postures(dataclasses.replace(performed, positions=ours, missing=None))
        dancers = PairedDancers(reference, postures, times[span], span.start / rate)
        pairs = dancers.pair(middle - HALF_S, middle + HALF_S)
        assert pairs is not None
        found = find_corrections(pairs.find_worst([SEGMENTS.index(name) for name in segments]), segments)
        if found and found[0].direction == what:
            said += 1
            errors.append(abs(found[0].amount_deg - amount))
    assert said >= 0.95 * tried
    assert np.mean(errors) < 5.0
