"""An assessment whose figures and weights are changed says what a fresh one says."""

import numpy as np
import pytest

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import AdjustableAssessment, Furi, assess
from dousa.motion import canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer

_SECONDS = 14.0


def _dance(performer: int, seed: int):
    import dataclasses

    whole = canonicalise(make_dance(Performer(name="x", seed=performer), seed).motion)
    return dataclasses.replace(whole, positions=whole.positions[: round(_SECONDS * whole.frame_rate)])


@pytest.fixture(scope="module")
def motions():
    return [_dance(1, seed) for seed in range(3)], _dance(7, 9)


@pytest.fixture(scope="module")
def adjustable(motions):
    return AdjustableAssessment(*motions)


def _is_same(one, other):
    assert one.to_json() == other.to_json()
    for name in ("d_space", "d_within", "d_path", "residual", "lag", "matched_time"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


CUTS = (Furi(0, 100, "A"), Furi(100, 230, "B"), Furi(230, 420, "A"))


@pytest.mark.parametrize(("furi", "weights"), [(None, None), (CUTS, {"left_arm": 0.0, "trunk": 2.0})])
def test_it_says_what_a_fresh_assessment_says(motions, adjustable, furi, weights):
    takes, performance = motions
    fresh = assess(takes, performance, furi=furi, weights=weights)
    _is_same(adjustable.assess(furi, weights), fresh)


def test_other_figures_are_exact_at_once(motions, adjustable):
    takes, performance = motions
    adjustable.assess()
    for end in (90, 101, 100):
        cuts = (Furi(0, end, "A"), Furi(end, 230, "B"), Furi(230, 420, "A"))
        quick, is_exact = adjustable.preview(cuts, None)
        assert is_exact
        _is_same(quick, assess(takes, performance, furi=cuts))


def test_other_weights_are_nearly_exact_at_once(adjustable):
    adjustable.assess()
    quick, is_exact = adjustable.preview(None, {"left_arm": 0.25})
    assert not is_exact
    exact = adjustable.assess(None, {"left_arm": 0.25})
    assert quick.score == pytest.approx(exact.score, abs=3.0)
    again, is_exact = adjustable.preview(None, {"left_arm": 0.25})
    assert is_exact
    _is_same(again, exact)


@pytest.mark.slow
def test_what_is_kept_does_not_grow(motions):
    adjustable = AdjustableAssessment(*motions)
    sizes = []
    for step in range(5):
        adjustable.assess(None, {"trunk": 1.0 + step / 10})
        for end in range(60, 160, 3):
            adjustable.preview((Furi(0, end, "A"), Furi(end, 300, "B")))
        sizes.append(adjustable.n_bytes)
    assert sizes[3] == sizes[-1]
    kept = list(adjustable._prepared.values())
    assert len(kept) == 3 and all(len(one.spaces) <= 60 for one in kept)


def test_found_figures_are_those_of_the_take(motions, adjustable):
    found = adjustable.found
    assert found[0].start == 0 and found[-1].end == motions[0][0].n_frames == adjustable.n_frames
    _is_same(adjustable.assess(found), adjustable.assess())


def test_what_cannot_be_is_said(motions, adjustable):
    _, performance = motions
    with pytest.raises(OptionError, match="at least one weight above 0"):
        adjustable.assess(None, dict.fromkeys(("trunk", "left_arm", "right_arm", "left_leg", "right_leg"), 0.0))
    with pytest.raises(OptionError, match="expected frames between 0"):
        adjustable.preview((Furi(0, 10_000, "A"),))
    with pytest.raises(InvalidMotionError, match="at least one reference"):
        AdjustableAssessment([], performance)
