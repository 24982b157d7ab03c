"""Many clips of a library as files at once, in a format of the user's choice, perhaps on the user's character.

A folder per category and a ``manifest.csv`` with the labels. Each file appears whole or not at all. What an earlier run
has written is kept if nothing has changed since, so that an interrupted export goes on where it stopped.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.errors import DousaError, OptionError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.motion_files import ReadOptions, Skipped, describe_problem

if TYPE_CHECKING:
    from dousa.library import ClipInfo, Library
    from dousa.motion import Motion, Trajectories

FORMATS: dict[str, str] = {
    "glb": ".glb", "bvh": ".bvh", "c3d": ".c3d", "trc": ".trc", "csv": ".csv", "npz": ".npz", "amass": ".amass.npz",
}  # fmt: skip
"""Suffix by the name of a format; besides there is ``"original"``: the files as they are."""

MANIFEST = "manifest.csv"
COLUMNS = (
    "file", "id", "kind", "category", "performer", "n_frames", "frame_rate", "duration_s", "source", "from", "made_of",
)  # fmt: skip

Progress = Callable[[int, int, str], None]
_UNSAFE = re.compile(r'[\x00-\x1f<>:"|?*\\]')


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What an export did.

    Parameters
    ----------
    written, kept : files, relative to the folder: new, and there already.
    skipped : clips that could not be exported, by the path of their source.
    """

    written: tuple[str, ...]
    kept: tuple[str, ...]
    skipped: tuple[Skipped, ...]

    def to_json(self) -> dict[str, Any]:
        """The report as plain values."""
        return {
            "written": list(self.written),
            "kept": list(self.kept),
            "skipped": [skipped.to_json() for skipped in self.skipped],
        }


def export_clips(
    library: Library,
    folder: str | os.PathLike[str],
    *,
    category: str | None = None,
    performer: str | None = None,
    clips: Sequence[int | str] | None = None,
    to: str = "original",
    onto: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> ExportReport:
    """Write clips of a library as files.

    Parameters
    ----------
    library : where the clips are.
    folder : where the files go, made if necessary; files of others in it are left alone.
    category, performer, clips : only these.
    to : a key of ``FORMATS``, or ``"original"``.
    onto : character whose skeleton the motions are put onto.
    progress : called with the number of clips that are done, of all, and the name of the next.

    Returns
    -------
    What was written, kept and skipped; ``manifest.csv`` in the folder says the same for each file with its labels. Of a
    clip whose source is gone the stored joints are exported, which the column ``from`` says (``stored joints``).

    Raises
    ------
    LibraryError : no such clip or category.
    OptionError : a format that does not exist, the originals put onto a character, a character without a skeleton.
    """
    if to not in FORMATS and to != "original":
        raise OptionError("export.format", found=to, known=(*FORMATS, "original"))
    if onto is not None and to == "original":
        raise OptionError("export.original_onto")
    found = library.clips(list(clips) if clips else None, category=category, performer=performer)
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise OptionError("export.no_folder", path=target)
    job = _Export(library, target, to, onto)
    try:
        for number, clip in enumerate(found):
            if progress is not None:
                progress(number, len(found), os.path.basename(clip.path))
            job.run(clip)
        if progress is not None:
            progress(len(found), len(found), "")
    finally:  # also when it is interrupted: what is there is listed
        job.write_manifest()
    return ExportReport(tuple(job.written), tuple(job.kept), tuple(job.skipped))


class _Export:
    """One run: what is there from earlier ones, and what it does."""

    def __init__(self, library: Library, folder: Path, to: str, onto: str | os.PathLike[str] | None) -> None:
        self.library, self.folder, self.to = library, folder, to
        self.character: Motion | None = None
        self.recipe = to
        if onto is not None:
            from dousa.formats import read_character

            self.character = read_character(onto)
            self.recipe += " onto " + hashlib.sha256(read_bytes(onto)).hexdigest()[:16]
        self.rows = _read_manifest(folder / MANIFEST)
        self.written: list[str] = []
        self.kept: list[str] = []
        self.skipped: list[Skipped] = []

    def run(self, clip: ClipInfo) -> None:
        """Export one clip, unless it is there already."""
        suffix = FORMATS.get(self.to) or _suffix_of(clip.path)
        name = self._choose_name(clip, suffix)
        content = self.library.contents([clip.id]).get(clip.id, "")
        made_of = hashlib.sha256(f"{self.recipe} {content}".encode()).hexdigest()[:16]
        known = self.rows.get(name)
        row = _describe(clip, name, made_of, known["from"] if known else "file")
        if known is not None and known["made_of"] == made_of and (self.folder / name).is_file():
            self.rows[name] = row
            self.kept.append(name)
            return
        try:
            row["from"] = self._write(clip, self.folder / name, content)
        except DousaError as error:
            self.rows.pop(name, None)
            self.skipped.append(Skipped(clip.path, describe_problem(clip.path, error)))
            return
        self.rows[name] = row
        self.written.append(name)

    def _choose_name(self, clip: ClipInfo, suffix: str) -> str:
        """Category, name of the source; with the clip's number where another clip has the name."""
        parts = [_safe(part) for part in (clip.category or "").split("/") if part]
        base = os.path.basename(clip.path)
        own = _suffix_of(clip.path)
        stem = _safe(base[: -len(own)] if own and base.lower().endswith(own.lower()) else base)
        name = "/".join((*parts, stem + suffix))
        other = self.rows.get(name)
        if other is not None and other["id"] != str(clip.id):
            name = "/".join((*parts, f"{stem}_{clip.id}{suffix}"))
        return name

    def _write(self, clip: ClipInfo, path: Path, content: str) -> str:
        """Write the file; returns what it was made of."""
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.to == "original":
            data = read_bytes(clip.path)
            if clip.path.lower().endswith(".amc"):
                self._copy_skeleton(clip, path)
            with atomic_write(path) as file:
                file.write(data)
            return "file"
        from dousa.formats import write_motion

        motion, origin = self._read(clip, content)
        if self.character is not None:
            from dousa.motion import retarget

            motion = retarget(motion, self.character).motion
        write_motion(motion, path)
        return origin

    def _copy_skeleton(self, clip: ClipInfo, path: Path) -> None:
        from dousa.formats.asf_amc.reading import find_skeleton

        skeleton = find_skeleton(clip.path)
        with atomic_write(path.parent / os.path.basename(skeleton)) as file:
            file.write(read_bytes(skeleton))

    def _read(self, clip: ClipInfo, content: str) -> tuple[Motion | Trajectories, str]:
        """The motion of the file as it was added, else the joints that the library keeps."""
        if not os.path.exists(clip.path):
            return self.library.trajectories(clip.id), "stored joints"
        from dousa.formats import read_motion

        options = _parse_options(content.partition(" ")[2])
        return read_motion(clip.path, unit=options.unit, up=options.up), "file"

    def write_manifest(self) -> None:
        """The list of what is in the folder, in the order of the names."""
        if not self.rows:
            return
        text = io.StringIO()
        table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(row for name, row in sorted(self.rows.items()) if (self.folder / name).is_file())
        with atomic_write(self.folder / MANIFEST) as file:
            file.write(text.getvalue().encode())


def _describe(clip: ClipInfo, name: str, made_of: str, origin: str) -> dict[str, str]:
    return {
        "file": name,
        "id": str(clip.id),
        "kind": clip.kind,
        "category": clip.category or "",
        "performer": clip.performer or "",
        "n_frames": str(clip.n_frames),
        "frame_rate": repr(clip.frame_rate),
        "duration_s": f"{clip.duration:.6g}",
        "source": clip.path,
        "from": origin,
        "made_of": made_of,
    }


def _suffix_of(path: str) -> str:
    """What a name ends in, both suffixes of a packed file."""
    stem, suffix = os.path.splitext(path)
    return os.path.splitext(stem)[1] + suffix if suffix.lower() in (".gz", ".zip") else suffix


def _safe(part: str) -> str:
    """A name that any disk takes."""
    return _UNSAFE.sub("_", part).strip(". ")[:150] or "clip"


def _parse_options(text: str) -> ReadOptions:
    given = json.loads(text) if text else {}
    return ReadOptions(unit=given.get("unit"), up=given.get("up"))


def _read_manifest(path: Path) -> dict[str, dict[str, str]]:
    """Rows by file of an earlier run; none if there is no list, or another's."""
    try:
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    return {
        row["file"]: row for row in rows if set(row) == set(COLUMNS) and all(isinstance(v, str) for v in row.values())
    }
