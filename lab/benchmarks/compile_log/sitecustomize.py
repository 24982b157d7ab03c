"""Write what numba compiles in any program started with this folder on PYTHONPATH into the file COMPILE_LOG names.

A line for each function: seconds of processor, without those of functions compiled meanwhile; module; name.
"""

from __future__ import annotations

import os
import sys
import time


def _listen() -> None:
    from numba.core import event

    class Log(event.Listener):
        def __init__(self) -> None:
            self.running: list[list[float]] = []

        def on_start(self, event):  # type: ignore[no-untyped-def]
            self.running.append([time.thread_time(), 0.0])

        def on_end(self, event):  # type: ignore[no-untyped-def]
            began, inner = self.running.pop()
            spent = time.thread_time() - began
            if self.running:
                self.running[-1][1] += spent
            function = event.data["dispatcher"].py_func
            with open(os.environ["COMPILE_LOG"], "a") as file:
                file.write(f"{spent - inner:.4f}\t{function.__module__}\t{function.__qualname__}\n")

    event.register("numba:compile", Log())


def _watch(name: str, values: tuple[object, ...]) -> None:
    if name == "import" and values[0] == "numba.core.dispatcher":  # numba is being loaded: not by us, who would slow it
        _listen()


if "COMPILE_LOG" in os.environ:
    sys.addaudithook(_watch)
