"""Warnings about an assessment as a whole, in both languages."""

from __future__ import annotations

__all__ = ["describe_warning"]

_WORDS: dict[str, dict[str, str]] = {
    "en": {
        "unlike": "the performance resembles the reference hardly anywhere (mismatch {0:.2f} of 1); is it the same "
        "dance?",
        "mirrored": "mirrored, left for right, the performance fits far better; --mirror compares it so",
        "unmirrored": "as it is, not mirrored, the performance fits far better; compare it without --mirror",
        "tempo": "the performance takes {0:.2f} times as long as the reference; --tempo free does not count that as "
        "being late",
        "sides": "mirrored: left and right are the reference's; the pupil's own are the other way round",
        "left out": "take {0:.0f} of the reference is not like the first and was left out",
        "reference gaps": "{0:.1f} % of the reference was not seen; nothing is judged there",
        "still reference": "the reference hardly moves: there is little to compare",
        "still performance": "the performer hardly moves",
        "compared": "only {0:.0f} % of the performance has a place in the reference; the grade is of that part alone",
        "gaps": "{0:.1f} % of the performance was not seen; these spans are marked, not judged",
        "uncovered": "{0:.1f} s of the reference lie outside all furi: no eigenspace there",
    },
    "ja": {
        "unlike": "入力動作は手本とほとんど似ていません（不一致 {0:.2f}／1）。同じ舞踊でしょうか。",
        "mirrored": "左右を反転すると手本とよく一致します。--mirror を付けると反転して比較します。",
        "unmirrored": "左右を反転しないほうが手本とよく一致します。--mirror を外すとそのまま比較します。",
        "tempo": "入力動作は手本の {0:.2f} 倍の時間がかかっています。--tempo free を付けると遅れとして数えません。",
        "sides": "左右反転して比較：左右は手本の側です。演者自身の左右は逆になります。",
        "left out": "手本の {0:.0f} 回目は1回目と似ていないため、除外しました。",
        "reference gaps": "手本の {0:.1f} % は計測されていません。その区間は評価していません。",
        "still reference": "手本がほとんど動いていないため、比較できることがわずかです。",
        "still performance": "演者がほとんど動いていません。",
        "compared": "入力動作のうち手本と対応するのは {0:.0f} % だけです。評価点はその部分だけのものです。",
        "gaps": "入力動作の {0:.1f} % は計測されていません。その区間は印を付け、評価していません。",
        "uncovered": "手本の {0:.1f} 秒はどの振りにも含まれていないため、固有空間がありません。",
    },
}


def describe_warning(key: str, value: float, language: str) -> str:
    """The sentence of a warning; ``value`` is the number in it, if it has one."""
    return _WORDS[language][key].format(value)
