"""Who is who: the stretches in which somebody was followed become people over the whole film.

A stretch is cut where two people touch and where its points jump, for there a crop may have slid from one to the
other. Pieces are given to people in the order of time, all that begin at about the same moment together, such that
the sum of the costs is least (Kuhn 1955, Munkres 1957): how unlike the colours are, how far a piece begins from where
the person would be, how much the size differs. Who is two pieces at a time is nobody.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.estimation.keypoints.people import CORE, measure_middle
from dousa.motion.runs import find_equal_runs

_TOUCH = 0.2  # of the crop's size between the middles of two people
_JUMP = 0.2  # of the crop's size, off the place where the person was expected
_TOGETHER_S = 0.3  # pieces that begin within this time are given to people together
_NEW = 1.1  # cost of a person who was not seen before
_COLOUR, _PLACE, _SIZE, _SAME_STRETCH = 2.0, 0.5, 0.25, 0.6  # weights of the costs
_REACH, _SPEED = 0.15, 1.5  # crop sizes that a person may be off at once, and more per second
_MOST = 3.0
_GOES_ON_S = 0.6  # that somebody who is not seen is thought to go on as before
_LEAST_S, _LEAST_QUALITY, _LEAST_INSIDE = 0.3, 0.65, 0.95
_VISIBLE, _NEAR, _MOST_LOOKED_AT = 0.5, 2, 200  # visibility, px of the mask, sightings


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of a stretch that is surely of one person.

    Parameters
    ----------
    rows : places among the sightings, rising in time.
    stretch : the number of the stretch.
    """

    rows: IntArray
    stretch: int


@dataclass(slots=True)
class _Person:
    """What is known of somebody so far."""

    pieces: list[Piece] = field(default_factory=list)
    colours: FloatArray | None = None
    weight: float = 0.0


def find_identities(sightings: NDArray[np.void], times: FloatArray) -> list[IntArray]:
    """The people of a film.

    Parameters
    ----------
    sightings : of `people.SIGHTING`, rising in time.
    times : (T,) s of the frames.

    Returns
    -------
    For each person the places among the sightings, at most one for each frame; who is seen most comes first. Who is
    seen for less than a third of a second, or only doubtfully, is nobody.
    """
    pieces = cut_stretches(sightings)
    people: list[_Person] = []
    starts = [float(times[sightings["frame"][piece.rows[0]]]) for piece in pieces]
    first = 0
    while first < len(pieces):
        last = first
        while last < len(pieces) and starts[last] - starts[first] <= _TOGETHER_S:
            last += 1
        _give(pieces[first:last], people, sightings, times)
        first = last
    found = [np.concatenate([piece.rows for piece in person.pieces]) for person in people]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    least = min(_LEAST_S, 0.5 * step * len(times))  # a film may be shorter than that
    kept = [rows for rows in found if is_somebody(sightings, rows, step, least)]
    return sorted(kept, key=lambda rows: -_measure_presence(sightings, rows))


def _measure_presence(sightings: NDArray[np.void], rows: IntArray) -> float:
    """How much of somebody is seen: frames, weighed by what is visible and by how large it is."""
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64).mean(axis=1)
    return float((visible * np.sqrt(sightings["crop"][rows, 2])).sum())


def is_somebody(sightings: NDArray[np.void], rows: IntArray, step: float, least: float = _LEAST_S) -> bool:
    """Whether the sightings at these places, ``step`` s apart, are of a person at all, who is there for ``least`` s."""
    if len(rows) * step < least and step < _LEAST_S:
        return False
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64)
    best = np.maximum(visible[:, :6].mean(axis=1), visible[:, 4:].mean(axis=1))  # arms and hips, hips and legs
    if np.percentile(best * sightings["score"][rows], 25) < _LEAST_QUALITY:
        return False
    sample = rows[:: max(1, len(rows) // _MOST_LOOKED_AT)]
    return float(np.percentile([measure_inside(sightings[row]) for row in sample], 25)) >= _LEAST_INSIDE


def measure_inside(row: np.void) -> float:
    """Share of the visible landmarks of a sighting that lie on its mask: nearly all do, unless nobody is there."""
    points = row["points"][list(CORE)][row["visibility"][list(CORE)] > _VISIBLE].astype(np.float64)
    side = len(row["mask"])
    x, y, size, angle = row["crop"].tolist()
    inverse = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]) * (side / size)
    places = (points - (x, y)) @ inverse.T + (side - 1) / 2
    mask = np.pad(np.unpackbits(row["mask"], axis=1).astype(bool), _NEAR)
    columns, rows = np.clip(np.rint(places).astype(int) + _NEAR, 0, side + 2 * _NEAR - 1).T
    near = [
        mask[max(0, down - _NEAR) : down + _NEAR + 1, max(0, column - _NEAR) : column + _NEAR + 1].any()
        for down, column in zip(rows, columns, strict=True)
    ]
    return float(np.mean(near)) if near else 0.0


def cut_stretches(sightings: NDArray[np.void]) -> list[Piece]:
    """The pieces of all stretches, in the order in which they begin."""
    middles, sizes = measure_middle(sightings["points"]), sightings["crop"][:, 2]
    touching = np.zeros(len(sightings), bool)
    for start, stop in find_equal_runs(sightings["frame"]):
        apart = np.linalg.norm(middles[start:stop, None] - middles[None, start:stop], axis=2)
        near = apart < _TOUCH * np.minimum(sizes[start:stop, None], sizes[None, start:stop])
        touching[start:stop] = near.sum(axis=1) > 1
    pieces = []
    for stretch in np.unique(sightings["stretch"]):
        rows = np.flatnonzero(sightings["stretch"] == stretch)
        cuts = find_equal_runs(touching[rows])[1:, 0]
        moves = np.diff(middles[rows], axis=0, prepend=middles[rows[:1]])
        off = np.linalg.norm(np.diff(moves, axis=0, prepend=moves[:1]), axis=1) / sizes[rows]
        cuts = np.union1d(cuts, np.flatnonzero(off > _JUMP)).astype(int)
        pieces += [Piece(part, int(stretch)) for part in np.split(rows, cuts) if len(part)]
    return sorted(pieces, key=lambda piece: int(piece.rows[0]))


def _give(pieces: Sequence[Piece], people: list[_Person], sightings: NDArray[np.void], times: FloatArray) -> None:
    """Give pieces that begin at about the same time to people, and make new people for the others."""
    left = list(pieces)
    while left:
        # pieces of one person may follow each other within the group: one round for each
        now: list[Piece] = []
        later: list[Piece] = []
        for piece in left:
            before = [one for one in now if sightings["frame"][one.rows[-1]] < sightings["frame"][piece.rows[0]]]
            (later if before else now).append(piece)
        costs = np.full((len(now), len(people) + len(now)), _NEW)
        for row, piece in enumerate(now):
            for column, person in enumerate(people):
                costs[row, column] = _measure_cost(piece, person, sightings, times)
        for row, column in enumerate(assign(costs)):
            if column >= len(people) or costs[row, column] >= _NEW:
                people.append(_Person())
                _add(now[row], people[-1], sightings)
            else:
                _add(now[row], people[column], sightings)
        left = later


def _add(piece: Piece, person: _Person, sightings: NDArray[np.void]) -> None:
    colours = _mean_colours(piece, sightings)
    weight = float(min(len(piece.rows), 60))
    total = person.weight + weight
    person.colours = colours if person.colours is None else (person.weight * person.colours + weight * colours) / total
    person.weight = min(total, 300.0)
    person.pieces.append(piece)


def _mean_colours(piece: Piece, sightings: NDArray[np.void]) -> FloatArray:
    return np.asarray(sightings["colours"][piece.rows].astype(np.float64).mean(axis=0))


def _measure_cost(piece: Piece, person: _Person, sightings: NDArray[np.void], times: FloatArray) -> float:
    """What it costs that a piece is of a person; infinite (a large number) where they are seen at the same time."""
    last = person.pieces[-1]
    begin, end = sightings[piece.rows[0]], sightings[last.rows[-1]]
    if begin["frame"] <= end["frame"]:
        return 1e6
    gap = float(times[begin["frame"]] - times[end["frame"]])
    size = float(min(begin["crop"][2], end["crop"][2]))
    place = measure_middle(end["points"])
    if len(last.rows) > 3 and gap < 1.0:
        back = sightings[last.rows[-min(len(last.rows), 9)]]
        took = float(times[end["frame"]] - times[back["frame"]])
        place = place + (place - measure_middle(back["points"])) * min(gap, _GOES_ON_S) / max(took, 1e-3)
    off = float(np.hypot(*(measure_middle(begin["points"]) - place))) / size / (_REACH + _SPEED * gap)
    grown = abs(math.log(float(begin["crop"][2]) / float(end["crop"][2]))) / (0.2 + gap)
    colours = _mean_colours(piece, sightings)
    unlike = 0.0 if person.colours is None else 1 - float(np.minimum(colours, person.colours).sum(axis=1).mean())
    cost = _COLOUR * unlike + _PLACE * min(off, _MOST) + _SIZE * min(grown, _MOST)
    return cost - (_SAME_STRETCH if last.stretch == piece.stretch else 0.0)


def assign(costs: FloatArray) -> list[int]:
    """The column (N,) of each row of a matrix (N, M >= N) of costs, each once, with the least sum.

    Source: the Hungarian method with potentials (Jonker and Volgenant 1987, in its shortest form), O(N^2 M).
    """
    n_rows, n_columns = costs.shape
    row_price, column_price = np.zeros(n_rows + 1), np.zeros(n_columns + 1)
    owner = np.zeros(n_columns + 1, int)  # row of each column, from 1; 0 is free
    for row in range(1, n_rows + 1):
        owner[0], here = row, 0
        least, came_from = np.full(n_columns + 1, np.inf), np.zeros(n_columns + 1, int)
        done = np.zeros(n_columns + 1, bool)
        while owner[here]:
            done[here] = True
            reduced = costs[owner[here] - 1] - row_price[owner[here]] - column_price[1:]
            better = ~done[1:] & (reduced < least[1:])
            least[1:][better], came_from[1:][better] = reduced[better], here
            following = int(np.argmin(np.where(done, np.inf, np.where(np.arange(n_columns + 1) == 0, np.inf, least))))
            step = least[following]
            row_price[owner[done]] += step
            column_price[done] -= step
            least[~done] -= step
            here = following
        while here:
            owner[here] = owner[came_from[here]]
            here = int(came_from[here])
    columns = np.zeros(n_rows, int)
    for column in range(1, n_columns + 1):
        if owner[column]:
            columns[owner[column] - 1] = column - 1
    return [int(column) for column in columns]
