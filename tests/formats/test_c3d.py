"""C3D: every storage, missing points, what is left out, damaged files, round trips, agreement with ezc3d."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.c3d_file import DEC, INTEL, MIPS, group, make_c3d, parameter, random_points

from dousa.errors import MotionFileError, MotionWriteError
from dousa.formats.c3d import read_c3d, write_c3d
from dousa.motion import Motion, Trajectories, canonicalise, forward_kinematics
from dousa.motion.rotations import rotate

LABELS = ["LASI", "RASI", "SACR"]


@pytest.fixture
def saved(tmp_path):
    """Writes bytes to a .c3d file and gives its path."""

    def save(data):
        path = tmp_path / "made.c3d"
        path.write_bytes(data)
        return path

    return save


@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
@pytest.mark.parametrize("scale", [-1.0, 0.5])
@pytest.mark.parametrize("n_analog", [0, 6])
def test_every_storage(saved, processor, scale, n_analog):
    points = random_points()
    missing = np.zeros((5, 3), bool)
    missing[2, 1] = True
    path = saved(make_c3d(points, LABELS, processor=processor, scale=scale, missing=missing, n_analog=n_analog))
    got = read_c3d(path, up="y")
    expected = points * (0.001 if scale < 0 else 0.0005)
    expected[missing] = np.nan
    np.testing.assert_allclose(got.positions, expected, rtol=1e-12)
    assert got.names == tuple(LABELS)
    assert got.frame_rate == 50.0
    assert got.provenance.unit_source == "declared"
    assert got.provenance.up_source == "given"


def test_frame_rate_is_the_number_meant(saved):
    assert read_c3d(saved(make_c3d(random_points(), LABELS, rate=29.97))).frame_rate == 29.97


def test_unit_and_up_axis(saved):
    extra = parameter("X_SCREEN", 1, ["+X"]) + parameter("Y_SCREEN", 1, ["+Z"])
    path = saved(make_c3d(random_points(), LABELS, units="cm", extra=extra))
    got = read_c3d(path)
    x, y, z = np.moveaxis(random_points() * 0.01, -1, 0)
    np.testing.assert_allclose(got.positions, np.stack([x, z, -y], -1))
    assert (got.provenance.up, got.provenance.up_source, got.provenance.unit) == ("z", "declared", 0.01)
    given = read_c3d(path, unit="mm", up="y")
    np.testing.assert_allclose(given.positions, random_points() * 0.001)
    assert (given.provenance.up_source, given.provenance.unit_source) == ("given", "given")


def test_unlabelled_and_computed_points_are_left_out(saved):
    labels = ["LASI", "*12", "LKneeAngles", "LGRF", "", "RASI"]
    extra = parameter("ANGLES", 1, ["LKneeAngles"]) + parameter("FORCES", 1, ["LGRF", "RGRF"])
    got = read_c3d(saved(make_c3d(random_points(4, 6), labels, extra=extra)), up="y")
    assert got.names == ("LASI", "RASI")
    np.testing.assert_allclose(got.positions, random_points(4, 6)[:, [0, 5]] * 0.001)


@pytest.mark.parametrize("labels", [["", "", ""], ["*1", "*2", "*3"]])
def test_points_without_any_label_are_numbered(saved, labels):
    assert read_c3d(saved(make_c3d(random_points(), labels))).names == ("point1", "point2", "point3")


def test_a_parameter_that_occurs_twice_and_one_that_lies_about_analog(saved):
    extra = parameter("RATE", 1, [77.0]) + group("ANALOG", 2) + parameter("RATE", 2, [999.0])
    assert read_c3d(saved(make_c3d(random_points(), LABELS, extra=extra))).frame_rate == 50.0


def test_a_coordinate_that_is_nan_is_missing(saved):
    points = random_points().astype(float)
    points[1, 0, 2] = np.nan
    got = read_c3d(saved(make_c3d(points, LABELS)), up="y")
    assert np.isnan(got.positions[1, 0, 2])
    assert np.isfinite(np.delete(got.positions, 1, axis=0)).all()


def patched(data, place, new):
    return data[:place] + new + data[place + len(new) :]


GOOD = make_c3d(random_points(), LABELS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"HIERARCHY\nROOT", "not a C3D file"),
        (b"\x02P", "truncated"),
        (GOOD[:700], "truncated"),
        (GOOD[:-512], "declares 5 frames, the file holds 0; is it truncated"),
        (patched(GOOD, 0, b"\xff"), "beyond the end"),
        (patched(GOOD, 512 + 3, b"\x07"), "processor"),
        (patched(GOOD, 16, b"\xff\xff"), "truncated"),
        (make_c3d(random_points(0), LABELS), "no frames"),
        (make_c3d(np.zeros((4, 0, 3)), ["a"]), "no points"),
        (make_c3d(random_points(), LABELS, rate=0.0), "frame rate in Hz above 0"),
        (make_c3d(random_points(), LABELS, rate=float("nan")), "frame rate in Hz above 0"),
        (make_c3d(random_points(), LABELS, scale=float("nan")), "POINT:SCALE"),
        (make_c3d(random_points().astype(float) * np.inf, LABELS), "is at inf in frame 1"),
    ],
)
def test_damaged_files_say_what_is_wrong(saved, data, message):
    with pytest.raises(MotionFileError, match=message) as caught:
        read_c3d(saved(data))
    assert "made.c3d" in str(caught.value)


def test_a_parameter_that_claims_too_much(saved):
    place = GOOD.index(b"LABELS") + len("LABELS") + 4  # first axis
    with pytest.raises(MotionFileError, match="POINT:LABELS claims more"):
        read_c3d(saved(patched(GOOD, place, b"\xff\xff")))
    link = GOOD.index(b"LABELS") + len("LABELS")
    with pytest.raises(MotionFileError, match="points outside"):
        read_c3d(saved(patched(GOOD, link, b"\xff\xff")))


def test_a_thousand_million_frames(saved):
    extra = group("TRIAL", 3) + parameter("ACTUAL_START_FIELD", 3, [1, 0])
    extra += parameter("ACTUAL_END_FIELD", 3, [0, 15_258])
    got = read_c3d(saved(make_c3d(random_points(), LABELS, extra=extra, frames=60_000)))
    assert got.n_frames == len(random_points())
    assert got.provenance.notes[0].code == "guard.frame_count"


@pytest.mark.parametrize("cut", [0, 40])
def test_a_file_that_ends_early_is_read_as_far_as_it_goes(saved, cut):
    points = random_points(60)
    data = make_c3d(points, LABELS, frames=60_000)
    got = read_c3d(saved(data[: len(data) - 512 * (cut > 0)]), up="y")
    assert 0 < got.n_frames <= 60
    assert (got.n_frames < 60) == (cut > 0)
    np.testing.assert_allclose(got.positions, points[: got.n_frames] * 0.001, rtol=1e-12)
    assert [note.code for note in got.provenance.notes] == ["guard.frame_count"]


def test_the_size_of_the_file_tells_the_analog_samples(saved):
    """The header holds the number of channels; seven samples of each stand in every frame."""
    points = random_points(60)
    data = bytearray(make_c3d(points, LABELS, n_analog=14))
    data[4:6] = (2).to_bytes(2, "little")
    data[18:20] = (7).to_bytes(2, "little")
    got = read_c3d(saved(bytes(data)), up="y")
    np.testing.assert_allclose(got.positions, points * 0.001, rtol=1e-12)
    assert [note.code for note in got.provenance.notes] == ["c3d.analog_count"]


def test_positions_that_are_all_marked_as_missing_are_used(saved):
    points = random_points()
    got = read_c3d(saved(make_c3d(points, LABELS, missing=np.ones((5, 3), bool))), up="y")
    np.testing.assert_allclose(got.positions, points * 0.001, rtol=1e-12)
    assert [note.code for note in got.provenance.notes] == ["c3d.residuals"]


def test_a_link_in_the_other_byte_order(saved):
    data = make_c3d(random_points(), LABELS, processor=MIPS)
    place = data.index(b"LABELS") + len("LABELS")
    swapped = data[:place] + data[place : place + 2][::-1] + data[place + 2 :]
    assert read_c3d(saved(swapped)).names == tuple(LABELS)


@pytest.mark.parametrize(
    ("name", "frames", "code"),
    [
        ("c3d_org/MotionMonitorC3D.c3d", 840, "c3d.analog_count"),
        ("c3d_org/sgi_int.c3d", 89, None),
        ("c3d_org/sgi_real.c3d", 89, None),
        ("c3d_org/golf.c3d", 137, "c3d.residuals"),
        ("ezc3d_testfiles/Optotrak.c3d", 29, "guard.frame_count"),
    ],
)
def test_files_that_say_wrong_things_of_themselves(foreign, name, frames, code):
    got = read_c3d(foreign(name))
    assert got.n_frames == frames
    assert code is None or code in {note.code for note in got.provenance.notes}
    steps = np.linalg.norm(np.diff(got.positions, axis=0), axis=-1)
    assert np.nanpercentile(steps, 99) < 0.3  # m in a frame: nothing leaps but a swapped marker


def random_trajectories(seed, n_frames, n_points, gaps=0.2):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(n_frames, n_points, 3))
    positions[rng.random((n_frames, n_points)) < gaps] = np.nan
    names = tuple(f"marker {number}" for number in range(n_points))
    return Trajectories(names, positions, 120.0)


def assert_same_to_float32(got, expected):
    assert got.names == expected.names
    assert got.frame_rate == expected.frame_rate
    millimetres = (expected.positions * 1000).astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(got.positions, millimetres * 0.001, rtol=1e-15)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), n_frames=st.integers(1, 20), n_points=st.integers(1, 8))
def test_round_trip(tmp_path_factory, seed, n_frames, n_points):
    path = tmp_path_factory.mktemp("c3d") / "x.c3d"
    moving = random_trajectories(seed, n_frames, n_points)
    write_c3d(moving, path)
    got = read_c3d(path)
    assert_same_to_float32(got, moving)
    assert (got.provenance.unit, got.provenance.up, got.provenance.up_source) == (0.001, "y", "declared")


def test_three_of_four_points_in_one_frame_are_no_picture(tmp_path):
    moving = random_trajectories(0, 1, 4)
    positions = np.random.default_rng(0).normal(size=(1, 4, 3))
    positions[0, 2] = np.nan
    write_c3d(moving.replace(positions=positions), tmp_path / "x.c3d")
    assert np.isfinite(read_c3d(tmp_path / "x.c3d").positions).all(axis=2).sum() == 3


def test_many_points_and_many_frames(tmp_path):
    path = tmp_path / "x.c3d"
    for moving in (random_trajectories(1, 2, 600), random_trajectories(2, 70_001, 1)):
        write_c3d(moving, path)
        assert_same_to_float32(read_c3d(path), moving)


@pytest.mark.parametrize("name", ["", "  ", "*5", "x" * 256, "a\0b"])
def test_names_that_do_not_fit(tmp_path, name):
    with pytest.raises(MotionWriteError, match="point name"):
        write_c3d(Trajectories((name,), np.zeros((1, 1, 3)), 1.0), tmp_path / "x.c3d")


def test_what_does_not_fit(tmp_path):
    path = tmp_path / "x.c3d"
    with pytest.raises(MotionWriteError, match="range"):
        write_c3d(Trajectories(("a", "b"), np.array([[[0, 0, 0], [1e37, 0, 0]]]), 1.0), path)
    many = tuple("x" * 200 + str(number) for number in range(1000))
    with pytest.raises(MotionWriteError, match="do not fit"):
        write_c3d(Trajectories(many, np.zeros((1, 1000, 3)), 1.0), path)
    assert not list(tmp_path.iterdir())


def test_ezc3d_reads_what_we_write(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    moving = random_trajectories(3, 30, 300)
    write_c3d(moving, tmp_path / "x.c3d")
    peer = ezc3d.c3d(str(tmp_path / "x.c3d"))
    points = peer["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(points, (moving.positions * 1000).astype(np.float32).astype(np.float64))
    assert peer["header"]["points"]["frame_rate"] == 120
    labels = peer["parameters"]["POINT"]["LABELS"]["value"] + peer["parameters"]["POINT"]["LABELS2"]["value"]
    assert tuple(labels) == moving.names


def test_real_recordings_agree_with_ezc3d(shared_data):
    ezc3d = pytest.importorskip("ezc3d")
    files = sorted(shared_data("utd_mhad/skeleton").glob("*/*.c3d"))[::20]
    for file in files:
        got = read_c3d(file)
        assert (got.provenance.up, got.provenance.unit, len(got.names)) == ("y", 0.001, 20)
        peer = ezc3d.c3d(str(file))["data"]["points"][:3].transpose(2, 1, 0)
        np.testing.assert_allclose(got.positions, peer * 0.001, rtol=1e-12)


def _theia(foreign):
    return foreign("ezc3d_testfiles/C3DRotationExample.c3d")


def test_segments_of_a_markerless_system_are_a_motion(foreign):
    ezc3d = pytest.importorskip("ezc3d")
    path = _theia(foreign)
    motion = read_c3d(path)
    assert isinstance(motion, Motion)
    theirs = ezc3d.c3d(str(path))
    labels = theirs["parameters"]["ROTATION"]["LABELS"]["value"]
    matrices = theirs["data"]["rotations"]
    places, world = forward_kinematics(motion.skeleton.parents, motion.rotations, motion.translations)
    for joint in ("pelvis", "l_hand", "r_toes"):
        column, row = labels.index(f"{joint}_4X4"), motion.skeleton.names.index(joint)
        seen = np.isfinite(places[:, row]).all(axis=1)  # where all segments up to the pelvis are
        assert seen.mean() > 0.95
        x, y, z = matrices[:3, 3, column][:, seen] / 1000.0
        np.testing.assert_allclose(places[seen, row], np.stack([x, z, -y], axis=1), atol=1e-6)
        x, y, z = matrices[:3, 0, column][:, seen]  # the first axis of the segment, Y up
        first = rotate(world[seen, row], np.array([1.0, 0, 0]))
        np.testing.assert_allclose(first, np.stack([x, z, -y], axis=1), atol=1e-5)
    body = canonicalise(motion)
    assert body.absent == () and body.mapping.sides == "agree"
    assert 1.6 < body.stature < 1.9


@pytest.mark.parametrize("place", ["USED", "LABELS", "DATA_START", "RATE"])
def test_segments_that_are_damaged_are_refused_or_read(foreign, saved, place):
    data = bytearray(_theia(foreign).read_bytes())
    start = data.index(place.encode(), data.index(b"ROTATION"))
    data[start + len(place) : start + len(place) + 8] = b"\xff" * 8
    with contextlib.suppress(MotionFileError):
        assert read_c3d(saved(bytes(data))).n_frames > 0


def test_segments_of_a_file_that_ends_early(foreign, saved):
    whole = read_c3d(_theia(foreign))
    part = read_c3d(saved(_theia(foreign).read_bytes()[:200_000]))
    assert 0 < part.n_frames < whole.n_frames
    with pytest.raises(MotionFileError, match="no points"):
        read_c3d(saved(_theia(foreign).read_bytes()[:2600]))


def test_events_and_other_bytes_of_the_header_do_not_matter(saved):
    noisy = patched(GOOD, 298, struct.pack("<H", 60_000))  # a number of events that has no room
    assert read_c3d(saved(noisy)).n_frames == 5


def test_of_two_scales_the_body_decides(foreign):
    """The parameter of this file makes a person of 0.7 m, the header one of 1.9 m."""
    motion = read_c3d(foreign("c3d_org/MACsample.c3d"))
    assert [note.code for note in motion.provenance.notes] == ["c3d.scale_of_header"]
    assert 1.4 < np.nanmax(motion.positions[..., 1]) < 2
