"""Show a film of the performance and the music of the dance in step with the figures of an evaluation.

Users add both files. The film of a performance that was estimated from films is found automatically. ``start_s`` is the
time of the performance at which a companion begins, in s; negative if it begins earlier.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.uploads import SOUNDS, VIDEOS
from dousa.app.studio.core.workspace import Workspace, write_file

if TYPE_CHECKING:
    from dousa.app.studio.content.motions import MotionRef, Motions
    from dousa.app.studio.jobs.board import Job, JobBoard
    from dousa.app.studio.jobs.lanes import Reader
    from dousa.evaluation import Beats, BeatTiming

Kind = Literal["film", "music"]
_SUFFIXES = {"film": VIDEOS, "music": SOUNDS}
_OTHER_KIND = {"film": "studio_evaluation.no_film", "music": "studio_evaluation.no_music"}
COMPANIONS, _BEATS = "companions.json", "beats.json"


@dataclass(frozen=True, slots=True)
class Companion:
    """A film or a piece of music: a file of a batch, and when it begins, in s of the performance."""

    batch: str
    name: str
    start_s: float = 0.0


class Companions:
    """The companions of all evaluations, stored in the folders of their jobs."""

    def __init__(self, workspace: Workspace, board: JobBoard, motions: Motions, reader: Reader) -> None:
        self._workspace, self._board, self._motions, self._reader = workspace, board, motions, reader

    def get(self, job: Job) -> dict[str, Companion]:
        """Return the companions of an evaluation by kind."""
        found: dict[str, Companion] = {}
        film = self._find_film(job.request["performance"])
        if film is not None:
            found["film"] = film
        with suppress(OSError, ValueError, TypeError):
            stored = json.loads((self._board.folder(job) / COMPANIONS).read_bytes())
            for kind, one in stored.items():
                if one is None:
                    found.pop(kind, None)
                else:
                    found[kind] = Companion(**one)
        return found

    def put(self, job: Job, kind: Kind, companion: Companion | None) -> None:
        """Store or remove a companion; RefusedError if its file is missing or of another kind."""
        if companion is not None:
            path = self._workspace.find(companion.batch, companion.name)
            if path.suffix.lower() not in _SUFFIXES[kind]:
                raise RefusedError(415, _OTHER_KIND[kind], suffix=path.suffix.lower())
            self._workspace.keep(companion.batch)
        folder = self._board.folder(job)
        stored: dict[str, Any] = {}
        with suppress(OSError, ValueError):
            stored = json.loads((folder / COMPANIONS).read_bytes())
        stored[kind] = None if companion is None else asdict(companion)
        write_file(folder / COMPANIONS, json.dumps(stored).encode())

    def path(self, job: Job, kind: Kind) -> Path:
        """Return the file of a companion; RefusedError if there is none."""
        one = self.get(job).get(kind)
        if one is None:
            raise RefusedError(404, "studio_evaluation.no_companion")
        return self._workspace.find(one.batch, one.name)

    def find_beats(self, job: Job) -> Beats | None:
        """Find the beats of the music once and store them; None without music.

        Raises MissingExtraError without the extra ``music``, MotionFileError for music without beats.
        """
        from dousa.evaluation import Beats, find_beats

        music = self.get(job).get("music")
        if music is None:
            return None
        kept = self._board.folder(job) / _BEATS
        with suppress(OSError, ValueError, KeyError):
            stored = json.loads(kept.read_bytes())
            if stored["of"] == [music.batch, music.name]:
                return Beats(stored["times_s"])
        beats = self._reader.run(find_beats, self.path(job, "music"), seconds=180.0)
        write_file(kept, json.dumps({"of": [music.batch, music.name], "times_s": beats.times.tolist()}).encode())
        return beats

    def time_accents(self, job: Job, performance: MotionRef) -> BeatTiming | None:
        """Compare the accents of the performance with the beats of its music; None without music.

        Raises DousaError as `find_beats`, and for too few accents or beats.
        """
        from dousa.evaluation import assess_timing

        beats = self.find_beats(job)
        if beats is None:
            return None
        start_s = self.get(job)["music"].start_s
        return assess_timing(self._motions.get(performance).motion, beats, music_start_s=start_s)

    def _find_film(self, performance: dict[str, Any]) -> Companion | None:
        motion = str(performance.get("motion", ""))
        if not motion.startswith("job:"):
            return None
        with suppress(RefusedError, KeyError, OSError):
            estimated = self._board.get(motion.removeprefix("job:"))
            batch = str(estimated.request["batch"])
            folder = self._workspace.batch_folder(batch)
            films = [path for path in self._workspace.files(batch) if path.suffix.lower() in VIDEOS]
            if films:
                start_s = -float(performance.get("start_s") or 0.0)
                return Companion(batch, str(films[0].relative_to(folder)), start_s)
        return None
