"""Work that outlives a request: it is queued, watched, stopped and resumed, and survives a reload of the page.

Long work (adding, training, estimating) runs in its own process, which frees its memory, can be stopped at any moment
and leaves the page quick. Short work (labelling, evaluating) runs in a thread, where the kernels are loaded already.
Each lane runs one job at a time, in the order of the requests.
"""

from __future__ import annotations

import json
import queue
import secrets
import shutil
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from dousa.app.studio.core.answers import Answer, RefusedError, name_error, pack, say, say_packed
from dousa.app.studio.core.workspace import Workspace, write_file
from dousa.errors import DousaError
from dousa.formats.motion_files import find_motion_files
from dousa.messages import Message, get_language, use_language

LOG = "log.txt"
"""In the folder of a job: what its process prints, and where it failed."""

ACTIVE = frozenset({"queued", "running", "stopping"})
_MOST_WAITING, _MOST_KEPT = 50, 200


def describe_fault(error: Exception, folder: Path) -> Message:
    """Describe an error that nobody expected, in a job with this folder."""
    return Message("studio_jobs.fault", kind=type(error).__name__, text=str(error), log=folder / LOG)


class JobStopped(Exception):  # noqa: N818 - not an error
    """Raised inside work that was stopped."""


@dataclass(slots=True)
class Job:
    """One piece of work and its progress.

    Parameters
    ----------
    id : 16 hexadecimal digits.
    kind : name of the work, see `dousa.app.studio.work.worker`.
    title : a name or a message.
    request : of the client.
    language : of the result.
    state : ``queued``, ``running``, ``stopping``, ``done``, ``failed``, ``stopped``.
    done, total, what : progress.
    notes : messages for the user.
    result : None until it is done.
    problem : why it failed.
    created_s, started_s, finished_s : Unix times.
    version : counts changes.
    """

    id: str
    kind: str
    title: str | Message
    request: dict[str, Any]
    language: str = "en"
    state: str = "queued"
    done: int = 0
    total: int = 0
    what: Message | None = None
    notes: list[Message] = field(default_factory=list)
    result: dict[str, Any] | None = None
    problem: Message | None = None
    resumable: bool = False
    created_s: float = field(default_factory=time.time)
    started_s: float | None = None
    finished_s: float | None = None
    version: int = 0

    def to_json(self, *, brief: bool = False) -> dict[str, Any]:
        """Return the job in the current language; brief: without request and result.

        ``codes`` has the messages behind the sentences ``title``, ``what``, ``notes`` and ``problem``.
        """
        answer = {one.name: getattr(self, one.name) for one in fields(self)}
        if brief:
            del answer["request"], answer["result"]
        else:
            answer["result"] = say_packed(self.result)
        said = {name: answer[name] for name in _SAID if isinstance(answer[name], list | Message)}
        codes = {name: _each(value, Message.to_json) for name, value in said.items()}
        answer |= {name: _each(answer[name], say) for name in _SAID}
        return {**answer, "what": answer["what"] or "", "codes": codes}

    def to_file(self) -> dict[str, Any]:
        """Return the job as a dictionary for a file, with messages instead of sentences."""
        answer = {one.name: getattr(self, one.name) for one in fields(self)}
        return answer | {name: _each(answer[name], Message.to_json) for name in _SAID}

    @classmethod
    def from_file(cls, stored: Mapping[str, Any]) -> Job:
        """Read the result of ``to_file()``."""
        read: dict[str, Any] = {name: stored[name] for name in ("title", "what", "problem")}
        read = {name: Message.from_json(one) if isinstance(one, Mapping) else one for name, one in read.items()}
        return cls(**{**stored, **read, "notes": [Message.from_json(note) for note in stored["notes"]]})


_SAID = ("title", "what", "notes", "problem")


def _each(value: Any, change: Callable[[Message], Any]) -> Any:
    if isinstance(value, list):
        return [change(one) for one in value]
    return change(value) if isinstance(value, Message) else value


@dataclass(frozen=True, slots=True)
class Lane:
    """A queue of work.

    Parameters
    ----------
    name : jobs of the same lane wait for each other.
    run : does the work of a job until ``stop`` is set; returns the result.
    resumable : a stopped job can be resumed.
    """

    name: str
    run: Callable[[Job, JobBoard, threading.Event], dict[str, Any]]
    resumable: bool = False


class JobBoard:
    """All jobs of a studio; safe to be used from any thread.

    Parameters
    ----------
    workspace : with the files of the jobs.
    kinds : the lane of each kind of work.
    """

    def __init__(self, workspace: Workspace, kinds: Mapping[str, Lane]) -> None:
        self._workspace = workspace
        self._kinds = dict(kinds)
        self._lock = threading.RLock()
        self._jobs: dict[str, Job] = {}
        self._stops: dict[str, threading.Event] = {}
        self._queues: dict[str, queue.SimpleQueue[str | None]] = {}
        self._threads: list[threading.Thread] = []
        self._saved: dict[str, float] = {}
        self._closing = False
        self._load()

    # --- asking for work

    def submit(self, kind: str, request: Mapping[str, Any], title: str | Message) -> Job:
        """Queue a job; RefusedError if too many wait."""
        with self._lock:
            if sum(job.state in ACTIVE for job in self._jobs.values()) >= _MOST_WAITING:
                raise RefusedError(429, "studio_jobs.too_many", most=_MOST_WAITING)
            resumable = self._kinds[kind].resumable
            job = Job(secrets.token_hex(8), kind, title, dict(request), get_language(), resumable=resumable)
            self._workspace.job_folder(job.id).mkdir(parents=True)
            self._jobs[job.id] = job
            for old in [job for job in self.all() if job.state not in ACTIVE][_MOST_KEPT:]:
                with suppress(RefusedError):  # others were made from it
                    self.remove(old.id)
            self._enqueue(job)
            return job

    def resume(self, job_id: str) -> Job:
        """Resume a job that was stopped or failed; RefusedError if that is not possible."""
        with self._lock:
            job = self.get(job_id)
            if job.state in ACTIVE:
                raise RefusedError(409, "studio_jobs.under_way")
            if job.state == "done":
                raise RefusedError(409, "studio_jobs.resume_done")
            if not job.resumable:
                raise RefusedError(409, "studio_jobs.not_resumable")
            self.change(job, state="queued", problem=None, finished_s=None)
            self._enqueue(job)
            return job

    def stop(self, job_id: str) -> Job:
        """Ask a job to stop; finished parts of its work stay."""
        with self._lock:
            job = self.get(job_id)
            if job.state == "queued":
                self.change(job, state="stopped", finished_s=time.time())
            elif job.state == "running":
                self.change(job, state="stopping")
            self._stops[job_id].set()
            return job

    def remove(self, job_id: str) -> None:
        """Delete a finished job with its files; RefusedError if it is missing, active, or needed by others."""
        with self._lock:
            job = self.get(job_id)
            if job.state in ACTIVE:
                raise RefusedError(409, "studio_jobs.stop_first")
            if made := [other for other in self.all() if job_id in json.dumps(other.request)]:
                raise RefusedError(409, "studio_jobs.made_from", n=len(made), title=made[0].title)
            del self._jobs[job_id]
            self._stops.pop(job_id, None)
            self._saved.pop(job_id, None)
        shutil.rmtree(self.folder(job), ignore_errors=True)

    # --- looking

    def get(self, job_id: str) -> Job:
        """Return a job; RefusedError if there is none of this number."""
        with self._lock:
            if job_id not in self._jobs:
                raise RefusedError(404, "studio_jobs.no_job", job=job_id[:40])
            return self._jobs[job_id]

    def all(self) -> list[Job]:
        """List all jobs, the newest first."""
        with self._lock:
            return sorted(self._jobs.values(), key=lambda job: -job.created_s)

    def folder(self, job: Job) -> Path:
        """Return the folder of a job."""
        return self._workspace.job_folder(job.id)

    def change(self, job: Job, **values: Any) -> None:
        """Change a job; its state is set last, so that a finished job has its result."""
        with self._lock:
            settled = "state" in values
            for name in sorted(values, key="state".__eq__):
                setattr(job, name, values[name])
            job.version += 1
            # s between writes of the progress of a running job
            if settled or time.monotonic() - self._saved.get(job.id, 0) > 2.0:
                self._save(job)

    def close(self) -> None:
        """Stop all jobs and wait for them."""
        self._closing = True
        with self._lock:
            for job in self._jobs.values():
                if job.state in ACTIVE:
                    self._stops[job.id].set()
            for waiting in self._queues.values():
                waiting.put(None)
            threads = list(self._threads)
        for thread in threads:
            thread.join(timeout=15)

    # --- doing

    def _enqueue(self, job: Job) -> None:
        lane = self._kinds[job.kind].name
        self._stops[job.id] = threading.Event()
        self._save(job)
        if lane not in self._queues:
            self._queues[lane] = queue.SimpleQueue()
            thread = threading.Thread(target=self._serve, args=(lane,), name=f"jobs-{lane}", daemon=True)
            self._threads.append(thread)
            thread.start()
        self._queues[lane].put(job.id)

    def _serve(self, lane: str) -> None:
        while (job_id := self._queues[lane].get()) is not None:
            with self._lock:
                job = self._jobs.get(job_id)
                if job is None or job.state != "queued" or self._closing:
                    continue
                self.change(job, state="running", started_s=time.time(), done=0, total=0, what=None)
                stop = self._stops[job_id]
            self._run(job, stop)

    def _run(self, job: Job, stop: threading.Event) -> None:
        use_language(job.language)  # of the result
        try:
            result = self._kinds[job.kind].run(job, self, stop)
            self.change(job, state="done", result=pack(result), finished_s=time.time())
        except JobStopped:
            self.change(job, state="stopped", finished_s=time.time())
        except DousaError as error:
            self.change(job, state="failed", problem=name_error(error, self._workspace.root), finished_s=time.time())
        except Exception as error:  # a fault of ours must not end the lane
            folder = self.folder(job)
            with suppress(OSError), open(folder / LOG, "a", encoding="utf-8") as log:
                traceback.print_exc(file=log)
            self.change(job, state="failed", problem=describe_fault(error, folder), finished_s=time.time())

    # --- keeping

    def _save(self, job: Job) -> None:
        self._saved[job.id] = time.monotonic()
        with suppress(Exception):
            write_file(self.folder(job) / "job.json", Answer(None).render(job.to_file()))

    def _load(self) -> None:
        for path in (self._workspace.root / "jobs").glob("*/job.json"):
            with suppress(OSError, ValueError, TypeError, KeyError, RefusedError):
                job = Job.from_file(json.loads(path.read_bytes()))
                if job.kind not in self._kinds or self.folder(job) != path.parent:
                    continue
                if job.state in ACTIVE:  # the studio ended under it
                    job.state, job.finished_s = "stopped", time.time()
                self._jobs[job.id] = job
                self._stops[job.id] = threading.Event()


Opened = TypeVar("Opened")


class OpenedJobs(Generic[Opened]):
    """Keeps what was last opened of jobs; safe to be used from any thread.

    Parameters
    ----------
    board : the jobs.
    open_folder : opens the folder of a job.
    most : how many stay open.
    """

    def __init__(self, board: JobBoard, open_folder: Callable[[Path], Opened], most: int) -> None:
        self._board, self._open_folder, self._most = board, open_folder, most
        self._lock = threading.Lock()
        self._open: OrderedDict[str, Opened] = OrderedDict()

    def get(self, job: Job) -> Opened:
        """Open a job, or return it if it is open."""
        with self._lock:
            if job.id not in self._open:
                self._open[job.id] = self._open_folder(self._board.folder(job))
            self._open.move_to_end(job.id)
            while len(self._open) > self._most:
                self._open.popitem(last=False)
            return self._open[job.id]


_Seen = frozenset[tuple[str, int, int]]  # path, bytes, time of the last change


class FolderWatch:
    """Adds new files of a folder to the library once the folder is at rest.

    Parameters
    ----------
    folder : with motion files, at any depth.
    take_in : called with the paths of new and changed files; makes a job that adds them.
    is_busy : whether such a job is active.
    """

    def __init__(self, folder: Path, take_in: Callable[[list[str]], object], is_busy: Callable[[], bool]) -> None:
        self._folder, self._take_in, self._is_busy = folder.absolute(), take_in, is_busy
        self._last: _Seen = frozenset()
        self._taken: _Seen = frozenset()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="folder watch", daemon=True)

    def start(self) -> None:
        """Start to watch."""
        self._thread.start()

    def end(self) -> None:
        """Stop to watch."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def look(self) -> bool:
        """Look once; returns whether files are added."""
        now = self._read()
        rests, self._last = now == self._last, now
        if not rests or now <= self._taken or self._is_busy():
            return False
        self._take_in(sorted({path for path, _, _ in now - self._taken}))
        self._taken = now
        return True

    def _read(self) -> _Seen:
        seen = set()
        for file in find_motion_files([self._folder])[0]:
            with suppress(OSError):  # gone since
                state = file.path.stat()
                seen.add((str(file.path), state.st_size, state.st_mtime_ns))
        return frozenset(seen)

    def _run(self, *, look_every_s: float = 3.0) -> None:
        # look_every_s: between looks; files that are still being written change in between
        while not self._over.wait(look_every_s):
            # A queue that is full, a disk that is away: the next look may do better.
            with suppress(DousaError, OSError):
                self.look()
