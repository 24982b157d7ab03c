"""Every error that dousa raises on purpose.

    DousaError                  something a person can put right; the message says how
    ├── MotionFileError         a motion file cannot be read or written: path, line
    │   ├── UnknownFormatError  no reader or writer for this kind of file
    │   └── MotionWriteError    the motion does not fit the format, or the disk refuses
    ├── InvalidMotionError      arrays that do not make a skeleton, motion or trajectory (a ValueError too)
    ├── JointMappingError       the joints of a file cannot be told apart
    ├── LibraryError            a motion library cannot be opened, read or written
    │   ├── LibraryLockedError
    │   ├── LibraryDamagedError
    │   └── LibraryVersionError
    ├── TrainingError           the clips at hand cannot train or test anything
    ├── NotTrainedError         the forest is asked before it was trained
    ├── SilhouetteError         masks or videos that no silhouettes can be had from
    ├── KeypointError           keypoints that cannot be had: their file, their numbers, the models that find them
    ├── CalibrationError        a camera that cannot be: its file, its numbers, or its views disagree
    ├── BodyModelError          a body model that cannot be: its file, its measures, or its tree
    ├── ClusterError            a cluster of workers cannot be reached, or is not as it must be
    ├── OptionError             a command or function was called with a value outside its range
    └── MissingExtraError       an optional package is not installed; says the pip command

Messages say what was expected, what came, where, and the remedy:
``walk.bvh:41: expected 66 channel values, got 63; is the file truncated?``
"""

from __future__ import annotations

import os
from typing import Any, Self

from dousa.messages import Message


class DousaError(Exception):
    """Base of all errors that a person can put right: a code with values, in words where it is read.

    Parameters
    ----------
    code : of the tables of `dousa.messages`, or a whole message.
    values : what its sentence names.
    """

    def __init__(self, code: str | Message, /, **values: Any) -> None:
        self.message = code if isinstance(code, Message) else Message(code, **values)
        super().__init__(self.message)

    @property
    def code(self) -> str:
        """Which error it is, among those of all rooms."""
        return self.message.code

    @property
    def located(self) -> Message:
        """The message with the file and the line that it is about, where they are known."""
        path, line = getattr(self, "path", None), getattr(self, "line", None)
        if not path:
            return self.message
        if line is None:
            return Message("text.in_file", path=path, problem=self.message)
        return Message("text.in_line", path=path, line=line, problem=self.message)

    def render(self, language: str | None = None) -> str:
        """The sentence, in a language of `dousa.messages.LANGUAGES` or in the one in use."""
        return self.located.render(language)

    def to_json(self) -> dict[str, Any]:
        """Code and values, as `Message.to_json` gives them."""
        return self.message.to_json()

    def __str__(self) -> str:
        return self.render()

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.__dict__)


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
    code : what was expected, what came and what to do.
    line : 1-based line of a text file, where known.
    values : what the sentence names.
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
    """The motion does not fit the format, or the disk refuses."""


class InvalidMotionError(DousaError, ValueError):
    """Arrays that do not make a skeleton, a motion or a trajectory."""


class JointMappingError(DousaError):
    """The joints of a motion cannot be told apart.

    Parameters
    ----------
    code : what is missing.
    joints : the names the motion has, so that a joint map can be written.
    values : what the sentence names.

    ``path`` is the file, set by whoever read it.
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


class TrainingError(DousaError):
    """The clips at hand cannot train or test anything."""


class NotTrainedError(DousaError):
    """The forest is asked before it was trained."""


class _LocatableError(DousaError, ValueError):
    """An error that gets its place where the file is known; what is rendered begins with it."""

    path: str = ""
    line: int | None = None

    def at(self, path: str | os.PathLike[str] = "", line: int | None = None) -> Self:
        """The same error with the place that it does not have yet: the file, the 1-based line."""
        self.path = self.path or os.fspath(path)
        self.line = line if self.line is None else self.line
        return self

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "path": self.path or None, "line": self.line}


class SilhouetteError(_LocatableError):
    """Masks or videos that no silhouettes can be had from."""


class KeypointError(_LocatableError):
    """Keypoints that cannot be had: their file, their numbers, or the models that find them."""


class CalibrationError(_LocatableError):
    """A camera that cannot be: its file, its numbers, or views that disagree with it."""


class ClusterError(DousaError):
    """A cluster of workers cannot be reached, is gone, or is of another version."""


class BodyModelError(_LocatableError):
    """A body model that cannot be: its file, its measures, or its tree."""


class OptionError(DousaError, ValueError):
    """A command or function was called with a value outside its range."""


class MissingExtraError(DousaError, ImportError):
    """An optional package is not installed.

    Parameters
    ----------
    package : what is missing.
    extra : the extra of dousa that brings it.
    """

    def __init__(self, package: str, extra: str) -> None:
        super().__init__("extras.missing", package=package, extra=extra)
