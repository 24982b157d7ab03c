"""Work on the library: add uploads, train, export, check, label a take, judge a performance."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.motions import EXPORTED, Address, MotionRef
from dousa.app.studio.core.answers import shorten
from dousa.app.studio.core.workspace import safe_parts
from dousa.app.studio.jobs.lanes import Context
from dousa.errors import TrainingError
from dousa.formats.motion_files import ReadOptions
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio
    from dousa.library import Library


def add(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Add a batch; ``request``: batch, kind, category_from, performer_from, labels, tier, unit, up, joint_map."""
    folder = context.home / "files" / str(request["batch"])
    options = {
        "kind": request["kind"],
        "category_from": _inside(request.get("category_from"), folder),
        "performer_from": _inside(request.get("performer_from"), folder),
        "labels_from": "beside" if request.get("labels") else None,
        "tier": request.get("tier"),
        "options": ReadOptions(request.get("joint_map"), request.get("unit"), request.get("up")),
    }
    answer: dict[str, Any] = _without_folder(_take_in([folder], options, context), f"{folder}/")
    return answer


def watch(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Add new files of a folder of this machine, as `dousa add` does; ``request``: folder and files.

    Only the option ``--watch`` asks for this, not a page. Other files of the folder may have been removed on purpose.
    """
    folder, files = Path(request["folder"]), [Path(path) for path in request["files"]]
    table = context.folder / "categories.csv"
    with table.open("w", newline="", encoding="utf-8") as file:
        rows = ((path, path.parent.relative_to(folder).as_posix().removeprefix(".")) for path in files)
        csv.writer(file).writerows([("path", "category"), *rows])
    return _take_in(files, {"category_from": f"csv:{table}"}, context)


def _take_in(paths: Sequence[Path], options: Mapping[str, Any], context: Context) -> dict[str, Any]:
    with context.open_library() as library:
        report = library.add(
            paths,
            progress=lambda done, total, path: context.progress(done, total, Path(str(path)).name),
            **options,
        )
        said = {
            "skipped": [{"path": one.path, "reason": shorten(one.reason, context.home)} for one in report.skipped],
            "warnings": [{"path": path, "warning": shorten(text, context.home)} for path, text in report.warnings],
        }
        return {**report.to_json(), **said, "change": library.last_change}  # to be undone


def _inside(rule: str | None, folder: Path) -> str | None:
    """Resolve the table of a rule inside the batch, so that no other file of this machine is read."""
    kind, _, name = (rule or "").partition(":")
    return f"csv:{folder.joinpath(*safe_parts(name))}" if kind == "csv" and name else rule


def _without_folder(value: Any, folder: str) -> Any:
    """Replace paths in a report by those that were uploaded."""
    if isinstance(value, dict):
        return {key: _without_folder(item, folder) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_folder(item, folder) for item in value]
    return value.replace(folder, "") if isinstance(value, str) else value


def train(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Train the forest; ``request``: feature_set, n_trees, random_state."""
    with context.open_library() as library:
        return library.train(**request, progress=context.progress).to_json()


def review(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Find labels that are likely wrong, and clips that are nearly the same."""
    with context.open_library() as library:
        groups = [group.to_json() for group in library.find_near_duplicates()]
        try:
            labels = library.review_labels(progress=context.progress).to_json()
        except TrainingError as error:
            if not groups:
                raise
            context.tell(error.message)
            labels = {"doubts": [], "n_judged": 0, "n_few": 0, "n_checked": 0}
    return {**labels, "duplicates": groups}


def map_clips(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Lay out all clips on a map."""
    from dousa.app.studio.content.clips import keep_map

    with context.open_library() as library:
        found = library.map(progress=context.progress)
        keep_map(context.home, found, library.contents(found.clip_ids.tolist()))
    return {"n_clips": len(found.clip_ids), "n_laid_out": found.n_laid_out, "n_left_out": len(found.left_out)}


def demo(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Fill the library with synthetic motions of a few people, and train it."""
    from dousa.app.demo import write_library

    folder = context.home / "files" / str(request["batch"])
    context.progress(0, 1, Message("studio_jobs.making_motions"))
    write_library(folder, n_performers=6)
    report = _take_in([folder], {"category_from": "folder", "performer_from": r"name:^(performer\d+)_"}, context)
    with context.open_library() as library:
        library.train(progress=context.progress)
    answer: dict[str, Any] = _without_folder(report, f"{folder}/")
    return answer


def export(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Write clips into a ZIP file; ``request``: clips, to, onto, keep_reach, frame_rate."""
    with context.open_library() as library:
        there = {clip.id for clip in library.clips()}
        wanted = [number for number in request["clips"] if number in there]
        onto = request.get("onto")
        report = library.export(
            context.folder / EXPORTED,
            wanted or request["clips"],  # if all are gone, the export tells so
            to=request["to"],
            onto=None if onto is None else _find_character(library, onto, context.home),
            keep_reach=bool(request.get("keep_reach")),
            frame_rate=request.get("frame_rate"),
            progress=context.progress,
        )
    path = context.folder / EXPORTED
    return {
        "n_files": len(report.written) + len(report.kept),
        "n_gone": len(request["clips"]) - len(wanted),
        "skipped": [
            {"path": Path(one.path).name, "reason": shorten(one.reason, context.home)} for one in report.skipped
        ],
        "bytes": path.stat().st_size if path.is_file() else 0,
    }


def _find_character(library: Library, motion: str, home: Path) -> Path:
    address = Address.parse(motion)
    if address.clip is not None:
        return Path(library.clips([address.clip])[0].path)
    return (home / "files" / address.batch).joinpath(*safe_parts(address.name))


def label(studio: Studio, request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Label a take with all corrections; ``request``: take (a `MotionRef`), threshold."""
    from dousa.app.studio.content.corrections import list_examples

    take = MotionRef.model_validate(request["take"])
    examples = list_examples(studio)
    context.progress(0, 1, PurePath(take.motion).name)
    revision = studio.library.stats().revision
    answer = studio.library.label(
        studio.motions.query(take),
        threshold=request.get("threshold"),
        examples=examples,
        progress=context.progress,
    ).to_json()
    return {**answer, "take": take.motion, "n_examples": len(examples), "revision": revision}


def evaluate(studio: Studio, request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Judge a performance; ``request`` is an `EvaluationRequest`. The evaluation stays in memory to be adjusted."""
    from dousa.app.studio.content.evaluations import EvaluationRequest, assess_exercise, describe, make_ready

    wanted = EvaluationRequest.model_validate(request)
    if wanted.repetitions:
        return assess_exercise(wanted, studio.motions.get, context.folder, context.progress)
    ready = make_ready(wanted, studio.motions.get, context.progress)
    assessment = ready.assess(wanted)
    studio.evaluations.put(context.folder.name, ready)
    return describe(ready, assessment, wanted, wanted.language)


def check(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Check the library, as `dousa check`; ``request``: repair.

    A damaged file structure is not repaired while the studio has the file open; a note tells so.
    """
    with context.open_library() as library:
        repair = bool(request.get("repair"))
        report = library.check(repair=repair, salvage=False, progress=context.progress)
        if repair and any(one.what.code == "library_damage.structure" for one in report.damage):
            context.tell(Message("studio_jobs.repair_closed", library=library.name))
    lines = list(report.to_messages())
    for line in (*islice(lines[:-1], 30), lines[-1]):  # lines; the result has all
        context.tell(line)
    return report.to_json()


def backup(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Copy the library, as `dousa backup`; ``request``: to."""
    to = Path(request["to"])
    to.parent.mkdir(mode=0o700, exist_ok=True)
    with context.open_library() as library:
        report = library.backup(to, progress=context.progress)
    for line in (*report.to_messages(), Message("studio_jobs.restore", backup=to, library=library.name)):
        context.tell(line)
    return report.to_json()


def compact(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Forget removed clips and shrink the file, as `dousa compact`; ``request``: fragments."""
    with context.open_library() as library:
        report = library.compact(fragments="" if request.get("fragments") else None, progress=context.progress)
    for line in report.to_messages():
        context.tell(line)
    return report.to_json()
