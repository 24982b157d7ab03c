"""Tasks of a trial, done in order by any number of workers.

Answers do not depend on the number of workers: they come in the order of the tasks, and whatever is drawn at random
is drawn from the seed and the number of the task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from dousa.errors import OptionError
from dousa.experiments.runner import Steps
from dousa.messages import Message, Progress
from dousa.workers.current import current_cluster
from dousa.workers.threads import yield_answers

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


def run_tasks(
    work: Callable[[_Task], _Answer],
    tasks: Sequence[_Task],
    name: Callable[[_Task], Message],
    *,
    n_jobs: int | None,
    progress: Progress | None,
    in_processes: bool = False,
) -> Iterator[_Answer]:
    """Answers in the order of the tasks.

    Parameters
    ----------
    work : what is done to each.
    tasks : any number.
    name : what the progress callback is told of a task.
    n_jobs : workers; None for one.
    progress : called with (done, total, name); first with the name of the first task.
    in_processes : processes instead of threads: for work that holds Python's lock. Compiled kernels let go of it.

    Raises
    ------
    OptionError : no workers.
    """
    if n_jobs == 0:
        raise OptionError("trials.workers")
    answers: Iterable[_Answer]
    cluster = current_cluster()
    if cluster is not None and len(tasks) > 1:
        answers = cluster.map(work, tasks, most=1)
    elif n_jobs in (None, 1) or len(tasks) < 2:
        answers = map(work, tasks)
    else:
        how = None if in_processes else "threads"
        answers = yield_answers(work, tasks, n_jobs, prefer=how, batch_size=1)
    steps = Steps(progress, len(tasks))
    if tasks:
        steps.say(name(tasks[0]))
    for task, answer in zip(tasks, answers, strict=True):
        steps.done += 1
        steps.say(name(task))
        yield answer
