"""Where exported files go: a folder, or a ZIP file that is put together in a hidden folder beside it.

Either has a ``manifest.csv`` that lists what is in it. Each file appears whole or not at all.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
import zipfile
from pathlib import Path

from dousa.errors import OptionError
from dousa.files.disk import atomic_write, write_error

MANIFEST = "manifest.csv"
COLUMNS = (
    "file", "id", "kind", "category", "performer", "tags", "n_frames", "frame_rate", "duration_s", "source", "start_s",
    "end_s", "from", "made_of",
)  # fmt: skip

Rows = dict[str, dict[str, str]]
"""Rows of the manifest by file."""


class Destination:
    """A folder that files are written to.

    Parameters
    ----------
    path : of the folder; made when the first file is.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.folder = path, path
        if path.exists() and not path.is_dir():
            raise OptionError("export.no_folder", path=path)

    def open(self) -> Rows:
        """What an earlier run has left; OptionError where the list that is there is not ours."""
        rows = read_manifest(self.folder / MANIFEST)
        if not rows and _holds_text(self.folder / MANIFEST):
            raise OptionError("export.other_manifest", path=self.folder / MANIFEST)
        return {name: row for name, row in rows.items() if (self.folder / name).is_file()}

    def prepare(self, name: str) -> Path:
        """Where a file of this name, with folders and ``/``, is to be written."""
        path = self.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise write_error(path, error) from error
        return path

    def is_foreign(self, name: str, rows: Rows) -> bool:
        """Whether a file of this name is there that no export has written, such as a recording itself."""
        return name not in rows and (self.folder / name).exists()

    def remove(self, name: str) -> None:
        """Take away a file that was written."""
        (self.folder / name).unlink(missing_ok=True)

    def write_manifest(self, rows: Rows) -> None:
        """The list of what is there, in the order of the names; none of nothing."""
        if not rows:
            return
        text = io.StringIO()
        table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(row for name, row in sorted(rows.items()) if (self.folder / name).is_file())
        with atomic_write(self.folder / MANIFEST) as file:
            file.write(text.getvalue().encode())

    def close(self, extras: tuple[str, ...] = ()) -> None:
        """Finish what is there, with files besides those of the manifest."""


class ZipDestination(Destination):
    """A ZIP file.

    Until it is whole its files are in a hidden folder beside it, where an interrupted export is taken up again.

    Parameters
    ----------
    path : of the file; one that an earlier export has written is continued, any other is refused.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.parent / f".{path.name[:100]}.parts"

    def is_foreign(self, name: str, rows: Rows) -> bool:
        """No: nobody else writes into the hidden folder."""
        return False

    def open(self) -> Rows:
        """What an earlier run has left, unpacked."""
        if self.path.exists():
            self._unpack()
        return super().open()

    def _unpack(self) -> None:
        try:
            with zipfile.ZipFile(self.path) as archive:
                if MANIFEST not in archive.namelist():
                    raise OptionError("export.other_zip", path=self.path)
                for name in archive.namelist():
                    if not name.endswith("/") and not (self.folder / name).exists():
                        archive.extract(name, self.folder)  # which leaves out .. and the roots of disks
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


def choose_destination(path: str | os.PathLike[str]) -> Destination:
    """A folder, or a ZIP file if the name ends so."""
    target = Path(path)
    return ZipDestination(target) if target.suffix.lower() == ".zip" and not target.is_dir() else Destination(target)


def _holds_text(path: Path) -> bool:
    """Whether there is more in a file than our heading."""
    heading = ",".join(COLUMNS).encode()
    try:
        with open(path, "rb") as file:
            return file.read(len(heading) + 9).strip() not in (b"", heading)
    except OSError:
        return False


def read_manifest(path: Path) -> Rows:
    """Rows by file of an earlier run; none if there is no list, or another's."""
    try:
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    rows = [{"tags": "", **row} for row in rows]  # an earlier version had none
    return {
        row["file"]: row for row in rows if set(row) == set(COLUMNS) and all(isinstance(v, str) for v in row.values())
    }
