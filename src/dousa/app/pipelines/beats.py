"""The part of ``dousa evaluate`` that is about music: options, beats from a file, and the timing of the accents."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import InvalidMotionError, OptionError

if TYPE_CHECKING:
    from dousa.app.pipelines.evaluate import Evaluation
    from dousa.evaluation import Assessment, Beats, BeatTiming


def check_beat_options(music: Path | None, beats: Path | None, start_s: float | None, repetitions: bool) -> None:
    """Whether the options go together, before the long work.

    Raises
    ------
    OptionError : two sources of beats, a start without one, or either with ``--repetitions``.
    """
    if music is not None and beats is not None:
        raise OptionError("beats.one_source")
    if start_s is not None and music is None and beats is None:
        raise OptionError("beats.start_with")
    if repetitions and (music is not None or beats is not None):
        raise OptionError("beats.not_with", option="--music" if beats is None else "--beats")


def load_beats(music: Path | None, beats: Path | None) -> Beats | None:
    """The beats of a sound file or of a text file; None if there is neither."""
    from dousa.evaluation import find_beats, read_beats

    if beats is not None:
        return read_beats(beats)
    return None if music is None else find_beats(music)


def time_accents(done: Evaluation[Assessment], beats: Beats, start_s: float | None) -> BeatTiming:
    """The accents of the performance of an evaluation against the beats.

    Raises
    ------
    DousaError : as `dousa.evaluation.assess_timing`, with the name of the file.
    """
    from dousa.evaluation import assess_timing

    try:
        return assess_timing(done.motion, beats, music_start_s=start_s)
    except InvalidMotionError as error:
        raise InvalidMotionError("cli.file_problem", path=done.performance, reason=error.located) from error
