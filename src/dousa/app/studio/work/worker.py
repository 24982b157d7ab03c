"""The kinds of work with their functions and lanes; and the process of one long job: a task comes in as a line of JSON,
progress and the answer go out as lines."""

from __future__ import annotations

import json
import math
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from dousa.app.stops import hear_stops
from dousa.app.studio.core.answers import Answer, RefusedError, describe_disk, name_error, pack, to_message
from dousa.app.studio.core.workspace import open_private
from dousa.app.studio.jobs.board import Lane, describe_fault
from dousa.app.studio.jobs.lanes import READING, READY, Context, load_work, run_in_process, run_in_thread
from dousa.errors import DousaError, is_interrupt
from dousa.files.disk import TAKEN, lock_file
from dousa.files.json_values import refuse_infinite, to_json_value
from dousa.messages import Message, use_language

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio

_PATIENCE = 15.0  # s to end after the studio has ended, see docs/studio.md

JOBS = {
    "add": ("library.add", "library", True),
    "watch": ("library.watch", "library", True),
    "train": ("library.train", "library", True),
    "demo": ("library.demo", "library", False),
    "review": ("library.review", "review", False),
    "map": ("library.map_clips", "review", False),
    "export": ("library.export", "export", True),
    "check": ("library.check", "library", False),
    "backup": ("library.backup", "library", True),
    "compact": ("library.compact", "library", True),
    "estimate": ("estimation.estimate", "estimation", True),
    "masks": ("estimation.prepare_masks", "masks", False),
}
"""Kind of a job in a process -> module of this room and function, as of `load_work`; lane; whether it resumes."""


def make_lanes(studio: Studio) -> Mapping[str, Lane]:
    """Make the lanes of a studio by kind of job."""
    from dousa.app.studio.work.library import evaluate, label

    process = run_in_process(studio.settings)
    return {
        **{kind: Lane(lane, process, resumable=resumable) for kind, (_, lane, resumable) in JOBS.items()},
        "label": Lane("questions", run_in_thread(studio.settings, partial(label, studio))),
        "evaluate": Lane("questions", run_in_thread(studio.settings, partial(evaluate, studio))),
    }


_LOCK = "work.lock"  # in the folder of a job


def main() -> None:
    """Read the task, run it, answer and exit."""
    # A studio that a script started in the background ignores Ctrl-C, and so would we: it is how work is stopped.
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, signal.default_int_handler)
    with hear_stops():
        _work()


def _work() -> None:
    # What libraries print must not come between our lines: they get standard error.
    out = os.fdopen(os.dup(1), "w", encoding="utf-8", errors="replace", buffering=1)
    os.dup2(2, 1)
    # of a picture; small files can say that they are larger
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(200_000_000))  # read when OpenCV is loaded
    _stand_back()
    out.write(READY)  # from here on Ctrl-C is heard
    line = sys.stdin.buffer.readline()
    if line == READING:
        _read_on_request(sys.stdin.buffer, cast("IO[bytes]", out.buffer))
        return
    if not line:  # stopped before there was anything to do
        return
    task = json.loads(line)
    threading.Thread(target=_end_with_studio, daemon=True).start()
    with _wait_for_predecessor(Path(task["folder"]) / _LOCK):
        answer = _do(task, out)
    _say(out, answer)


def _read_on_request(questions: IO[bytes], answers: IO[bytes]) -> None:
    """Answer questions of a `Reader` until it is gone."""
    _limit_memory(pickle.load(questions))
    with suppress(EOFError):
        while True:
            language, seconds, function, args = pickle.load(questions)
            use_language(language)
            if hasattr(signal, "alarm"):  # where the studio is gone, which would end us
                signal.alarm(math.ceil(seconds) + 1)
            try:
                answer = True, function(*args)
            except MemoryError:
                answer = False, RefusedError(422, "studio_jobs.no_memory")
            except Exception as error:
                answer = False, error
            if hasattr(signal, "alarm"):
                signal.alarm(0)
            pickle.dump(answer, answers)
            answers.flush()


def _limit_memory(most: int | None) -> None:
    """Let no more memory be taken; it is in vain where the system does not count it."""
    if most is None:
        return
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _wait_for_predecessor(path: Path, *, patience_s: float = 2 * _PATIENCE) -> IO[bytes]:
    """Lock the folder of a job; a process of a killed studio may still be ending in it.

    It has longer than `_end_with_studio` gives it: with less, both would write into the folder.
    """
    file = open_private(path)
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        try:
            lock_file(file)
            break
        except OSError as error:
            if error.errno not in TAKEN:  # a disk without locks
                break
        time.sleep(0.05)
    return file


def _stand_back() -> None:
    """Lower the priority for the processor, and be the first to be killed when memory runs out."""
    if hasattr(os, "nice"):
        os.nice(5)
    with suppress(OSError):  # Linux
        Path("/proc/self/oom_score_adj").write_text("800", encoding="ascii")


def _do(task: dict[str, Any], out: Any) -> dict[str, Any]:
    use_language(task["language"])
    reported = 0.0

    def progress(done: int, total: int, what: Message | str) -> None:
        nonlocal reported
        now = time.monotonic()
        if done == total or now - reported > 0.1:  # s
            reported = now
            _say(out, {"progress": [int(done), int(total), to_message(what).to_json()]})

    def tell(note: Message | str) -> None:
        _say(out, {"note": to_message(note).to_json()})

    home = Path(task["home"])
    context = Context(Path(task["library"]), home, Path(task["folder"]), progress, tell)
    try:
        result = load_work(JOBS[task["kind"]][0])(task["request"], context)
        return {"result": to_json_value(pack(result), refuse_infinite)}
    except DousaError as error:
        return {"problem": name_error(error, home).to_json()}
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        return {"stopped": True}
    except OSError as error:
        problem = describe_disk(error)
        if problem is None:
            traceback.print_exc()
            problem = describe_fault(error, context.folder)
        return {"problem": problem.to_json()}
    except MemoryError:
        return {"problem": Message("studio_jobs.no_memory").to_json()}
    except Exception as error:  # a fault of ours: the log has where
        traceback.print_exc()
        return {"problem": describe_fault(error, context.folder).to_json()}


def _say(out: Any, message: dict[str, Any]) -> None:
    out.write(Answer(None).render(message).decode() + "\n")
    out.flush()


def _end_with_studio(patience_s: float = _PATIENCE) -> None:
    """End when the studio ends, which holds our standard input open; ``patience_s`` later whatever is under way."""
    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGINT if os.name == "posix" else signal.SIGTERM)
    time.sleep(patience_s)
    os._exit(1)  # what does not look up ends without a word


if __name__ == "__main__":
    main()
