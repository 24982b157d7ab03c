"""Tries every case of `shared/data/reported` and `shared/data/faults` as its README says."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import dousa
from lab.exams.incoming.door import CLOSE, SLOW, Answer, Read, read, run
from lab.places import SHARED_DATA

Verdict = tuple[str, str]
GIGABYTE = 1_000_000  # kB


def last(answer: Answer) -> str:
    """The last line that was said, or all notes."""
    return answer.trace or "; ".join(answer.notes) or "no word"


def told(answer: Answer, words: str, *, right: bool = False) -> Verdict:
    """Judge by words: right values, an error or a note that speaks of what is wrong; else wrong in silence."""
    said = last(answer)
    speaks = re.search(words, re.sub(r"\S*/\S+", "", said))
    if answer.trace:
        return "trace", said
    if right:
        return ("told" if speaks else "right"), said
    return ("error" if speaks else "vague") if answer.code else ("told" if speaks else "WRONG"), said


def entry(answer: Answer, key: str, default: float = 0.0) -> float:
    return float(answer.info[0][key] or 0) if len(answer.info) == 1 else default


def frame_time(data: Path, work: Path) -> Verdict:
    answer = run("info", "--json", data / "rate.bvh")
    return told(answer, r"rate|Hz|Frame Time|second", right=False)


def positions_zero(data: Path, work: Path) -> Verdict:
    answer = run("info", "--json", data / "zero.bvh")
    places = read(data / "zero.bvh").places
    spread = 0.0 if places is None else float(np.ptp(places, axis=1).max())
    return told(answer, r"OFFSET|offset|size|channel", right=1 < spread < 3)


def rate_override(data: Path, work: Path) -> Verdict:
    for option in (["--read", "frame_rate=120"],):
        answer = run("info", "--json", data / "labelled24.bvh", *option)
        if answer.code == 0 and abs(entry(answer, "frame_rate") - 120) < 1e-6:
            return "right", " ".join(option)
    return ("error" if answer.code else "WRONG"), last(answer)


def easymocap_cameras(data: Path, work: Path) -> Verdict:
    motion = SHARED_DATA / "reported" / "bvh_rate_override" / "labelled24.bvh"
    answer = run("render", motion, "--cameras", data / "calib", "-o", work / "a.npz")
    return told(answer, r".", right=answer.code == 0 and (work / "a.npz").exists())


def prefixed_markers(data: Path, work: Path) -> Verdict:
    answer = run("convert", data / "subject.trc", work / "a.csv")
    if answer.code:
        return told(answer, r".")
    before, after = read(data / "subject.trc"), read(work / "a.csv")
    same = before.names == after.names and near(before, after)
    return ("right" if same and "Anna:Hip" in (work / "a.csv").read_text() else "WRONG"), after.error


def near(a: Read, b: Read, close: float = CLOSE) -> bool:
    """Hold two readings to have the same places."""
    if a.places is None or b.places is None or a.places.shape != b.places.shape:
        return False
    return bool(np.allclose(a.places, b.places, atol=close, rtol=0, equal_nan=True))


def count(library: dousa.Library) -> int:
    """Count the clips of a library, which may have none."""
    return sum(1 for _ in library.iterate_clips())


def keypoints3d(data: Path, work: Path) -> Verdict:
    answer = run("add", work / "l.dousa", data / "keypoints3d", "--category-from", "none", "--json")
    one = run("info", "--json", data / "keypoints3d")
    if answer.code == 0 and (work / "l.dousa").exists():
        with dousa.Library.open(str(work / "l.dousa")) as library:
            n_clips = count(library)
        if n_clips == 1 and entry(one, "n_frames") == 30:
            return "right", ""
        return ("told" if n_clips == 0 and answer.notes else "WRONG"), f"{n_clips} clips; {last(one)}"
    return told(answer, r"single|frame|folder")


def smpl_json(data: Path, work: Path) -> Verdict:
    answer = run("info", "--json", data / "smpl")
    if entry(answer, "n_frames") == 3:
        return "right", ""
    return told(run("info", "--json", data / "smpl" / "000000.json"), r"angles|SMPL poses")


def mesh_only(data: Path, work: Path) -> Verdict:
    return told(run("info", "--json", data / "statue.glb"), r"skeleton|skin")


def meshopt(data: Path, work: Path) -> Verdict:
    return told(run("info", "--json", data / "packed.glb"), r"EXT_meshopt_compression")


def animations(data: Path, work: Path) -> Verdict:
    answer = run("info", "--json", "--animation", "Walk", data / "moves.glb")
    if answer.code:
        return told(run("info", "--json", data / "moves.glb"), "animations")
    shutil.copy(data / "moves.glb", work / "moves.glb")
    added = run("add", work / "l.dousa", work / "moves.glb", "--category-from", "none")
    with dousa.Library.open(str(work / "l.dousa")) as library:
        n_clips = count(library)
    return ("right" if n_clips == 3 else "WRONG"), f"{n_clips} clips of 3; {last(added)}"


def kinect_tables(data: Path, work: Path) -> Verdict:
    files = ("azure_offline_processor.json", "azure.csv", "mediapipe_body_3d_xyz.csv", "nexus.csv")
    answers = [run("info", "--json", data / name) for name in files]
    unread = [
        name for name, a in zip(files, answers, strict=True) if a.code or not a.info or a.info[0]["mapping"] is None
    ]
    return ("error" if unread else "right"), "not read or not mapped: " + ", ".join(unread) if unread else ""


def mvnx_tree(data: Path, work: Path) -> Verdict:
    whole, parts = read(data / "with_joints.mvnx"), read(data / "without.mvnx")
    answer = run("convert", data / "without.mvnx", work / "a.bvh", "--onto", data / "character.bvh")
    run("convert", data / "with_joints.mvnx", work / "w.bvh", "--onto", data / "character.bvh")
    run("convert", data / "without.mvnx", work / "b.bvh")
    roots = (work / "b.bvh").read_text().count("ROOT") if (work / "b.bvh").exists() else 0
    right = near(whole, parts) and roots == 1 and near(read(work / "a.bvh"), read(work / "w.bvh"), 0.01)
    return told(answer, r"roots|tree|<joints>", right=right)


def openpose(data: Path, work: Path) -> Verdict:
    views = (data / "cam01_json", data / "cam02_json")
    answer = run("estimate", *views, "--cameras", data / "Calib.toml", "--stature", "1.75",
                 "--rate", "30", "-o", work / "o.bvh")  # fmt: skip
    return told(answer, r".", right=answer.code == 0 and (work / "o.bvh").exists())


def text_to_motion(data: Path, work: Path) -> Verdict:
    files = ("results.npy", "with_scores.npy", "sample.npy")
    answers = [run("info", "--json", data / name) for name in files]
    unread = [
        f"{n}: {last(a)}" for n, a in zip(files, answers, strict=True) if a.code or entry(a, "n_joints", 22) != 22
    ]
    return ("error" if unread else "right"), "; ".join(unread)


def motive_rows(data: Path, work: Path) -> Iterator[tuple[str, Verdict]]:
    """Rows are missing, exchanged, repeated or cut: an error, a note, or (a digit of the last number) nothing."""
    for path in sorted(data.glob("*.csv")):
        answer = run("info", "--json", path)
        right = path.stem == "cutnum" and entry(answer, "n_frames") == 74
        yield f"csv/{path.name}", told(answer, r"rows?|\d frames|time|gap|repeat|missing|order|truncat", right=right)


def inserted_bytes(data: Path, work: Path) -> Iterator[tuple[str, Verdict]]:
    """Bytes were inserted: an error or a note about sizes, or the motion of the unharmed file."""
    whole = {suffix: read(data / f"x{suffix}") for suffix in (".c3d", ".glb")}
    for path in sorted(data.glob("silent*")):
        words = r"byte|size|left over|damaged|length|header|declare|expect"
        verdict = told(run("info", "--json", path), words, right=near(read(path), whole[path.suffix]))
        yield f"glb_c3d/{path.name}", verdict


def far_away(data: Path, work: Path) -> Iterator[tuple[str, Verdict]]:
    """All coordinates are far from the origin: in the library and as C3D the body stays as it is, or is refused."""
    for name in ("off5e5", "off4e6", "e7"):
        path, library_path, c3d = data / f"{name}.trc", work / f"{name}.dousa", work / f"{name}.c3d"
        places = {}
        answer = run("add", library_path, path, "--category-from", "none")
        if answer.code == 0:
            for which, file in (("base", data / "base.trc"), (name, path)):
                run("add", work / f"{which}.dousa", file, "--category-from", "none")
                with dousa.Library.open(str(work / f"{which}.dousa")) as library:
                    places[which] = np.asarray(library.trajectories(1).positions, float)
            off = shape_error(places["base"], places[name])
            yield f"offset/{name} in a library", told(answer, r"origin|far|cent|moved|away", right=off < CLOSE)
        else:
            yield f"offset/{name} in a library", told(answer, r"origin|far|cent|moved|away|large")
        answer = run("convert", path, c3d)
        off = np.inf
        if answer.code == 0:
            base, now = read(data / "base.trc").places, read(c3d).places
            off = np.inf if base is None or now is None else shape_error(base, now)
        yield f"offset/{name} to C3D", told(answer, r"origin|far|cent|moved|away|large", right=off < CLOSE)


def shape_error(a: np.ndarray, b: np.ndarray) -> float:
    """Compute how far two motions differ but for one shift."""
    off = b - a if a.shape == b.shape else np.array([np.nan])
    if np.isnan(off).all():
        return float("inf")
    return float(np.nanmax(np.abs(off - np.nanmedian(off, axis=(0, 1)))))


def five_million_markers(data: Path, work: Path) -> Iterator[tuple[str, Verdict]]:
    """A TRC of five million markers takes no more than 1 GB and 20 s."""
    path, n = work / "wide.trc", 5_000_000
    head = "PathFileType\t4\t(X/Y/Z)\tx\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
    body = (
        f"OrigDataStartFrame\tOrigNumFrames\n30\t30\t1\t{n}\tm\t30\t1\t1\nFrame#\tTime\t"
        + "A\t\t\t" * n
        + "\n\n1\t0\t"
        + "0\t" * (3 * n)
        + "\n"
    )
    path.write_text(head + body)
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (SLOW, SLOW))  # noqa: E731
    command = [sys.executable, "-c", "import sys; from lab.exams.incoming.door import run; a=run('info', sys.argv[1])\n"
               "print(a.code, len(a.out), a.trace, a.err[-300:])", str(path)]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=limit) as process:  # noqa: PLW1509
        assert process.stdout is not None
        out = process.stdout.read()
        _, status, use = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    spent = f"{use.ru_utime + use.ru_stime:.0f} s of CPU, {use.ru_maxrss / GIGABYTE:.1f} GB; {out.strip()[-200:]}"
    too_much = process.returncode != 0 or use.ru_maxrss > GIGABYTE
    yield "trc_wide", ("WRONG" if too_much else "error" if out.startswith("2") else "right", spent)


REPORTED: dict[str, Callable[[Path, Path], Verdict]] = {
    "bvh_frame_time_is_a_rate": frame_time,
    "bvh_positions_all_zero": positions_zero,
    "bvh_rate_override": rate_override,
    "calibration_of_easymocap": easymocap_cameras,
    "csv_of_prefixed_markers": prefixed_markers,
    "easymocap_keypoints3d": keypoints3d,
    "easymocap_smpl": smpl_json,
    "glb_mesh_only": mesh_only,
    "glb_meshopt": meshopt,
    "glb_several_animations": animations,
    "kinect_and_freemocap_tables": kinect_tables,
    "mvnx_without_joints": mvnx_tree,
    "openpose_2d_to_estimate": openpose,
    "text_to_motion": text_to_motion,
}
FAULTS: dict[str, Callable[[Path, Path], Iterator[tuple[str, Verdict]]]] = {
    "csv": motive_rows,
    "glb_c3d": inserted_bytes,
    "offset": far_away,
    "trc_wide": five_million_markers,
}


def run_all(folder: Path, only: str) -> Iterator[tuple[str, Verdict]]:
    """Try all shared cases whose name contains a word; says which are absent."""
    for group, names in (("reported", REPORTED), ("faults", FAULTS)):
        for name, judge in names.items():
            data, work = SHARED_DATA / group / name, folder / "shared" / name
            if only not in name:
                continue
            if not data.is_dir():
                print(f"shared/data/{group}/{name} is not here: skipped", file=sys.stderr)
                continue
            work.mkdir(parents=True)
            found = judge(data, work)
            yield from ((name, found),) if isinstance(found, tuple) else found
