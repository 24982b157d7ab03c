"""TRC: header variants, missing cells, damaged files, round trips, real files."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dousa.errors import MotionFileError, MotionWriteError
from dousa.formats.guard.place import is_flat
from dousa.formats.tables.trc import read_trc, write_trc
from dousa.motion import Trajectories

HEADER = (
    "PathFileType\t4\t(X/Y/Z)\tmade.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100.00\t100.00\t2\t2\tmm\t100.00\t1\t2\n"
    "Frame#\tTime\tLASI\t\t\tRASI\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = "1\t0.000\t1000\t2000\t3000\t-1\t-2\t-3\n2\t0.010\t1001\t2001\t3001\t4\t5\t6e0\n"
EXPECTED = np.array([[[1000, 2000, 3000], [-1, -2, -3]], [[1001, 2001, 3001], [4, 5, 6]]])


@pytest.fixture
def saved(tmp_path):
    def save(text, encoding="utf-8"):
        path = tmp_path / "made.trc"
        path.write_bytes(text.encode(encoding))
        return path

    return save


@pytest.mark.parametrize(
    "text",
    [
        HEADER + ROWS,
        HEADER + "\n" + ROWS,
        HEADER + ROWS.removesuffix("\n"),
        (HEADER + "\n" + ROWS).replace("\n", "\r\n"),
        (HEADER + ROWS).replace("\n", "\r"),
        (HEADER + ROWS).replace("\n", "\t\n"),
        HEADER + ROWS.replace("\n", "\t\t\t\n") + "\n\n",
        "\ufeff" + HEADER + ROWS,
        HEADER.replace("\t2\t2\tmm", "\t900\t7\tmm") + ROWS,
        HEADER.replace("\t2\t2\tmm", "\t1\t1\tmm") + ROWS,
        HEADER.replace("LASI\t\t\tRASI\t\t", "LASI\tRASI") + ROWS,
        HEADER.replace("LASI\t\t\tRASI\t\t", "LASI\t\t\tRASI\t\t\t") + ROWS,
        HEADER.replace("\t\tX1", "X1") + ROWS,
        HEADER + ROWS.replace("2000", " 2000 ").replace("-3", "-3. "),
        HEADER.replace("100\t100", "100,0\t100,0") + ROWS.replace(".", ",").replace("6e0", "0,6e1"),
    ],
)
def test_every_variant_gives_the_same(saved, text):
    got = read_trc(saved(text), up="y")
    assert got.names == ("LASI", "RASI")
    assert got.frame_rate == 100
    np.testing.assert_allclose(got.positions, EXPECTED * 0.001)
    np.testing.assert_array_equal(got.provenance.values, EXPECTED)


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("inches", 0.0254), ("Meters", 1), ("furlongs", None)]
)
def test_units(saved, unit, metres):
    got = read_trc(saved(HEADER.replace("mm", unit) + ROWS), up="y")
    if metres is None:
        assert got.provenance.unit_source in ("inferred", "assumed")
    else:
        assert (got.provenance.unit, got.provenance.unit_source) == (metres, "declared")
        np.testing.assert_allclose(got.positions, EXPECTED * metres)


@pytest.mark.parametrize("gap", ["\t\t\t", " \t \t ", "nan\tNaN\tNAN", "\t2\t3"])
def test_missing_cells(saved, gap):
    got = read_trc(saved(HEADER + ROWS.replace("1000\t2000\t3000", gap.removesuffix("\t"))), up="y")
    assert np.isnan(got.positions[0, 0, 0])
    np.testing.assert_allclose(got.positions[:, 1], EXPECTED[:, 1] * 0.001)


def test_a_nameless_marker_gets_a_number(saved):
    got = read_trc(saved(HEADER.replace("\tLASI\t", "\t\t") + ROWS))
    assert got.names == ("point1", "RASI")


@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ("nothing here\n", "DataRate", None),
        (HEADER.replace("100.00\t100", "0\t100") + ROWS.replace("0.010", "0"), "above 0", None),
        (HEADER.replace("100.00\t100", "nan\t100") + ROWS.replace("0.010", "0"), "above 0", None),
        (HEADER.replace("Frame#", "Bild") + ROWS, "Frame#", None),
        (HEADER.replace("LASI\t\t\tRASI", "") + ROWS, "marker names", 4),
        (HEADER, "at least one row", None),
        (HEADER + ROWS.replace("\t6e0", ""), "expected 8 cells", 7),
        (HEADER + ROWS.replace("6e0", "6\t7"), "expected 8 cells", 7),
        (HEADER + ROWS.replace("6e0", "six"), "'six'", 7),
        (HEADER + "\n" + ROWS.replace("2000", "2,5"), "expected a number, got '2,5'", 7),
        (HEADER + ROWS.replace("6e0", "inf"), "'RASI' is at inf in frame", None),
        (HEADER + ROWS.replace("6e0", "1e999"), "in frame", None),
    ],
)
def test_damaged_files_say_what_and_where(saved, text, message, line):
    with pytest.raises(MotionFileError, match=message) as caught:
        read_trc(saved(text))
    if line is not None:
        assert caught.value.line == line


@pytest.mark.parametrize("end", [ROWS.removesuffix("\n"), ROWS[:56]])
def test_a_row_that_breaks_off_is_left_out(saved, end):
    got = read_trc(saved(HEADER.replace("\t2\t2\tmm", "\t1000000000\t2\tmm") + end), up="y")
    assert got.n_frames == 1
    assert [note.code for note in got.provenance.notes] == ["guard.frame_count"]


def test_doubled_tabs_in_the_header(saved):
    """The values of the header are then in every other column, and the number of frames stood where the unit is."""
    first, keys, values, rest = HEADER.split("\n", 3)
    got = read_trc(saved("\n".join((first, keys, values.replace("\t", "\t\t"), rest)) + ROWS), up="y")
    assert (got.provenance.unit, got.provenance.unit_source) == (0.001, "declared")
    np.testing.assert_allclose(got.positions[:, 1], EXPECTED[:, 1] * 0.001)


@pytest.mark.parametrize("mark", [",", ";"])
def test_other_separators(saved, mark):
    got = read_trc(saved((HEADER + ROWS).replace("\t", mark)), up="y")
    assert got.names == ("LASI", "RASI")
    np.testing.assert_allclose(got.positions[:, 1], EXPECTED[:, 1] * 0.001)


@pytest.mark.parametrize(
    "name", ["opensim/motion_capture_walk.trc", "opensim/static_walk_2.trc", "addbiomechanics/walk__markers.trc"]
)
def test_people_are_as_tall_as_people(foreign, name):
    got = read_trc(foreign(name))
    assert got.provenance.unit == 0.001
    assert 1.2 < np.nanmedian(np.nanmax(got.positions[..., 1], axis=1)) < 2.2


def test_latin_bytes_in_a_name(saved):
    assert len(read_trc(saved(HEADER.replace("LASI", "Hüfte") + ROWS, "latin-1")).names) == 2


finite = st.floats(-1e6, 1e6) | st.just(float("nan"))


@settings(max_examples=60, deadline=None)
@given(
    values=st.integers(1, 4).flatmap(
        lambda k: st.lists(st.lists(finite, min_size=3 * k, max_size=3 * k), min_size=1, max_size=5)
    ),
    rate=st.floats(1, 1000),
)
def test_round_trip_is_exact(tmp_path_factory, values, rate):
    positions = np.array(values).reshape(len(values), -1, 3)
    assume(not is_flat(positions))
    names = tuple(f"m{number}" for number in range(positions.shape[1]))
    path = tmp_path_factory.mktemp("trc") / "x.trc"
    write_trc(Trajectories(names, positions, rate), path)
    got = read_trc(path, up="y")
    np.testing.assert_array_equal(got.provenance.values, positions)
    assert (got.names, got.frame_rate) == (names, rate)


def test_an_unchanged_file_keeps_its_unit_and_digits(saved, tmp_path):
    source = read_trc(saved(HEADER + ROWS), up="z")
    write_trc(source, tmp_path / "again.trc")
    again = read_trc(tmp_path / "again.trc", up="z")
    np.testing.assert_array_equal(again.provenance.values, EXPECTED)
    np.testing.assert_array_equal(again.positions, source.positions)
    assert again.provenance.unit == 0.001


def test_a_changed_one_is_written_in_metres(saved, tmp_path):
    source = read_trc(saved(HEADER + ROWS), up="y")
    write_trc(source.replace(positions=source.positions * 2), tmp_path / "twice.trc")
    again = read_trc(tmp_path / "twice.trc", up="y")
    np.testing.assert_array_equal(again.positions, source.positions * 2)
    assert again.provenance.unit == 1.0


@pytest.mark.parametrize("name", ["", " ", "a\tb", "a\nb"])
def test_names_that_do_not_fit(tmp_path, name):
    with pytest.raises(MotionWriteError, match="marker name"):
        write_trc(Trajectories((name,), np.zeros((1, 1, 3)), 1.0), tmp_path / "x.trc")


def test_real_files(shared_data, tmp_path):
    for name, frames in (("Balancing_for_IK.trc", 100), ("Standing_for_Scaling.trc", 25)):
        got = read_trc(shared_data(f"pose2sim/{name}"))
        assert (got.n_frames, len(got.names), got.frame_rate) == (frames, 21, 60)
        assert (got.provenance.unit, got.provenance.up) == (1.0, "y")
        write_trc(got, tmp_path / name)
        np.testing.assert_array_equal(read_trc(tmp_path / name).positions, got.positions)
