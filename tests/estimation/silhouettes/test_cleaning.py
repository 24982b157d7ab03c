"""Cleaning of masks: what goes, what stays, and who the person is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dousa.errors import OptionError
from dousa.estimation.silhouettes.cleaning import clean_mask, is_nearly_full
from dousa.estimation.silhouettes.mask_npz import read_silhouettes


def _person(height=120, width=90, left=30, top=20):
    mask = np.zeros((height, width), bool)
    mask[top : top + 80, left : left + 20] = True
    return mask


def test_specks_go_and_the_person_stays():
    person = _person()
    noisy = person.copy()
    for row, column in ((5, 5), (60, 85), (110, 10)):
        noisy[row : row + 2, column : column + 2] = True
    np.testing.assert_array_equal(clean_mask(noisy), person)


def test_small_holes_fill_and_large_ones_are_seen_through():
    person = _person()
    holed = person.copy()
    holed[40:42, 38:40] = False
    holed[70:80, 36:44] = False
    cleaned = clean_mask(holed)
    assert cleaned[40:42, 38:40].all() and not cleaned[70:80, 36:44].any()
    np.testing.assert_array_equal(clean_mask(holed, hole_share=0.0), holed)


@pytest.mark.parametrize("gap", [1, 2, 3])
def test_a_thin_hand_behind_a_gap_stays(gap):
    mask = _person()
    mask[50:53, 50 + gap : 58 + gap] = True
    np.testing.assert_array_equal(clean_mask(mask), mask)


def test_a_chain_of_pieces_stays():
    mask = _person()
    for start in (52, 62, 72):
        mask[50:53, start : start + 8] = True
    np.testing.assert_array_equal(clean_mask(mask), mask)


def test_somebody_else_goes():
    mask = _person()
    mask[25:95, 70:86] = True
    np.testing.assert_array_equal(clean_mask(mask), _person())


def test_the_person_is_who_it_was():
    small, large = _person(left=10), np.zeros((120, 90), bool)
    large[10:110, 60:85] = True
    both = small | large
    np.testing.assert_array_equal(clean_mask(both), large)
    np.testing.assert_array_equal(clean_mask(both, previous=small), small)
    jumped = _person(left=8)  # no overlap, but nearest
    jumped[:, 10:] = False
    np.testing.assert_array_equal(clean_mask(both, previous=jumped), small)


def test_a_person_cut_in_two_by_a_belt_stays_whole():
    mask = _person()
    mask[55:62] = False
    np.testing.assert_array_equal(clean_mask(mask), mask)
    mask[45:70] = False  # a wide gap needs the last frame
    assert clean_mask(mask).sum() < mask.sum()
    np.testing.assert_array_equal(clean_mask(mask, previous=_person()), mask)


def test_empty_and_full_masks():
    empty, full = np.zeros((20, 30), bool), np.ones((20, 30), bool)
    assert not clean_mask(empty).any() and clean_mask(full).all()
    assert not clean_mask(empty, previous=full).any()
    assert is_nearly_full(full) and not is_nearly_full(empty)


@pytest.mark.parametrize("name", ["speck_share", "hole_share", "reach", "limb_reach", "limb_share"])
def test_options_out_of_range(name):
    with pytest.raises(OptionError, match=name):
        clean_mask(_person(), **{name: -0.1})


@given(arrays(bool, st.tuples(st.integers(1, 30), st.integers(1, 30))))
@settings(max_examples=150, deadline=None)
def test_any_mask_is_cleaned(mask):
    before = mask.copy()
    cleaned = clean_mask(mask)
    np.testing.assert_array_equal(mask, before)
    assert cleaned.shape == mask.shape and cleaned.dtype == bool
    assert cleaned.any() == mask.any()
    assert not (clean_mask(mask, hole_share=0.0) & ~mask).any()  # without filling nothing is added


def test_noisy_silhouettes_come_nearer_to_the_clean_ones(shared_data):
    noisy = read_silhouettes(shared_data("silhouette_bench/bd_jog_noisy.npz"))
    clean = read_silhouettes(shared_data("silhouette_bench/bd_jog_clean.npz"))
    before, after = [], []
    for frame in range(0, noisy.n_frames, 6):
        for mask, truth in zip(noisy.read(frame), clean.read(frame), strict=True):
            better = clean_mask(mask)
            before.append((mask & truth).sum() / (mask | truth).sum())
            after.append((better & truth).sum() / (better | truth).sum())
    assert np.mean(after) > np.mean(before) + 0.01
