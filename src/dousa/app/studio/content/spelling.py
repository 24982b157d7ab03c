"""What is asked on a page, as a command for a terminal and as Python: one place makes both from the request.

Options have the names and defaults of the request classes, which the command line has too. A motion that no file holds
as it is meant (a part, a clip of the library, a file that is read in another unit) is written into a file first.
"""

from __future__ import annotations

import dataclasses
import hashlib
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from dousa.app.requests import evaluation, library
from dousa.app.studio.content.corrections import list_examples
from dousa.app.studio.content.evaluations import format_weights
from dousa.app.studio.content.motions import MotionRef
from dousa.app.studio.core.answers import say
from dousa.app.studio.core.workspace import SPELLED, write_file
from dousa.library.export import ExportFormat
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio


@dataclass(frozen=True, slots=True)
class Spelling:
    """A request as a command, None where the command line cannot ask it (``note`` says why), and as Python."""

    command: str | None
    python: str
    note: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return dataclasses.asdict(self)


def spell_search(studio: Studio, query: MotionRef, options: Mapping[str, Any]) -> Spelling:
    """Spell a search for what is like a motion; ``options`` are fields of the request class."""
    subject = _name(studio, query)
    given = _pick(library.SearchRequest, options)
    words = ["search", _lib(studio), subject, *_flags(library.SearchRequest, given)]
    return Spelling(_join(words), _use_library(studio, f"result = library.search({_call(subject, **given)})"))


def spell_text(studio: Studio, text: str, k: int, where: Mapping[str, Any]) -> Spelling:
    """Spell a search in words, among clips with labels."""
    given, kind = _pick(library.Labels, where), where.get("kind")
    words = ["search", _lib(studio), "--text", text, "-k", k, *_flags(library.Labels, given)]
    more = {"kind": kind} if kind else {}
    python = f"result = library.search_text({_call(text, k, **given, **more)})"
    return _spell(words, _use_library(studio, python), more)


def spell_label(studio: Studio, take: MotionRef, options: Mapping[str, Any]) -> Spelling:
    """Spell the labelling of a take; what was named by hand are examples, for which only Python has a parameter."""
    subject, examples = _name(studio, take), list_examples(studio)
    given = _pick(library.LabelRequest, options)
    more = {"examples": examples} if examples else {}
    words = ["label", _lib(studio), subject, *_flags(library.LabelRequest, given)]
    return _spell(words, _use_library(studio, f"result = library.label({_call(subject, **given, **more)})"), more)


def _spell(words: Sequence[object], python: str, only_python: Mapping[str, object]) -> Spelling:
    if not only_python:
        return Spelling(_join(words), python)
    return Spelling(None, python, say(Message("studio_spelling.only_python", names=tuple(only_python))))


def spell_export(studio: Studio, clips: Sequence[int], to: str, options: Mapping[str, Any]) -> Spelling:
    """Spell the export of clips as a ZIP file; ``onto`` among the options is the name of a motion."""
    onto = options.get("onto")
    character = None if onto is None else studio.motions.path(MotionRef(motion=onto))
    ExportFormat(to, character, bool(options.get("keep_reach")), options.get("frame_rate"))  # refuses mistakes
    given = _pick(library.Character, {**options, "onto": character})
    target = "export.zip"
    words = ["export", _lib(studio), *clips, "--output", target, "--to", to, *_flags(library.Character, given)]
    python = f"result = library.export({_call(target, list(clips), to=to, **given)})"
    return Spelling(_join(words), _use_library(studio, python))


def spell_evaluation(studio: Studio, job_id: str) -> Spelling:
    """Spell an evaluation with the figures and weights that it has now."""
    from dousa.app.studio.content.evaluations import EvaluationRequest
    from dousa.evaluation import format_furi

    wanted = EvaluationRequest.read(studio.evaluations.find_job(job_id))
    files = [_file(studio, ref) for ref in (*wanted.references, wanted.performance)]
    given: dict[str, Any] = {"repetitions": wanted.repetitions, "tempo": wanted.pace}
    given["mirror"] = {"auto": "auto", "mirrored": "yes", "same": "no"}[wanted.side]
    if not wanted.repetitions:
        adjustment, ready = studio.evaluations.read_adjustment(job_id), studio.evaluations.get(job_id)
        furi = ready.to_furi(adjustment.furi)
        if furi is not None:
            given["furi"] = _write(studio, "furi.txt", format_furi(furi, ready.assessment.frame_rate))
        if adjustment.weights:
            given["weights"] = _write(studio, "weights.toml", format_weights(adjustment.weights))
    flags = _flags(evaluation.EvaluationRequest, given)
    command = _join(["evaluate", *files[:-1], "--performance", files[-1], *flags])
    return Spelling(command, _spell_assessment(files, wanted.side, given))


def _spell_assessment(files: Sequence[Path], side: str, given: Mapping[str, Any]) -> str:
    function = "assess_repetitions" if given["repetitions"] else "assess"
    names, options = [function], [f"side={side!r}", f"tempo={given['tempo']!r}"]
    if "furi" in given:
        names.append("read_furi")
        options.append(f"furi=read_furi({str(given['furi'])!r}, takes[0].frame_rate, takes[0].n_frames)")
    if "weights" in given:
        names.append("read_weights")
        options.append(f"weights=read_weights({str(given['weights'])!r})")
    lines = [
        "import dousa",
        f"from dousa.evaluation import {', '.join(names)}",
        "",
        f"files = {[str(file) for file in files]!r}",
        "takes = [dousa.canonicalise(dousa.read_motion(file)) for file in files]",
        f"result = {function}(takes[:-1], takes[-1], {', '.join(options)})",
        "print(result)",
    ]
    return "\n".join(lines) + "\n"


def _use_library(studio: Studio, line: str) -> str:
    return f"import dousa\n\nwith dousa.Library.open({_lib(studio)!r}) as library:\n    {line}\nprint(result)\n"


def _lib(studio: Studio) -> str:
    return str(studio.settings.library.absolute())


def _join(words: Sequence[object]) -> str:
    return shlex.join(["dousa", *map(str, words)])


def _call(*args: object, **options: object) -> str:
    plain = {name: str(one) if isinstance(one, Path) else one for name, one in options.items()}
    return ", ".join([*map(repr, args), *(f"{name}={one!r}" for name, one in plain.items())])


def _pick(request: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Pick the values of the fields of a request class that differ from their defaults."""
    fields = {field.name: field.default for field in dataclasses.fields(request)}
    return {name: one for name, one in options.items() if name in fields and one is not None and one != fields[name]}


def _flags(request: Any, given: Mapping[str, Any]) -> list[object]:
    """Spell values as the options of the command line, which a request class declares."""
    hints = get_type_hints(request, include_extras=True)
    words: list[object] = []
    for name, value in _pick(request, given).items():
        yes, _, no = hints[name].__metadata__[0].default.partition("/")  # typer: its first name
        words += [yes if value else no] if isinstance(value, bool) else [yes, value]
    return words


def _name(studio: Studio, ref: MotionRef) -> int | str:
    """Name a motion as libraries take it: the number of a whole clip, else a file."""
    clip = ref.address.clip
    return clip if clip is not None and ref.is_whole else str(_file(studio, ref))


def _file(studio: Studio, ref: MotionRef) -> Path:
    """Return a file that holds a motion as it is meant, made where there is none."""
    if ref.is_whole and ref.address.clip is None and not (ref.unit or ref.up or ref.joint_map):
        return studio.motions.path(ref)
    from dousa.formats.registry import write_motion
    from dousa.motion import CANONICAL_JOINTS, Trajectories

    named = studio.motions.get(ref)
    key = hashlib.sha256(ref.model_dump_json().encode()).hexdigest()[:8]
    target = _folder(studio) / f"{Path(named.name).stem}_{key}.npz"
    if not target.exists():
        motion = named.motion
        write_motion(Trajectories(CANONICAL_JOINTS, motion.positions, motion.frame_rate), target)
    return target


def _write(studio: Studio, name: str, text: str) -> Path:
    """Write a file of its own for each content: a command that was copied stays as it was."""
    content = text.encode()
    path = _folder(studio) / f"{hashlib.sha256(content).hexdigest()[:8]}_{name}"
    write_file(path, content)
    return path


def _folder(studio: Studio) -> Path:
    folder = studio.workspace.root / SPELLED
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder
