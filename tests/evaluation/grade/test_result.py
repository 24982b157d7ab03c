"""An assessment as JSON: strict, rounded, null where there is no value."""

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.wrong_dances import get_dance, place

import dousa.evaluation
from dousa.evaluation import (
    SEGMENTS,
    Assessment,
    ErrorEvent,
    FuriAssessment,
    Lapse,
    PostureSequence,
    describe_assessment,
)
from dousa.evaluation.grade.result import describe_offset
from dousa.evaluation.posture.posture import thin_postures
from dousa.evaluation.posture.yaw import estimate_offset
from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX as J


@pytest.fixture
def assessment() -> Assessment:
    n = 40
    postures = PostureSequence(np.zeros((n, 9, 3)), np.ones((n, 9), bool), np.zeros((n, 20, 3)), 30.0)
    line = np.arange(n) / 30
    lag = np.full(n, np.nan)
    lag[10:20] = np.linspace(-0.05, 0.2, 10)
    space = SimpleNamespace(n_dims=7, contribution=0.99123456)
    gain = np.full(9, np.nan)
    gain[2] = 0.62049
    return Assessment(
        frame_rate=30.0, reference=postures, performance=postures, same_time=line, matched_time=line, lag=lag,
        facing=np.radians(np.r_[np.nan, np.linspace(-20, 10, n - 1)]),
        d_space=line, d_within=line, d_path=line, d_space_limit=line, d_within_limit=line,
        residual=np.zeros((n, 9)), residual_limit=np.zeros(9), path=np.zeros((n, 2), int),
        furi=(
            FuriAssessment(0.0, 0.70004, 0.1, 0.8, "A", space, gain, 0.18, 81.234),
            FuriAssessment(math.nan, math.nan, 0.8, 1.3, "B", space, gain, math.nan, math.nan),
        ),
        events=(
            ErrorEvent("incomplete", 0.2, 0.5, ("right_forearm",), None, 24.04, 38.4, 1.504, 0.3, 0.31, 0),
            ErrorEvent("shift", 0.6, 0.9, SEGMENTS, 180.0, None, math.nan, 2.0, 0.7, 0.52, None),
        ),
        lapses=(Lapse("early end", 1.0, 1.0, 1.2, 1.3),),
        score=81.26, score_formula=Message("text.verbatim", text="100 - 19"),
        calibrated=np.bool_(True), n_references=5, tempo=1.0,
        gaps=((0.1, 0.2, "trunk"),), warnings=(Message("text.verbatim", text="note"),),
    )  # fmt: skip


def test_the_keys_that_are_promised(assessment):
    answer = json.loads(json.dumps(assessment.to_json(), allow_nan=False))
    assert answer == describe_assessment(assessment)
    assert answer["score"] == 81.3 and answer["calibrated"] is True and answer["frame_rate"] == 30.0
    assert answer["lag_ms"] == {"median": 75.0, "mean_abs": 89.4, "max": 200.0, "min": -50.0}
    first, lost = answer["furi"]
    assert (first["start_s"], first["end_s"], first["n_dims"], first["contribution"]) == (0.0, 0.7, 7, 0.9912)
    assert lost["start_s"] is lost["end_s"] is lost["lag_ms"] is lost["score"] is None
    assert lost["reference_start_s"] == 0.8
    assert first["gain"] == {name: 0.62 if name == "left_forearm" else None for name in SEGMENTS}
    short, late = answer["events"]
    kept = "kind start_s end_s segments lag_ms shortfall_deg shortfall_percent severity says"
    assert list(short)[:9] == kept.split()
    assert (short["shortfall_deg"], short["shortfall_percent"], short["lag_ms"]) == (24.0, 38.4, None)
    assert late["lag_ms"] == 180.0 and late["shortfall_percent"] is None and late["segments"] == list(SEGMENTS)
    assert short["says"] == "0:00.2, right forearm: 24 deg short, reaches 62 % of the range (figure 1)"
    assert late["says"] == "0:00.6, whole body: 180 ms late"
    assert answer["lapses"][0]["says"] == "0:01.0, ends early: the last 0.1 s of the reference are missing"
    japanese = assessment.to_json("ja")["events"][1]
    assert (japanese["kind"], japanese["says"]) == ("shift", "0:00.6 全身：180ミリ秒遅れています")
    assert answer["facing_deg"] == {"median": pytest.approx(7.9, abs=0.5), "max": 20.0}
    assert answer["lapses"][0]["kind"] == "early end" and answer["gaps"][0]["segment"] == "trunk"
    assert answer["warnings"] == ["note"] and answer["warning_codes"] == ["text.verbatim"]
    assert answer["score_formula"] == "100 - 19" and answer["n_references"] == 5


def test_nothing_in_common_gives_nulls(assessment):
    nothing = np.full(40, np.nan)
    lost = dataclasses.replace(
        assessment, lag=nothing, facing=nothing, score=math.nan, tempo=math.nan, furi=(), events=()
    )
    answer = json.loads(json.dumps(lost.to_json(), allow_nan=False))
    assert set(answer["lag_ms"].values()) == {None} == set(answer["facing_deg"].values())
    assert answer["score"] is None and answer["tempo"] is None


def test_there_is_no_negative_zero(assessment):
    still = dataclasses.replace(assessment, lag=np.full(40, -1e-9), score=-0.001)
    assert "-0.0" not in json.dumps(still.to_json()["lag_ms"]) + json.dumps(still.to_json()["score"])


def test_every_public_name_of_the_package_can_be_loaded():
    for name in dousa.evaluation.__all__:
        assert getattr(dousa.evaluation, name) is not None
    with pytest.raises(AttributeError):
        dousa.evaluation.no_such_name  # noqa: B018


def hold_arm(motion, towards):
    """The left arm held still towards (3,) left, up and front of the body at each frame."""
    positions = motion.positions.copy()
    left = (positions[:, J["left_hip"]] - positions[:, J["right_hip"]]) * (1.0, 0.0, 1.0)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])
    way = towards[0] * left + towards[1] * up + towards[2] * np.cross(left, up)
    for reach, joint in zip((0.3, 0.55, 0.6), ("elbow", "wrist", "hand"), strict=True):
        positions[:, J[f"left_{joint}"]] = positions[:, J["left_shoulder"]] + reach * way / np.linalg.norm(towards)
    return dataclasses.replace(motion, positions=positions)


@pytest.mark.parametrize("facing", [0.0, 1.2, 3.0])
@pytest.mark.parametrize(
    ("towards", "way"),
    [((0.5, -1.0, 0.8), "forward"), ((0.5, -1.0, 0.2), "back"), ((0.8, -1.0, 0.5), "out"), ((0.2, -1.0, 0.5), "in")],
)
def test_another_body_is_said_in_its_own_directions(facing, towards, way):
    dance = place(get_dance(), facing, 0.0, 0.0, 1.0)
    reference, performance = (
        thin_postures(dousa.evaluation.compute_postures(hold_arm(dance, arm))) for arm in ((0.5, -1.0, 0.5), towards)
    )
    pairs = np.repeat(np.arange(reference.n_frames)[:, None], 2, axis=1)
    said = describe_offset(estimate_offset(reference, performance, pairs), reference)
    assert [(one.values["who"][0].code, one.values["way"].code) for one in said] == [
        ("body_segments.left_arm", f"offset_ways.{way}")
    ]
