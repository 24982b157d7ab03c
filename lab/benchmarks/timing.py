"""The frame of the benchmarks: a benchmark yields rows, ours and a peer's, measured in turns and equally often.

Every figure is a median, on the clock and of all processors (this process, its threads and the programs that it ran):
where others keep the machine busy, the second is the one to compare.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import NamedTuple, TypeVar

__all__ = ["Row", "Spent", "measure_memory", "run", "spend", "take_turns", "timed"]

_Result = TypeVar("_Result")


class Spent(NamedTuple):
    """Seconds on the clock, and of all processors."""

    wall: float
    cpu: float

    def per(self, number: float) -> Spent:
        """Of one of so many."""
        return Spent(self.wall / number, self.cpu / number)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table.

    Parameters
    ----------
    work : what is done.
    ours, theirs : what it takes; None without a peer.
    peer : who does the same, and what of it, if not all.
    amount, unit : what is done in that time, so that a rate is printed (``MB/s``) instead of seconds.
    note : what else was found: that both give the same, memory.
    """

    work: str
    ours: Spent
    peer: str = ""
    theirs: Spent | None = None
    amount: float = 0.0
    unit: str = ""
    note: str = ""

    def tell(self, spent: Spent) -> str:
        """Time or rate, on the clock and of processors."""
        if not self.unit:
            return f"{_tell_seconds(spent.wall)} ({_tell_seconds(spent.cpu)} of CPU)"
        clock, cpu = (self.amount / max(seconds, 1e-9) for seconds in spent)
        return f"{_round(clock)} {self.unit} ({_round(cpu)} of CPU)"

    def ratios(self) -> str:
        """How many times as long the peer takes, on the clock and of processors."""
        if self.theirs is None:
            return ""
        pairs = zip(self.theirs, self.ours, strict=True)
        return ", ".join(_round(theirs / max(ours, 1e-9)) for theirs, ours in pairs)

    def __str__(self) -> str:
        theirs = f"; {self.peer}: {self.tell(self.theirs)}; ratio {self.ratios()}" if self.theirs else ""
        return f"{self.work}: {self.tell(self.ours)}{theirs}{'; ' * bool(self.note)}{self.note}"


def _tell_seconds(seconds: float) -> str:
    scale, unit = next(((s, u) for s, u in ((1.0, "s"), (1e3, "ms")) if seconds * s >= 1.0), (1e6, "us"))
    return f"{_round(seconds * scale)} {unit}"


def _round(number: float) -> str:
    return f"{number:,.0f}" if number >= 100 else f"{number:.3g}"


def _clocks() -> Spent:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Spent(time.perf_counter(), time.process_time() + children.ru_utime + children.ru_stime)


def spend(call: Callable[[], _Result]) -> tuple[Spent, _Result]:
    """What one call takes, and its result."""
    before = _clocks()
    result = call()
    after = _clocks()
    return Spent(after.wall - before.wall, after.cpu - before.cpu), result


def timed(call: Callable[[], _Result]) -> tuple[float, _Result]:
    """Seconds of one call on the clock, and its result."""
    begin = time.perf_counter()
    result = call()
    return time.perf_counter() - begin, result


def take_turns(calls: Mapping[str, Callable[[], object]], repeats: int = 5, *, warm: bool = True) -> dict[str, Spent]:
    """Medians of calls that take turns, so that other load meets all; each is called once before, which compiles."""
    if warm:
        for call in calls.values():
            call()
    found: dict[str, list[Spent]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            found[name].append(spend(call)[0])
    return {name: Spent(*map(statistics.median, zip(*all_of, strict=True))) for name, all_of in found.items()}


def measure_memory(call: Callable[[], object]) -> str:
    """What a call needs at most beyond what is held before, as words; nothing where the system does not tell."""

    def read(key: str) -> float:
        with open("/proc/self/status") as status:
            return next(float(line.split()[1]) / 1024 for line in status if line.startswith(key))

    try:
        with open("/proc/self/clear_refs", "w") as reset:
            reset.write("5")
    except OSError:
        return ""
    before = read("VmRSS")
    call()
    return f"at most {read('VmHWM') - before:.0f} MB beyond what was held"


def run(
    about: str | None,
    benchmark: Callable[[argparse.Namespace], Iterator[Row]],
    add_options: Callable[[argparse.ArgumentParser], object] = lambda parser: None,
) -> None:
    """A benchmark as a program: its rows as lines, with --json each as an object."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    parser.add_argument("--repeats", type=int, default=5, help="of ours and of the peers, of which the median counts")
    parser.add_argument("--json", action="store_true", help="for python -m lab.benchmarks, which makes the table")
    options = parser.parse_args()
    for row in benchmark(options):
        print(json.dumps(asdict(row)) if options.json else row, flush=True)
