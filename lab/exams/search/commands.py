"""dousa as anybody uses it: its command line, in a process of its own, and its answers as JSON."""

from __future__ import annotations

import csv
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import dousa

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(dousa.__file__).resolve().parents[1])}


class CommandError(RuntimeError):
    """dousa did not answer."""


def ask(*words):
    """(what it answers, s by the clock, s of the processor) of a command."""
    began, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "dousa", "--jobs", "1", *map(str, words), "--json"]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    try:
        return json.loads(done.stdout), time.perf_counter() - began, spent
    except json.JSONDecodeError:
        raise CommandError(f"dousa {' '.join(map(str, words[:3]))}: {done.stderr.strip()[-400:]}") from None


def build(library, clips, takes=(), labels=None, performer=None, train=True):
    """A library of clips, and of takes with labels or without; (wall, processor) s of its training."""
    library.unlink(missing_ok=True)
    library.parent.mkdir(parents=True, exist_ok=True)
    if clips:
        table = library.with_suffix(".csv")
        with open(table, "w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(("file", "category", "performer"))
            rows.writerows((c.path, c.category, f"{c.dataset}_{c.person}") for c in clips)
        rule = f"csv:{table}"
        ask("add", library, *(c.path for c in clips), "--category-from", rule, "--performer-from", rule)
    if takes:
        extra = ("--labels", labels) if labels else ()
        extra += ("--performer-from", performer) if performer else ()
        ask("add", library, *takes, "--takes", *extra)
    return ask("train", library)[1:] if train else (0.0, 0.0)


def label(library, take, *extra):
    """[(start, end, category, confidence, repetitions)] of a take, without what is unknown."""
    answer = ask("label", library, take, *extra)[0]
    return [
        (s["start_s"], s["end_s"], s["category"], s["confidence"], s.get("repetitions", 1))
        for s in answer["segments"]
        if s["category"] is not None
    ]


def classify(library, paths):
    """[(guess, category or None, confidence, how likely known)] of files, in their order."""
    answers = {a["path"]: a for a in ask("classify", library, *paths)[0]}
    rows = (answers[str(p)] for p in paths)
    return [(a.get("guess"), a.get("category"), a.get("confidence") or 0.0, a.get("known") or 0.0) for a in rows]
