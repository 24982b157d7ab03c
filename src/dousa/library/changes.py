"""Manual changes of a motion library, and undo."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from dousa.errors import LibraryError, OptionError
from dousa.library.contents import LibraryContents
from dousa.library.label_rules import check_labels
from dousa.library.store import selection as _selection
from dousa.library.store.engine import next_revision
from dousa.library.store.selection import UNCHANGED, Selection, Unchanged, select_ids

if TYPE_CHECKING:
    from dousa.library.care.backup import BackupReport
    from dousa.library.care.compact import CompactReport
    from dousa.library.care.damage import CheckReport
    from dousa.library.history.journal import JournalEntry
    from dousa.messages import Progress

_FULL = ("library_file.disk_full", "library_file.server_disk_full", "library_file.disk_failed")


class LibraryChanges(LibraryContents):
    """The part of `dousa.library.Library` that removes, labels and tags clips, with the undo journal."""

    def remove(
        self,
        selection: Selection = (),
        *,
        category: str | None = None,
        performer: str | None = None,
        tag: str | None = None,
        for_good: bool = False,
    ) -> list[str]:
        """Remove clips or takes from the library; their files stay on disk.

        The forest keeps what it learned from them until the next training. ``undo`` restores them, unless ``compact``
        ran since. The place of a removed segment of a take with a table of labels becomes undecided; without segments
        the take has no labels.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer, tag : only clips of this label, with this tag.
        for_good : keep nothing for an undo, which takes as much disk space as the removed clips.

        Returns
        -------
        Paths of the removed clips.

        Raises
        ------
        OptionError : nothing is chosen.
        LibraryError : something chosen is not there, or the library cannot be written.

        >>> len(library.remove(category="squat"))
        4
        """
        from dousa.library.annotations.store import find_leaving, leave_open
        from dousa.library.history.recording import recording

        try:
            with self.one_change(), self.database.writing() as connection:
                ids = select_ids(connection, self.name, selection, category, performer, tag)
                paths = _selection.list_paths(connection, ids)
                if ids:
                    revision, labelled = next_revision(connection), find_leaving(connection, ids)
                    written = recording(connection, revision, "remove", gone=ids, takes=labelled)
                    with nullcontext() if for_good else written:
                        _selection.delete_clips(connection, ids)
                        leave_open(connection, labelled)
        except LibraryError as error:
            if for_good or error.code not in _FULL:
                raise
            raise LibraryError("library_clips.no_room_for_undo", library=self.name) from error
        return paths

    def relabel(
        self,
        selection: Selection = (),
        *,
        category: str | Unchanged | None = UNCHANGED,
        performer: str | Unchanged | None = UNCHANGED,
        where_category: str | None = None,
        where_performer: str | None = None,
    ) -> list[str]:
        """Change the category or performer of clips or takes; the forest learns it in the next training.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : the new labels, None for no label.
        where_category, where_performer : only clips that have this label now.

        Returns
        -------
        Paths of the chosen clips.

        Raises
        ------
        OptionError : nothing is chosen, no new label is given, or an empty one.
        LibraryError : something chosen is not there, or the library cannot be written.

        >>> len(library.relabel(category="greeting", where_category="wave_right"))
        4
        >>> library.categories()
        {'greeting': 4, 'squat': 4, 'walk': 4}
        """
        from dousa.library.history.recording import recording

        if category is UNCHANGED and performer is UNCHANGED:
            raise OptionError("library_clips.no_new_label")
        check_labels(category, performer)
        given = {"category": category, "performer": performer}
        values = {name: label for name, label in given.items() if label is not UNCHANGED}
        with self.one_change(), self.database.writing() as connection:
            ids = select_ids(connection, self.name, selection, where_category, where_performer)
            if ids:
                revision, marked = next_revision(connection), _selection.with_segments(connection, ids)
                with recording(connection, revision, "relabel", marked=marked, values=values):
                    _selection.set_labels(connection, ids, category, performer)
            return [clip.path for clip in _selection.list_clips(connection, ids)]

    def tag(
        self,
        selection: Selection = (),
        *,
        add: Iterable[str] = (),
        remove: Iterable[str] = (),
        where_category: str | None = None,
        where_performer: str | None = None,
        where_tag: str | None = None,
    ) -> list[str]:
        """Add or remove tags of clips or takes; the forest ignores tags.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        add, remove : names of tags; ``"favourite"`` is a star in the studio.
        where_category, where_performer, where_tag : only clips of this label, with this tag.

        Returns
        -------
        Paths of the clips whose tags changed.

        Raises
        ------
        OptionError : nothing is chosen, no tag is given, or an invalid one.
        LibraryError : something chosen is not there, or the library cannot be written.

        >>> len(library.tag(where_category="walk", add=["favourite"]))
        4
        """
        from dousa.library.annotations.tags import change_tags, check_tags
        from dousa.library.history.recording import recording

        more, less = check_tags(add), check_tags(remove)
        if not more and not less:
            raise OptionError("library_tags.nothing_to_change")
        values = {"tags": [*(f"+{name}" for name in more), *(f"-{name}" for name in less)]}
        with self.one_change(), self.database.writing() as connection:
            ids = select_ids(connection, self.name, selection, where_category, where_performer, where_tag)
            with recording(connection, next_revision(connection), "tag", marked=ids, values=values):
                changed = change_tags(connection, ids, more, less)
            return _selection.list_paths(connection, list(changed))

    def tags(self) -> dict[str, int]:
        """Return the number of clips and takes of each tag.

        >>> changed = library.tag([1, 2], add=["favourite"])
        >>> library.tags()
        {'favourite': 2}
        """
        from dousa.library.annotations.tags import count_tags

        with self.database.reading() as connection:
            return count_tags(connection)

    def journal(self) -> list[JournalEntry]:
        """Return the changes that can be undone or redone, the last first.

        The last 1,000 are kept, with removed clips of up to 1 GB, until ``compact``.

        >>> removed = library.remove(category="squat")
        >>> entry = library.journal()[0]
        >>> entry.kind, entry.n_clips
        ('remove', 4)
        """
        from dousa.library.history.journal import list_entries

        with self.database.reading() as connection:
            return list_entries(connection)

    def removed_paths(self) -> list[str]:
        """Return the paths of the removed clips that are kept for ``undo``.

        >>> library.remove(1) == library.removed_paths()
        True
        """
        from dousa.library.history.journal import list_kept_paths

        with self.database.reading() as connection:
            return list_kept_paths(connection)

    @property
    def last_change(self) -> int | None:
        """Number of this thread's last change with ``add``, ``add_motion``, ``relabel``, ``tag``, ``remove`` or
        ``annotations``; None if that changed nothing.

        >>> removed = library.remove(1)
        >>> library.last_change == library.journal()[0].number
        True
        """
        return getattr(self._last, "change", None)

    @contextmanager
    def one_change(self, kind: str | None = None, **values: Any) -> Iterator[None]:
        """Make this thread's changes inside the block one step of undo and redo.

        Changes before an error stay, as the change of ``last_change``. Within a block a clip can be changed once.
        ``kind`` and message values as in ``JournalEntry``; by default those of its first part.

        >>> with library.one_change():
        ...     changed = library.relabel(1, category="bow"), library.tag(2, add=["favourite"])
        >>> undone = library.undo()
        >>> library.tags()
        {}
        """
        from dousa.library.history.recording import recording_together

        with recording_together(self.database.engine, kind, values) as whole:
            try:
                yield
            finally:
                self._last.change = whole.number

    def undo(self, number: int | None = None, *, n_jobs: int | None = None) -> JournalEntry:
        """Undo a change: restore labels, tags, takes and removed clips.

        What a forest learned from added clips stays until the next training.

        Parameters
        ----------
        number : of a change, by default the last one in force that this user made on this machine.
        n_jobs : takes described at a time, as in ``add``.

        Raises
        ------
        LibraryError : there is nothing to undo but changes of others, or the same clips were changed since; nothing
            changes.

        >>> removed = library.remove(category="squat")
        >>> library.undo().is_undone, len(library.clips())
        (True, 12)
        """
        return self._step(number, redo=False, n_jobs=n_jobs)

    def redo(self, number: int | None = None, *, n_jobs: int | None = None) -> JournalEntry:
        """Redo an undone change, as long as no new one was made; parameters and errors as in ``undo``.

        >>> removed, undone = library.remove(category="squat"), library.undo()
        >>> library.redo().is_undone, len(library.clips())
        (False, 8)
        """
        return self._step(number, redo=True, n_jobs=n_jobs)

    def _step(self, number: int | None, *, redo: bool, n_jobs: int | None) -> JournalEntry:
        from dousa.library.history.recording import step
        from dousa.library.takes.windows import refresh_windows

        entry = step(self.database, number, redo=redo)
        with self.database.reading() as connection:
            stored = self._forests.renew(connection)
        if stored is not None:
            refresh_windows(self.database, stored, n_jobs)
        return entry

    def check(self, *, repair: bool = False, salvage: bool = True, progress: Progress | None = None) -> CheckReport:
        """Check that the library is as it was written: the structure of the file, and every checksum.

        Parameters
        ----------
        repair : compute features, leaves and windows again, and read positions again from the original files.
        salvage : rewrite a file whose structure is damaged, while no other program has it open. If false, nothing of
            such a file is repaired.
        progress : called with (rows done, rows, message about the step).

        Raises
        ------
        LibraryError : to be repaired, but cannot be written.

        >>> library.check().damage
        ()
        """
        from dousa.library.care.repair import check_library

        if repair and self.database.is_read_only:
            raise LibraryError("library_file.opened_read_only", library=self.name)
        return check_library(self.database, repair, progress, salvage)

    def compact(self, *, fragments: str | None = None, progress: Progress | None = None) -> CompactReport:
        """Shrink the file to its contents, without the room of removed clips.

        Removed clips kept for ``undo`` are deleted, with the changes that need them.

        Needs free space of the final size. Others may read meanwhile, and write afterwards; if interrupted, the file is
        unchanged.

        Parameters
        ----------
        fragments : where to move positions and features, and to write new ones: ``""`` for a folder beside the library
            file; of a library on a server, a shared folder, or a URL such as ``s3://bucket/moves``. If interrupted,
            repeat the call to go on. None leaves them in place.
        progress : called with (kB done, kB, message about the step).

        Raises
        ------
        LibraryError : cannot be written, too little free space, a database server without fragments (it manages its own
            space), or a place for fragments that does not fit the library.

        >>> report = library.compact()
        """
        from dousa.library.care.compact import compact_library

        return compact_library(self.database, fragments, progress)

    def backup(self, to: str | os.PathLike[str], *, progress: Progress | None = None) -> BackupReport:
        """Copy the library as of one moment to a new file, with fragments beside it where this one has some.

        Others may write meanwhile. The copy is a library itself, also that of a library on a server. It gets its name
        after everything in it was compared with its checksums; if interrupted, call it again.

        Parameters
        ----------
        to : path of a new file.
        progress : called with (pages or rows done, all, message about the step).

        Raises
        ------
        LibraryError : there is a file already, or no room; LibraryDamagedError if something in the library is damaged.

        >>> library.backup("copy.dousa").n_clips
        12
        """
        from dousa.library.care.backup import back_up

        return back_up(self.database, to, progress)

    @staticmethod
    def restore(
        backup: str | os.PathLike[str], to: str | os.PathLike[str], *, progress: Progress | None = None
    ) -> BackupReport:
        """Put a copy of a library in the place of a library, which is kept in a folder, or into an empty database.

        No other program may have that library open.

        Parameters
        ----------
        backup : path of ``backup``, or of any library file; it stays as it is.
        to : path of a library or of none yet; or the URL of an empty database, where the arrays of fragments go to
            rows.
        progress : as in ``backup``.

        Raises
        ------
        LibraryError : the copy is missing or damaged, the library is in use, or the database is not empty.

        >>> copied = library.backup("copy.dousa")
        >>> dousa.Library.restore("copy.dousa", "moves again.dousa").n_clips
        12
        """
        from dousa.library.care.backup import restore

        return restore(backup, to, progress)
