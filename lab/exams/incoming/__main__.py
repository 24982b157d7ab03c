"""Run the exam and print its table: kind x format -> right, told, error, vague, WRONG or trace."""

from __future__ import annotations

import argparse
import collections
import json
import os
import re
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np

from lab.exams.incoming import shared_cases
from lab.exams.incoming.door import VERDICTS, Control, Read, compare, make_control, named, read, run, stem
from lab.exams.incoming.faults import COUNT, Case, cases, controls, random_harms
from lab.exams.incoming.writers import BODY, FORMATS, Format, Scene

N_RANDOM = 200  # a format
NAMELESS = {"npy", "json"}  # hold numbers alone: what they are taken for is said of every file
Verdict = tuple[str, str]
Cells = dict[tuple[str, str], list[Verdict]]


class Exam:
    """Makes files in a folder and collects verdicts as (kind, format) -> verdict, reason."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.controls: dict[str, Control] = {}
        self.cells: Cells = collections.defaultdict(list)

    def put(self, form: Format, scene: Scene, data: bytes) -> Path:
        """Write a file, and what lies beside it."""
        folder = self.folder / form.name.replace(" ", "_")
        folder.mkdir(exist_ok=True)
        if form.beside:
            suffix, write = form.beside
            (folder / f"walk.{suffix}").write_bytes(write(scene))
        path = folder / f"walk.{form.suffix}"
        path.write_bytes(data)
        return path

    def options(self, form: Format, rate: float) -> tuple[list[str], float | None]:
        """Give the rate where the format has none."""
        return (["--read", f"frame_rate={rate:g}"], rate) if form.name in NAMELESS else ([], None)

    def control(self, form: Format, case: Case) -> Verdict:
        """Judge an unharmed file: any word about it is a false alarm."""
        path = self.put(form, case.scene, form.write(case.scene))
        words, rate = self.options(form, case.scene.rate)
        answer, found, truth = run("info", "--json", *words, path), read(path, rate), case.scene.truth
        if answer.trace or found.trace:
            return "trace", answer.trace or found.trace
        if answer.code or found.error:
            return "error", found.error or answer.err.strip()
        made = make_control(found, truth, answer, path)
        if made is None or made.worst:
            return "WRONG", "places are off"
        plain = self.controls.setdefault(form.name, made)
        wrong = compare(found, plain, truth, case.scene.rate, np.zeros(truth.shape[:2], bool))
        notes = (
            []
            if form.name in NAMELESS and made is plain
            else [n for n in answer.notes if stem(n, path) not in plain.notes]
        )
        notes = answer.notes if made is plain and form.name not in NAMELESS else notes
        return ("WRONG", wrong) if wrong else ("told", notes[0]) if notes else ("right", "")

    def judge(  # noqa: PLR0911
        self, form: Format, case: Case, found: Read, path: Path, *, asked: bool
    ) -> Verdict:
        """Judge a harmed file."""
        control = self.controls[form.name]
        if found.trace:
            return "trace", found.trace
        if found.error:
            return named(found.error, path), found.error
        truth, lost = case.scene.truth, np.zeros((case.scene.n, len(BODY)), bool)
        for row, joint in case.lost:
            lost[row, joint] = True
        wrong = compare(found, control, truth, case.rate or case.scene.rate, lost, shape=case.shape)
        if case.shape and not wrong:
            wrong = "" if not compare(found, control, truth, case.scene.rate, lost) else "moved"
        elif case.shape:
            return "WRONG", wrong
        wrong = wrong or ("" if case.check != "one root" or found.roots <= 1 else f"{found.roots} roots")
        if not asked and not wrong:
            return "right", ""
        words, _ = self.options(form, case.scene.rate)
        answer = run("info", "--json", *words, path)
        if answer.trace:
            return "trace", answer.trace
        if answer.code:
            return named(answer.err, path), answer.err.strip()
        new = [n for n in answer.notes if stem(n, path) not in control.notes]
        if case.check == "stature" and answer.info:
            off = abs(float(answer.info[0]["stature_m"] or 0) - control.stature)
            wrong = wrong or ("" if off < 0.01 else f"stature off by {off:.2f} m")
        said = [n for n in new if re.search(case.words, n.replace(str(path), ""))]
        if said:
            return "told", said[0]
        if wrong and new and not asked:
            return "vague", f"{wrong}; said only: {new[0]}"
        if wrong or case.must_say:
            return "WRONG", (wrong or "no word") + (f"; said only: {new[0]}" if new else "")
        return "right", ""

    def kinds(self, form: Format, only: str) -> None:
        """Judge all controls and faults of a format."""
        for kind, case in controls(form):
            if form.name in self.controls or kind == "plain":
                self.cells[f"control: {kind}", form.name].append(self.control(form, case))
        for kind, case in cases(form) if form.name in self.controls else ():
            if only in kind:
                path = self.put(form, case.scene, case.harm(form.write(case.scene)))
                found = read(path, self.options(form, case.scene.rate)[1])
                self.cells[kind, form.name].append(self.judge(form, case, found, path, asked=True))

    def random(self, form: Format) -> None:
        """Judge files with bytes inserted, deleted and flipped at random."""
        scene = Scene(rate=form.rate, unit=form.unit)
        data, case = form.write(scene), Case(scene, COUNT, must_say=False)
        rng = np.random.default_rng(zlib.crc32(form.name.encode()))
        for structure, what, harmed in random_harms(form, data, N_RANDOM, rng):
            path = self.put(form, scene, harmed)
            found = read(path, self.options(form, scene.rate)[1])
            kind = "random: structure" if structure else "random: value"
            verdict, reason = self.judge(form, case, found, path, asked=False)
            self.cells[kind, form.name].append((verdict, f"{reason} ({what})"))


def shown(verdicts: list[Verdict]) -> str:
    """Spell a cell: its verdict, or how often each came."""
    counts = collections.Counter(v for v, _ in verdicts)
    if len(counts) == 1 and len(verdicts) < 10:
        return next(iter(counts))
    return " ".join(f"{counts[v]}{v[:1]}" for v in VERDICTS if counts[v])


def group_of(kind: str) -> str:
    """Sort a kind into a row of the totals."""
    head = kind.split(":", maxsplit=1)[0]
    return kind if head == "random" else head if head in {"control", "shared"} else "faults"


def print_tables(cells: Cells) -> None:
    """Print kind x format, shared cases, totals, and what failed."""
    columns = [form.name for form in FORMATS]
    print("kind".ljust(26) + " ".join(c[:10].ljust(10) for c in columns))
    for kind in dict.fromkeys(kind for kind, column in cells if column in columns):
        row = [shown(cells[kind, c]) if (kind, c) in cells else "." for c in columns]
        print(kind[:25].ljust(26) + " ".join(c.ljust(10) for c in row))
    print("(random: r right, t told, e error, v vague, W WRONG, of 200; vague: no file, place or cause named;")
    print("the faults of a format whose plain control is not read are not judged)\n")
    for kind, column in cells:
        if column == "shared":
            print(kind.ljust(50) + shown(cells[kind, column]))
    sums: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for (kind, _), verdicts in cells.items():
        sums[group_of(kind)].update(v for v, _ in verdicts)
    print("\ntotal".ljust(27) + " ".join(v.ljust(7) for v in VERDICTS))
    for group, counts in sums.items():
        print(group.ljust(26) + " ".join(str(counts[v]).ljust(7) for v in VERDICTS))
    print("\nwhat failed (of a control: anything but right; of random damage to structure: one a format)")
    for (kind, column), verdicts in cells.items():
        fine = {"right"} if kind.startswith("control") else {"right", "told", "error"}
        bad = sorted(
            (x for x in verdicts if x[0] not in fine and kind != "random: value"), key=lambda x: x[0] == "vague"
        )
        for verdict, reason in bad[:1] if kind.startswith("random") else bad:
            print(f"{verdict:6} {kind} / {column}: {reason[:150]}")


def main() -> int:
    """Run the exam."""
    parser = argparse.ArgumentParser(prog="python -m lab.exams.incoming", description=__doc__)
    parser.add_argument("--only", default="", metavar="KIND", help="kinds whose name contains this")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write each verdict and its reason")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        exam = Exam(Path(folder))
        for form in FORMATS:
            exam.kinds(form, options.only)
            if options.only in "random" and form.name in exam.controls:
                exam.random(form)
        for name, verdict in shared_cases.run_all(Path(folder), options.only):
            exam.cells[f"shared: {name}", "shared"].append(verdict)
    print_tables(exam.cells)
    print(f"\n{sum(os.times()[:4]):.0f} s of CPU", file=sys.stderr)
    rows = [(kind, column, *verdict) for (kind, column), verdicts in exam.cells.items() for verdict in verdicts]
    if options.json:
        keys = ("kind", "format", "verdict", "reason")
        options.json.write_text(json.dumps([dict(zip(keys, row, strict=True)) for row in rows], indent=1))
    return int(any(row[2] in {"WRONG", "trace"} and row[0] != "random: value" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
