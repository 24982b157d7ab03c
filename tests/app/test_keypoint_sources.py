"""Keypoints of other programs where films are expected: estimate, sync and calibrate from the command line."""

import json

import cv2
import numpy as np
import pytest
from oracles.made_films import Performance, make_cameras
from oracles.made_films import film as make_film

from dousa.estimation import read_cameras, write_cameras, write_silhouettes
from dousa.estimation.keypoints.keypoint_json import COCO_17, HALPE_26
from dousa.formats.registry import read_motion

BEGINS, RATE = (0.3, 0.65), 30.0


def to_rows(view, names, person=0):
    """(T, K, 3) x, y, confidence; points that the performance lacks are zero, as other programs have them."""
    rows = np.zeros((view.n_frames, len(names), 3))
    for place, name in enumerate(names):
        if name in view.names:
            rows[:, place, :2] = view.people[person].points[:, view.names.index(name)]
            rows[:, place, 2] = 0.9
    return rows


def write_openpose(folder, rows):
    for frame, points in enumerate(rows):
        path = folder.with_name(f"{folder.name}_json") / f"{folder.name}_{frame:012d}_keypoints.json"
        path.parent.mkdir(exist_ok=True)
        people = [{"person_id": [-1], "pose_keypoints_2d": points.reshape(-1).tolist()}]
        path.write_text(json.dumps({"version": 1.3, "people": people}))
    return folder.with_name(f"{folder.name}_json")


def write_json(content):
    def write(path, rows):
        path = path.with_suffix(".json")
        path.write_text(json.dumps(content(rows)))
        return path

    return write


def write_table(path, rows):
    names = [name.replace("left_", "L").replace("right_", "R").title().replace("_", "") for name in COCO_17]
    heading = [
        ["scorer", *["DLC_net"] * 51],
        ["bodyparts", *np.repeat(names, 3)],
        ["coords", *["x", "y", "likelihood"] * 17],
    ]
    lines = [*heading, *[[frame, *points.reshape(-1)] for frame, points in enumerate(rows)]]
    path = path.with_suffix(".csv")
    path.write_text("\n".join(",".join(map(str, line)) for line in lines))
    return path


def mmpose(rows):
    people = [[{"keypoints": p[:, :2].tolist(), "keypoint_scores": p[:, 2].tolist()}] for p in rows]
    names = {str(number): name for number, name in enumerate(COCO_17)}
    frames = [{"frame_id": number + 1, "instances": found} for number, found in enumerate(people)]
    return {"meta_info": {"dataset_name": "coco", "keypoint_id2name": names}, "instance_info": frames}


def alphapose(rows):
    return [
        {"image_id": f"{frame}.jpg", "category_id": 1, "keypoints": points.reshape(-1).tolist(), "score": 2.9, "idx": 1}
        for frame, points in enumerate(rows)
    ]


def coco(rows):
    images = [{"id": frame, "file_name": f"{frame:05d}.png"} for frame in range(len(rows))]
    flags = [np.where(points[:, 2:] > 0, 2.0, 0.0) for points in rows]
    found = [
        {"image_id": frame, "keypoints": np.hstack([points[:, :2], flag]).reshape(-1).tolist()}
        for frame, (points, flag) in enumerate(zip(rows, flags, strict=True))
    ]
    return {"images": images, "annotations": found, "categories": [{"name": "person", "keypoints": list(COCO_17)}]}


def by_image(rows):
    return {
        f"{frame}.jpg": {"version": "AlphaPose", "people": [{"pose_keypoints_2d": points.reshape(-1).tolist()}]}
        for frame, points in enumerate(rows)
    }


PROGRAMS = {
    "openpose": (HALPE_26, write_openpose),
    "alphapose": (COCO_17, write_json(alphapose)),
    "alphapose, one object": (COCO_17, write_json(by_image)),
    "mmpose": (COCO_17, write_json(mmpose)),
    "coco": (COCO_17, write_json(coco)),
    "deeplabcut": (COCO_17, write_table),
}


def at_night(first, *others):
    """One case with every run, the others nightly."""
    return [first, *(pytest.param(other, marks=pytest.mark.slow) for other in others)]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The views of two cameras, and a calibration."""
    folder = tmp_path_factory.mktemp("scene")
    performance, cameras = Performance(("punch", "turn_around", "kick_left")), make_cameras(2)
    write_cameras(folder / "Calib.toml", cameras)
    views = [make_film(performance, camera, begin, 2.5, RATE) for camera, begin in zip(cameras, BEGINS, strict=True)]
    return folder / "Calib.toml", {camera.name: view for camera, view in zip(cameras, views, strict=True)}


@pytest.fixture(scope="module")
def written(scene, tmp_path_factory):
    """The files of a program."""

    def write(program):
        folder = tmp_path_factory.mktemp("keypoints")
        names, writer = PROGRAMS[program]
        return [writer(folder / name, to_rows(view, names)) for name, view in scene[1].items()]

    return write


@pytest.mark.parametrize("program", at_night(*PROGRAMS))
def test_times_of_every_programs_keypoints(dousa, scene, written, program):
    code, out, error = dousa("sync", *written(program), "--calibration", scene[0], "--rate", RATE, "--json")
    assert code == 0, error
    assert json.loads(out)["films"][1]["offset"] == pytest.approx(BEGINS[1] - BEGINS[0], abs=0.02)


@pytest.mark.parametrize("program", at_night("mmpose", "openpose", "deeplabcut"))
def test_a_motion_of_every_programs_keypoints(dousa, scene, written, program, tmp_path):
    code, out, error = dousa(
        "estimate", *written(program), "--cameras", scene[0], "--rate", RATE, "-o", tmp_path / "out.bvh", "--json"
    )
    assert code == 0, error
    answer = json.loads(out)
    assert read_motion(tmp_path / "out.bvh").frame_rate == pytest.approx(RATE)
    assert not answer["lost_frames"] and not any("assumed" in note for note in answer["warnings"])


def draw_hulls(view):
    """Masks (T, H, W) of a quarter of the size: the hulls of all points."""
    masks = np.zeros((view.n_frames, view.size[1] // 4, view.size[0] // 4), np.uint8)
    for mask, points in zip(masks, view.people[0].points, strict=True):
        cv2.fillConvexPoly(mask, cv2.convexHull((points[np.isfinite(points[:, 0])] / 4).astype(np.int32)), 255)
    return masks


@pytest.mark.parametrize("form", at_night("folders", "one file"))
def test_masks_beside_keypoints_are_of_the_same_views(dousa, scene, written, form, tmp_path):
    masks = {name: draw_hulls(view) for name, view in scene[1].items()}
    if form == "one file":
        sources = [tmp_path / "clip.npz"]
        write_silhouettes(sources[0], list(masks.values()), frame_rate=RATE)
    else:
        sources = [tmp_path / name for name in masks]
        for folder, pictures in zip(sources, masks.values(), strict=True):
            folder.mkdir()
            for frame, picture in enumerate(pictures):
                cv2.imwrite(str(folder / f"{frame:04d}.png"), picture)
    words = ("--cameras", scene[0], "--rate", RATE, "--frames", "0:8", "-o", tmp_path / "out.bvh", "--json")
    code, out, error = dousa("estimate", *written("openpose"), *sources, "--cues", "both", *words)
    assert code == 0, error
    answer = json.loads(out)
    assert answer["iou"]["mean"] > 0.4 and len(answer["views"]) == 2
    code, _, error = dousa("estimate", *written("openpose")[:1], sources[-1], sources[-1], *words)
    assert code == 2 and "Traceback" not in error


def test_cameras_of_keypoints(dousa, scene, written, tmp_path):
    times, made = tmp_path / "sync.toml", tmp_path / "made.toml"
    starts = zip(scene[1], BEGINS, strict=True)
    times.write_text("".join(f'[[film]]\nname = "{name}"\noffset = {begin - BEGINS[0]}\n' for name, begin in starts))
    words = ("--rate", RATE, "--stature", "1.7", "--offsets", times, "--calibration", scene[0], "-o", made)
    code, _, error = dousa("calibrate", *written("mmpose"), *words)
    assert code == 0, error
    apart = [float(np.linalg.norm(one.position - other.position)) for one, other in map(read_cameras, (made, scene[0]))]
    assert apart[0] == pytest.approx(apart[1], rel=0.2)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "--size WxH"),
        (("--size", "big"), "big"),
        (("--rate", "0"), "above 0"),
        (("--cameras", "one.toml"), "1 camera for the views"),
    ],
)
def test_what_lacks_is_one_sentence(dousa, scene, written, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    write_cameras("one.toml", read_cameras(scene[0])[:1])
    code, out, error = dousa("estimate", *written("openpose"), *words, "--stature", "1.7", "-o", "out.bvh")
    assert (code, out, error.count("\n")) == (2, "", 1) and says in error, error
    assert not (tmp_path / "out.bvh").exists()


def test_others_who_are_seen_are_named(dousa, scene, tmp_path):
    sources = []
    for name, view in scene[1].items():
        rows = to_rows(view, COCO_17)
        people = [(frame, who, rows[::step][frame]) for frame in range(len(rows)) for who, step in enumerate((1, -1))]
        found = [
            {"image_id": f"{frame}.jpg", "keypoints": points.reshape(-1).tolist(), "idx": who}
            for frame, who, points in people
        ]
        sources.append(tmp_path / f"{name}.json")
        sources[-1].write_text(json.dumps(found))
    words = ("estimate", *sources, "--cameras", scene[0], "--rate", RATE, "--offsets", "none", "--json")
    code, out, error = dousa(*words, "-o", tmp_path / "one.trc")
    assert code == 0, error
    assert any("--person N takes another" in note for note in json.loads(out)["warnings"])


def test_points_in_pictures_are_no_motion_though_their_suffix_is_that_of_one(dousa, tmp_path):
    path = tmp_path / "left_px.trc"
    heads = ("PathFileType", "DataRate", "30", "Frame#\tTime\tNose\t\t\tLKnee\t\t\tRKnee\t\t",
             "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3", "")  # fmt: skip
    rows = (f"{number}\t{number / 10}" + "\t10\t20\t0" * 3 for number in range(1, 4))
    path.write_text("\n".join([*heads, *rows, ""]))
    code, _, error = dousa("estimate", path, "--stature", "1.7", "--size", "64x48", "-o", tmp_path / "out.bvh")
    assert code == 2 and "is a motion already" not in error
