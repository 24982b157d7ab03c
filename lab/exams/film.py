"""The exam of films without preparation: the command line as a user runs it, against truth and a plain baseline.

    python -m lab.exams.film DATA [--rows 1,2,...] [--dousa COMMAND] [--work FOLDER]

DATA is the folder of recordings. Each line: row, what is measured | target | dousa | baseline.
Written from the words of the task alone, by somebody who had not seen the code. Landmarks are kept in build/exam_film.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np

from lab.exams import film_baseline as plain
from lab.exams.film_baseline import JOINTS, Camera, align
from lab.exams.film_commands import (
    BENCH,
    FAR,
    FOCAL,
    POSTURE,
    RATE,
    SURE,
    VIEWS,
    Answer,
    Exam,
    Motion,
    both,
    mean_error,
    not_there,
    tell,
)


def row_1(exam: Exam) -> None:
    answer = exam.ask("calibrated", exam.films("pose2sim"), "four views")
    truth = exam.truth(np.arange(100.0))
    plainly = both(exam.triangulated((0, 1, 2, 3)), truth)
    base = f"{plainly}, landmarks' own 17 {exam.own_seventeen:.0f} (lag {exam.lag})"
    if not answer.motions:
        return tell("1", "4 views calibrated", "<= 30 mm, heavy + DLT 35", not_there(answer), base)
    found, truth = at_frames(exam, answer.motions[0])
    speed = f"{answer.seconds:.0f} s, {len(found) / answer.seconds:.1f} frames/s in all"
    told = f"{both(found, truth)}; lost {len(answer.lost)}; {speed}"
    tell("1", "4 views calibrated", "<= 30 mm, heavy + DLT 35", told, base)


def at_frames(exam: Exam, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The motion and the truth at its frames; it begins with the films."""
    return motion.joints, exam.truth(np.arange(len(motion.joints)) * RATE / motion.rate)


def row_2(exam: Exam) -> None:
    mine, base, truth = [], [], exam.truth(np.arange(100.0))
    for pair in combinations(range(4), 2):
        name = "+".join(VIEWS[v][-2:] for v in pair)
        answer = exam.ask("calibrated", exam.films("pose2sim", pair), f"pair {name}")
        base.append(mean_error(exam.triangulated(pair), truth))
        told = not_there(answer)
        if answer.motions:
            mine.append(mean_error(*at_frames(exam, answer.motions[0])))
            told = f"{both(*at_frames(exam, answer.motions[0]))}; lost {len(answer.lost)}"
        tell("2", f"views {name}", "", told, both(exam.triangulated(pair), truth))
    mean = f"{np.mean(mine):.0f} mm over {len(mine)} of 6 pairs" if mine else "not there"
    tell("2", "2 views, mean over the pairs", "<= 55 mm, none lost", mean, f"{np.mean(base):.0f} mm")


def row_3(exam: Exam) -> None:
    truth = exam.truth(np.arange(100.0))
    kinds = (("films, focal known", "<= 45 mm aligned", None), ("films", "<= 60 mm aligned", 1920.0))
    for what, target, focal in kinds:
        found, scale = align(from_the_person(exam, focal), truth)
        base = f"{both(found, truth)} (essential matrix, focal {focal or 'known'})"
        answer = exam.ask(what, exam.films("pose2sim"), f"uncalibrated {what}")
        told = not_there(answer)
        if answer.motions:
            found, there = at_frames(exam, answer.motions[0])
            found, scale = align(found, there)
            told = f"{both(found, there)}; scale {scale:.2f}; lost {len(answer.lost)}"
        tell("3", "4 films and a stature" + ("" if focal else ", focal length given"), target, told, base)
    answer = exam.ask("calibrate", exam.films("pose2sim"), "calibrate", ".toml")
    told = "written" if answer.out.exists() else not_there(answer)
    tell("3", "dousa calibrate writes a calibration", "a file", told, "-")


def from_the_person(exam: Exam, focal: float | None) -> np.ndarray:
    """Joints (T, 17, 3) in an arbitrary world; without a known focal length: the picture's longer side, no lens."""
    seen = exam.seen[0]
    if focal is None:
        rays = np.stack([c.straighten(view[..., :2]) for c, view in zip(exam.cameras, seen, strict=True)])
    else:
        rays = (seen[..., :2] - np.array([543.5, 959.5])) / focal
    sure = np.where(seen[..., 2:] > 0.5, rays, np.nan)
    poses = plain.place_cameras(sure.reshape(4, -1, 2), 8 / FOCAL)
    return plain.landmarks_to_joints(plain.triangulate_rays(poses, rays, seen[..., 2]))


# Row 4: a scene of the frames of pose2sim, filmed by cameras that start at other moments.

CUTS = {  # scene (frames of 60 Hz), beginning of each film, its end; cam03 is filmed at 25 frames/s
    "cut, up to 0.5 s": (list(range(100)), [0, 30, 12, 21], [85, 100, 95, 100]),
    "up to 3 s, still before": ([0] * 192 + list(range(100)) + [99] * 30, [0, 180, 82, 43], [322, 310, 322, 300]),
}


def cut_films(exam: Exam, name: str) -> tuple[list[Path], list[np.ndarray]]:
    """The films (no sound), and for each the frame of the scene that its pictures show."""
    scene, begins, ends = CUTS[name]
    folder = exam.work / name.replace(" ", "_").replace(",", "")
    folder.mkdir(exist_ok=True)
    shown, paths = [], []
    for v, film in enumerate(exam.films("pose2sim")):
        rate = 25 if v == 2 else 60
        moments = np.arange(begins[v], ends[v], 60 / rate)
        moments = np.minimum(np.floor(moments + 0.5).astype(int), len(scene) - 1)  # the nearest: no error on average
        plain.write_film(folder / film.name, [scene[m] for m in moments], list(plain.read_frames(film)), rate)
        shown.append(moments)
        paths.append(folder / film.name)
    return paths, shown


def row_4(exam: Exam) -> None:
    for name, (scene, begins, _) in CUTS.items():
        films, shown = cut_films(exam, name)
        truth = (np.array(begins) - begins[0]) / RATE
        base = naive_offsets(exam, [np.array(scene)[m] for m in shown])
        answer = exam.ask("sync", films, f"sync {name}", ".toml")
        found = read_offsets(answer)
        told = not_there(answer) if answer.failed else "offsets not found in the answer"
        if found is not None:
            sign = min((1, -1), key=lambda s: np.abs(s * found - truth).max())
            miss = 1e3 * np.abs(sign * found - truth)
            told = f"{np.round(miss[1:], 1)} ms, most {miss.max():.1f} (sign {sign:+d})"
        wrong = 1e3 * np.abs(base - truth)
        tell("4", f"offsets, {name}", "<= 10 ms", told, f"{np.round(wrong[1:], 1)} ms, most {wrong.max():.1f} (speeds)")
        score_shifted(exam, name, films, scene)


def read_offsets(answer: Answer) -> np.ndarray | None:
    """Four numbers under a key with `offset` in it (or `start`), in s about the first film; `ms` in the key: ms."""

    def search(node: object, key: str) -> list[tuple[str, list[float]]]:
        found: list[tuple[str, list[float]]] = []
        values = list(node.values()) if isinstance(node, dict) else node if isinstance(node, list) else []
        if len(values) == 4 and re.search("offset|start|shift|delay", key):
            numbers = [v for v in values if isinstance(v, (int, float))]
            found += [(key, numbers)] if len(numbers) == 4 else []
        if isinstance(node, list) and len(node) == 4 and all(isinstance(v, dict) for v in node):
            for inner in node[0]:
                found += search([v.get(inner) for v in node], inner)
        pairs = node.items() if isinstance(node, dict) else [(key, v) for v in values]
        return found + [hit for inner, value in pairs for hit in search(value, str(inner))]

    said = answer.said
    if not said and answer.out.exists() and answer.out.suffix == ".toml":
        import tomllib

        said = tomllib.loads(answer.out.read_text())
    hits = search(said, "")
    if not hits:
        return None
    key, numbers = next((hit for hit in hits if "offset" in hit[0]), hits[0])
    values = np.array(numbers, float) / (1e3 if re.search("ms|milli", key) else RATE if "frame" in key else 1)
    return values - values[0]


def naive_offsets(exam: Exam, shown: list[np.ndarray]) -> np.ndarray:
    """Seconds of each film's start after the first one's: cross-correlation of the mean landmark speeds, at 240 Hz."""
    curves = []
    for v, frames in enumerate(shown):
        rate = 25 if v == 2 else 60
        pixels = exam.seen[0][v][frames][..., :2]
        speed = np.nanmedian(np.linalg.norm(np.diff(pixels, axis=0), axis=-1), axis=1) * rate
        fine = np.arange(0, len(frames) / rate, 1 / 240)
        curve = np.interp(fine, (np.arange(len(speed)) + 0.5) / rate, speed)
        curves.append((curve - curve.mean()) / (curve.std() + 1e-9))
    found = []
    for curve in curves:
        sums = np.correlate(curves[0], curve, "full")
        lags = np.arange(len(sums)) - (len(curve) - 1)
        overlap = np.minimum(len(curves[0]), lags + len(curve)) - np.maximum(0, lags)
        scores = np.where(overlap > 0.5 * min(len(curve), len(curves[0])), sums / np.maximum(overlap, 1), -np.inf)
        found.append(lags[np.argmax(scores)] / 240)
    return np.array(found) - found[0]


def score_shifted(exam: Exam, name: str, films: list[Path], scene: list[int]) -> None:
    """The error where the scene moves and all films see it, at the best moment to begin, less the other run's."""
    what, target = f"4 views calibrated, {name}", "<= 3 mm worse"
    answer = exam.ask("calibrated", films, f"shifted {name}")
    together = exam.ask("calibrated", exam.films("pose2sim"), "four views")
    if not answer.motions or not together.motions:
        return tell("4", what, target, not_there(answer if not answer.motions else together), "-")
    first = max(CUTS[name][1][k] for k in range(4)) - scene.index(1) + 1  # frame of pose2sim that all see
    last = min(99, min(CUTS[name][2]) - scene.index(1))
    grid = np.arange(max(0, first), last)
    errors = []
    for motion in (answer.motions[0], together.motions[0]):
        spans = [(error_from(exam, motion, grid, b), b) for b in np.arange(-400, 120, 0.5)]
        errors.append(min((span for span in spans if np.isfinite(span[0])), default=(np.nan, 0.0)))
    shifted, together = errors[0][0], errors[1][0]
    tell("4", what, target, f"{shifted:.0f} mm, synchronised {together:.0f}: {shifted - together:+.1f}", "-")


def error_from(exam: Exam, motion: Motion, grid: np.ndarray, begin: float) -> float:
    """The mean error over the frames `grid` of pose2sim if the motion begins at frame `begin`; NaN beyond it."""
    index = (grid - begin) * motion.rate / RATE
    if index[0] < -1 or index[-1] > len(motion.joints):
        return np.nan
    index = np.clip(index, 0, len(motion.joints) - 1.001)
    below, part = index.astype(int), (index % 1)[:, None, None]
    found = (1 - part) * motion.joints[below] + part * motion.joints[below + 1]
    return mean_error(found, exam.truth(grid.astype(float)))


def row_5(exam: Exam) -> None:
    for v, camera in enumerate(exam.cameras):
        answer = exam.ask("one view", exam.films("pose2sim", (v,)), f"one view {v + 1}")
        world = plain.landmarks_to_joints(exam.seen[1][v]) @ camera.rotation  # camera axes -> world axes
        base = posture_error(world, exam.truth(np.arange(100.0)))
        told = not_there(answer)
        if answer.motions:
            told = f"{posture_error(*at_frames(exam, answer.motions[0])):.0f} mm; lost {len(answer.lost)}"
        tell("5", f"one view {camera.name}, about the hips", "<= 90 mm each", told, f"{base:.0f} mm (network's own 3D)")


def posture_error(found: np.ndarray, truth: np.ndarray) -> float:
    return mean_error((found - found[:, :1])[:, POSTURE], (truth - truth[:, :1])[:, POSTURE])


def row_6(exam: Exam) -> None:
    people = two_people(exam)
    height = exam.cameras[0].size[1]
    plainly = {
        who: plain.landmarks_to_joints(plain.triangulate(exam.cameras, seen[..., :2], seen[..., 2]))
        for who, seen in people.items()
    }
    base = "; ".join(f"{who} {reprojection(exam, points, people[who]) / height:.1%}" for who, points in plainly.items())
    answer = exam.ask("everybody", exam.films("two"), "everybody")
    target = "2 motions, <= 2 %, no swap"
    if not answer.motions:
        return tell("6", "two people", target, not_there(answer), base + " (heavy + DLT, identities given)")
    told = f"{len(answer.motions)} motions"
    tell("6", "two people: motions", "2", told, "2 (given)")
    for k, motion in enumerate(answer.motions):
        miss = {who: reprojection(exam, motion.joints, seen) / height for who, seen in people.items()}
        who = min(miss, key=lambda one: miss[one])
        step = np.linalg.norm(np.diff(motion.joints[:, 0], axis=0), axis=1)
        text = f"is the {who}: {miss[who]:.1%}; {swaps(motion, plainly, who)} frames nearer to the other"
        text += f"; leaps > 100 mm {int((step > 0.1).sum())}, most {1e3 * np.nanmax(step):.0f} mm"
        text += f"; {both(*at_frames(exam, motion))}" if who == "man" else ""
        tell("6", f"two people: motion {k + 1}", "<= 2 %, 0 frames, 0 leaps", text, f"{base} (heavy + DLT)")


def swaps(motion: Motion, people: dict[str, np.ndarray], who: str) -> int:
    n_frames = min(len(motion.joints), 100)
    gaps = {
        name: np.linalg.norm(motion.joints[:n_frames, 0] - points[:n_frames, 0], axis=1)
        for name, points in people.items()
    }
    return int(sum((gaps[who] > other).sum() for name, other in gaps.items() if name != who))


def reprojection(exam: Exam, joints: np.ndarray, seen: np.ndarray) -> float:
    """Mean over views, frames and the 15 sure joints of the distance in pixels to visible landmarks (V, T, 33, 3)."""
    n_frames, misses = min(len(joints), seen.shape[1]), []
    for camera, view in zip(exam.cameras, seen, strict=True):
        marks = plain.landmarks_to_joints(view[:n_frames])
        miss = np.linalg.norm(camera.project(joints[:n_frames]) - marks[..., :2], axis=-1)
        misses.append(np.where(marks[..., 2] > 0.5, miss, np.nan)[:, SURE])
    return float(np.nanmean(misses))


def two_people(exam: Exam) -> dict[str, np.ndarray]:
    """Own detections (V, T, 33, 3) of the man (near the reference) and the woman (the biggest away from him)."""
    found: dict[str, list[np.ndarray]] = {"man": [], "woman": []}
    for camera, film in zip(exam.cameras, exam.films("two"), strict=True):
        hips = camera.project(exam.reference[np.clip(np.arange(100) + exam.lag, 0, 99), 0])

        def gap(t: int, crop: plain.Crop, hips: np.ndarray = hips) -> float:
            return float(np.hypot(*(crop.middle - hips[min(t, 99)])))

        choose = {
            "man": lambda t, crops: min((c for c in crops if gap(t, c) < 120), key=lambda c: gap(t, c), default=None),
            "woman": lambda t, crops: max((c for c in crops if gap(t, c) > 120), key=lambda c: c.side, default=None),
        }
        close = {"man": lambda t, crop: gap(t, crop) < 120, "woman": lambda t, crop: gap(t, crop) > 90}
        for who, views in found.items():
            views.append(plain.follow(film, f"two_{film.stem}_{who}", choose[who], close[who])[0])
    return {who: without_strays(exam.cameras, np.stack(views)) for who, views in found.items()}


def without_strays(cameras: list[Camera], seen: np.ndarray) -> np.ndarray:
    """A view of a frame is left out if another set of views agrees without it: 40 pixels in the median are too many."""
    seen = seen.copy()
    for _ in range(2):
        points = plain.triangulate(cameras, seen[..., :2], seen[..., 2])
        miss = np.stack(
            [np.linalg.norm(c.project(points) - s[..., :2], axis=-1) for c, s in zip(cameras, seen, strict=True)]
        )
        bad = np.nanmedian(np.where(np.isfinite(miss), miss, 0), axis=2)  # (V, T)
        worst = (bad == bad.max(axis=0)) & (bad > 40)
        seen[worst] = np.nan
    return seen


def row_7(exam: Exam) -> None:
    tallies = {"film": np.zeros(4, int), "silhouette_bench": np.zeros(4, int)}
    refused = 0
    gone = exam.work / "gone"
    gone.mkdir(exist_ok=True)
    for film in exam.films("pose2sim"):  # Nobody is seen from frame 40 to 69.
        pictures = list(plain.read_frames(film))
        plain.write_film(
            gone / film.name,
            [k if not 40 <= k < 70 else 100 for k in range(100)],
            [*pictures, np.zeros_like(pictures[0])],
            60,
        )
    runs = [("four views", exam.films("pose2sim")), ("nobody from 40 to 69", exam.films("gone"))]
    runs += [(f"pair {a + 1:02d}+{b + 1:02d}", exam.films("pose2sim", (a, b))) for a, b in combinations(range(4), 2)]
    for name, films in runs:
        answer = exam.ask("calibrated", films, name)
        for motion in answer.motions[:1]:
            found, truth = at_frames(exam, motion)
            if films[0].parent == gone:  # Whatever is said of frames that nobody sees is a guess: off.
                truth[40:70] += 1000
            tallies["film"] += plain.tally(found, truth, answer.lost, FAR)
        refused += not answer.motions
    refused_bench = 0
    for clip in sorted((exam.data / "silhouette_bench").glob(BENCH)):
        for views in ((0, 1, 2, 3), (0, 1)):
            answer = exam.ask("bench", [bench_views(exam, clip, views)], f"{clip.stem} {len(views)}")
            with np.load(clip) as file:
                names, there = [str(n) for n in file["joint_names"]], file["joint_positions"]
            truth = there[:, [names.index(joint) for joint in JOINTS]].copy()
            truth[:, 0] = (there[:, names.index("left_hip")] + there[:, names.index("right_hip")]) / 2
            for motion in answer.motions[:1]:
                tallies["silhouette_bench"] += plain.tally(
                    motion.joints[: len(truth)], truth[: len(motion.joints)], answer.lost, FAR
                )
            refused_bench += not answer.motions
    for (where, (off, caught, good, wrongly)), n in zip(tallies.items(), (refused, refused_bench), strict=True):
        share = f"{caught}/{off} off flagged ({caught / max(off, 1):.0%})"
        share += f", {wrongly}/{good} good flagged ({wrongly / max(good, 1):.0%})"
        told = f"{share}; {n} runs without a motion" if off + good else "not there (no motion)"
        tell(
            "7",
            f"lost, {where}: frames off by more than 150 mm",
            ">= 90 % of off, <= 5 % good",
            told,
            "nothing flagged: 0 %, 0 %",
        )


def bench_views(exam: Exam, clip: Path, views: tuple[int, ...]) -> Path:
    """The clip with some of its views, without the truth."""
    path = exam.work / "bench" / f"{clip.stem}_{len(views)}.npz"
    path.parent.mkdir(exist_ok=True)
    with np.load(clip) as file:
        by_view = ("mask_packed", "camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")
        kept = {
            name: file[name][list(views)] if name in by_view else file[name]
            for name in file.files
            if not name.startswith("joint_")
        }
    np.savez_compressed(path, **kept)
    return path


def row_8(exam: Exam) -> None:
    for case, what, films, words in bad_inputs(exam):
        answer = exam.ask(what, films, f"bad {case}", ".toml" if what in ("sync", "calibrate") else ".trc", **words)
        if answer.code == -1:
            told = not_there(answer)
        else:
            fine = answer.code == 2 and len(answer.error_lines) == 1 and not answer.out.exists()
            text = (answer.error_lines or ["nothing"])[-1][:110]
            told = f"{'yes' if fine else 'NO'}: exit {answer.code}, {len(answer.error_lines)} lines: {text}"
            if not answer.code:
                told += f"; lost {len(answer.lost)}, warnings {len(answer.said.get('warnings', []))}"
        tell("8", case, "exit 2 and one line", told, "-")


def bad_inputs(exam: Exam) -> list[tuple[str, str, list[Path], dict[str, object]]]:
    folder = exam.work / "bad"
    folder.mkdir(exist_ok=True)
    first, second = exam.films("pose2sim", (0, 1))
    pictures = list(plain.read_frames(first))
    walk = folder / "walk.mp4"
    shutil.copyfile(exam.data / "films/one_view_walk/demo.mp4", walk)
    names = ("black1", "black2", "damaged", "still1", "still2", "moving", "twin")
    made = {name: folder / f"{name}.mp4" for name in names}
    for name in ("black1", "black2"):
        plain.write_film(made[name], [0] * 60, [np.zeros_like(pictures[0])], 60)
    made["damaged"].write_bytes(first.read_bytes()[: first.stat().st_size * 6 // 10])
    plain.write_film(made["still1"], [0] * 60, pictures, 60)
    plain.write_film(made["still2"], [0] * 60, list(plain.read_frames(second)), 60)
    plain.write_film(made["moving"], list(range(100)), [np.roll(p, 4 * t, axis=1) for t, p in enumerate(pictures)], 60)
    shutil.copyfile(first, made["twin"])
    keyless = plain.without_key_frames(exam.films("pose2sim", (2,))[0], folder / "keyless.mp4")
    wrong = folder / "wrong.qca.txt"
    swapped = exam.calibration.read_text().replace('"cam01"', '"x"').replace('"cam03"', '"cam01"')
    swapped = swapped.replace('"x"', '"cam03"')
    wrong.write_text(swapped)
    return [
        ("films of different people: estimate", "films", [first, walk], {}),
        ("films of different people: sync", "sync", [first, walk], {}),
        ("films of different people: calibrate", "calibrate", [first, walk], {}),
        ("nobody (black films): estimate", "calibrated", [made["black1"], made["black2"]], {}),
        ("nobody (black films): sync", "sync", [made["black1"], made["black2"]], {}),
        ("damaged film (cut off at 60 %)", "calibrated", [first, second, made["damaged"]], {}),
        ("film without key frames", "calibrated", [first, second, keyless], {}),
        ("one picture repeated: sync", "sync", [made["still1"], made["still2"]], {}),
        ("one picture repeated: calibrate", "calibrate", [made["still1"], made["still2"]], {}),
        ("no parallax (the same film twice)", "calibrate", [first, made["twin"]], {}),
        ("a camera that moves", "calibrate", [second, made["moving"]], {}),
        ("wrong calibration (cam01 and cam03 exchanged)", "calibrated", exam.films("pose2sim"), {"cameras": wrong}),
    ]


ROWS = {"1": row_1, "2": row_2, "3": row_3, "4": row_4, "5": row_5, "6": row_6, "7": row_7, "8": row_8}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--dousa", default="dousa")
    parser.add_argument("--work", type=Path, help="keep the temporary folder here")
    options = parser.parse_args()
    work = options.work or Path(tempfile.mkdtemp(prefix="exam_film_"))
    try:
        exam = Exam(options.data.resolve(), options.dousa, work.resolve())
        tell("row", "", "target", "dousa", "baseline")
        for row in options.rows.split(","):
            try:
                ROWS[row.strip()](exam)
            except Exception as error:  # A row must not end the others.
                tell(row, "the row broke", "", f"{type(error).__name__}: {error}", "-")
                if os.environ.get("EXAM_DEBUG"):
                    raise
    finally:
        if options.work is None:
            shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
