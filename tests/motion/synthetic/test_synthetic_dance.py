"""The synthetic dance: the same seeds give the same dance, figures come again, nothing jumps."""

import numpy as np
import pytest

from dousa.errors import OptionError
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories
from dousa.motion.synthetic.dance import CHOREOGRAPHY, make_dance
from dousa.motion.synthetic.performers import Performer, draw_performer

PEOPLE = (Performer(), draw_performer(3), draw_performer(8))


def directions(motion):
    """Unit vectors (T, 19, 3) from each joint's parent to the joint, whatever the size of the body."""
    points = canonicalise(motion)
    trajectories = points.to_trajectories()
    children = np.flatnonzero(trajectories.parents >= 0)
    bones = points.positions[:, children] - points.positions[:, trajectories.parents[children]]
    return bones / np.linalg.norm(bones, axis=2, keepdims=True)


def test_the_same_seeds_give_the_same_dance():
    first, second = (make_dance(draw_performer(3), seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.motion.rotations, second.motion.rotations)
    np.testing.assert_array_equal(first.motion.translations, second.motion.translations)
    for other in (make_dance(draw_performer(3), seed=2), make_dance(draw_performer(4), seed=1)):
        assert other.motion.n_frames == first.motion.n_frames  # all keep the tempo of the music
        assert not np.array_equal(other.motion.rotations, first.motion.rotations)


@pytest.mark.parametrize("frame_rate", [30.0, 120.0, 23.976])
def test_figures_follow_one_another(frame_rate):
    dance = make_dance(Performer(), frame_rate=frame_rate)
    assert 25 < dance.motion.duration < 40
    assert tuple(figure.name for figure in dance.figures) == CHOREOGRAPHY
    for before, after in zip(dance.figures, dance.figures[1:], strict=False):
        assert before.end == after.start
    assert dance.figures[0].start > 0 and dance.figures[-1].end < dance.motion.n_frames


def test_a_figure_that_comes_again_is_alike_and_others_are_not():
    dance = make_dance(Performer(), seed=3)
    bones = directions(dance.motion)
    # Heading differs by a turn that is not quite whole, so only what points up is compared.
    rises = [bones[figure.start : figure.end, :, 1] for figure in dance.figures]
    for one in range(len(rises)):
        for two in range(one):
            difference = np.sqrt(np.mean((rises[one] - rises[two]) ** 2))
            alike = dance.figures[one].name == dance.figures[two].name
            assert difference < 0.08 if alike else difference > 0.12, (one, two)


@pytest.mark.parametrize("performer", PEOPLE, ids=lambda performer: performer.name)
def test_it_is_a_body_that_dances(performer):
    dance = make_dance(performer)
    moved = compute_trajectories(dance.motion)
    assert np.isfinite(moved.positions).all()
    speed = np.linalg.norm(np.diff(moved.positions, axis=0), axis=2) * moved.frame_rate
    assert speed.max() < 12  # m/s: nothing jumps where figures are joined
    change = np.linalg.norm(np.diff(moved.positions, 2, axis=0), axis=2) * moved.frame_rate**2
    assert change.max() < 250  # m/s2
    tips = [f"{side}_{name}" for side in ("left", "right") for name in ("ankle", "toe", "toe_end")]
    lowest = moved.select(tips)[..., 1].min(axis=1)
    assert lowest.min() > -0.005 and lowest.max() < 0.06
    assert np.ptp(moved.positions[:, 0, [0, 2]], axis=0).max() < 5  # stays on a stage
    heading = moved.select(["left_hip"])[:, 0] - moved.select(["right_hip"])[:, 0]
    assert heading[-1] @ heading[0] > 0  # one whole turn


def test_it_can_be_written_and_read(tmp_path):
    dance = make_dance(draw_performer(2))
    write_motion(dance.motion, tmp_path / "dance.bvh")
    back = canonicalise(read_motion(tmp_path / "dance.bvh"))
    there = compute_trajectories(dance.motion).select(CANONICAL_JOINTS)
    assert np.abs(back.positions - there).max() < 1e-3


@pytest.mark.parametrize("change", [{"seed": -1}, {"frame_rate": 0}, {"frame_rate": float("nan")}, {"frame_rate": 1e6}])
def test_bad_numbers_are_refused(change):
    with pytest.raises(OptionError):
        make_dance(Performer(), **change)
