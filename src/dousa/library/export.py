"""Export of many clips of a library as files, in any format, optionally retargeted to a character.

Writes a folder per category and a ``manifest.csv`` with the labels, in a folder, or a ZIP file made from a hidden
folder beside it. Files of an earlier run are kept if nothing has changed, so that an interrupted export goes on: the
manifest names all files before the first is written, and says of each when it is whole.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import itertools
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from dousa.errors import DousaError, MotionWriteError, OptionError
from dousa.files.disk import NO_ROOM, atomic_write, read_bytes, remove_left_overs, write_error
from dousa.formats.motion_files import ReadOptions, Skipped, describe_problem, read_with
from dousa.formats.parts import file_of, split_address
from dousa.formats.registry import WRITERS
from dousa.library.results import Answer

if TYPE_CHECKING:
    from dousa.library.results import ClipInfo
    from dousa.motion import Motion, Trajectories

MANIFEST = "manifest.csv"
_WORST = ("worst_limb", "worst_deg", "worst_frame")
COLUMNS = (
    "file", "id", "kind", "category", "performer", "tags", "n_frames", "frame_rate", "duration_s", "source", "start_s",
    "end_s", "from", "made_of", *_WORST,
)  # fmt: skip

Rows = dict[str, dict[str, str]]
"""Rows of the manifest by file."""


class Destination:
    """A folder to write files to, made when the first file is."""

    def __init__(self, path: Path) -> None:
        self.path, self.folder = path, path
        if path.exists() and not path.is_dir():
            raise OptionError("export.no_folder", path=path)

    def open(self) -> Rows:
        """Read the manifest of an earlier run, removing what a killed one left; OptionError if it is not ours."""
        rows = read_manifest(self.folder / MANIFEST)
        if not rows and _holds_text(self.folder / MANIFEST):
            raise OptionError("export.other_manifest", path=self.folder / MANIFEST)
        if rows:
            remove_left_overs(self.folder)
        return {name: row for name, row in rows.items() if (self.folder / name).is_file()}

    def prepare(self, name: str) -> Path:
        """Return the path to write a file of this name, with folders and ``/``."""
        path = self.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise write_error(path, error) from error
        return path

    def is_foreign(self, name: str, rows: Rows) -> bool:
        """Return whether a file of this name exists that no export wrote, such as a recording itself."""
        return name not in rows and (self.folder / name).exists()

    def write_manifest(self, rows: Iterable[Mapping[str, str]], *, to_come: bool = False) -> None:
        """Write rows as the manifest, sorted by name; without any that of an earlier moment goes.

        Files that are missing are left out, or are ``to_come``.
        """
        there = [row for row in rows if to_come or (self.folder / row["file"]).is_file()]
        if there:
            with atomic_write(self.prepare(MANIFEST)) as file:
                file.write(_write_rows(sorted(there, key=lambda row: row["file"]), heading=True))
        else:
            (self.folder / MANIFEST).unlink(missing_ok=True)

    def note(self, row: Mapping[str, str]) -> None:
        """Add to the manifest that a file is whole."""
        path = self.folder / MANIFEST
        try:
            with open(path, "ab") as file:
                file.write(_write_rows([row]))
        except OSError as error:
            raise write_error(path, error) from error

    def close(self, extras: tuple[str, ...] = ()) -> None:
        """Finish, with files besides those of the manifest."""


class ZipDestination(Destination):
    """A ZIP file; one of an earlier export is continued, any other is refused.

    Its files are in a hidden folder beside it until it is complete, so that an interrupted export can go on.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.parent / f".{path.name[:100]}.parts"

    def is_foreign(self, name: str, rows: Rows) -> bool:
        """Return false: only exports write into the hidden folder."""
        return False

    def open(self) -> Rows:
        """Unpack the files of an earlier run and read their manifest."""
        if self.path.exists():
            self._unpack()
        return super().open()

    def _unpack(self) -> None:
        try:
            with zipfile.ZipFile(self.path) as archive:
                if MANIFEST not in archive.namelist():
                    raise OptionError("export.other_zip", path=self.path)
                inside = os.path.realpath(self.folder)
                for name in archive.namelist():
                    path = os.path.realpath(self.folder / name)
                    if path.startswith(f"{inside}{os.sep}") and not name.endswith("/") and not os.path.exists(path):
                        with archive.open(name) as packed, atomic_write(self.prepare(name)) as file:
                            shutil.copyfileobj(packed, file)
        except (OSError, zipfile.BadZipFile, EOFError, RuntimeError, ValueError, NotImplementedError) as error:
            raise OptionError("export.other_zip", path=self.path) from error

    def close(self, extras: tuple[str, ...] = ()) -> None:
        """Write the ZIP file, and remove the folder."""
        names = [*read_manifest(self.folder / MANIFEST), *extras]
        if names:
            with atomic_write(self.path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                for name in (MANIFEST, *sorted(set(names))):
                    archive.write(self.folder / name, name)
        shutil.rmtree(self.folder, ignore_errors=True)


def _write_rows(rows: Iterable[Mapping[str, str]], *, heading: bool = False) -> bytes:
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    if heading:
        table.writeheader()
    table.writerows(rows)
    return text.getvalue().encode()


def _holds_text(path: Path) -> bool:
    """Return whether a file has more than our heading."""
    heading = ",".join(COLUMNS).encode()
    try:
        with open(path, "rb") as file:
            return file.read(len(heading) + 9).strip() not in (b"", heading)
    except OSError:
        return False


def read_manifest(path: Path) -> Rows:
    """Read the rows of an earlier run by file; empty if there is no manifest, or another's."""
    try:
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    return {
        row["file"]: row
        for row in rows
        if set(COLUMNS).difference(_WORST) <= set(row) <= set(COLUMNS) and all(isinstance(v, str) for v in row.values())
    }


ORIGINAL = "original"

ExportProgress = Callable[[int, int, str], None]
"""Called with (clips done, clips, name of the next)."""

_UNSAFE = re.compile(r'[\x00-\x1f<>:"|?*\\]')
_GIVEN = ("joint_map", "unit", "up", "skeleton", "frame_rate", "person", "animation")


class Source(Protocol):
    """The parts of a library that an export needs."""

    def contents(self, clip_ids: Sequence[int]) -> dict[int, str]:
        """Return content hashes and read options of clips, by number."""
        ...

    def trajectories(self, clip_id: int) -> Trajectories:
        """Return the stored joints of a clip."""
        ...


@dataclass(frozen=True, slots=True)
class ExportReport(Answer):
    """The result of an export.

    Parameters
    ----------
    written, kept : files, relative to the folder: new, and there already.
    skipped : clips that could not be exported, by the path of their source.
    """

    written: tuple[str, ...]
    kept: tuple[str, ...]
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """The output format of clips.

    Parameters
    ----------
    to : a key of `list_formats`, or ``"original"``: the files as they are.
    onto : file of a character to retarget the motions to.
    keep_reach : keep the places that hands reach, instead of arm directions.
    frame_rate : Hz to resample to; None keeps each clip's own.
    """

    to: str = ORIGINAL
    onto: str | os.PathLike[str] | None = None
    keep_reach: bool = False
    frame_rate: float | None = None

    def __post_init__(self) -> None:
        known = list_formats()
        if self.to not in known and self.to != ORIGINAL:
            raise OptionError("export.format", found=self.to, known=(*known, ORIGINAL))
        if self.to == ORIGINAL and (self.onto is not None or self.frame_rate is not None):
            raise OptionError("export.original_onto")
        if self.keep_reach and self.onto is None:
            raise OptionError("export.reach_of_nobody")
        if self.frame_rate is not None and not 0 < self.frame_rate <= 1e6:
            raise OptionError("resampling.rate", rate=self.frame_rate)


def list_formats() -> dict[str, str]:
    """Return suffixes of the output formats, by name: ``"glb"`` for ``".glb"``, ``"amass"`` for ``".amass.npz"``."""
    return {suffix[1:] if suffix.count(".") == 1 else line.name: suffix for suffix, line in WRITERS.items()}


def export_clips(
    library: Source,
    clips: Sequence[ClipInfo],
    path: str | os.PathLike[str],
    form: ExportFormat,
    options: ReadOptions | None = None,
    progress: ExportProgress | None = None,
) -> ExportReport:
    """Write clips of a library as files; see `Library.export`.

    ``path`` is a folder or the name of a ZIP file; ``options`` replace those of adding.
    """
    target = Path(path)
    if form.to == "fbx":
        from dousa.formats.exchange.conversion import find_blender

        find_blender(target)  # said once, not of each file
    is_zip = target.suffix.lower() == ".zip" and not target.is_dir()
    destination = ZipDestination(target) if is_zip else Destination(target)
    job = _Export(library, destination, form, options or ReadOptions())
    try:
        planned = job.plan(clips)
        for number, one in enumerate(planned):
            if progress is not None:
                progress(number, len(clips), os.path.basename(one.clip.path))
            job.run(one)
        if progress is not None:
            progress(len(clips), len(clips), "")
    except BaseException as error:
        with suppress(MotionWriteError):  # what is in it serves as well
            destination.write_manifest({**job.to_come, **job.rows}.values())
        if not isinstance(error, MotionWriteError):
            raise
        done = len(job.written) + len(job.kept)
        raise MotionWriteError(path, "export.no_room", reason=error.message, done=done, total=len(clips)) from error
    destination.write_manifest(job.rows.values())
    destination.close(tuple(job.skeletons))
    return ExportReport(tuple(job.written), tuple(job.kept), tuple(job.skipped))


@dataclass(frozen=True, slots=True)
class _Planned:
    """A clip, the row of its file in the manifest, its content, and whether the file is there already."""

    clip: ClipInfo
    row: dict[str, str]
    content: str
    is_there: bool


class _Export:
    """One run, with the files of earlier ones."""

    def __init__(self, library: Source, destination: Destination, form: ExportFormat, options: ReadOptions) -> None:
        self.library, self.destination, self.form, self.options = library, destination, form, options
        self.character: Motion | None = None
        recipe: dict[str, Any] = {"to": form.to}
        if form.onto is not None:
            from dousa.formats import read_character

            self.character = read_character(form.onto)
            recipe |= {"onto": hashlib.sha256(read_bytes(file_of(form.onto))).hexdigest(), "reach": form.keep_reach}
        recipe |= {"rate": form.frame_rate, "read": options.describe(), "skeleton": str(options.skeleton or "")}
        self.recipe = json.dumps(recipe, sort_keys=True)
        self.rows = destination.open()
        self.to_come: Rows = {}
        self.written: list[str] = []
        self.kept: list[str] = []
        self.skipped: list[Skipped] = []
        self.skeletons: list[str] = []

    def plan(self, clips: Sequence[ClipInfo]) -> list[_Planned]:
        """Choose the names of all files, and list those to be written before the first of them is."""
        names: dict[str, str] = {name: row["id"] for name, row in self.rows.items()}
        planned = []
        for clip in clips:
            suffix = _suffix_of(file_of(_file_of(clip))) if self.form.to == ORIGINAL else list_formats()[self.form.to]
            name = self._choose_name(clip, suffix, names)
            names[name] = str(clip.id)
            content = self.library.contents([clip.id]).get(clip.id, "")
            made_of = hashlib.sha256(f"{self.recipe} {content} {clip.start_s} {clip.end_s}".encode()).hexdigest()[:16]
            known = self.rows.get(name, {})
            is_there = known.get("made_of") == made_of
            row = _describe(clip, name, made_of)
            row |= {key: known[key] for key in ("from", *_WORST) if is_there and key in known}
            planned.append(_Planned(clip, row, content, is_there))
        self.to_come = {one.row["file"]: {**one.row, "made_of": ""} for one in planned if not one.is_there}
        if self.to_come:
            self.destination.write_manifest({**self.rows, **self.to_come}.values(), to_come=True)
        return planned

    def run(self, planned: _Planned) -> None:
        """Write a file, unless it is there."""
        clip, row, name = planned.clip, planned.row, planned.row["file"]
        if planned.is_there:
            self._copy_skeleton(clip, name)
            self.rows[name] = row
            self.kept.append(name)
            return
        try:
            row |= self._write(clip, name, planned.content)
            self.destination.note(row)
        except DousaError as error:
            self.rows.pop(name, None)
            if isinstance(error, MotionWriteError) and error.code in NO_ROOM:
                raise
            self.skipped.append(Skipped(clip.path, describe_problem(clip.path, error)))
            return
        self.rows[name] = row
        self.written.append(name)

    def _choose_name(self, clip: ClipInfo, suffix: str, names: Mapping[str, str]) -> str:
        """Return category and name of the source; with the clip's number if the name is, or may be, another clip's, or
        is that of a file that no export wrote.

        ``names`` : numbers of clips by the names of their files.
        """
        parts = [_safe(part) for part in (clip.category or "").split("/") if part]
        file, chosen = split_address(_file_of(clip))
        base = os.path.basename(file)
        own = _suffix_of(base)
        stem = "_".join((base[: -len(own)] if own and base.lower().endswith(own.lower()) else base, *chosen.values()))
        stem = _safe(stem)
        if clip.take_id is not None:
            stem = f"{stem}_{clip.start_s or 0.0:.2f}s"
        name = "/".join((*parts, stem + suffix))
        if name == MANIFEST or names.get(name, str(clip.id)) != str(clip.id) or self._is_foreign(name):
            name = "/".join((*parts, f"{stem}_{clip.id}{suffix}"))
        numbers = itertools.count(2)
        while self._is_foreign(name):
            name = "/".join((*parts, f"{stem}_{clip.id}_{next(numbers)}{suffix}"))
        return name

    def _is_foreign(self, name: str) -> bool:
        return self.destination.is_foreign(name, self.rows)

    def _write(self, clip: ClipInfo, name: str, content: str) -> dict[str, str]:
        """Write a file, and return what its row says of how it was made."""
        if self.form.to == ORIGINAL:
            if clip.take_id is not None:
                raise OptionError("export.part_of_take")
            data = read_bytes(file_of(clip.path))
            path = self.destination.prepare(name)
            self._copy_skeleton(clip, name)
            with atomic_write(path) as file:
                file.write(data)
            return {"from": "file"}
        from dousa.formats import write_motion

        if clip.take_id is not None:
            content = self.library.contents([clip.take_id]).get(clip.take_id, "")
        options = self._options(content)
        motion, origin = self._read(clip, options)
        made = {"from": origin}
        if self.form.frame_rate is not None:
            from dousa.motion import resample

            motion = resample(motion, self.form.frame_rate)  # type: ignore[type-var]  # either, not both
        if self.character is not None:
            from dousa.motion import retarget

            joints = options.joint_map if origin == "file" else None
            done = retarget(motion, self.character, joint_map=joints, keep_reach=self.form.keep_reach)
            motion = done.motion
            worst = done.worst.limb, f"{math.degrees(done.worst.angle):.1f}", str(done.worst.frame + 1)
            made |= dict(zip(_WORST, worst, strict=True))
        write_motion(motion, self.destination.prepare(name))
        return made

    def _copy_skeleton(self, clip: ClipInfo, name: str) -> None:
        if self.form.to != ORIGINAL or not clip.path.lower().endswith(".amc"):
            return
        from dousa.formats.asf_amc.reading import find_skeleton

        skeleton = self.options.skeleton or find_skeleton(clip.path)
        copy = "/".join((*name.split("/")[:-1], os.path.basename(skeleton)))
        if copy not in self.skeletons:
            data = read_bytes(skeleton)
            with atomic_write(self.destination.prepare(copy)) as file:
                file.write(data)
            self.skeletons.append(copy)

    def _options(self, content: str) -> ReadOptions:
        """Return how the file was read when it was added, with the options given now."""
        text = content.partition(" ")[2]
        stored = json.loads(text) if text else {}
        known = ReadOptions(**{key: stored[key] for key in _GIVEN if key in stored})
        given = {key: getattr(self.options, key) for key in _GIVEN if getattr(self.options, key) is not None}
        return dataclasses.replace(known, **given)

    def _read(self, clip: ClipInfo, options: ReadOptions) -> tuple[Motion | Trajectories, str]:
        """Read the motion of the file, or its part, else the stored joints."""
        path = _file_of(clip)
        if not os.path.exists(file_of(path)):
            return self.library.trajectories(clip.id), "stored joints"
        motion = read_with(path, options)
        return (motion if clip.take_id is None else _cut(motion, clip)), "file"


def _cut(motion: Motion | Trajectories, clip: ClipInfo) -> Motion | Trajectories:
    from dousa.motion import Motion

    first = round((clip.start_s or 0.0) * motion.frame_rate)
    frames = slice(first, None if clip.end_s is None else round(clip.end_s * motion.frame_rate))
    if isinstance(motion, Motion):
        return motion.replace(rotations=motion.rotations[frames], translations=motion.translations[frames])
    return motion.replace(positions=motion.positions[frames])


def _file_of(clip: ClipInfo) -> str:
    return clip.path if clip.take_id is None else clip.path.rpartition("#t=")[0]


def _describe(clip: ClipInfo, name: str, made_of: str) -> dict[str, str]:
    return {
        "file": name,
        "id": str(clip.id),
        "kind": clip.kind,
        "category": clip.category or "",
        "performer": clip.performer or "",
        "tags": "; ".join(clip.tags),
        "n_frames": str(clip.n_frames),
        "frame_rate": repr(clip.frame_rate),
        "duration_s": f"{clip.duration:.6g}",
        "source": clip.path,
        "start_s": "" if clip.start_s is None else f"{clip.start_s:.6g}",
        "end_s": "" if clip.end_s is None else f"{clip.end_s:.6g}",
        "from": "file",
        "made_of": made_of,
    }


def _suffix_of(path: str) -> str:
    """Return the suffix of a name, both suffixes of a packed file."""
    stem, suffix = os.path.splitext(path)
    return os.path.splitext(stem)[1] + suffix if suffix.lower() in (".gz", ".zip") else suffix


def _safe(part: str) -> str:
    return _UNSAFE.sub("_", part).strip(". ")[:150] or "clip"
