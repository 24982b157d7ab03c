"""Background subtraction on made-up scenes whose silhouettes are known."""

import numpy as np
import pytest

from dousa.errors import OptionError, SilhouetteError
from dousa.estimation.silhouettes.background import fill_camouflage, learn_background, subtract_background
from dousa.estimation.silhouettes.cleaning import clean_mask

H, W = 120, 160


def make_scene(seed=0):
    """A textured room (H, W, 3): blocks of colour, so that edges tell things apart."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(60, 220, (H // 20, W // 20, 3))
    return np.kron(blocks, np.ones((20, 20, 1))).astype(np.float32)


def make_clip(scene, places, seed=0, noise=2.0, colour=(60, 90, 190), gain=1.0):
    """Frames (N, H, W, 3) uint8 with a figure at each (row, column), and its masks."""
    rng = np.random.default_rng(seed)
    frames, masks = [], []
    for row, column in places:
        mask = np.zeros((H, W), bool)
        mask[row : row + 70, column : column + 24] = True
        mask[row + 10 : row + 16, column - 6 : column + 28] = True
        frame = scene.copy()
        frame[mask] = colour
        frame = gain * frame + rng.normal(0, noise, frame.shape)
        frames.append(np.clip(frame, 0, 255).astype(np.uint8))
        masks.append(mask)
    return np.stack(frames), np.stack(masks)


WALK = [(30, 20 + 5 * k) for k in range(20)]
SWAY = [(30 + k % 3, 62 + 3 * (k % 6)) for k in range(20)]


def _iou(found, truth):
    return (found & truth).sum() / max((found | truth).sum(), 1)


def _mean_iou(frames, masks, background):
    return np.mean(
        [
            _iou(clean_mask(subtract_background(frame, background)), mask)
            for frame, mask in zip(frames, masks, strict=True)
        ]
    )


@pytest.mark.parametrize("method", ["median", "mog2"])
def test_someone_who_walks_through_needs_no_plate(method):
    frames, masks = make_clip(make_scene(), WALK)
    background = learn_background(frames, method)
    assert _mean_iou(frames, masks, background) > (0.85 if method == "median" else 0.8)


def test_someone_who_stays_needs_one():
    scene = make_scene()
    frames, masks = make_clip(scene, SWAY)
    plate = np.clip(scene * 0.9 + 6, 0, 255).astype(np.uint8)  # another exposure
    assert _mean_iou(frames, masks, learn_background(frames, "median")) < 0.7
    assert _mean_iou(frames, masks, learn_background(frames, "plate", plate)) > 0.85


def test_a_plate_with_somebody_in_it_far_away_does_no_harm():
    scene = make_scene()
    frames, masks = make_clip(scene, SWAY)
    plate = make_clip(scene, [(40, 16)], seed=1, colour=(20, 20, 20))[0][0]
    plate[40:110, 130:150] = (240, 10, 240)
    assert _mean_iou(frames, masks, learn_background(frames, "plate", plate)) > 0.85


def test_a_plate_with_somebody_where_the_person_passes_is_mended():
    scene = make_scene()
    frames, masks = make_clip(scene, WALK)
    plate = make_clip(scene, [(35, 70)], seed=1, colour=(20, 20, 20))[0][0]
    background = learn_background(frames, "plate", plate)
    assert _mean_iou(frames, masks, background) > 0.85
    assert np.abs(background.image - scene).max(axis=2).mean() < 12  # blocks' edges are smoothed


def test_a_plate_that_was_touched_is_moved_back():
    scene = make_scene()
    frames, masks = make_clip(scene, SWAY)
    plate = np.roll(scene, 3, axis=1).astype(np.uint8)
    background = learn_background(frames, "plate", plate)
    assert any("moved onto it" in str(text) for text in background.warnings)
    assert _mean_iou(frames, masks, background) > 0.85


def test_a_plate_of_another_room_is_said():
    frames, _ = make_clip(make_scene(0), SWAY)
    background = learn_background(frames, "plate", make_scene(5).astype(np.uint8))
    assert any("unlike most of the video" in str(text) for text in background.warnings)


def test_nothing_moves_and_the_plate_decides():
    scene = make_scene()
    frames, masks = make_clip(scene, [(30, 70)] * 8)
    background = learn_background(frames, "plate", scene.astype(np.uint8))
    assert any("nothing moves" in str(text) for text in background.warnings)
    assert _mean_iou(frames, masks, background) > 0.85


def test_shadow_is_no_person():
    scene = make_scene()
    frames, masks = make_clip(scene, WALK)
    background = learn_background(frames, "median")
    shaded = frames[5].astype(np.float32)
    shaded[100:115, 20:100] *= 0.75
    shaded = shaded.astype(np.uint8)
    assert _iou(clean_mask(subtract_background(shaded, background)), masks[5]) > 0.85
    assert subtract_background(shaded, background, shadow=0.0)[102:113, 25:95].mean() > 0.85


def test_another_exposure_of_one_frame_is_evened_out():
    frames, masks = make_clip(make_scene(), WALK)
    background = learn_background(frames, "median")
    brighter = np.clip(frames[4] * 1.15, 0, 255).astype(np.uint8)
    assert _iou(clean_mask(subtract_background(brighter, background)), masks[4]) > 0.85


def test_holes_without_an_edge_fill():
    frame = np.full((60, 60, 3), 40, np.uint8)
    mask = np.zeros((60, 60), bool)
    mask[5:55, 10:50] = True
    mask[20:28, 20:28] = False  # dark clothes before something dark
    mask[40:48, 30:38] = False  # seen through
    frame[40:48, 30:38] = 200
    fill_camouflage(mask, frame)
    assert mask[20:28, 20:28].all() and not mask[40:48, 30:38].any()


def test_what_no_background_can_be_learnt_from():
    frames, _ = make_clip(make_scene(), WALK[:3])
    with pytest.raises(OptionError, match="expected the background method"):
        learn_background(frames, "magic")
    with pytest.raises(OptionError, match="needs an image"):
        learn_background(frames, "plate")
    with pytest.raises(SilhouetteError, match="at least 2"):
        learn_background(frames[:1])
    with pytest.raises(SilhouetteError, match="shape"):
        learn_background(frames, "plate", np.zeros((5, 5, 3), np.uint8))
    flat = np.zeros((4, 30, 40, 3), np.uint8)
    for method in ("median", "mog2", "plate"):  # nothing to see is no reason to fail
        assert not subtract_background(flat[0], learn_background(flat, method, flat[0])).any()
