"""How many things are done at a time."""

from __future__ import annotations

from dousa.errors import OptionError

__all__ = ["check_jobs", "choose_jobs"]


def check_jobs(n_jobs: int | None) -> None:
    """OptionError for zero jobs."""
    if n_jobs == 0:
        raise OptionError("expected a number of jobs other than 0, such as 2, or -1 for every core")


def choose_jobs(n_jobs: int | None) -> int | None:
    """The number for joblib: as given, else what ``joblib.parallel_config`` says, else every core."""
    import joblib

    check_jobs(n_jobs)
    if n_jobs is None and joblib.effective_n_jobs() == 1:
        return int(joblib.cpu_count())
    return n_jobs
