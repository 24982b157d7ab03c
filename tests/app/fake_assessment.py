"""An assessment made by hand: a synthetic dance, a pupil with one error of each class or several, known times.

For tests of what is shown (report, player, command line); none of it comes from `assess`.
"""

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from dousa.evaluation import SEGMENTS, Assessment, ErrorEvent, FuriAssessment, Lapse, PostureSequence
from dousa.evaluation.posture.posture import compute_segments
from dousa.messages import Message
from dousa.motion import JOINT_INDEX, canonicalise
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.synthetic.performers import draw_performer, make_motion

HOSTILE_WORDS = '</script><img src=x onerror="window.hacked=1"> & \u2028 \' " ${1} `'

_FIGURES = ("raise_hands", "squat", "wave_right", "side_bend", "raise_hands", "kick_left", "arm_circles")
_KINDS = ("partial", "incomplete", "shift", "global")
_LAG_S = 0.2


class _Worded(ErrorEvent):
    """An event that says something of its own."""

    words = ""

    @property
    def message(self) -> Message:
        return Message("text.verbatim", text=self.words)

    says_in_furi = says = message


@dataclass(frozen=True)
class _Dance:
    positions: np.ndarray
    cuts: tuple[int, ...]  # first frames of the figures, and the end
    labels: tuple[str, ...]


@lru_cache(maxsize=4)
def _make_dance(frames: int, frame_rate: float) -> _Dance:
    """Figures of one synthetic performer, one after the other, joined over 0.3 s."""
    performer, parts, cuts, labels = draw_performer(4), [], [0], []
    overlap = max(round(0.3 * frame_rate), 1)
    fade = np.linspace(0, 1, overlap)[:, None, None]
    while cuts[-1] < frames:
        name = _FIGURES[len(labels) % len(_FIGURES)]
        figure = canonicalise(make_motion(name, performer, 0, frame_rate)).positions.copy()
        if parts:
            figure[:overlap] = fade * figure[:overlap] + (1 - fade) * parts[-1][-overlap:]
            parts[-1] = parts[-1][:-overlap]
            cuts[-1] -= overlap
        parts.append(figure)
        cuts.append(cuts[-1] + len(figure))
        labels.append("ABCDAEF"[len(labels) % len(_FIGURES)])
    return _Dance(np.concatenate(parts)[:frames], (*cuts[:-1], frames), tuple(labels))


def _keep_lengths(positions: np.ndarray, model: np.ndarray) -> np.ndarray:
    """The same directions of bones, with the lengths of the model."""
    out = positions.copy()
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            bone = positions[:, joint] - positions[:, parent]
            length = np.linalg.norm(model[:, joint] - model[:, parent], axis=1, keepdims=True)
            size = np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)
            out[:, joint] = out[:, parent] + bone / size * length
    return out


def _event_windows(seconds: float, per_kind: int) -> list[tuple[str, float, float]]:
    """One window of each kind in turn over the middle of the performance."""
    n_events = len(_KINDS) * per_kind
    slot = 0.86 * seconds / n_events
    length = min(1.6, 0.7 * slot)
    starts = 0.07 * seconds + slot * np.arange(n_events)
    return [(_KINDS[k % len(_KINDS)], float(start), float(start + length)) for k, start in enumerate(starts)]


def _bump(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Rises to 1 and falls in the window, 0 outside."""
    share = np.clip((times - start) / (end - start), 0, 1)
    return np.clip(3 * np.sin(np.pi * share), 0, 1)


_ARMS = {
    "partial": ("right", ("right_upper_arm", "right_forearm")),
    "incomplete": ("left", ("left_upper_arm", "left_forearm")),
}


def _perform(dance: np.ndarray, frame_rate: float, windows: list[tuple[str, float, float]]) -> Any:
    """Positions (T, 20, 3) of the pupil, and of each frame the lag in s."""
    times = np.arange(len(dance)) / frame_rate
    lag = np.zeros(len(dance))
    for kind, start, end in windows:
        if kind == "shift":
            lag = np.maximum(lag, _LAG_S * _bump(times, start, end))
    frames = np.clip(np.rint((times - lag) * frame_rate).astype(int), 0, len(dance) - 1)
    positions = dance[frames].copy()
    model = positions.copy()
    for kind, start, end in windows:
        share = _bump(times, start, end)[:, None, None]
        if kind in _ARMS:
            side = _ARMS[kind][0]
            arm = [JOINT_INDEX[f"{side}_{end}"] for end in ("elbow", "wrist", "hand")]
            shoulder = positions[:, [JOINT_INDEX[f"{side}_shoulder"]]]
            reach = np.array([[0.05, -0.3, 0.1], [0.1, -0.5, 0.25], [0.1, -0.55, 0.33]])
            wrong = shoulder + (reach if kind == "incomplete" else reach * [3, -1, 1])
            amount = 0.45 * share if kind == "incomplete" else share
            positions[:, arm] = (1 - amount) * positions[:, arm] + amount * wrong
        elif kind == "global":
            positions = (1 - share) * positions + share * np.roll(dance, len(dance) // 3, axis=0)
    scale, yaw = 0.92, 0.6
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    return scale * _keep_lengths(positions, model) @ turn.T + [0.8, 0, -0.4], lag


def _make_events(windows: Any, furi_of: Any, words: str | None) -> tuple[ErrorEvent, ...]:
    kind_of_event = ErrorEvent if words is None else type("Worded", (_Worded,), {"words": words})
    events = []
    for kind, start, end in windows:
        lag = 1000 * _LAG_S if kind == "shift" else None
        short = kind == "incomplete"
        segments = _ARMS[kind][1] if kind in _ARMS else SEGMENTS
        worst = (start + end) / 2
        severity = {"partial": 2.6, "incomplete": 1.8, "shift": 1.4, "global": 3.9}[kind]
        events.append(
            kind_of_event(kind, start, end, segments, lag, 24.0 if short else None, 38.0 if short else None,
                       severity, worst, worst - (lag or 0) / 1000, furi_of(worst))
        )  # fmt: skip
    return tuple(events)


def _make_space(segments: np.ndarray) -> Any:
    flat = segments.reshape(len(segments), 27)
    mean = flat.mean(axis=0)
    _, sizes, axes = np.linalg.svd(flat - mean, full_matrices=False)
    variances = sizes**2 / len(flat)
    n_dims = min(int(np.searchsorted(np.cumsum(variances) / variances.sum(), 0.99)) + 1, len(axes))
    return SimpleNamespace(
        mean=mean.reshape(9, 3), axes=axes[:n_dims].T, variances=variances[:n_dims],
        contribution=float(variances[:n_dims].sum() / variances.sum()), n_dims=n_dims, n_frames=len(flat),
    )  # fmt: skip


def _make_furi(dance: _Dance, segments: np.ndarray, frame_rate: float) -> tuple[FuriAssessment, ...]:
    furi = []
    for number, label in enumerate(dance.labels):
        start, end = dance.cuts[number], dance.cuts[number + 1]
        gain = np.where(np.arange(9) == number % 9, 0.62, 0.97)
        gain[(number + 4) % 9] = np.nan
        span = (start / frame_rate, end / frame_rate)
        furi.append(
            FuriAssessment(*span, *span, label, _make_space(segments[start:end]), gain, 0.03 * (number % 4), 90.0)
        )
    return tuple(furi)


def make_assessment(
    seconds: float = 20.0, frame_rate: float = 30.0, events_per_kind: int = 1, words: str | None = None
) -> Assessment:
    """An assessment of that many seconds.

    Parameters
    ----------
    seconds : length of reference and performance, s; 4 or more.
    frame_rate : Hz.
    events_per_kind : how many events each of the four classes has; times are `assessment.events`.
    words : what every event says, instead of a fitting sentence; `HOSTILE_WORDS` for example.
    """
    frames = round(seconds * frame_rate)
    dance = _make_dance(frames, frame_rate)
    windows = _event_windows(seconds, events_per_kind)
    performed, lag = _perform(dance.positions, frame_rate, windows)
    times = np.arange(frames) / frame_rate
    wrong = {kind: sum(_bump(times, a, b) for k, a, b in windows if k == kind) for kind in _KINDS}
    reference = _make_sequence(dance.positions, frame_rate, "reference.bvh")
    performance = _make_sequence(performed, frame_rate, "pupil.bvh")
    furi = _make_furi(dance, reference.segments, frame_rate)
    cuts = np.array(dance.cuts[1:-1]) / frame_rate
    matched = times - lag
    matched[-round(0.5 * frame_rate) :] = np.nan  # the pupil goes on after the end of the reference
    gap = (0.02 * seconds, 0.05 * seconds, "left_forearm")
    ripple = 0.05 * (1 + np.sin(3 * times)) / 2
    return Assessment(
        frame_rate=frame_rate, reference=reference, performance=performance,
        same_time=times.copy(), matched_time=matched, lag=lag, facing=0.1 * np.sin(times),
        d_space=ripple + 0.9 * wrong["global"] + 0.5 * wrong["partial"],
        d_within=ripple + 0.5 * wrong["incomplete"] + 0.4 * wrong["shift"],
        d_path=ripple + 0.7 * wrong["global"],
        d_space_limit=np.full(frames, 0.25), d_within_limit=np.full(frames, 0.3),
        residual=_make_residual(wrong, ripple), residual_limit=np.full(9, 0.3),
        path=np.stack([np.arange(frames), np.clip(np.rint((times - lag) * frame_rate), 0, None)], 1).astype(int),
        furi=furi,
        events=_make_events(windows, lambda t: int(np.searchsorted(cuts, t, "right")), words),
        lapses=(Lapse("skip", 0.95 * seconds, 0.95 * seconds, 0.9 * seconds, 0.95 * seconds),),
        score=71.0, score_formula=Message("text.verbatim", text="100 - 10 x 2.9 = 71"), calibrated=False,
        n_references=1, tempo=1.0, coverage=0.95, score_interval=(64.0, 77.0),
        gaps=(gap,), warnings=(Message("text.verbatim", text="one take of the reference: the limits are guessed"),),
    )  # fmt: skip


def _make_sequence(positions: np.ndarray, frame_rate: float, name: str) -> PostureSequence:
    seen = np.ones((len(positions), 9), dtype=bool)
    return PostureSequence(compute_segments(positions), seen, positions, frame_rate, name)


def _make_residual(wrong: dict[str, np.ndarray], ripple: np.ndarray) -> np.ndarray:
    residual = np.tile(ripple[:, None], (1, 9)) + 0.6 * wrong["global"][:, None]
    residual[:, 3:5] += 0.7 * wrong["partial"][:, None]
    residual[:, 1:3] += 0.4 * wrong["incomplete"][:, None]
    return residual
