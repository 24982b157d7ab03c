"""Assess, and hold every answer to what every answer must keep."""

import json
import math

import pytest

from dousa.evaluation import SEGMENTS, Assessment, assess
from dousa.motion import CanonicalMotion

CURVES = ("lag", "facing", "d_space", "d_within", "d_path", "residual")


def judge(performance: CanonicalMotion, reference: CanonicalMotion, **options: object) -> Assessment:
    """Assess, and hold the answer to what every answer must keep."""
    assessment = assess(reference, performance, **options)  # type: ignore[arg-type]
    check(assessment)
    return assessment


def check(assessment: Assessment) -> None:
    text = json.dumps(assessment.to_json(), allow_nan=False, ensure_ascii=False)
    said = json.loads(text)["score"]
    # There is a grade, or a reason why there is none.
    ungraded = assessment.score_formula.code in ("grade.unlike", "grade.nothing", "grade.hardly", "grade.unseen")
    assert ungraded == (said is None) == math.isnan(assessment.score)
    if not ungraded:
        assert said == pytest.approx(assessment.score, abs=0.051) and 0.0 <= assessment.score <= 100.0
        low, high = assessment.score_interval
        assert 0.0 <= low <= assessment.score <= high <= 100.0
    assert 0.0 <= assessment.coverage <= 1.0
    count = assessment.performance.n_frames
    for name in ("same_time", "matched_time", "d_space_limit", "d_within_limit", *CURVES):
        assert len(getattr(assessment, name)) == count, name
    for event in assessment.events:
        assert event.kind in ("global", "partial", "incomplete", "shift")
        assert 0.0 <= event.start_s < event.end_s <= assessment.performance.duration + 1e-9
        assert event.start_s <= event.worst_s <= event.end_s
        assert event.segments and set(event.segments) <= set(SEGMENTS)
        assert (event.lag_ms is not None) == (event.kind == "shift" and event.cause is None)
        assert event.severity >= 1.0 and event.says
    starts = [event.start_s for event in assessment.events]
    assert starts == sorted(starts)
    assert assessment.path.min(initial=0) >= 0
    if len(assessment.path):
        assert (assessment.path.max(axis=0) < [count, assessment.reference.n_frames]).all()
    assert assessment.score_formula


def kinds(assessment: Assessment) -> list[str]:
    return [event.kind for event in assessment.events]
