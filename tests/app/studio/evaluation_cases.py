"""A dance for the tests of the evaluation page: takes of a teacher, and a pupil who makes known errors."""

import functools
import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

_TAKES = 3
_MOST = 20


class _Call:
    """The arguments of a call; two are equal where their bytes are."""

    def __init__(self, words: tuple[Any, ...], named: dict[str, Any]) -> None:
        self.words, self.named = words, named
        self.digest = hashlib.sha256(pickle.dumps((words, named))).digest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self.digest == other.digest


def keep(work: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with its last answers kept: tests of pages judge the same dances."""
    answer = functools.lru_cache(_MOST)(lambda call: work(*call.words, **call.named))
    return lambda *words, **named: answer(_Call(words, named))


def write_dances(folder: Path) -> tuple[list[Path], Path]:
    """Write three takes and a performance with one error of each class as BVH files."""
    from dousa.app.demo import write_dance
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.dance import make_dance
    from dousa.motion.synthetic.performers import Performer

    first, pupil, _ = write_dance(folder, 0)
    takes = [first]
    for seed in range(1, _TAKES):
        takes.append(folder / f"dance_reference_{seed}.bvh")
        write_motion(make_dance(Performer(name="teacher", seed=0), seed).motion, takes[-1])
    return takes, pupil


def upload(client: Any, *paths: Path) -> list[dict[str, str]]:
    """Send files to a studio; motions for its interface."""
    found = []
    for path in paths:
        answer = client.post(f"/api/uploads?name={path.name}", content=path.read_bytes())
        found.append({"motion": answer.json()["files"][0]["motion"]})
    return found
