"""How far the learning is that a search waits for: a body of which parts are missing asks for a forest of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dousa.messages import Message

Step = tuple[int, int, Message]
"""Steps done, steps, message about the next step."""


class Learning:
    """What searches learn at present."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[object, Step] = {}

    @contextmanager
    def follow(self) -> Iterator[Callable[[int, int, Message], None]]:
        """What a search calls with its steps; they count until it is over."""
        mine = object()

        def tell(done: int, total: int, what: Message) -> None:
            with self._lock:
                self._steps[mine] = (done, total, what)

        try:
            yield tell
        finally:
            with self._lock:
                self._steps.pop(mine, None)

    def now(self) -> Step | None:
        """The step of the search that began first among those that learn; None if none does."""
        with self._lock:
            return next(iter(self._steps.values()), None)
