"""Errors that dousa raises on purpose.

    DousaError                  something the user can fix; the message has the remedy
    ├── MotionFileError         a motion file cannot be read or written: path, line
    │   ├── UnknownFormatError  no reader or writer for this kind of file
    │   └── MotionWriteError    the motion does not fit the format, or a disk error
    ├── InvalidMotionError      arrays that do not make a skeleton, motion or trajectory (a ValueError too)
    ├── JointMappingError       the joints of a file cannot be mapped
    ├── LibraryError            a motion library cannot be opened, read or written
    │   ├── LibraryLockedError
    │   ├── LibraryDamagedError
    │   └── LibraryVersionError
    ├── TrainingError           the available clips cannot train or test anything (a ValueError too)
    ├── NotTrainedError         the forest was used before training
    ├── SilhouetteError         masks or videos that give no silhouettes
    ├── KeypointError           bad keypoints: their file, their numbers, or their models
    ├── CalibrationError        a bad camera: its file, its numbers, or its views disagree
    ├── BodyModelError          a bad body model: its file, its measures, or its tree
    ├── ClusterError            a cluster of workers cannot be reached or used
    ├── OptionError             a value outside its range
    └── MissingExtraError       an optional package is not installed; with the pip command

Messages have the expected and the found value, the place, and the remedy:
``walk.bvh:41: expected 66 channel values, got 63; is the file truncated?``
"""

from __future__ import annotations

import os
from typing import Any, Self

from dousa.messages import Message


class DousaError(Exception):
    """Base of all errors that the user can fix: a code with values, rendered when read.

    Parameters
    ----------
    code : of the tables of `dousa.messages`, or a whole message.
    values : of its sentence.
    """

    def __init__(self, code: str | Message, /, **values: Any) -> None:
        self.message = code if isinstance(code, Message) else Message(code, **values)
        super().__init__(self.message)

    @property
    def code(self) -> str:
        """Code of the message."""
        return self.message.code

    @property
    def located(self) -> Message:
        """The message with its file and line, where known."""
        path, line = getattr(self, "path", None), getattr(self, "line", None)
        if not path:
            return self.message
        if line is None:
            return Message("text.in_file", path=path, problem=self.message)
        return Message("text.in_line", path=path, line=line, problem=self.message)

    def render(self, language: str | None = None) -> str:
        """Return the sentence, in a language of `dousa.messages.LANGUAGES` or in the one in use."""
        return self.located.render(language)

    def to_json(self) -> dict[str, Any]:
        """Return code and values, as in `Message.to_json`."""
        return self.message.to_json()

    def __str__(self) -> str:
        return self.render()

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.__dict__)


def is_interrupt(error: BaseException) -> bool:
    """Return whether an error is Ctrl-C, or that as a compiled loop passes it on: as the first cause of another."""
    while isinstance(error, SystemError) and error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def _rebuild(kind: type[DousaError], state: dict[str, Any]) -> DousaError:
    error = kind.__new__(kind)
    error.__dict__.update(state)
    error.args = (state["message"],)
    return error


class MotionFileError(DousaError):
    """A motion file cannot be read or written.

    Parameters
    ----------
    path : the file.
    code : of the problem and its remedy.
    line : 1-based line of a text file, where known.
    values : of the sentence.
    """

    def __init__(
        self, path: str | os.PathLike[str], code: str | Message, /, line: int | None = None, **values: Any
    ) -> None:
        super().__init__(code, **values)
        self.path = os.fspath(path)
        self.line = line

    @property
    def problem(self) -> str:
        """The sentence without the place."""
        return self.message.render()

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "path": self.path, "line": self.line}


class UnknownFormatError(MotionFileError):
    """No reader or writer for this kind of file."""


class MotionWriteError(MotionFileError):
    """The motion does not fit the format, or a disk error."""


class InvalidMotionError(DousaError, ValueError):
    """Arrays that do not make a skeleton, a motion or a trajectory."""


class JointMappingError(DousaError):
    """The joints of a motion cannot be mapped. ``path`` is the file, set by its reader.

    Parameters
    ----------
    code : of the problem.
    joints : names in the motion, for a joint map.
    values : of the sentence.
    """

    def __init__(self, code: str | Message, /, joints: tuple[str, ...] = (), **values: Any) -> None:
        super().__init__(code, **values)
        self.path: str | None = None
        self.problem = self.message
        self.joints = tuple(joints)
        if self.joints:
            self.message = Message("joints.has", problem=self.message, joints=self.joints)

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "path": self.path}


class LibraryError(DousaError):
    """A motion library cannot be opened, read or written."""


class LibraryLockedError(LibraryError):
    """Another program is writing to the library."""


class LibraryDamagedError(LibraryError):
    """The file is not a library, or its content is damaged."""


class LibraryVersionError(LibraryError):
    """The library was written by a newer dousa."""


class TrainingError(DousaError, ValueError):
    """The clips at hand cannot train or test anything."""


class NotTrainedError(DousaError):
    """The forest is asked before it was trained."""


class _LocatableError(DousaError, ValueError):
    """An error whose file is set later; the rendered message begins with it."""

    path: str = ""
    line: int | None = None

    def at(self, path: str | os.PathLike[str] = "", line: int | None = None) -> Self:
        """Set the file and the 1-based line where they are missing, and return the error."""
        self.path = self.path or os.fspath(path)
        self.line = line if self.line is None else self.line
        return self

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "path": self.path or None, "line": self.line}


class SilhouetteError(_LocatableError):
    """Masks or videos that give no silhouettes."""


class KeypointError(_LocatableError):
    """Bad keypoints: their file, their numbers, or their models."""


class CalibrationError(_LocatableError):
    """A bad camera: its file, its numbers, or views that disagree with it."""


class ClusterError(DousaError):
    """A cluster of workers cannot be reached, is gone, or is of another version."""


class BodyModelError(_LocatableError):
    """A bad body model: its file, its measures, or its tree."""


class OptionError(DousaError, ValueError):
    """A value outside its range."""


class MissingExtraError(DousaError, ImportError):
    """An optional ``package`` is not installed; ``extra`` of dousa installs it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__("extras.missing", package=package, extra=extra)
