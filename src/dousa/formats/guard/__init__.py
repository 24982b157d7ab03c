"""The one guard between readers and the library: what a file declares against what it holds, and what can be.

Readers say what is in a file and decide nothing: points in any state, and a `Clock` with all that it says of time.
`dousa.formats.assembly` sends everything through here: time (`settle_clock`), lost points (`find_lost`), place
(`settle_positions`), the body (`check_body`). Sizes are checked by the readers before they allocate (`check_points`,
`check_memory`).
"""

from __future__ import annotations

from dousa.formats.guard.body import check_body, keep_offsets
from dousa.formats.guard.clock import Clock, Timeline, given_rate, settle_clock
from dousa.formats.guard.lost import Cloud, find_lost, measure_cloud
from dousa.formats.guard.place import EXACT, find_shift, is_flat, note_shift, settle_positions, settle_roots
from dousa.formats.guard.sizes import MOST_POINTS, check_even, check_memory, check_points, compare_bytes, compare_points

__all__ = [
    "EXACT", "MOST_POINTS", "Clock", "Cloud", "Timeline", "check_body", "check_even", "check_memory", "check_points",
    "compare_bytes", "compare_points", "find_lost", "find_shift", "given_rate", "is_flat", "keep_offsets",
    "measure_cloud", "note_shift", "settle_clock", "settle_positions", "settle_roots",
]  # fmt: skip
