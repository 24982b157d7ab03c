"""The process that does one long job: a task comes in as a line of JSON, progress and the answer go out as lines."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["main"]

_TELL_EVERY = 0.1  # s
_PATIENCE = 15.0  # s to end after the studio has ended
_MOST_PIXELS = 200_000_000  # of a picture; small files can say that they are larger


def main() -> None:
    """Read the task, do it, answer, end."""
    # What libraries print must not come between our lines: they get standard error.
    out = os.fdopen(os.dup(1), "w", encoding="utf-8", errors="replace", buffering=1)
    os.dup2(2, 1)
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(_MOST_PIXELS))  # read when OpenCV is loaded
    _stand_back()
    task = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_studio, daemon=True).start()
    answer = _do(task, out)
    _say(out, answer)


def _stand_back() -> None:
    """The studio goes first: with the processor, and where the memory runs out."""
    if hasattr(os, "nice"):
        os.nice(5)
    with suppress(OSError):  # Linux
        Path("/proc/self/oom_score_adj").write_text("800", encoding="ascii")


def _do(task: dict[str, Any], out: Any) -> dict[str, Any]:
    from dousa.app.studio.problems import describe_disk
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
    except OSError as error:
        problem = describe_disk(error)
        if problem is None:
            raise
        return {"problem": problem}
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
    time.sleep(_PATIENCE)
    os._exit(1)  # what does not look up ends without a word


if __name__ == "__main__":
    main()
