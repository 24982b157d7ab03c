"""Where the labels of takes are found when the takes are added.

A rule is written as a short text:

``beside``        a table that lies beside the take and has its name: ``NAME.labels.csv``, ``NAME.eaf`` (ELAN),
                  ``NAME.TextGrid`` (Praat), ``NAME.boris.csv``, or a table of labels ``NAME.csv``; or .tsv
``folder:FOLDER`` the same in another folder
``csv:FILE``      one file for all takes: a table with a column ``path`` or ``file`` beside those of the labels, an
                  export of BORIS, whose observations are called as the takes, or a list of CMU (``mocap.txt``)
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dousa.errors import OptionError
from dousa.formats.annotations import LABEL_SUFFIXES, LabelFile, LabelTier, is_label_file, read_label_file
from dousa.formats.annotations.label_file import choose_tier
from dousa.formats.annotations.tables import about_one_take
from dousa.formats.motion_files import FoundFile
from dousa.messages import Message

_TABLES = (".csv", ".tsv")  # which may be a recording too


@dataclass(frozen=True, slots=True)
class FoundLabels:
    """Labels of a take.

    Parameters
    ----------
    file : that they are in.
    tiers : of this take.
    notes : doubts about whether they are of this take.
    """

    file: LabelFile
    tiers: tuple[LabelTier, ...]
    notes: tuple[Message, ...] = ()


def find_labels(files: Sequence[FoundFile], rule: str, tier: str | None) -> dict[str, FoundLabels]:
    """Labels by the path of the take; every table is read, before anything else is done with them.

    Parameters
    ----------
    files : the takes.
    rule : see the head of this module.
    tier : name of the tier that is wanted, None for the first that has labels.

    Raises
    ------
    OptionError : a rule that cannot be understood, no labels of any take, two tables of one take, no such tier.
    MotionFileError : a table that cannot be read, with its line.
    """
    kind, _, rest = rule.partition(":")
    if (kind, rest) != ("beside", "") and not (kind in ("folder", "csv") and rest):
        raise OptionError("annotations.unknown_rule", text=rule)
    found: dict[str, FoundLabels] = {}
    called: dict[tuple[str, str], list[str]] = {}  # takes by the table and what it calls them
    if kind == "csv":
        file = read_label_file(os.path.expanduser(rest))
        for one in files:
            name = file.name_of(one.path, one.root if one.root != one.path else None)
            if name is not None:
                found[str(one.path)] = FoundLabels(file, file.takes[name])
                called.setdefault((file.path, name), []).append(str(one.path))
        if files and not found:
            raise OptionError(
                "annotations.none_in_file", path=file.path, takes=list(file.takes), name=files[0].path.name
            )
    else:
        where = _Folders(Path(os.path.expanduser(rest)) if rest else None)
        for one in files:
            path = where.find(one.path)
            if path is not None:
                file = about_one_take(read_label_file(path))
                tiers = file.tiers_of(one.path)
                if tiers is not None:
                    found[str(one.path)] = FoundLabels(file, tiers)
                    if kind == "folder":
                        called.setdefault((file.path, path.name), []).append(str(one.path))
        if files and not found:
            stem = files[0].path.name.partition(".")[0]
            raise OptionError("annotations.none_beside", folder=rest or files[0].path.parent, stem=stem)
    for labels in found.values():
        choose_tier(labels.file, labels.tiers, tier)  # whether it is there
    _note_names(found, called)
    return found


def _note_names(found: dict[str, FoundLabels], called: Mapping[tuple[str, str], Sequence[str]]) -> None:
    """Say of takes in different folders that one name of a table means them all."""
    for (table, name), takes in called.items():
        if len({os.path.dirname(take) for take in takes}) > 1:  # one take in two formats lies in one folder
            values = {"n": len(takes), "takes": takes[:4], "name": name or os.path.basename(table)}
            note = Message("annotations.one_name", path=table, **values)
            found.update({take: replace(found[take], notes=(note,)) for take in takes})


class _Folders:
    """Tables beside takes, or in one folder; names in any case."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._names: dict[Path, dict[str, str]] = {}

    def find(self, take: Path) -> Path | None:
        """The table of a take, if there is one."""
        folder = self._folder or take.parent
        names = self._list(folder)
        stems = list(dict.fromkeys((take.name.partition(".")[0].lower(), take.stem.lower())))
        found = [folder / names[stem + suffix] for stem in stems for suffix in LABEL_SUFFIXES if stem + suffix in names]
        if not found:
            tables = [folder / names[stem + suffix] for stem in stems for suffix in _TABLES if stem + suffix in names]
            found = [path for path in tables if path != take and is_label_file(path)]
        found = list(dict.fromkeys(found))
        if len(found) > 1:
            raise OptionError("annotations.two_tables", take=take, found=[path.name for path in found])
        return found[0] if found else None

    def _list(self, folder: Path) -> dict[str, str]:
        if folder not in self._names:
            try:
                self._names[folder] = {name.lower(): name for name in sorted(os.listdir(folder))}
            except OSError as error:
                raise OptionError("annotations.no_folder", folder=folder, reason=error) from error
        return self._names[folder]
