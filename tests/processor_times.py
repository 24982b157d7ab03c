"""What tests cost in processor seconds, with the programs that they start: clocks say little where others work too.

With ``DOUSA_TEST_TIMES=40`` the run ends with the 40 dearest tests and with sums by folders.
"""

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

_NAME = "processor seconds"
_SYSTEM = Path("/proc")


def _has_children() -> bool:
    """Whether a thread of this program has started one that still runs: most tests start none."""
    try:
        return any((task / "children").read_bytes() for task in (_SYSTEM / "self/task").iterdir())
    except OSError:  # another system, or a thread that has just ended
        return True


def _read_descendants() -> float:
    """Seconds of the programs below this one that still run, where the system shows them; browsers have many threads,
    so that each process is asked once who its parent is, and no thread which its children are."""
    if not _has_children():
        return 0.0
    parents, ticks = {}, {}
    for process in filter(str.isdigit, os.listdir(_SYSTEM) if _SYSTEM.is_dir() else ()):
        try:
            with open(f"{_SYSTEM}/{process}/stat", "rb") as file:
                words = file.read().rpartition(b")")[2].split()
        except OSError:  # it has just ended
            continue
        parents[int(process)] = int(words[1])
        ticks[int(process)] = sum(map(int, words[11:15]))
    below, waiting = 0, {os.getpid()}
    while waiting := {process for process, parent in parents.items() if parent in waiting}:
        below += sum(ticks[process] for process in waiting)
    return below / os.sysconf("SC_CLK_TCK") if below else 0.0


def _read_seconds() -> float:
    """Seconds of this program, and of all that it has started."""
    return sum(os.times()[:4]) + _read_descendants()


class ProcessorTimes:
    """A plugin of pytest.

    Parameters
    ----------
    count : how many tests are named.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.tests: Counter[str] = Counter()
        self.read = 0.0

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[object]:
        """What was before the first test is nobody's."""
        self.read = self.read or _read_seconds()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        """A test costs what was used since the one before it, with what fixtures did for it."""
        try:
            return (yield)
        finally:
            before, self.read = self.read, _read_seconds()
            # What a browser has used is gone with it, at the end of the last test.
            item.user_properties.append((_NAME, max(self.read - before, 0.0)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """The last report of a test has what it has cost; one that is run again has two, the latter being last."""
        if report.when == "teardown":
            self.tests[report.nodeid] += dict(report.user_properties).get(_NAME, 0.0)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """The table."""
        folders: Counter[str] = Counter()
        for name, seconds in self.tests.items():
            folders["/".join(name.split("::")[0].split("/")[:-1])] += seconds
        terminalreporter.section(f"processor seconds: {sum(self.tests.values()):.0f}")
        for table in (self.tests.most_common(self.count), folders.most_common()):
            for name, seconds in table:
                terminalreporter.line(f"{seconds:8.1f}  {name}")
            terminalreporter.line("")
