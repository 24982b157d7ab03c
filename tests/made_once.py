"""What is dear to make and never changed, as a trained library: one worker makes it, the others wait and read it."""

import functools
import hashlib
import pickle
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dousa.files.disk import atomic_write
from dousa.retrieval.takes import labeller_training

try:
    import fcntl
except ImportError:  # elsewhere each makes its own
    fcntl = None


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that ``make`` has filled, the same for all workers of a run.

    Parameters
    ----------
    factory : of the temporary folders of this worker; those of all lie beside one another.
    name : of the folder, one for each thing.
    make : fills an empty folder; where it fails, each worker tries, and each says why.
    """
    worker = factory.getbasetemp()
    if fcntl is None or not worker.name.startswith("popen-"):
        folder = factory.mktemp(name, numbered=False)
        make(folder)
        return folder
    folder, made = worker.parent / name, worker.parent / f"{name}.made"
    with open(worker.parent / f"{name}.lock", "ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            made.touch()
    return folder


def _remember(factory: pytest.TempPathFactory, work: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, whose answers lie in files: what it has done once in a run is not done again.

    Parameters
    ----------
    factory : of the temporary folders of this worker; those of all lie beside one another.
    work : answers the same whenever it is asked the same, and takes a ``progress``, which hears the same again too.
    """
    worker = factory.getbasetemp()
    folder = (worker.parent if worker.name.startswith("popen-") else worker) / work.__name__
    folder.mkdir(exist_ok=True)

    @functools.wraps(work)
    def recall(*words: Any, progress: Callable[..., None] | None = None, **options: Any) -> Any:
        report = progress or (lambda *step: None)
        path = folder / hashlib.sha256(pickle.dumps((words, options))).hexdigest()
        if path.exists():
            steps, answer = pickle.loads(path.read_bytes())
            for step in steps:
                report(*step)
            return answer
        steps = []

        def tell(*step: Any) -> None:
            steps.append(step)
            report(*step)

        answer = work(*words, progress=tell, **options)
        with atomic_write(path) as file:
            pickle.dump((steps, answer), file)
        return answer

    return recall


def learn_labellers_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A fixture. Most libraries have the same clips: to learn to label their takes is most of what a training costs."""
    with pytest.MonkeyPatch.context() as patch:
        learn = _remember(tmp_path_factory, labeller_training.train_labeller)
        patch.setattr(labeller_training, "train_labeller", learn)
        yield
