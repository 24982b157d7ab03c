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
    ├── CalibrationError        a camera that cannot be: its file, its numbers, or its views disagree
    ├── BodyModelError          a body model that cannot be: its file, its measures, or its tree
    ├── OptionError             a command or function was called with a value outside its range
    └── MissingExtraError       an optional package is not installed; says the pip command

Messages say what was expected, what came, where, and the remedy:
``walk.bvh:41: expected 66 channel values, got 63; is the file truncated?``
"""

from __future__ import annotations

import os

__all__ = [
    "BodyModelError",
    "CalibrationError",
    "DousaError",
    "InvalidMotionError",
    "JointMappingError",
    "LibraryDamagedError",
    "LibraryError",
    "LibraryLockedError",
    "LibraryVersionError",
    "MissingExtraError",
    "MotionFileError",
    "MotionWriteError",
    "NotTrainedError",
    "OptionError",
    "SilhouetteError",
    "TrainingError",
    "UnknownFormatError",
]


class DousaError(Exception):
    """Base of all errors that a person can put right."""


class MotionFileError(DousaError):
    """A motion file cannot be read or written.

    Parameters
    ----------
    path : the file.
    problem : what was expected, what came and what to do.
    line : 1-based line of a text file, where known.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str, line: int | None = None) -> None:
        self.path = os.fspath(path)
        self.problem = problem
        self.line = line
        where = self.path if line is None else f"{self.path}:{line}"
        super().__init__(f"{where}: {problem}")

    def __reduce__(self) -> tuple[type, tuple[str, str, int | None]]:
        return type(self), (self.path, self.problem, self.line)


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
    problem : what is missing.
    joints : the names the motion has, so that a joint map can be written.
    """

    def __init__(self, problem: str, joints: tuple[str, ...] = ()) -> None:
        self.problem = problem
        self.joints = tuple(joints)
        has = f"; the joints are: {', '.join(self.joints)}" if self.joints else ""
        super().__init__(f"{problem}{has}")

    def __reduce__(self) -> tuple[type, tuple[str, tuple[str, ...]]]:
        return type(self), (self.problem, self.joints)


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


class SilhouetteError(DousaError, ValueError):
    """Masks or videos that no silhouettes can be had from."""


class CalibrationError(DousaError, ValueError):
    """A camera that cannot be: its file, its numbers, or views that disagree with it."""


class BodyModelError(DousaError, ValueError):
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
        super().__init__(f"{package} is not installed; run: pip install 'dousa[{extra}]'")
