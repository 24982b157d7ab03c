"""Decimal text to float64, equal to Python's ``float()`` to the last bit.

The kernels work on a uint8 view of a file's bytes. Short numbers take Clinger's exact fast path
(W. D. Clinger, "How to read floating point numbers accurately", PLDI 1990), the others the method of
D. Lemire, "Number parsing at a gigabyte per second", Software: Practice and Experience 51 (2021),
algorithm 1. What neither can decide (``nan`` of other spellings, ties beyond 19 digits, plain text) is noted and
settled by Python's ``float()``, which is slow and always right.
"""

from __future__ import annotations

import functools
import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.kernels import is_worth_compiling, kernel, part
from dousa.messages import Message

Bytes = NDArray[np.uint8]

# Status of scan_rows; the position that comes with it is the start of the line (SHORT, LONG) or token (FULL), or a byte
# that no text has (ODD).
DONE, SHORT, LONG, FULL, ODD = range(5)

_SMALLEST_POWER, _LARGEST_POWER = -342, 308
_EXACT_POWERS = np.array([10.0**k for k in range(23)])  # Clinger 1990: up to 10^22 float64 is exact

_ZERO, _ONE, _TEN = np.uint64(0), np.uint64(1), np.uint64(10)
_LOW_HALF, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
# Lemire 2021, algorithm 1.
_PRECISION_MASK = np.uint64(0x1FF)
_HIDDEN_BIT, _ALL_BITS = np.uint64(1 << 52), np.uint64(0xFFFFFFFFFFFFFFFF)
_TOP_BIT = np.uint64(63)  # by the definition of uint64
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|infinity|nan)", re.IGNORECASE)
_WINDOWS_NAN = re.compile(rb"[+-]?(?:1\.#(?:IND|QNAN|SNAN)\w*|nan\([a-z0-9_]*\))", re.IGNORECASE)


@functools.cache
def power_table() -> NDArray[np.uint64]:
    """The 128 leading bits of 5^q for q from -342 to 308, (651, 2): high word, low word."""
    rows = []
    for exponent in range(_SMALLEST_POWER, _LARGEST_POWER + 1):
        power = 5 ** abs(exponent)
        if exponent < 0:
            # Rounded up; for the small powers, where exact ties can happen, at the last of the 128 bits.
            bits = power.bit_length()
            power = (1 << (bits + 127 if exponent >= -27 else 2 * bits + 128)) // power + 1
        excess = power.bit_length() - 128
        power = power >> excess if excess > 0 else power << -excess
        rows.append((power >> 64, power & 0xFFFFFFFFFFFFFFFF))
    table = np.array(rows, dtype=np.uint64)
    table.flags.writeable = False
    return table


@part
def _multiply(a: Any, b: Any) -> Any:
    """High and low word of the 128-bit product of two uint64."""
    a_high, a_low = a >> _HALF, a & _LOW_HALF
    b_high, b_low = b >> _HALF, b & _LOW_HALF
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    other = a_low * b_high + (middle & _LOW_HALF)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF), (other << _HALF) | (low & _LOW_HALF)


@part
def _lemire(digits: Any, exponent: Any, powers: NDArray[np.uint64]) -> Any:  # noqa: PLR0911
    """The float64 nearest to digits * 10^exponent (digits not 0); infinite or -1 where it is not decided."""
    if exponent < _SMALLEST_POWER:
        return 0.0
    if exponent > _LARGEST_POWER:
        return math.inf
    zeros = 0
    while digits >> _TOP_BIT == _ZERO:
        digits = digits << _ONE
        zeros += 1
    row = exponent - _SMALLEST_POWER
    high, low = _multiply(digits, powers[row, 0])
    if high & _PRECISION_MASK == _PRECISION_MASK:
        correction, _ = _multiply(digits, powers[row, 1])
        low = low + correction
        if low < correction:
            high = high + _ONE
    if low == _ALL_BITS and (exponent < -27 or exponent > 55):
        return -1.0
    top = high >> _TOP_BIT
    shift = top + np.uint64(9)
    mantissa = high >> shift
    binary = ((217706 * exponent) >> 16) + 63 + np.int64(top) - zeros + 1023
    if binary <= 0:  # subnormal: fewer bits are kept
        if binary <= -63:
            return 0.0
        mantissa = mantissa >> np.uint64(1 - binary)
        mantissa = (mantissa + (mantissa & _ONE)) >> _ONE
        return math.ldexp(np.float64(np.int64(mantissa)), -1074)
    tie = low <= _ONE and -4 <= exponent <= 23 and mantissa & np.uint64(3) == _ONE
    if tie and mantissa << shift == high:
        mantissa = mantissa & ~_ONE  # exactly half way: to even
    mantissa = (mantissa + (mantissa & _ONE)) >> _ONE
    if binary >= 2047 or (binary == 2046 and mantissa >= _HIDDEN_BIT << _ONE):
        return math.inf
    return math.ldexp(np.float64(np.int64(mantissa)), binary - 1075)


@part
def _digits_19(buffer: Bytes, position: int, end: int) -> Any:
    """The first 19 significant digits of a decimal: (digits, power of ten, is any lost, is there any, position)."""
    digits: Any = _ZERO
    exponent: Any = 0
    count: Any = 0
    start = position
    fraction, lost = False, False
    while position < end:
        digit = np.int64(buffer[position]) - 48
        if digit == -2 and not fraction:  # the point
            fraction = True
        elif digit < 0 or digit > 9:
            break
        elif count < 19:
            digits = digits * _TEN + np.uint64(digit)
            count += digits != _ZERO
            exponent -= fraction
        else:
            lost = lost or digit != 0
            exponent += not fraction
        position += 1
    return digits, exponent, lost, position - start > fraction, position


@part
def _exponent_at(buffer: Bytes, position: int, end: int) -> Any:
    """The exponent after an ``e`` before position: value, position after it (on the ``e`` if there is none)."""
    before = position - 1
    negative = position < end and buffer[position] == 45
    position += position < end and (negative or buffer[position] == 43)
    start = position
    exponent: Any = 0
    while position < end and 48 <= buffer[position] <= 57:
        exponent = min(exponent * 10 + np.int64(buffer[position]) - 48, 1_000_000)
        position += 1
    return (-exponent if negative else exponent), (position if position > start else before)


@part
def _is_nan(buffer: Bytes, start: int, end: int) -> bool:
    """Whether the token, its sign left out, is ``nan`` in any case."""
    return (
        start + 3 <= end
        and (start + 3 == end or buffer[start + 3] <= 32)
        and (buffer[start] | 32) == 110
        and (buffer[start + 1] | 32) == 97
        and (buffer[start + 2] | 32) == 110
    )


@kernel
def _settle_long(buffer: Bytes, end: int, notes: IntArray, out: FloatArray, powers: NDArray[np.uint64]) -> int:
    """Give the noted tokens their values; those that are left for Python move to the front of the notes."""
    left = 0
    for k in range(len(notes)):
        token = notes[k, 0]
        negative = buffer[token] == 45
        first = token + (negative or buffer[token] == 43)
        digits, exponent, lost, settled, position = _digits_19(buffer, first, end)
        if settled and position < end and (buffer[position] | 32) == 101:
            explicit, position = _exponent_at(buffer, position + 1, end)
            exponent += explicit
        value = 0.0
        if position < end and buffer[position] > 32:
            value, settled = math.nan, _is_nan(buffer, first, end)
        elif digits <= _HIDDEN_BIT << _ONE and -22 <= exponent <= 22 and not lost:
            value = np.float64(np.int64(digits))
            value = value * _EXACT_POWERS[exponent] if exponent >= 0 else value / _EXACT_POWERS[-exponent]
        elif digits != _ZERO:
            value = _lemire(digits, exponent, powers)
            settled = settled and 0.0 <= value < math.inf
            if lost:
                settled = settled and value == _lemire(digits + _ONE, exponent, powers)
        if settled:
            out[notes[k, 1]] = -value if negative else value
        else:
            notes[left, 0], notes[left, 1] = token, notes[k, 1]
            left += 1
    return left


@part
def scan_short(buffer: Bytes, position: int) -> tuple[float, int, bool]:
    """Read a plain decimal of at most 18 digits: (value, position after the token, whether it is one).

    White space must follow before the buffer ends: that saves asking for the end at every byte.
    """
    negative = buffer[position] == 45
    position += negative
    start, places = position, 0
    digits: Any = 0
    while 48 <= buffer[position] <= 57:
        digits = digits * 10 + np.int64(buffer[position]) - 48
        position += 1
    if buffer[position] == 46:
        start += 1
        position += 1
        places = position
        while 48 <= buffer[position] <= 57:
            digits = digits * 10 + np.int64(buffer[position]) - 48
            position += 1
        places = position - places
    # 18 digits cannot overflow; below 2^53 and 10^22 both are exact, and one division rounds once.
    short = 0 < position - start <= 18 and digits <= 1 << 53
    while buffer[position] > 32:
        short = False
        position += 1
    value = np.float64(digits) / _EXACT_POWERS[places] if short else 0.0
    return (-value if negative else value), position, short


@kernel
def scan_rows(
    buffer: Bytes, position: int, end: int, columns: int, out: FloatArray, notes: IntArray
) -> tuple[int, int, int, int]:
    """Fill ``out`` with the numbers of ``buffer[position:end]``, one row of ``columns`` numbers a line.

    Blank lines are skipped; blanks are spaces and tabs.
    Tokens that are no short decimals go to ``notes`` (out.size, 2): position, index in out.
    Returns (status, position, numbers read, tokens noted).
    """
    filled, noted, in_row, line = 0, 0, 0, position
    while position < end:
        byte = buffer[position]
        if byte == 10 or byte == 13:  # noqa: PLR1714
            if 0 < in_row < columns:
                return SHORT, line, filled, noted
            in_row = 0
            position += 1
            line = position
        elif byte <= 32:
            if byte != 32 and byte != 9:  # noqa: PLR1714
                return ODD, position, filled, noted
            position += 1
        elif in_row == columns:
            return LONG, line, filled, noted
        elif filled == out.size:
            return FULL, position, filled, noted
        else:
            token = position
            out[filled], position, short = scan_short(buffer, position)
            if not short:
                notes[noted, 0], notes[noted, 1] = token, filled
                noted += 1
            filled += 1
            in_row += 1
    if 0 < in_row < columns:
        return SHORT, line, filled, noted
    return DONE, position, filled, noted


def read_plain_rows(data: bytes, start: int, columns: int, most: int) -> FloatArray | None:
    """Read at most so many rows of numbers without a kernel; None where that is not worth it, or the text is not plain.

    Plain are finite decimals, ``columns`` in each line that is not blank, in all lines from ``start`` on.
    """
    if is_worth_compiling((len(data) - start) // 8):
        return None
    text = data[start:]
    if text.translate(None, b"0123456789+-.eE \t\r\n"):
        return None
    lines = [words for line in text.splitlines() if (words := line.split())]
    if len(lines) > most or any(len(line) != columns for line in lines):
        return None
    try:
        values = np.array([list(map(float, line)) for line in lines]).reshape(-1, columns)
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def scan_numbers(
    data: bytes, start: int, columns: int, rows: int
) -> tuple[FloatArray, int, int, int, tuple[int, Message] | None]:
    """Scan at most so many rows of numbers: values (rows, C), and what `scan_rows` and `settle` say.

    Returns (values, status, position, numbers read, what is no finite number).
    """
    values = np.empty((rows, columns))
    notes = np.empty((rows * columns, 2), np.int64)
    flat = values.reshape(-1)
    status, position, filled, noted = scan_rows(np.frombuffer(data, np.uint8), start, len(data), columns, flat, notes)
    bad = settle(data, notes[:noted], flat)
    if status == ODD and bad is None:
        bad = position, Message("numbers.control", found=f"\\x{data[position]:02x}")
    return values, status, position, filled, bad


def scannable(data: bytes) -> bytes:
    """The bytes, with white space at the end as the kernels need it, and no padding of old programs there."""
    data = data.rstrip(b"\0\x1a") if data[-1:] in (b"\0", b"\x1a") else data
    return data if data[-1:].isspace() else data + b"\n"


def parse_number(token: bytes) -> float | None:
    """The value Python gives a token; None for what is no number (``1_0`` and ``0x1`` are none).

    ``-1.#IND``, ``1.#QNAN`` and ``nan(...)``, which C libraries print, are NaN.
    """
    if _NUMBER.fullmatch(token):
        return float(token)
    if _WINDOWS_NAN.fullmatch(token):
        return math.nan
    return math.inf if token.lower().lstrip(b"+-").startswith(b"1.#inf") else None


def token_at(data: bytes, position: int) -> bytes:
    """The token that starts at a position, up to white space."""
    end = position
    while end < len(data) and data[end] > 32:
        end += 1
    return data[position:end]


def settle(data: bytes, notes: IntArray, out: FloatArray) -> tuple[int, Message] | None:
    """Store the values of the noted tokens; (position, problem) of the first that is no finite number, or None."""
    if len(notes) == 0:
        return None
    flat = out.reshape(-1)
    buffer = np.frombuffer(data, np.uint8)
    left = _settle_long(buffer, len(data), notes, flat, power_table())
    for position, index in notes[:left].tolist():
        token = token_at(data, position)
        value = parse_number(token)
        if value is None or math.isinf(value):
            shown = token[:40].decode("ascii", "backslashreplace")
            return position, Message("numbers.number" if value is None else "numbers.finite", found=shown)
        flat[index] = value
    return None


def line_number(data: bytes, position: int) -> int:
    """1-based line of a byte position; lines end with LF, CR or CRLF."""
    before = data[:position]
    pairs = before.count(b"\r\n")
    return 1 + before.count(b"\n") + before.count(b"\r") - pairs
