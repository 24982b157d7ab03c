"""What tests cost in processor seconds, with the programs that they start: clocks say little where others work too.

With ``DOUSA_TEST_TIMES=40`` the run ends with the 40 dearest tests and with sums by folders.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

__all__ = ["ProcessorTimes"]

_NAME = "processor seconds"


def _read_descendants() -> float:
    """Seconds of the programs below this one that still run, where the system shows them."""
    ticks, waiting = 0, [str(os.getpid())]
    while waiting:
        parent = waiting.pop()
        for task in Path("/proc", parent, "task").glob("*/children"):
            try:
                for child in task.read_text().split():
                    waiting.append(child)
                    words = Path("/proc", child, "stat").read_text().rpartition(")")[2].split()
                    ticks += sum(map(int, words[11:15]))
            except OSError:  # it has just ended
                continue
    return ticks / os.sysconf("SC_CLK_TCK") if ticks else 0.0


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

    def _measure(self, item: pytest.Item) -> Iterator[None]:
        start = _read_seconds()
        try:
            return (yield)
        finally:
            item.user_properties.append((_NAME, _read_seconds() - start))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._measure(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._measure(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._measure(item))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """The last report of a test has what all its parts have cost."""
        if report.when == "teardown":
            self.tests[report.nodeid] += sum(value for name, value in report.user_properties if name == _NAME)

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
