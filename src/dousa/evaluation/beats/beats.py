"""Beats of a piece of music, and how early or late the accents of a dance are to them.

A beats file has one time in seconds a line. The rest of the line, after a comma, semicolon, space or tab, is a label:
so Sonic Visualiser, madmom and ``librosa`` write beats, and Audacity its label tracks (start, end, label). A heading,
empty lines, lines that begin with ``#`` and Audacity's lines of frequencies (``\\``) are skipped. Beats of a recording
are those of `librosa.beat.beat_track` (the extra ``music``) on a grid of 12 ms: D. P. W. Ellis, "Beat tracking by
dynamic programming", Journal of New Music Research 36(1), 51-60, 2007.

The place of an accent between its two beats is an angle, and the agreement of the accents is the length of the mean of
these angles' unit vectors (Rayleigh's statistic): a dancer who is late throughout agrees with the music as well as one
who is on the beat, and the lateness is the direction of that mean. Source: K. V. Mardia, P. E. Jupp, "Directional
Statistics", Wiley 2000, section 6.3.1 (Rayleigh's test).
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.evaluation.beats.accents import Accent, find_accents
from dousa.extras import require
from dousa.files.disk import read_small_text
from dousa.files.json_values import round_number
from dousa.messages import Message
from dousa.motion import CanonicalMotion

_SEPARATOR = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True, eq=False)
class Beats:
    """Beats of a piece of music.

    Parameters
    ----------
    times : (B,) s from the beginning of the music, rising.
    """

    times: FloatArray

    def __post_init__(self) -> None:
        times = np.array(self.times, np.float64)
        fewest, closest_s = 4, 0.1  # fewer beats give no tempo; 600 a minute are none
        if times.ndim != 1 or len(times) < fewest:
            raise OptionError("beats.too_few", least=fewest, n=times.size)
        if not np.isfinite(times).all():
            raise OptionError("beats.not_finite", number=int(np.flatnonzero(~np.isfinite(times))[0]) + 1)
        close = np.flatnonzero(np.diff(times) < closest_s)
        if len(close):
            first = int(close[0])
            code = "beats.unsorted" if times[first + 1] <= times[first] else "beats.too_close"
            raise OptionError(code, number=first + 2, time=float(times[first + 1]), before=float(times[first]))
        times.flags.writeable = False
        object.__setattr__(self, "times", times)

    @property
    def period_s(self) -> float:
        """Median time from one beat to the next."""
        return float(np.median(np.diff(self.times)))

    @property
    def tempo(self) -> float:
        """Beats a minute."""
        return 60.0 / self.period_s


def to_beats(beats: Beats | ArrayLike) -> Beats:
    """Make beats from times in seconds.

    Raises
    ------
    OptionError : fewer than four, not in order, closer than 0.1 s, or not finite.
    """
    if isinstance(beats, Beats):
        return beats
    try:
        times = np.asarray(beats, np.float64)
    except (TypeError, ValueError) as error:
        raise OptionError("beats.no_numbers") from error
    return Beats(times)


def read_beats(path: str | os.PathLike[str], *, shown: int = 40) -> Beats:
    """Read the beats of a text file.

    Parameters
    ----------
    path : text as the module's docstring says.
    shown : letters of a wrong line that a message quotes.

    Raises
    ------
    MotionFileError : the file cannot be read; a line without a time; what `to_beats` does not take.
    """
    times: list[float] = []
    heading = False
    for number, line in enumerate(read_small_text(path).splitlines(), 1):
        content = line.strip()
        if not content or content[0] in "#\\":
            continue
        try:
            time = float(_SEPARATOR.split(content, maxsplit=1)[0].strip("\"'"))
        except ValueError:
            if times or heading:
                raise MotionFileError(path, "beats.no_time", line=number, found=repr(content[:shown])) from None
            heading = True
            continue
        if not np.isfinite(time):
            raise MotionFileError(path, "beats.no_time", line=number, found=repr(content[:shown]))
        times.append(time)
    try:
        return Beats(np.array(times))
    except OptionError as error:
        raise MotionFileError(path, error.message) from None


def find_beats(
    path: str | os.PathLike[str], *, hop: int = 256, silent: float = 1e-4, sample_rate: int = 22050
) -> Beats:
    """Find the beats of a sound file.

    Parameters
    ----------
    path : WAV, FLAC, OGG, MP3 and what else libsndfile reads; up to an hour.
    hop : samples from one value of the onset curve to the next.
    silent : share of full scale that silence stays below.
    sample_rate : Hz, of the sound as it is analysed.

    Raises
    ------
    MissingExtraError : the extra ``music`` is not installed.
    MotionFileError : no sound file, silent, too long, or without a beat.
    """
    librosa, soundfile = require("librosa", "music"), require("soundfile", "music")
    samples, rate = _read(soundfile, path)
    if not len(samples) or float(np.abs(samples).max()) < silent:
        raise MotionFileError(path, "beats.silent", seconds=len(samples) / rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of very short pieces: an error of ours follows
        samples = librosa.resample(samples, orig_sr=rate, target_sr=sample_rate)
        onsets = librosa.onset.onset_strength(y=samples, sr=sample_rate, hop_length=hop, aggregate=np.median)
        _, frames = librosa.beat.beat_track(onset_envelope=onsets, sr=sample_rate, hop_length=hop, trim=False)
    times = np.asarray(frames, np.float64) * hop / sample_rate
    try:
        return Beats(times)
    except OptionError:
        raise MotionFileError(path, "beats.no_beat", seconds=len(samples) / sample_rate) from None


def _read(soundfile: Any, path: str | os.PathLike[str], *, longest_s: float = 3600.0) -> tuple[FloatArray, int]:
    """Samples (N,) of all channels in one, and their rate."""
    try:
        with soundfile.SoundFile(os.fspath(path)) as file:
            if file.frames > longest_s * file.samplerate:
                raise MotionFileError(path, "beats.too_long", minutes=file.frames / file.samplerate / 60.0)
            samples = file.read(dtype="float32", always_2d=True)
            rate = int(file.samplerate)
    except (soundfile.SoundFileError, OSError, ValueError, TypeError) as error:
        raise MotionFileError(path, "beats.not_sound", reason=str(error)) from None
    mono: FloatArray = np.nan_to_num(samples.mean(axis=1))
    return mono, rate


_FEWEST_ACCENTS = 5  # that an answer rests on, see docs/evaluation.md
_CHANCE = 0.01  # p: agreement that chance gives as rarely as this is agreement, see docs/evaluation.md


@dataclass(frozen=True, slots=True)
class TimedAccent:
    """An accent and its beat.

    Parameters
    ----------
    accent : the accent.
    beat : number of the beat from 1; 2.5 is half way from the second to the third; None between the beats.
    beat_s : when that beat is, in the recording of the movement; None between the beats.
    off_ms : how late the accent is, negative if early; None between the beats.
    """

    accent: Accent
    beat: float | None
    beat_s: float | None
    off_ms: float | None


@dataclass(frozen=True, slots=True, eq=False)
class BeatTiming:
    """The accents of a performance against the beats of the music.

    Parameters
    ----------
    accents : within the music, in order of time.
    n_beats : of the music.
    tempo : beats a minute.
    start_s : where the music begins in the recording of the movement.
    start_estimated : whether that was found from the accents: then constant earliness or lateness is unknown.
    agreement : 0 to 1, how far the accents have the same place between the beats: 1 all of them.
    p_value : probability of such an agreement by chance.
    subdivision : 1 the accents are held against the beats, 2 against half beats.
    median_ms : how late the accents are, negative if early; nan if the start was estimated.
    spread_ms : half of the accents are within so much of the median.
    drift_ms_per_min : how much later the accents become each minute; nan for too few.
    drift_distinguishable : whether the drift is distinguishable from chance.
    """

    accents: tuple[TimedAccent, ...]
    n_beats: int
    tempo: float
    start_s: float
    start_estimated: bool
    agreement: float
    p_value: float
    subdivision: int
    median_ms: float
    spread_ms: float
    drift_ms_per_min: float
    drift_distinguishable: bool

    @property
    def on_beat(self) -> tuple[TimedAccent, ...]:
        """The accents that belong to a beat."""
        return tuple(one for one in self.accents if one.off_ms is not None)

    @property
    def follows(self) -> bool:
        """Whether the accents follow the beats better than chance would."""
        return self.p_value < _CHANCE

    @property
    def messages(self) -> tuple[Message, ...]:
        """The answer in two or three sentences."""
        return _describe(self)

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """What ``dousa evaluate --json`` says below ``beats``; what has no value is None."""
        return {
            "tempo_bpm": round(self.tempo, 2),
            "n_beats": self.n_beats,
            "music_start_s": round(self.start_s, 3),
            "music_start_estimated": self.start_estimated,
            "follows": self.follows,
            "agreement": round(self.agreement, 3),
            "p_value": float(f"{self.p_value:.3g}"),
            "subdivision": self.subdivision,
            "n_accents": len(self.accents),
            "n_on_beat": len(self.on_beat),
            "median_ms": round_number(self.median_ms, 1),
            "spread_ms": round_number(self.spread_ms, 1),
            "drift_ms_per_min": round_number(self.drift_ms_per_min, 1),
            "drift_distinguishable": self.drift_distinguishable,
            "accents": [
                {
                    "time_s": round(one.accent.time_s, 3),
                    "kind": one.accent.kind,
                    "parts": list(one.accent.parts),
                    "strength": round(one.accent.strength, 2),
                    "beat": one.beat,
                    "beat_s": None if one.beat_s is None else round(one.beat_s, 3),
                    "off_ms": round_number(one.off_ms, 1),
                }
                for one in self.accents
            ],
            "says": [message.render(language) for message in self.messages],
            "says_codes": [message.code for message in self.messages],
        }


def assess_timing(
    performance: CanonicalMotion, beats: Beats | ArrayLike, *, music_start_s: float | None = None
) -> BeatTiming:
    """Compare the accents of a performance with the beats of its music.

    Parameters
    ----------
    performance : the dance.
    beats : (B,) s from the beginning of the music, or what `read_beats` and `find_beats` give.
    music_start_s : where the music begins in the recording, s from its first frame; negative if the recording began
        later than the music. None: where the accents agree best, of equally good places the nearest to 0.

    Raises
    ------
    OptionError : beats as in `to_beats`; a start that is not finite, or at which the accents are not in the music.
    InvalidMotionError : fewer than five accents, or music shorter than they last.
    """
    known = to_beats(beats)
    if music_start_s is not None and not math.isfinite(music_start_s):
        raise OptionError("beats.start", start=music_start_s)
    accents = find_accents(performance)
    if len(accents) < _FEWEST_ACCENTS:
        raise InvalidMotionError("beats.few_accents", least=_FEWEST_ACCENTS, n=len(accents))
    _check_length(accents, known)
    start_s = _estimate_start(accents, known) if music_start_s is None else float(music_start_s)
    inside = _choose_inside(accents, known, start_s)
    if 2 * len(inside) < len(accents) or len(inside) < _FEWEST_ACCENTS:
        raise OptionError(
            "beats.elsewhere",
            n=len(accents) - len(inside),
            of=len(accents),
            start=start_s + known.times[0],
            end=start_s + known.times[-1],
        )
    return _measure(inside, known, start_s, music_start_s is None)


def _check_length(accents: Sequence[Accent], beats: Beats) -> None:
    """Whether the music is as long as the dance."""
    music_s = float(beats.times[-1] - beats.times[0])
    dance_s = accents[-1].time_s - accents[0].time_s
    if music_s + 2.0 * beats.period_s < dance_s:
        raise InvalidMotionError("beats.short", music_s=music_s, dance_s=dance_s)


def _choose_inside(accents: Sequence[Accent], beats: Beats, start_s: float) -> list[Accent]:
    """Accents from half a beat before the first beat to half a beat after the last one."""
    first, last = start_s + beats.times[[0, -1]]
    reach = 0.5 * beats.period_s
    return [one for one in accents if first - reach <= one.time_s <= last + reach]


def _count_beats(times: FloatArray, beats: Beats) -> FloatArray:
    """Times of the music (..., ) s in beats from 0, not whole; beyond the ends in the tempo of the music."""
    known, period = beats.times, beats.period_s
    inner = np.interp(times, known, np.arange(len(known), dtype=np.float64))
    before, after = np.minimum(times - known[0], 0.0), np.maximum(times - known[-1], 0.0)
    counted: FloatArray = inner + (before + after) / period
    return counted


def _estimate_start(
    accents: Sequence[Accent], beats: Beats, *, step_s: float = 0.01, good_share: float = 0.98
) -> float:
    """Where the music begins for the accents to agree with its beats.

    Accents on the beats count 1, half way between them -1; half as much is said by their half beats, so that a
    dance on both finds its place too.
    """
    # step_s: between the places where the music is tried; good_share: of the best agreement: as good
    times = np.array([one.time_s for one in accents])
    weights = np.array([0.25 + one.strength for one in accents])
    slack = beats.period_s
    earliest = times[-1] - beats.times[-1] - slack
    latest = max(times[0] - beats.times[0] + slack, earliest + beats.period_s)
    starts = np.arange(earliest, latest, step_s)
    scores = np.empty(len(starts))
    for first in range(0, len(starts), 256):
        part = starts[first : first + 256]
        angles = 2.0 * np.pi * _count_beats(times - part[:, None], beats)
        scores[first : first + 256] = (np.cos(angles) + 0.5 * np.cos(2.0 * angles)) @ weights
    best = float(scores.max())
    inner = np.r_[True, scores[1:] >= scores[:-1]] & np.r_[scores[:-1] >= scores[1:], True]
    good = starts[inner & (scores >= (good_share * best if best > 0.0 else best))]
    return float(good[np.argmin(np.abs(good))])


def _measure(
    accents: Sequence[Accent], beats: Beats, start_s: float, estimated: bool, *, window: float = 0.3
) -> BeatTiming:
    # window: of a beat to either side of where the accents are on average: what is further is between the beats
    times = np.array([one.time_s for one in accents])
    counted = _count_beats(times - start_s, beats)
    subdivision, slope, agreement, p_value = _find_agreement(counted, times, beats)
    counted = counted * subdivision
    trend = slope * (times - times.mean())  # in parts of a beat
    mean = np.angle(np.exp(2j * np.pi * (counted - trend)).mean()) / (2.0 * np.pi)
    places = np.round(counted - trend - mean)
    off = counted - places
    near = np.abs(off - trend - mean) <= window
    beat_s = start_s + _time_of(places / subdivision, beats)
    off_ms = 1000.0 * (times - beat_s)
    if estimated and near.any():  # the middle of the accents is where the beat is
        shift = float(np.median(off_ms[near]))
        start_s, beat_s, off_ms = start_s + shift / 1000.0, beat_s + shift / 1000.0, off_ms - shift
    median = float(np.median(off_ms[near])) if near.any() else math.nan
    spread = float(np.median(np.abs(off_ms[near] - median))) if near.any() else math.nan
    drift, distinguishable = _find_drift(times[near], off_ms[near])
    return BeatTiming(
        accents=tuple(
            TimedAccent(one, 1.0 + float(place) / subdivision, float(beat), float(late))
            if is_near
            else TimedAccent(one, None, None, None)
            for one, place, beat, late, is_near in zip(accents, places, beat_s, off_ms, near, strict=True)
        ),
        n_beats=len(beats.times),
        tempo=beats.tempo,
        start_s=start_s,
        start_estimated=estimated,
        agreement=agreement,
        p_value=p_value,
        subdivision=subdivision,
        median_ms=math.nan if estimated else median,
        spread_ms=spread,
        drift_ms_per_min=drift,
        drift_distinguishable=distinguishable,
    )


def _time_of(counted: FloatArray, beats: Beats) -> FloatArray:
    """Seconds of the music at beats from 0: what `_count_beats` counts, back."""
    last = len(beats.times) - 1.0
    inner = np.interp(counted, np.arange(len(beats.times), dtype=np.float64), beats.times)
    outer = np.minimum(counted, 0.0) + np.maximum(counted - last, 0.0)
    times: FloatArray = inner + outer * beats.period_s
    return times


def _find_agreement(
    counted: FloatArray, times: FloatArray, beats: Beats, *, halves: float = 0.1
) -> tuple[int, float, float, float]:
    """Beats or half beats, the drift in these a second, the agreement, and its p-value."""
    # halves: by how much more the accents must agree with half beats to be measured against these
    whole, half = (_find_slope(part * counted, times, beats.period_s / part) for part in (1, 2))
    subdivision = 2 if half[1] > whole[1] + halves else 1
    slope, agreement, tried = half if subdivision == 2 else whole
    return subdivision, slope, agreement, min(2.0 * tried * _rayleigh(len(counted), agreement), 1.0)


def _rayleigh(n: int, length: float) -> float:
    """Probability of a mean resultant of this length or longer for n angles at random."""
    z = n * length * length
    return math.exp(math.sqrt(1.0 + 4.0 * n + 4.0 * (n * n - n * z)) - (1.0 + 2.0 * n))


def _find_slope(
    counted: FloatArray, times: FloatArray, period_s: float, *, drift_gain: float = 6.0, steepest_ms: float = 30.0
) -> tuple[float, float, int]:
    """Drift, beats a second, at which the accents agree best; their agreement; how many drifts were tried."""
    # steepest_ms: a second, of the drift looked for
    # drift_gain: log-likelihood that a drift must win
    plain = float(np.abs(np.exp(2j * np.pi * counted).mean()))
    lasting = float(np.ptp(times))
    steepest = steepest_ms / 1000.0 / period_s
    n = int(np.ceil(steepest * lasting / 0.125))
    slopes = np.linspace(-steepest, steepest, 2 * n + 1)
    middle = times - times.mean()
    found = np.array([np.abs(np.exp(2j * np.pi * (counted - slope * middle)).mean()) for slope in slopes])
    best = int(found.argmax())
    if len(times) * (found[best] ** 2 - plain**2) < drift_gain + math.log(max(len(slopes), 1)):
        return 0.0, plain, 1
    return float(slopes[best]), float(found[best]), max(n // 2, 1)


def _find_drift(
    times: FloatArray, off_ms: FloatArray, *, sure: float = 2.6, most_pairs: int = 1000
) -> tuple[float, bool]:
    """Ms a minute, the median of the slopes of all pairs (Theil and Sen); whether it is more than chance."""
    # sure: standard errors; most_pairs: accents whose pairs give the drift
    step = -(-len(times) // most_pairs)
    t, y = times[::step], off_ms[::step]
    one, other = np.triu_indices(len(t), 1)
    apart: NDArray[np.float64] = t[other] - t[one]
    far = apart > 1e-6
    if len(times) < _FEWEST_ACCENTS or not far.any():
        return math.nan, False
    slope = float(np.median((y[other] - y[one])[far] / apart[far]))
    rest = off_ms - slope * times
    scatter = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    error = max(scatter, 1.0) / (math.sqrt(len(times)) * float(times.std()))
    return 60.0 * slope, abs(slope) > sure * error


def _describe(timing: BeatTiming) -> tuple[Message, ...]:
    n, of = len(timing.on_beat), len(timing.accents)
    place = Message("beats.place_estimated" if timing.start_estimated else "beats.place_given", start=timing.start_s)
    if not timing.follows:
        return (Message("beats.no_agreement", of=of, tempo=timing.tempo, place=place, p=timing.p_value),)
    said = []
    against = Message("beats.half_beats" if timing.subdivision == 2 else "beats.beats")
    counts = {"n": n, "of": of, "against": against, "tempo": timing.tempo, "spread": timing.spread_ms}
    if timing.start_estimated:
        said.append(Message("beats.scattered", **counts))
    else:
        late = timing.median_ms
        code = "beats.on_time" if abs(late) < 1.0 else "beats.late" if late > 0 else "beats.early"
        said.append(Message(code, **counts, size=abs(late)))
    if timing.drift_distinguishable:
        drift = timing.drift_ms_per_min
        said.append(Message("beats.falls_behind" if drift > 0 else "beats.runs_ahead", size=abs(drift)))
    else:
        said.append(Message("beats.no_drift"))
    if timing.start_estimated:
        said.append(Message("beats.start_estimated", start=timing.start_s, percent=100.0 * timing.agreement))
    return tuple(said)
