"""The process that does one long job: a task comes in as a line of JSON, progress and the answer go out as lines."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

__all__ = ["main"]

_TELL_EVERY = 0.1  # s


def main() -> None:
    """Read the task, do it, answer, end."""
    # What libraries print must not come between our lines: they get standard error.
    out = os.fdopen(os.dup(1), "w", encoding="utf-8", errors="replace", buffering=1)
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(5)  # the page goes first
    task = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_studio, daemon=True).start()
    answer = _do(task, out)
    _say(out, answer)


def _do(task: dict[str, Any], out: Any) -> dict[str, Any]:
    from dousa.app.studio.work import WORK, Context
    from dousa.errors import DousaError

    told = 0.0

    def progress(done: int, total: int, what: str) -> None:
        nonlocal told
        now = time.monotonic()
        if done == total or now - told > _TELL_EVERY:
            told = now
            _say(out, {"progress": [int(done), int(total), str(what)]})

    context = Context(
        library=Path(task["library"]),
        home=Path(task["home"]),
        folder=Path(task["folder"]),
        progress=progress,
        tell=lambda text: _say(out, {"note": str(text)}),
    )
    try:
        return {"result": WORK[task["kind"]](task["request"], context)}
    except DousaError as error:
        return {"problem": str(error)}
    except KeyboardInterrupt:
        return {"stopped": True}
    except MemoryError:
        return {
            "problem": "the motions do not fit into the memory of this machine; give fewer or shorter ones"
        }
    except SystemError as error:  # Ctrl-C inside a compiled loop
        if "KeyboardInterrupt" in repr(error.__cause__):
            return {"stopped": True}
        raise


def _say(out: Any, message: dict[str, Any]) -> None:
    from dousa.app.studio.answers import Answer

    out.write(Answer(None).render(message).decode() + "\n")
    out.flush()


def _end_with_studio() -> None:
    """The studio holds our standard input open; when it ends, by whatever cause, so do we."""
    import signal

    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGINT if os.name == "posix" else signal.SIGTERM)


if __name__ == "__main__":
    main()
