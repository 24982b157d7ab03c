"""Sentences about a performance, in English and Japanese: what a teacher would say, with its numbers.

The Japanese names of the four errors are those of Yamane and Shakunaga, section 2.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TypeGuard

from dousa.errors import OptionError

__all__ = [
    "KIND_WORDS",
    "LANGUAGES",
    "LAPSE_WORDS",
    "SEGMENT_WORDS",
    "check_language",
    "describe_event",
    "describe_facing",
    "describe_lapse",
    "describe_segments",
    "format_time",
]

LANGUAGES: tuple[str, ...] = ("en", "ja")

SEGMENT_WORDS: dict[str, dict[str, str]] = {
    "en": {
        "trunk": "trunk",
        "left_upper_arm": "left upper arm",
        "left_forearm": "left forearm",
        "right_upper_arm": "right upper arm",
        "right_forearm": "right forearm",
        "left_thigh": "left thigh",
        "left_shank": "left shank",
        "right_thigh": "right thigh",
        "right_shank": "right shank",
    },
    "ja": {
        "trunk": "胴体",
        "left_upper_arm": "左上腕",
        "left_forearm": "左前腕",
        "right_upper_arm": "右上腕",
        "right_forearm": "右前腕",
        "left_thigh": "左太もも",
        "left_shank": "左すね",
        "right_thigh": "右太もも",
        "right_shank": "右すね",
    },
}
"""Language -> segment -> its name."""

KIND_WORDS: dict[str, dict[str, str]] = {
    "en": {
        "global": "global motion error",
        "partial": "partial motion error",
        "incomplete": "incomplete motion",
        "shift": "time shift",
    },
    "ja": {
        "global": "全体振りミス",
        "partial": "部分振りミス",
        "incomplete": "不完全動作",
        "shift": "時間ズレ",
    },
}
"""Language -> kind of error -> its name."""

LAPSE_WORDS: dict[str, dict[str, str]] = {
    "en": {
        "stop": "stop",
        "skip": "skip",
        "repeat": "repeat",
        "late start": "late start",
        "early end": "early end",
        "lead-in": "lead-in",
        "lead-out": "lead-out",
    },
    "ja": {
        "stop": "停止",
        "skip": "抜け",
        "repeat": "繰り返し",
        "late start": "途中から開始",
        "early end": "途中で終了",
        "lead-in": "前置き",
        "lead-out": "後置き",
    },
}
"""Language -> kind of lapse -> its name."""

# The larger whole first: name, the segments that it takes, English, Japanese.
_WHOLES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (
        ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm"),
        "both arms",
        "両腕",
    ),
    (("left_upper_arm", "left_forearm"), "left arm", "左腕"),
    (("right_upper_arm", "right_forearm"), "right arm", "右腕"),
    (("left_upper_arm", "right_upper_arm"), "both upper arms", "両上腕"),
    (("left_forearm", "right_forearm"), "both forearms", "両前腕"),
    (("left_thigh", "left_shank", "right_thigh", "right_shank"), "both legs", "両脚"),
    (("left_thigh", "left_shank"), "left leg", "左脚"),
    (("right_thigh", "right_shank"), "right leg", "右脚"),
    (("left_thigh", "right_thigh"), "both thighs", "両太もも"),
    (("left_shank", "right_shank"), "both shanks", "両すね"),
)
_WHOLE_BODY = {"en": "whole body", "ja": "全身"}


def check_language(language: str) -> str:
    """The language itself, if there are words for it.

    Parameters
    ----------
    language : ``"en"`` or ``"ja"``.

    Raises
    ------
    OptionError : another one.
    """
    if language not in LANGUAGES:
        raise OptionError(
            f"language: expected one of {', '.join(LANGUAGES)}, got {language!r}; "
            "choose en for English, ja for Japanese"
        )
    return language


def format_time(seconds: float) -> str:
    """A moment as ``m:ss.s``.

    Parameters
    ----------
    seconds : s; nan or infinite gives a dash.
    """
    if not math.isfinite(seconds):
        return "–"
    tenths = round(abs(seconds) * 10)
    sign = "-" if seconds < 0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths % 600 / 10:04.1f}"


def describe_segments(segments: Iterable[str], language: str = "en") -> str:
    """Segments in words, grouped to limbs: ``"right arm"``, ``"trunk and both legs"``, ``"whole body"``.

    Parameters
    ----------
    segments : names out of `SEGMENT_WORDS`, any order; none at all is the whole body.
    language : ``"en"`` or ``"ja"``.

    Raises
    ------
    OptionError : a segment or language that there is not.
    """
    words = SEGMENT_WORDS[check_language(language)]
    left = set(segments)
    unknown = sorted(left - set(words))
    if unknown:
        raise OptionError(f"segments: expected names out of {', '.join(words)}, got {', '.join(unknown)}")
    if not left or len(left) == len(words):
        return _WHOLE_BODY[language]
    # Each word stands where its first segment stands, so that the trunk comes before arms and legs.
    order = list(words)
    found: list[tuple[int, str]] = []
    for members, english, japanese in _WHOLES:
        if left.issuperset(members):
            left.difference_update(members)
            found.append((order.index(members[0]), japanese if language == "ja" else english))
    found.extend((order.index(name), words[name]) for name in left)
    return _join([word for _, word in sorted(found)], language)


def _join(words: Sequence[str], language: str) -> str:
    if language == "ja":
        return "・".join(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def describe_event(
    kind: str,
    start_s: float,
    segments: Iterable[str],
    *,
    lag_ms: float | None = None,
    shortfall_deg: float | None = None,
    shortfall_percent: float | None = None,
    deviation_deg: float | None = None,
    language: str = "en",
    furi: int | None = None,
) -> str:
    """One error in a sentence, such as ``"1:12.0, right arm: 24 deg short, reaches 62 % of the range"``.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    start_s : performance seconds.
    segments : names of the wrong segments.
    lag_ms : how late, negative is early; of a shift.
    shortfall_deg, shortfall_percent : missing range of motion, in degrees and percent of the reference's; negative
        if it goes further than the reference.
    deviation_deg : largest lasting angle from the reference, of a partial error.
    language : ``"en"`` or ``"ja"``.
    furi : number of the furi, from 0; None to leave it out.

    Raises
    ------
    OptionError : a kind, segment or language that there is not.
    """
    who = describe_segments(segments, language)
    if kind not in KIND_WORDS[language]:
        raise OptionError(f"kind: expected one of {', '.join(KIND_WORDS['en'])}, got {kind!r}")
    numbers = (lag_ms, shortfall_deg, shortfall_percent, deviation_deg)
    if language == "ja":
        where = "" if furi is None else f"（振り{furi + 1}）"
        return f"{format_time(start_s)} {_say_ja(kind, who, *numbers)}{where}"
    where = "" if furi is None else f" (furi {furi + 1})"
    return f"{format_time(start_s)}, {_say_en(kind, who, *numbers)}{where}"


def _say_en(
    kind: str, who: str, lag: float | None, degrees: float | None, percent: float | None, off: float | None
) -> str:
    if kind == "global":
        return "the whole figure is another one"
    if kind == "partial":
        if _is_number(degrees) and degrees < 0:
            return f"{who}: goes {-degrees:.0f} deg further than the reference"
        far = f", up to {off:.0f} deg away" if _is_number(off) else ""
        return f"{who}: another movement than the reference's{far}"
    if kind == "shift":
        if not _is_number(lag):
            return f"{who}: out of time"
        return f"{who}: {abs(lag):.0f} ms {'late' if lag > 0 else 'early'}"
    parts = []
    if _is_number(degrees):
        parts.append(f"{degrees:.0f} deg short")
    if _is_number(percent):
        parts.append(f"reaches {_reached(percent)} % of the range")
    return f"{who}: {', '.join(parts) or 'not danced to the full'}"


def _say_ja(
    kind: str, who: str, lag: float | None, degrees: float | None, percent: float | None, off: float | None
) -> str:
    if kind == "global":
        return "全身：手本とは別の振りになっています"
    if kind == "partial":
        if _is_number(degrees) and degrees < 0:
            return f"{who}：手本より{-degrees:.0f}度大きく動いています"
        far = f"（最大{off:.0f}度）" if _is_number(off) else ""
        return f"{who}：手本と動きが違います{far}"
    if kind == "shift":
        if not _is_number(lag):
            return f"{who}：タイミングがずれています"
        return f"{who}：{abs(lag):.0f}ミリ秒{'遅れています' if lag > 0 else '早くなっています'}"
    parts = []
    if _is_number(degrees):
        parts.append(f"{degrees:.0f}度足りません")
    if _is_number(percent):
        parts.append(f"手本の振れ幅の{_reached(percent)} %まで")
    return f"{who}：{'、'.join(parts) or '振りが最後まで伸びていません'}"


def _is_number(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def _reached(percent: float) -> int:
    return round(min(100.0, max(0.0, 100.0 - percent)))


def describe_lapse(
    kind: str,
    start_s: float,
    end_s: float,
    reference_start_s: float,
    reference_end_s: float,
    language: str = "en",
) -> str:
    """One lapse of order in a sentence, such as ``"0:31.0, leaves out 2.0 s of the reference (0:30.0 to 0:32.0)"``.

    Parameters
    ----------
    kind : ``"stop"``, ``"skip"``, ``"repeat"``, ``"late start"``, ``"early end"``, ``"lead-in"`` or ``"lead-out"``.
    start_s, end_s : performance seconds.
    reference_start_s, reference_end_s : reference seconds left out, done again or not reached.
    language : ``"en"`` or ``"ja"``.

    Raises
    ------
    OptionError : a kind or language that there is not.
    """
    check_language(language)
    if kind not in LAPSE_WORDS[language]:
        raise OptionError(f"kind: expected one of {', '.join(LAPSE_WORDS['en'])}, got {kind!r}")
    own = _seconds(end_s - start_s, language)
    missed = _seconds(reference_end_s - reference_start_s, language)
    span = (
        f"{format_time(reference_start_s)}{'–' if language == 'ja' else ' to '}{format_time(reference_end_s)}"
    )
    when = format_time(start_s)
    if language == "ja":
        return (
            f"{when} "
            + {
                "stop": f"{own}止まってから、続きを踊っています",
                "skip": f"手本の{missed}（{span}）が抜けています",
                "repeat": f"手本の{missed}（{span}）を繰り返しています",
                "late start": f"手本の始めの{missed}を踊っていません",
                "early end": f"手本の終わりの{missed}を踊っていません",
                "lead-in": f"始めの{own}は手本にない動きです",
                "lead-out": f"ここからの{own}は手本にない動きです",
            }[kind]
        )
    return (
        f"{when}, "
        + {
            "stop": f"stands still for {own}, then goes on",
            "skip": f"leaves out {missed} of the reference ({span})",
            "repeat": f"does {missed} of the reference again ({span})",
            "late start": f"begins late: the first {missed} of the reference are not danced",
            "early end": f"ends early: the last {missed} of the reference are not danced",
            "lead-in": f"the first {own} are not in the reference",
            "lead-out": f"the last {own} are not in the reference",
        }[kind]
    )


def _seconds(duration: float, language: str) -> str:
    if not math.isfinite(duration):
        return "一部" if language == "ja" else "a part"
    return f"{abs(duration):.1f}{'秒' if language == 'ja' else ' s'}"


def describe_facing(angle: float, language: str = "en") -> str:
    """A heading in words, such as ``"turned 25 deg to the left"``.

    Parameters
    ----------
    angle : rad about the vertical, positive is to the dancer's own left; nan is unknown.
    language : ``"en"`` or ``"ja"``.

    Raises
    ------
    OptionError : a language that there is not.
    """
    check_language(language)
    if not math.isfinite(angle):
        return "向きは不明" if language == "ja" else "facing unknown"
    degrees = round(math.degrees(abs(math.remainder(angle, 2.0 * math.pi))))
    to_left = math.remainder(angle, 2.0 * math.pi) > 0
    if degrees == 0:
        return "手本と同じ向き" if language == "ja" else "faces as the reference does"
    if language == "ja":
        return f"{'左' if to_left else '右'}に{degrees}度向いている"
    return f"turned {degrees} deg to the {'left' if to_left else 'right'}"
