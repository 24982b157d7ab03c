"""Repairs of silhouettes: strokes, excluded parts, what is followed through a film; frames that look doubtful."""

import json
from itertools import pairwise

import numpy as np
import pytest

from dousa.errors import SilhouetteError
from dousa.estimation import (
    ExcludedPart,
    MaskStroke,
    PackedSilhouettes,
    RepairedSilhouettes,
    find_part,
    follow_part,
    read_silhouettes,
    write_silhouettes,
)
from dousa.estimation.silhouettes.cleaning import doubt_masks, measure_mask
from dousa.estimation.silhouettes.repairs import repair_from_json

HEIGHT, WIDTH, N_FRAMES = 60, 80, 12


def make_masks() -> np.ndarray:
    """(2, T, H, W): a person who stands, and in the first view a blob that moves by two pixels a frame."""
    masks = np.zeros((2, N_FRAMES, HEIGHT, WIDTH), bool)
    masks[:, :, 10:55, 30:42] = True
    for frame in range(N_FRAMES):
        masks[0, frame, 20:32, 48 + 2 * frame : 56 + 2 * frame] = True
    return masks


@pytest.fixture
def seen() -> PackedSilhouettes:
    return PackedSilhouettes(make_masks(), 30.0)


def test_a_stroke_is_a_round_brush_along_its_points_in_one_frame_of_one_view(seen):
    points = ((5.0, 50.0), (20.0, 50.0))
    repaired = RepairedSilhouettes(seen, [MaskStroke(1, 3, points, 3.0, adds=True)])
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    along = np.clip(columns, 5, 20)
    away = np.hypot(rows - 50.0, columns - along)
    added = repaired.read(3)[1] & ~seen.read(3)[1]
    assert added[away <= 2.5].all() and not added[away >= 4.0].any()
    for view, frame in ((0, 3), (1, 2), (1, 4)):
        np.testing.assert_array_equal(repaired.read(frame)[view], seen.read(frame)[view])


def test_repairs_are_applied_in_their_order_and_leave_the_source_alone(seen):
    before = seen.read(0)[0].copy()
    add = MaskStroke(0, 0, ((10.0, 10.0),), 4.0, adds=True)
    remove = MaskStroke(0, 0, ((10.0, 10.0),), 4.0, adds=False)
    assert RepairedSilhouettes(seen, [remove, add]).read_view(0, 0)[10, 10]
    assert not RepairedSilhouettes(seen, [add, remove]).read_view(0, 0)[10, 10]
    np.testing.assert_array_equal(seen.read(0)[0], before)
    np.testing.assert_array_equal(RepairedSilhouettes(seen, []).read(0)[0], before)


def test_a_part_is_taken_away_in_one_frame(seen):
    part = find_part(seen, 0, 4, (56.0 + 3, 25.0))
    assert part.frames == (4,)
    repaired = RepairedSilhouettes(seen, [part])
    np.testing.assert_array_equal(repaired.read(4)[0], seen.read(4)[1])
    np.testing.assert_array_equal(repaired.read(5)[0], seen.read(5)[0])


def test_a_part_that_moves_is_followed_both_ways(seen):
    done = []
    part = follow_part(seen, 0, 5, (60.0, 25.0), lambda count, total, what: done.append((count, total)))
    assert part.frames == tuple(range(N_FRAMES)) and done[-1] == (N_FRAMES - 1, N_FRAMES - 1)
    repaired = RepairedSilhouettes(seen, [part])
    for frame in range(N_FRAMES):
        np.testing.assert_array_equal(repaired.read(frame)[0], seen.read(frame)[1])


def test_where_a_part_has_grown_together_with_the_person_the_frame_is_left_alone():
    masks = make_masks()
    masks[0, 6, 24:28, 40:62] = True  # a bridge
    seen = PackedSilhouettes(masks, 30.0)
    part = follow_part(seen, 0, 3, (56.0, 25.0))
    assert part.frames == tuple(frame for frame in range(N_FRAMES) if frame != 6)
    assert RepairedSilhouettes(seen, [part]).read(6)[0][10:55, 30:42].all()


def test_a_part_that_is_gone_is_not_looked_for_for_ever():
    masks = np.zeros((1, 60, HEIGHT, WIDTH), bool)
    masks[0, :5, 10:20, 10:20] = masks[0, 40:, 10:20, 10:20] = True
    assert follow_part(PackedSilhouettes(masks, 30.0), 0, 0, (12.0, 12.0)).frames == (0, 1, 2, 3, 4)


@pytest.mark.parametrize(
    ("act", "code"),
    [
        (lambda seen: find_part(seen, 0, 0, (2.0, 2.0)), "mask_repairs.nothing_there"),
        (lambda seen: find_part(seen, 2, 0, (2.0, 2.0)), "mask_repairs.view"),
        (lambda seen: find_part(seen, 0, 99, (2.0, 2.0)), "masks.frame"),
        (lambda seen: MaskStroke(0, 0, (), 3.0, adds=True), "mask_repairs.stroke"),
        (lambda seen: MaskStroke(0, 0, ((float("nan"), 0.0),), 3.0, adds=True), "mask_repairs.stroke"),
        (lambda seen: RepairedSilhouettes(seen, [ExcludedPart(0, {99: (0, 0)})]), "masks.frame"),
        (lambda seen: RepairedSilhouettes(seen, [ExcludedPart(5, {0: (0, 0)})]), "mask_repairs.view"),
        (lambda seen: repair_from_json({"kind": "magic"}), "mask_repairs.unreadable"),
        (lambda seen: repair_from_json({"kind": "exclude", "view": 0}), "mask_repairs.unreadable"),
    ],
)
def test_what_cannot_be_repaired_is_refused(seen, act, code):
    with pytest.raises(SilhouetteError) as caught:
        act(seen)
    assert caught.value.code == code


def test_repairs_come_back_from_json(seen):
    repairs = [MaskStroke(0, 1, ((3.25, 4.5), (6.0, 7.0)), 2.5, adds=False), follow_part(seen, 0, 5, (60.0, 25.0))]
    again = [repair_from_json(json.loads(json.dumps(one.to_json()))) for one in repairs]
    assert again == repairs


def test_repaired_silhouettes_are_written_for_the_command(seen, tmp_path):
    repaired = RepairedSilhouettes(seen, [follow_part(seen, 0, 5, (60.0, 25.0))])
    write_silhouettes(tmp_path / "masks.npz", repaired)
    back = read_silhouettes(tmp_path / "masks.npz")
    for frame in range(N_FRAMES):
        np.testing.assert_array_equal(back.read(frame)[0], seen.read(frame)[1])


def test_doubtful_are_empty_frames_second_parts_and_sudden_sizes():
    masks = make_masks()[1]
    masks[2] = False  # nobody
    masks[5, 20:30, 60:70] = True  # a second part
    masks[8, 30:55] = True  # as wide as the picture
    measured = np.array([measure_mask(mask) for mask in masks])
    assert doubt_masks(*measured.T) == [(2, "empty"), (5, "parts"), (8, "size")]


def test_a_person_who_moves_is_not_doubted_and_no_image_is_no_doubt():
    areas = np.array([500.0 * 1.03**frame for frame in range(40)])
    areas[10] = np.nan
    assert doubt_masks(areas, np.zeros(40)) == []
    assert all(later > earlier for earlier, later in pairwise(areas[11:]))
    assert doubt_masks(np.zeros(5), np.zeros(5)) == []  # a view in which nobody ever is
