"""Time: declared rate, time column, frame numbers and declared number of frames of a file, and one answer of them.

A reader hands over what its file says in a `Clock` and decides nothing. Gaps become missing frames, repeated rows are
dropped, exchanged ones sorted. Times that contradict the declared rate win, as in OpenSim. Each correction is a note.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import MotionFileError
from dousa.messages import Message

_LOWEST, _HIGHEST = 1.0, 5000.0
"""Hz, by the definition of docs/formats.md: outside of these a rate is questioned."""

_SLOWEST = 5.0
"""Hz, by the definition of docs/formats.md: slower recordings are too rare to read seconds as a rate for them."""

_TICKS = (1.0, 1e3, 1e6, 1e7, 1e9)
"""Units of time columns in a second, by definition: s, ms, microseconds, 100 ns (Kinect, .NET), ns."""

_GIVEN: ContextVar[float | None] = ContextVar("given_rate", default=None)


@contextmanager
def given_rate(rate: float | None) -> Iterator[None]:
    """Have all files that are read inside the block taken at ``rate`` Hz, whatever they say; None changes nothing."""
    token = _GIVEN.set(rate)
    try:
        yield
    finally:
        _GIVEN.reset(token)


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """What a file says about time, unchecked.

    Parameters
    ----------
    rate : Hz, declared; None where it is not.
    times : (T,) time of every row, in seconds or in another unit of time; NaN where blank; None without such a column.
    numbers : (T,) number of the frame of every row, NaN where blank; None without such a column.
    frames : number of frames that the header declares; None where it does not.
    assumed : Hz, usual in such files, for one that says nothing of time; None where there is no such rate.
    """

    rate: float | None = None
    times: FloatArray | None = None
    numbers: FloatArray | None = None
    frames: float | None = None
    assumed: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """When the rows of a file were.

    Parameters
    ----------
    rate : Hz.
    rows : (T',) row of the file of every frame, -1 where there is none; None if the rows are the frames.
    notes : for the user.
    """

    rate: float
    rows: IndexArray | None = None
    notes: tuple[Message, ...] = ()

    def place(self, values: FloatArray) -> FloatArray:
        """Return the values (T, ...) of the rows in the order of the frames, NaN where a frame is missing."""
        if self.rows is None:
            return values
        placed = values[self.rows]
        placed[self.rows < 0] = np.nan
        return placed

    def join(self, notes: tuple[Message, ...]) -> tuple[Message, ...]:
        """Return a reader's notes and those about time: that frames are lacking says that the last row breaks off."""
        lacking = any(note.code == "guard.frame_count" for note in self.notes)
        return (*(note for note in notes if not lacking or note.code != "guard.cut_off"), *self.notes)


def settle_clock(
    path: str | os.PathLike[str], clock: Clock | float, n_rows: int, content: FloatArray | None = None
) -> Timeline:
    """Decide on rate and order of the rows of a file.

    Parameters
    ----------
    path : for the messages.
    clock : what the file says; of some formats only the rate.
    n_rows : number of rows that were read.
    content : (T, ...) their values: rows of one time that differ are not repeated ones.

    Raises
    ------
    MotionFileError : neither rate nor times, a rate that is none, more missing frames than ten for each row.
    """
    if not isinstance(clock, Clock):
        clock = Clock(clock)
    given = _GIVEN.get()
    if given is None and _agrees(clock, n_rows):  # nearly every file
        return Timeline(float(clock.rate or 0.0))
    times = _usable(clock.times, n_rows)
    numbers = _usable(clock.numbers, n_rows)
    numbers = None if numbers is None or np.any(numbers != np.rint(numbers)) else numbers
    steps, notes = _count_steps(numbers, times)
    rows: IndexArray | None = None
    n_frames = n_rows
    if steps is not None and np.any(steps != 1):
        rows, more = _order_rows(path, np.concatenate(([0], np.cumsum(steps))), content)
        notes += more
        n_frames = n_rows if rows is None else len(rows)
    if clock.frames is not None and clock.frames not in (n_rows, n_frames) and not clock.frames <= 0:
        notes.append(Message("guard.frame_count", declared=f"{clock.frames:,.0f}", found=n_rows))
    if given is not None:
        if clock.rate is not None and clock.rate != given:
            notes.append(Message("guard.given_rate", declared=clock.rate, given=given))
        return Timeline(given, rows, tuple(notes))
    if clock.rate is None and times is None and clock.assumed is not None:
        return Timeline(clock.assumed, rows, (*notes, Message("arrays.assumed_rate", rate=clock.assumed)))
    rate, more = _choose_rate(path, clock.rate, times, steps)
    return Timeline(rate, rows, (*notes, *more))


def _agrees(clock: Clock, n_rows: int) -> bool:
    """Whether all that a file says of time is that its rows follow each other at its rate."""
    rate, numbers, times = clock.rate, clock.numbers, clock.times
    if rate is None or not _LOWEST <= rate <= _HIGHEST or clock.frames not in (None, n_rows):
        return False
    if numbers is None and times is None:
        return True
    counted = np.arange(n_rows)
    if numbers is not None and (len(numbers) != n_rows or np.any(numbers != counted + numbers[0])):
        return False
    return times is None or (len(times) == n_rows and np.abs((times - times[0]) * rate - counted).max() < 0.25)


def _usable(column: FloatArray | None, n_rows: int) -> FloatArray | None:
    """A column that counts: mostly numbers, not all the same; blank cells go on as their neighbours do."""
    if column is None or len(column) != n_rows or n_rows < 2:
        return None
    column = np.asarray(column, np.float64)
    if np.nanmin(np.abs(column), initial=np.inf) > 2.0**53:  # ns since 1970: whole numbers only from the first one on
        column = column - column[0]
    finite = np.isfinite(column)
    if 2 * np.count_nonzero(finite) <= n_rows:
        return None
    if not finite.all():
        rows, known = np.arange(n_rows), np.flatnonzero(finite)
        beyond = rows - np.clip(rows, known[0], known[-1])
        column = np.interp(rows, known, column[finite])
        column += beyond * np.median(np.diff(column[known[0] : known[-1] + 1]))
    return None if np.all(column == column[0]) or np.abs(column).max() > 2.0**53 else column


def _even_steps(column: FloatArray, rounded: float, most: float = 0.25) -> IntArray | None:
    """Steps (T - 1,) from row to row in units of the usual step; None if the column has no usual step.

    ``rounded`` : what the column rounds away. ``most`` : of a usual step that most steps, less this, may differ.
    """
    steps = np.diff(column)
    rising = steps[steps > 0]
    if len(rising) == 0:
        return None
    usual = float(np.sort(rising)[(len(rising) - 1) // 2])
    counted = np.rint(steps / usual)
    if rounded > most * usual:  # 0.01, 0.02, 0.02, 0.03: the column is too coarse to tell frames apart
        return None
    off = np.abs(steps - counted * usual) > most * usual + rounded
    if 10 * np.count_nonzero(off | (counted != 1)) > 3 * len(steps) + 10:
        return None
    return counted.astype(np.int64)


def _resolution(column: FloatArray) -> float:
    """The last decimal that the numbers of a column have, 0 beyond the ninth."""
    size = np.abs(column).max() * 2.0**-50
    for places in range(10):
        shifted = column * 10.0**places
        if np.abs(shifted - np.rint(shifted)).max() <= max(size * 10.0**places, 1e-9):
            return 10.0**-places
    return 0.0


def _count_steps(numbers: FloatArray | None, times: FloatArray | None) -> tuple[IntArray | None, list[Message]]:
    """Frames from row to row (T - 1,), by the numbers and the times; None where neither counts."""
    by_number = None if numbers is None else _even_steps(numbers, 0.0)  # they are counted
    by_time = None if times is None else _even_steps(times, _resolution(times))
    notes = []
    if times is not None and by_time is None:
        notes += _note_uneven(times)
    found = [
        _without_slips(steps, other)
        for steps, other in ((by_number, by_time), (by_time, by_number))
        if steps is not None
    ]
    slips = sum(count for _, count in found)
    if slips:
        notes.append(Message("guard.time_slips", n=slips))
    if not found:
        return None, notes
    steps = found[0][0]
    if len(found) > 1:
        steps = np.where(steps == 1, found[1][0], steps)
    return steps, notes


def _note_uneven(times: FloatArray) -> list[Message]:
    steps = np.diff(times)
    steps = steps[steps > 0]
    if len(steps) == 0 or _resolution(times) > 0.25 * np.median(steps):
        return []
    return [Message("guard.uneven_times", shortest=float(steps.min()), longest=float(steps.max()))]


def _without_slips(steps: IntArray, other: IntArray | None) -> tuple[IntArray, int]:
    """Steps without single rows that bear a wrong number or time, and the number of such rows.

    Between two rows that are two steps apart there is one place. A number that fills a gap elsewhere is that of an
    exchanged row, which is no slip.
    """
    places = np.concatenate(([0], np.cumsum(steps)))
    inner = np.flatnonzero((steps[:-1] + steps[1:] == 2) & (steps[:-1] != 1)) + 1
    expected = places[inner - 1] + 1
    wrong = inner[~np.isin(places[inner], expected)]
    places[wrong] = places[wrong - 1] + 1
    if other is not None and len(steps) > 1:  # at the ends only the other clock can tell
        for end, place in ((0, places[1] - 1), (-1, places[-2] + 1)):
            if places[end] != place and steps[end] != 1 and other[end] == 1:
                places[end] = place
                wrong = np.append(wrong, end)
    return np.diff(places), len(wrong)


def _order_rows(
    path: str | os.PathLike[str], places: IntArray, content: FloatArray | None, most: int = 10
) -> tuple[IndexArray | None, list[Message]]:
    """Row of every frame, -1 where there is none, and notes; None where the places contradict the rows.

    ``most`` : missing frames for each row that is there: by the memory that they take.
    """
    order = np.argsort(places, kind="stable")
    ranked = places[order]
    again = np.concatenate(([False], ranked[1:] == ranked[:-1]))
    notes = []
    if again.any():
        firsts = order[~again][np.cumsum(~again) - 1]
        differing = 0 if content is None else _count_differing(content, firsts[again], order[again])
        if differing > len(places) // 10 + 1:  # several recordings one after the other
            return None, [Message("guard.starts_again", row=_fall(places))]
        order, ranked = order[~again], ranked[~again]
        dropped = int(np.count_nonzero(again))
        notes.append(Message("guard.differing_rows" if differing else "guard.repeated_rows", n=dropped))
    if np.any(np.diff(order) < 0):
        notes.append(Message("guard.exchanged_rows", row=_fall(places)))
    ranked = ranked - ranked[0]
    missing = int(ranked[-1]) + 1 - len(ranked)
    if missing > most * len(places):
        raise MotionFileError(path, "guard.far_gap", missing=missing, found=len(places))
    rows = np.full(int(ranked[-1]) + 1, -1, np.intp)
    rows[ranked] = order
    if missing:
        notes.append(Message("guard.gaps", n=missing, first=int(np.flatnonzero(rows < 0)[0])))
    return rows, notes


def _fall(places: IntArray) -> int:
    """The first row, from 1, that comes before the one above it."""
    falls = np.flatnonzero(places[1:] <= places[:-1])
    return int(falls[0]) + 2 if len(falls) else 1


def _count_differing(content: FloatArray, rows: IndexArray, others: IndexArray) -> int:
    flat = content.reshape(len(content), -1)
    return sum(not np.array_equal(flat[a], flat[b], equal_nan=True) for a, b in zip(rows, others, strict=True))


def _choose_rate(
    path: str | os.PathLike[str],
    declared: float | None,
    times: FloatArray | None,
    steps: IntArray | None,
    near: float = 0.005,
) -> tuple[float, list[Message]]:
    """Rate in Hz, of the header or of the times, and notes.

    ``near`` : by which share they may differ: 29.97 is called 30.
    """
    sound = declared is not None and 0 < declared <= 1e6
    measured = None if times is None else _measure_rate(times, steps)
    if measured is not None and sound and declared is not None:
        low, high = measured
        for ticks in _TICKS:
            if low * ticks * (1 - near) <= declared <= high * ticks * (1 + near):
                return float(declared), _question(declared)
    if measured is not None:
        for ticks in _TICKS:
            rate = _simplest(measured[0] * ticks, measured[1] * ticks)
            if _LOWEST <= rate <= _HIGHEST:
                if declared is None:
                    return rate, [] if ticks == 1.0 else [Message("guard.time_unit", rate=rate, ticks=ticks)]
                return rate, [Message("guard.rate_of_times", declared=declared, rate=rate)]
    if not sound or declared is None:
        raise MotionFileError(path, "guard.no_rate" if declared is None else "guard.rate", found=declared)
    notes = [] if measured is None else [Message("guard.times_refused", declared=declared, rate=measured[0])]
    if declared < _LOWEST:
        meant = _rate_of_duration(1.0 / declared)
        if meant is not None:
            return meant, [*notes, Message("guard.rate_is_time", found=1.0 / declared, rate=meant)]
    return float(declared), [*notes, *_question(declared)]


def _question(rate: float) -> list[Message]:
    return [] if _LOWEST <= rate <= _HIGHEST else [Message("guard.odd_rate", rate=rate)]


def _rate_of_duration(duration: float) -> float | None:
    """The rate that stands where seconds should be, or that of so many milliseconds; None if it can be neither."""
    candidates = [rate for rate in (duration, 1e3 / duration) if min(rate, duration) >= _SLOWEST and rate <= _HIGHEST]
    # Rates are mostly whole numbers; 33.3333 are the milliseconds of 30 Hz.
    whole = [rate for rate in candidates if abs(rate - round(rate)) <= 1e-3 * rate]
    return float(round(whole[0])) if whole else candidates[0] if candidates else None


def _measure_rate(times: FloatArray, steps: IntArray | None) -> tuple[float, float] | None:
    """Least and greatest rate of a column of times, by what it rounds away."""
    if steps is None:
        span, count = float(times[-1] - times[0]), len(times) - 1
    else:
        plain = steps == 1
        span, count = float(np.diff(times)[plain].sum()), int(np.count_nonzero(plain))
    if count == 0 or not span > 0:
        return None
    rounded = min(_resolution(times) / 2, 0.4 * span)
    return count / (span + rounded), count / (span - rounded)


def _simplest(low: float, high: float) -> float:
    """The number of the fewest decimals from ``low`` to ``high``, or near enough their middle."""
    middle = (low + high) / 2
    for places in range(7):
        rate = round(middle, places)
        if low * (1 - 1e-9) <= rate <= high * (1 + 1e-9) and rate > 0:
            return float(rate)
    return middle
