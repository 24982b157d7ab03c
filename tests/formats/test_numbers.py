"""The number scanner gives what Python's float() gives, to the last bit."""

import math
import random
import struct

import numpy as np
import pytest

from dousa.formats import numbers
from dousa.formats.numbers import (
    DONE,
    FULL,
    LONG,
    SHORT,
    line_number,
    parse_number,
    read_plain_rows,
    scan_rows,
    scannable,
    settle,
)

CHUNK = 40_000


def scan(tokens, columns=1, room=None, between=b"\n"):
    data = scannable(between.join(tokens))
    out = np.full(len(tokens) if room is None else room, 777.0)
    notes = np.empty((len(out), 2), np.int64)
    status, position, filled, noted = scan_rows(np.frombuffer(data, np.uint8), 0, len(data), columns, out, notes)
    return status, position, filled, out, settle(data, notes[:noted], out)


def assert_equal_to_float(tokens):
    tokens = [token for token in tokens if not math.isinf(float(token))]
    status, _, filled, out, problem = scan(tokens)
    assert (status, filled, problem) == (DONE, len(tokens), None)
    wanted = np.array([float(token) for token in tokens])
    same = (out.view(np.uint64) == wanted.view(np.uint64)) | (np.isnan(out) & np.isnan(wanted))
    wrong = np.flatnonzero(~same)
    assert not len(wrong), [(tokens[i], out[i], wanted[i]) for i in wrong[:5]]


def random_double(rng):
    return struct.unpack("<d", rng.randbytes(8))[0]


@pytest.mark.parametrize(
    "make",
    [
        lambda rng: repr(random_double(rng)),
        lambda rng: f"{rng.uniform(-1000, 1000):.6f}",
        lambda rng: f"{rng.gauss(0, 1):.{rng.randrange(25)}f}",
        lambda rng: f"{random_double(rng):.{rng.randrange(30)}e}",
        lambda rng: f"{rng.randrange(10 ** rng.randrange(1, 40))}e{rng.randrange(-365, 320)}",
        lambda rng: (
            f"{'+-'[rng.randrange(2)]}{'0' * rng.randrange(9)}{rng.randrange(10**6)}"
            f".{rng.randrange(10**9)}E+0{rng.randrange(9)}"
        ),
    ],
    ids=["shortest", "fixed", "digits", "scientific", "long integers", "signs"],
)
def test_random_numbers(make):
    rng = random.Random(7)
    assert_equal_to_float([make(rng).encode() for _ in range(CHUNK)])


def test_numbers_half_way_between_two_floats():
    rng = random.Random(8)
    tokens = []
    for _ in range(5000):
        odd, shift = 2 * rng.randrange(2**52, 2**53) + 1, rng.randrange(1, 60)
        exact = f"{odd * 10**shift // 2**shift:0{shift + 1}d}"  # odd / 2^shift has exactly shift decimals
        exact = f"{exact[:-shift]}.{exact[-shift:]}"
        tokens += [exact.encode(), f"{exact}1".encode(), f"{odd << rng.randrange(9)}".encode()]
    assert_equal_to_float(tokens)


def test_tricky_numbers():
    text = """0 -0 0.0 -0.0e5 +1 1. .5 -.5 +.5e-3 nan NaN -nan +NAN 5e-324 2.4703282292062327e-324
    2.4703282292062328e-324 1.7976931348623157e308 2.2250738585072011e-308 2.2250738585072014e-308 4.9e-324
    9007199254740993 9007199254740992
    9007199254740991.5 1e22 1e23 8.5e-23 1e-400 1e-99999999999999999999 0e99999999999 000000000000000000000000000001.5
    0.000000000000000000000000000000000000001 123456789012345678 1234567890123456789 12345678901234567890
    18446744073709551615 18446744073709551616 9223372036854775808
    0.1000000000000000055511151231257827021181583404541015625"""
    tokens = text.encode().split()
    assert_equal_to_float(tokens)
    assert_equal_to_float(
        [b"0." + b"0" * 400 + b"1", b"0." + b"0" * 300 + b"1234567890123456789012", b"1" + b"0" * 300]
    )
    _, _, _, out, _ = scan([b"-0", b"-0.0", b"-0e0"])
    assert np.signbit(out).all()


@pytest.mark.parametrize(
    "token", [*"1_0 abc . + - e5 1e 1e+ 0x1 1,5 --1 +-1 1.2.3 1-2 1e5.0 na nanx n nan1 1.5f".split(), "１", "1\xa0"]
)
def test_what_is_no_number_is_refused(token):
    with_number = [b"1.5", token.encode(), b"2.5"]
    position, problem = scan(with_number)[4]
    assert position == 4
    assert problem.code == "numbers.number"
    assert parse_number(token.encode()) is None


@pytest.mark.parametrize("token", [b"inf", b"-Infinity", b"1e400", b"1.#INF", b"9" * 400])
def test_infinite_values_are_refused(token):
    assert scan([token])[4][1].code == "numbers.finite"


def test_the_nan_of_c_libraries():
    _, _, _, out, problem = scan([b"-1.#IND", b"1.#QNAN", b"nan(ind)", b"-nan(0x8)"])
    assert problem is None
    assert np.isnan(out).all()


def test_rows():
    assert scan([b"1 2", b"3 4"], columns=2, room=4)[0] == DONE
    assert scan([b"", b" 1\t2 ", b"\t", b"3 4", b""], columns=2, room=4, between=b"\r\n")[0] == DONE
    assert scan([b"1 2", b"3 4"], columns=2, room=4, between=b"\r")[2] == 4
    assert scan([b"1 2", b"3", b"4 5"], columns=2, room=9)[:3] == (SHORT, 4, 3)
    assert scan([b"1 2", b"3"], columns=2, room=9)[:3] == (SHORT, 4, 3)
    assert scan([b"1 2", b"3 4 5"], columns=2, room=9)[:3] == (LONG, 4, 4)
    assert scan([b"1 2", b"3 4"], columns=2, room=2)[:3] == (FULL, 4, 2)


def test_line_numbers_of_all_line_ends():
    data = b"a\r\nb\nc\rd\r\r\n\ne"
    assert [line_number(data, data.index(letter)) for letter in (b"a", b"b", b"c", b"d", b"e")] == [1, 2, 3, 4, 7]


@pytest.mark.parametrize("between", [b"\n", b"\r\n", b"\n\n \t", b"\r"])
def test_plain_rows_are_read_the_same_without_a_kernel(monkeypatch, between):
    monkeypatch.setattr(numbers, "is_worth_compiling", lambda numbers: False)
    rng = random.Random(10)
    rows = [
        [f"{rng.gauss(0, 10.0 ** rng.randrange(-5, 6)):.{rng.randrange(20)}f}" for _ in range(3)] for _ in range(50)
    ]
    data = between.join(" ".join(row).encode() for row in rows)
    got = read_plain_rows(b"MOTION" + between + data, len("MOTION"), 3, 50)
    np.testing.assert_array_equal(got, np.array(rows, dtype=float))
    np.testing.assert_array_equal(got.ravel(), scan(data.split())[3])


@pytest.mark.parametrize(
    "text", [b"1 2\n3", b"1 2\n3 4 5", b"1 nan", b"1 1_0", b"1 1e999", b"1 2e", b"1\x002", b"1 2\n" * 9]
)
def test_what_is_not_plain_is_left_to_the_kernel(monkeypatch, text):
    monkeypatch.setattr(numbers, "is_worth_compiling", lambda numbers: False)
    assert read_plain_rows(text, 0, 2, 8) is None
