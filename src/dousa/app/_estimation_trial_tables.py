"""Answers of ``experiment-estimation`` as tables for people; each prints to the console it is given."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from dousa.app._output import one_line

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["print_bench", "print_paper"]

_METHODS = {
    "estimate": "estimated",
    "frozen": "first pose held",
    "constant_velocity": "constant velocity",
}
_COLUMNS = (
    ("mean mm", "mean_mm", 0, 1.0),
    ("hips mm", "root_mm", 0, 1.0),
    ("posture mm", "rigid_mm", 0, 1.0),
    ("limbs deg", "segment_deg", 1, 1.0),
    ("bends deg", "angle_deg", 1, 1.0),
    ("PCK50 %", "pck_50", 0, 100.0),
    ("PCK100 %", "pck_100", 0, 100.0),
    ("frames lost %", "loss_rate", 0, 100.0),
    ("jitter m/s2", "jitter_m_s2", 1, 1.0),
    ("image px", "mean_px", 1, 1.0),
    ("% of stature", "percent_of_stature", 1, 1.0),
)
_CLIP_HEADINGS = {"root_mm": "hips mm", "rigid_mm": "posture mm", "percent_of_stature": "% of stature"}
_HELD_HEADINGS = ("held mm", "hips mm", "velocity mm", "hips mm")
_STARTS = {"truth": "the first frame's joints are told", "auto": "the start is found"}
_BODIES = {"stature": "body from the stature", "start": "bones from the first frame's joints"}


def print_bench(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of a bench: means by variant and number of views, then every clip."""
    settings = answer["settings"]
    told = f"{_STARTS[answer['start']]}, {_BODIES[answer['body']]}"
    out.print(f"{told}; reading {settings['reading']}, evidence {settings['evidence']}", markup=False)
    for variant in dict.fromkeys(entry["variant"] for entry in answer["summary"]):
        entries = [entry for entry in answer["summary"] if entry["variant"] == variant]
        _print_means(out, variant, entries)
        _print_clips(out, [row for row in answer["clips"] if row["variant"] == variant])


def _print_means(out: Console, variant: str, entries: list[dict[str, Any]]) -> None:
    n_clips = max(entry["n_clips"] for entry in entries)
    table = Table(title=f"{variant or 'sequences'}: mean over {n_clips} clips", title_justify="left")
    table.add_column("views", justify="right")
    table.add_column("what")
    for heading, *_ in _COLUMNS:
        table.add_column(heading, justify="right")
    for entry in entries:
        for method, words in _METHODS.items():
            cells = (_number(entry[method][key], digits, by) for _, key, digits, by in _COLUMNS)
            first = str(entry["n_views"]) if method == "estimate" else ""
            table.add_row(first, words, *cells, style="bold" if method == "estimate" else "")
        table.add_section()
    out.print(table)
    for entry in entries:
        hidden, seen = entry["estimate"]["occluded_mm"], entry["estimate"]["visible_mm"]
        out.print(
            f"{_views(entry['n_views'])}: {entry['n_lost']} of {entry['n_clips']} clips lost; nearer than the first "
            f"pose held in {entry['n_below_frozen']}, in posture about the hips in {entry['n_below_frozen_rooted']}; "
            f"visible joints {_number(seen)} mm, hidden {_number(hidden)} mm; overlap {_number(entry['iou'], 2)}; "
            f"{_number(entry['frames_per_second'])} frames/s in each trial",
            markup=False,
            soft_wrap=True,
        )


def _print_clips(out: Console, rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, title="Each clip", title_justify="left")
    table.add_column("clip", overflow="fold")
    for heading in ("views", "mean mm", *_CLIP_HEADINGS.values(), *_HELD_HEADINGS, "overlap", "lost"):
        table.add_column(heading, justify="right")
    groups: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["clip"], len(row["views"])), []).append(row)
    before = ""
    for (clip, count), same in groups.items():
        ours = [row["estimate"] for row in same if "estimate" in row]
        cells = [_number(_mean(ours, key), 1 if key == "percent_of_stature" else 0) for key in _CLIP_HEADINGS]
        held = [
            _number(same[0][method][key])
            for method in ("frozen", "constant_velocity")
            for key in ("mean_mm", "root_mm")
        ]
        n_lost = sum(row["is_lost"] for row in same)
        lost = "" if not n_lost else "!" if len(same) == 1 else f"{n_lost} of {len(same)}"
        name = escape(one_line(clip)) if clip != before else ""
        overlap = _number(_mean(same, "iou"), 2)
        table.add_row(name, str(count), _number(_mean(ours, "mean_mm")), *cells, *held, overlap, lost)
        before = clip
    out.print(table)
    if any(row["is_lost"] for row in rows):
        out.print(
            "lost: more than half of the frames, or the last one, off by more than 150 mm", markup=False
        )


def _mean(entries: list[dict[str, Any]], key: str) -> float:
    numbers = [entry[key] for entry in entries if entry[key] is not None and math.isfinite(entry[key])]
    return sum(numbers) / len(numbers) if numbers else math.nan


def print_paper(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of the paper's experiment: readings by evidence, then what inertia is worth."""
    first, stop = answer["frames"]
    views = list(dict.fromkeys(tuple(row["views"]) for row in answer["rows"]))
    out.print(
        f"{one_line(answer['clip'])}, frames {first} to {stop - 1}; mean joint error in mm with "
        f"{' / '.join(str(len(some)) for some in views)} views "
        f"(those numbered {' / '.join(', '.join(map(str, some)) for some in views)})",
        markup=False,
        soft_wrap=True,
    )
    for source in dict.fromkeys(row["source"] for row in answer["rows"]):
        _print_readings(out, source, [row for row in answer["rows"] if row["source"] == source], answer)
    _print_ranges(out, answer)


def _print_readings(out: Console, source: str, rows: list[dict[str, Any]], answer: dict[str, Any]) -> None:
    words = {"recorded": "silhouettes of the file", "own body": "silhouettes drawn with the model itself"}
    held = answer["baselines"][source]
    title = (
        f"{words[source]}; first pose held {_number(held['frozen']['mean_mm'])}, constant velocity "
        f"{_number(held['constant_velocity']['mean_mm'])}"
    )
    table = Table(title=title, title_justify="left")
    changes = list(dict.fromkeys(row["change"] for row in rows))
    for heading in ("reading", "evidence"):
        table.add_column(heading)
    for change in changes:
        table.add_column(change, justify="right")
    for reading, evidence in dict.fromkeys((row["reading"], row["evidence"]) for row in rows):
        same = [row for row in rows if (row["reading"], row["evidence"]) == (reading, evidence)]
        cells = (
            " / ".join(_number(row["mean_mm"]) for row in same if row["change"] == change)
            for change in changes
        )
        table.add_row(reading, evidence, *cells)
    out.print(table)


def _print_ranges(out: Console, answer: dict[str, Any]) -> None:
    n_candidates = answer["settings"]["n_candidates"]
    out.print(
        f"mean range of our joints / (2 dR) = {answer['quantisation_ratio']:.2f}; the paper says "
        f"{answer['quantisation_ratio_of_the_paper']:.2f} of its own body",
        markup=False,
        soft_wrap=True,
    )
    table = Table(
        title=f"{n_candidates} candidates over the whole range of each joint, and within +-dR: mean joint error in mm",
        title_justify="left",
    )
    table.add_column("silhouettes")
    table.add_column("views", justify="right")
    table.add_column("reading")
    table.add_column("told the truth of")
    for heading in ("whole range", "within dR", "with W", "times nearer", "with W"):
        table.add_column(heading, justify="right")
    for row in answer["end_to_end"]:
        errors = (_number(row[name]["mean_mm"]) for name in ("full_range", "within", "weighed"))
        ratios = (_number(row[name], 2) for name in ("ratio", "weighed_ratio"))
        table.add_row(row["source"], str(len(row["views"])), row["reading"], row["told"], *errors, *ratios)
    out.print(table)
    out.print(
        "Told the truth of every frame, W alone keeps the pose near it, whatever the image says; go by the columns "
        "without W. Told the first frame, errors live on from frame to frame, as they do in use.",
        markup=False,
        soft_wrap=True,
    )


def _views(count: int) -> str:
    return f"{count} view" if count == 1 else f"{count} views"


def _number(value: float | None, digits: int = 0, by: float = 1.0) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{by * value:.{digits}f}"
