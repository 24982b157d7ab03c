"""Films begun at known times are synchronised to a fraction of a frame, or refused; offsets go through their file."""

import numpy as np
import pytest
from oracles.made_films import Performance, film, make_cameras

from dousa.errors import CalibrationError, OptionError
from dousa.estimation import PersonTrack, Sound, Synchronisation, ViewKeypoints, read_offsets, sync, write_offsets
from dousa.estimation.calibration.person import guess_lenses
from dousa.estimation.calibration.sightings import choose_points
from dousa.estimation.sync.synchronise import _make_tracks
from dousa.estimation.sync.timing import choose_step, correlate, describe_movement

ACTS = ("punch", "turn_around", "kick_left", "raise_hands", "side_step", "bow")


@pytest.fixture(scope="module")
def performance():
    return Performance(ACTS)


@pytest.mark.slow
def test_films_of_other_rates_and_unsteady_frames_are_within_10_ms(performance):
    cameras = make_cameras(3)
    begins, rates = (1.0, 0.1234, 3.05), (60.0, 25.0, 29.97)
    views = [
        film(performance, camera, begin, 5.0, rate, unsteady=0.3)
        for camera, begin, rate in zip(cameras, begins, rates, strict=True)
    ]
    found = sync(views)
    assert found.offsets[0] == 0.0 and found.basis == ("reference", "movement", "movement")
    np.testing.assert_allclose(found.offsets, np.array(begins) - begins[0], atol=0.010)
    assert (found.spreads[1:] > 0).all() and (found.spreads < 0.05).all()
    assert np.isnan(found.by_sound[1:]).all()


def test_known_cameras_and_the_right_person_of_several(performance):
    cameras = make_cameras(2)
    views = [film(performance, cameras[0], 0.5, 4.0), film(performance, cameras[1], 1.7, 4.0, 25.0)]
    other = film(Performance(ACTS[::-1], seed=5), cameras[1], 0.0, 4.0, 25.0)
    both = ViewKeypoints(views[1].names, (*other.people, *views[1].people), views[1].times, views[1].size, "film2")
    found = sync([views[0], both], cameras=cameras)
    assert found.people == (0, 1)
    assert found.offsets[1] == pytest.approx(1.2, abs=0.010)


def make_tracks(views):
    lenses = guess_lenses(views)
    return [_make_tracks(view, choose_points(view.names), lens)[0] for view, lens in zip(views, lenses, strict=True)]


def test_the_lag_that_agrees_best_is_found_among_all(performance):
    cameras = make_cameras(2)
    views = [film(performance, cameras[0], 4.0, 3.0), film(performance, cameras[1], 1.0, 6.0)]
    tracks = make_tracks(views)
    movements = [describe_movement(track, choose_step(tracks)) for track in tracks]
    agreement = correlate(*movements)
    best, *others = agreement.find(5)
    assert best == pytest.approx(-3.0, abs=2 * choose_step(tracks))
    assert all(agreement.at(other) < agreement.at(best) for other in others)


def test_correlation_at_each_lag_is_that_of_the_overlap(performance):
    cameras = make_cameras(2)
    views = [film(performance, cameras[0], 0.0, 3.0), film(performance, cameras[1], 0.4, 2.0)]
    tracks = make_tracks(views)
    first, second = (describe_movement(track, choose_step(tracks)) for track in tracks)
    found = correlate(first, second)
    for shift in (-20, 0, 13, 40):
        place = int(np.argmin(np.abs(found.lags - shift * first.step)))
        expected = []
        for family in range(3):
            total = np.zeros(3)
            for row in np.flatnonzero(first.families == family):
                a, b = np.arange(first.values.shape[1]), np.arange(second.values.shape[1])
                pairs = [(i, i - shift) for i in a if i - shift in b]
                pairs = [(i, j) for i, j in pairs if first.known[row, i] and second.known[row, j]]
                x = first.values[row, [i for i, _ in pairs]]
                y = second.values[row, [j for _, j in pairs]]
                x, y = x - x.mean(), y - y.mean()
                total += (x @ y, x @ x, y @ y)
            expected.append(total[0] / np.sqrt(total[1] * total[2]))
        assert found.correlations[place] == pytest.approx(np.mean(expected), abs=1e-6)


def test_people_who_do_different_things_are_refused(performance):
    cameras = make_cameras(2)
    other = Performance(("squat", "wave_left", "sit_down", "lunge"), seed=9)
    with pytest.raises(CalibrationError) as caught:
        sync([film(performance, cameras[0], 0.5, 4.0), film(other, cameras[1], 0.5, 4.0)])
    assert caught.value.code in ("sync.no_time", "sync.no_agreement")


def test_nobody_who_moves_and_nobody_at_all(performance):
    cameras = make_cameras(2)
    views = [film(performance, camera, 0.5, 2.0, noise=0.3, wrong=0.0) for camera in cameras]
    points = np.repeat(views[1].people[0].points[:1], views[1].n_frames, axis=0)
    still = ViewKeypoints(
        views[1].names, (PersonTrack(points, np.ones(points.shape[:2])),), views[1].times, views[1].size, "still"
    )
    with pytest.raises(CalibrationError) as caught:
        sync([views[0], still])
    assert caught.value.code == "sync.still" and "still: nobody moves" in str(caught.value)
    empty = ViewKeypoints(views[1].names, (), views[1].times, views[1].size, "empty")
    with pytest.raises(CalibrationError) as caught:
        sync([empty, views[0]])
    assert caught.value.code == "sync.nobody" and "empty" in str(caught.value)
    with pytest.raises(OptionError) as wrong:
        sync(views[:1])
    assert wrong.value.code == "sync.one_film"
    with pytest.raises(OptionError) as wrong:
        sync(views, cameras=cameras[:1])
    assert wrong.value.code == "sync.count"


@pytest.mark.slow
def test_sound_agrees_differs_or_stands_alone(performance):
    cameras = make_cameras(2)
    views = [film(performance, cameras[0], 0.5, 3.5), film(performance, cameras[1], 1.5, 3.5)]
    rng = np.random.default_rng(0)
    sound = rng.normal(0, 0.2, 8000 * 6)
    right = [Sound(sound[4000 : 4000 + 28000]), Sound(sound[12000 : 12000 + 28000])]
    found = sync(views, sounds=right)
    assert found.basis[1] == "both" and not found.warnings
    assert found.by_sound[1] == pytest.approx(1.0, abs=1e-3)
    late = [right[0], Sound(right[1].samples, 0.25)]
    found = sync(views, sounds=late)
    assert found.offsets[1] == pytest.approx(1.0, abs=0.01) and found.basis[1] == "movement"
    assert [note.code for note in found.warnings] == ["sync.disagree"]
    empty = [ViewKeypoints(view.names, (), view.times, view.size, view.source) for view in views]
    found = sync(empty, sounds=right)
    assert found.basis == ("reference", "sound") and [note.code for note in found.warnings] == ["sync.sound_only"]
    assert found.offsets[1] == pytest.approx(1.0, abs=1e-3)


class Exercise(Performance):
    """One movement, again and again."""

    def __init__(self, category):
        super().__init__((category,), wander=0.0)
        self.gap = super().at(np.array([self.seconds]))[0] - super().at(np.zeros(1))[0]

    def at(self, times):
        phase = times % self.seconds
        return super().at(phase) - self.gap * (phase / self.seconds)[:, None, None]


@pytest.mark.slow
def test_where_a_movement_is_repeated_the_time_is_open_and_sound_tells_it():
    exercise, cameras = Exercise("squat"), make_cameras(3)
    begins = np.array([0.5, 1.87, 1.1])
    views = [film(exercise, camera, begin, 8.0) for camera, begin in zip(cameras, begins, strict=True)]
    found = sync(views, cameras=cameras)
    rounds = (found.offsets - (begins - begins[0])) / exercise.seconds
    np.testing.assert_allclose(rounds, np.round(rounds), atol=0.01)
    assert [note.code for note in found.warnings] == ["sync.ambiguous"] * 2
    noise = np.random.default_rng(0).normal(0, 0.2, 8000 * 10)
    sounds = [Sound(noise[int(8000 * begin) : int(8000 * (begin + 8))]) for begin in begins]
    found = sync(views, cameras=cameras, sounds=sounds)
    np.testing.assert_allclose(found.offsets, begins - begins[0], atol=0.01)
    assert found.basis[1:] == ("both", "both") and not found.warnings


FOUND = Synchronisation(
    np.array([0.0, -1.25, 0.0333]),
    np.array([0.0, 0.002, 0.004]),
    ("reference", "movement", "both"),
    (0, 0, 0),
    np.array([0.0, np.nan, 0.03]),
    0.2,
)


def test_offsets_are_read_by_name(tmp_path):
    path = tmp_path / "sync.toml"
    write_offsets(path, ['le"ft', "front", "cam 03"], FOUND)
    assert read_offsets(path, ["cam3", 'le"ft']) == [0.0333, 0.0]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[[film]\n", "sync_file.toml"),
        ("offset = 1\n", "sync_file.no_films"),
        ("[[film]]\noffset = 1\n", "sync_file.no_films"),
        ('[[film]]\nname = "a"\n', "sync_file.offset"),
        ('[[film]]\nname = "a"\noffset = nan\n', "sync_file.offset"),
        ('[[film]]\nname = "a"\noffset = true\n', "sync_file.offset"),
        ('[[film]]\nname = "b"\noffset = 1\n', "camera.none_for_view"),
    ],
)
def test_mistakes_name_the_file(tmp_path, text, code):
    path = tmp_path / "sync.toml"
    path.write_text(text)
    with pytest.raises(CalibrationError) as caught:
        read_offsets(path, ["a"])
    assert caught.value.code == code and str(caught.value).startswith(str(path))


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(CalibrationError, match=r"none\.toml"):
        read_offsets(tmp_path / "none.toml", ["a"])
