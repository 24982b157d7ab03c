"""Ctrl-C and SIGTERM, as of ``docker stop`` or of a machine that is shut down: both raise KeyboardInterrupt."""

from __future__ import annotations

import _thread
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def hear_stops() -> Iterator[list[int]]:
    """Raise KeyboardInterrupt at either signal, unless it is ignored; provides the list of those that came.

    They wait while a module is loaded: it would stay half loaded, and what is finished could not be kept. Where Python
    drops the exception, as in what it does when an object is deleted, they come again.
    """
    came: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
            frame = frame.f_back
        if frame is not None:
            _send_again(number)
            return
        came.append(number)
        raise KeyboardInterrupt

    def look(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            _send_again([*came, signal.SIGINT][0])
        else:
            sys.__unraisablehook__(lost)

    numbers = [one for one in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(one) != signal.SIG_IGN]
    before = [signal.signal(one, stop) for one in numbers]
    sys.unraisablehook = look
    try:
        yield came
    finally:
        for number, earlier in zip(numbers, before, strict=True):
            signal.signal(number, earlier)
        sys.unraisablehook = sys.__unraisablehook__


def _send_again(number: int, after_s: float = 0.01) -> None:
    def send() -> None:
        time.sleep(after_s)
        signal.raise_signal(number)

    _thread.start_new_thread(send, ())  # one of `threading` takes a lock, which what was interrupted may have
