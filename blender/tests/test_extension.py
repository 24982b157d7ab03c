# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in a Blender without windows: `make blender`.

DOUSA names the program. The library is that of `dousa demo`, made anew unless DOUSA_DEMO names its folder.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

FOLDER = Path(__file__).parents[1]
DOUSA = os.environ.get("DOUSA", "dousa")
QUERY = "kick_left/performer00_1.bvh"
sys.path.insert(0, str(FOLDER))

import dousa_motion_search  # noqa: E402
from dousa_motion_search import bvh, thumbnails  # noqa: E402
from dousa_motion_search.session import SESSION  # noqa: E402
from dousa_motion_search.studio import Studio, StudioError  # noqa: E402


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """The folder of the demo: a library that is trained, with its recordings."""
    if "DOUSA_DEMO" in os.environ:
        return Path(os.environ["DOUSA_DEMO"])
    folder = tmp_path_factory.mktemp("demo")
    subprocess.run([DOUSA, "demo", "--output", str(folder)], check=True, capture_output=True)
    return folder


@pytest.fixture(autouse=True)
def extension():
    """A new file, and the extension switched on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    dousa_motion_search.register()
    yield
    dousa_motion_search.unregister()


def import_armature(path):
    bpy.ops.import_anim.bvh(filepath=str(path), global_scale=0.01, use_fps_scale=False, update_scene_fps=True)
    return bpy.context.active_object


def make_character():
    """A person of 1.4 m with other names, rolled bones, turned and scaled as an object."""
    data = bpy.data.armatures.new("hero")
    hero = bpy.data.objects.new("hero", data)
    bpy.context.scene.collection.objects.link(hero)
    bpy.context.view_layer.objects.active = hero
    hero.scale, hero.rotation_euler, hero.location = (0.1,) * 3, (0, 0, 0.7), (1, 2, 0)
    bpy.ops.object.mode_set(mode="EDIT")
    chains = {
        "hips spine chest neck head": ((0, 0, 8), (0, 0, 9), (0, 0, 10), (0, 0, 11.6), (0, 0, 12.2)),
        "chest shoulder.L upper_arm.L forearm.L hand.L": (
            0,
            (0.3, 0, 11.3),
            (1.2, 0, 11.3),
            (3.4, 0, 11.3),
            (5.4, 0, 11.3),
        ),
        "chest shoulder.R upper_arm.R forearm.R hand.R": (
            0,
            (-0.3, 0, 11.3),
            (-1.2, 0, 11.3),
            (-3.4, 0, 11.3),
            (-5.4, 0, 11.3),
        ),
        "hips thigh.L shin.L foot.L toe.L": (0, (0.8, 0, 7.8), (0.8, -0.1, 4.4), (0.8, 0, 0.8), (0.8, -1.2, 0.1)),
        "hips thigh.R shin.R foot.R toe.R": (0, (-0.8, 0, 7.8), (-0.8, -0.1, 4.4), (-0.8, 0, 0.8), (-0.8, -1.2, 0.1)),
    }
    tips = {
        "head": (0, 0, 14),
        "hand.L": (6.2, 0, 11.3),
        "hand.R": (-6.2, 0, 11.3),
        "toe.L": (0.8, -1.8, 0.1),
        "toe.R": (-0.8, -1.8, 0.1),
    }
    for roll, (names, heads) in enumerate(chains.items()):
        words = names.split()
        for place, word in enumerate(words):
            if word in data.edit_bones:
                continue
            bone = data.edit_bones.new(word)
            bone.head = heads[place]
            bone.tail = tips[word] if word in tips else heads[place + 1]
            bone.roll = 0.5 * roll
            if place:
                bone.parent = data.edit_bones[words[place - 1]]
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    return hero


def joint_places(armature, frame):
    """Heads of the bones in the world."""
    bpy.context.scene.frame_set(frame)
    return {bone.name: np.array(armature.matrix_world @ bone.head) for bone in armature.pose.bones}


def swing(armature, n_frames=12):
    """Some bones of a character moved about their own axes."""
    for frame in range(1, n_frames + 1):
        for k, name in enumerate(("hips", "upper_arm.L", "forearm.R", "thigh.L", "head")):
            bone = armature.pose.bones[name]
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = [0.9 * math.sin(0.3 * frame + k + axis) for axis in range(3)]
            bone.keyframe_insert("rotation_euler", frame=frame)
        armature.pose.bones["hips"].location = (0.1 * frame, 0.2, 0.05 * frame)
        armature.pose.bones["hips"].keyframe_insert("location", frame=frame)


def test_the_manifest_says_what_blender_asks_for():
    manifest = tomllib.loads((FOLDER / "dousa_motion_search/blender_manifest.toml").read_text())
    needed = {
        "schema_version",
        "id",
        "version",
        "name",
        "tagline",
        "maintainer",
        "type",
        "blender_version_min",
        "license",
    }
    assert needed <= set(manifest)
    assert manifest["id"] == dousa_motion_search.__name__ and manifest["type"] == "add-on"
    assert len(manifest["tagline"]) <= 64 and not manifest["tagline"].endswith(".")
    assert all(len(reason) <= 64 and not reason.endswith(".") for reason in manifest["permissions"].values())


def test_what_is_recorded_and_applied_is_the_same_motion():
    hero = make_character()
    swing(hero)
    text = bvh.record(hero, 1, 12)
    before = [joint_places(hero, frame) for frame in range(1, 13)]
    first, last = bvh.apply(hero, bvh.read_bvh(text), "again", 1)
    assert (first, last) == (1, 12)
    for frame, places in enumerate(before, 1):
        after = joint_places(hero, frame)
        assert max(np.linalg.norm(after[name] - place) for name, place in places.items()) < 1e-4  # m


def test_a_recording_is_the_file_it_was_imported_from(demo, tmp_path):
    path = demo / "motions" / QUERY
    armature = import_armature(path)
    text = bvh.record(armature, *map(round, armature.animation_data.action.frame_range))
    (tmp_path / "recorded.bvh").write_text(text)
    first, second = (describe(file) for file in (path, tmp_path / "recorded.bvh"))
    assert second["n_frames"] == first["n_frames"]
    assert second["height_m"] == pytest.approx(first["height_m"], rel=0.02)


def describe(path):
    import json

    done = subprocess.run([DOUSA, "info", str(path), "--json"], check=True, capture_output=True, text=True)
    answer = json.loads(done.stdout)
    return answer[0] if isinstance(answer, list) else answer


def test_search_finds_and_a_hit_becomes_an_action(demo):
    armature = import_armature(demo / "motions" / QUERY)
    settings = bpy.context.window_manager.dousa
    settings.library = str(demo / "demo.dousa")
    SESSION.connect(Studio.start(settings.library, DOUSA))
    settings.n_hits = 5
    assert bpy.ops.dousa.search() == {"FINISHED"}
    found = SESSION.found
    assert len(found.hits) == 5
    assert found.category == found.hits[0].category != ""

    hit = found.hits[0]
    assert bpy.ops.dousa.import_new(motion=hit.motion, name=hit.name) == {"FINISHED"}
    assert bpy.context.active_object is not armature

    hero = make_character()
    assert bpy.ops.dousa.import_onto(motion=hit.motion, name=hit.name) == {"FINISHED"}
    first, last = map(round, hero.animation_data.action.frame_range)
    assert last - first > 10
    tall = [joint_places(hero, frame) for frame in range(first, last + 1, 5)]
    lengths = [np.linalg.norm(places["forearm.L"] - places["upper_arm.L"]) for places in tall]
    assert np.ptp(lengths) < 1e-5 and lengths[0] == pytest.approx(0.22, abs=1e-4)  # its own proportions
    assert all(places["head"][2] > places["foot.L"][2] for places in tall)  # upright
    moved = np.ptp([places["hand.L"] for places in tall], axis=0).max()
    assert moved > 0.05


def test_thumbnails_show_a_body():
    pose = np.zeros((24, 20, 2), np.int8)
    assert not thumbnails.draw(np.zeros(4, "<f4").tobytes() + bytes(1440)).any()
    rng = np.random.default_rng(0)
    body = rng.integers(-100, 100, (24, 20, 3)).astype(np.int8)
    picture = thumbnails.draw(np.array([0.01, 1, 0, 0.5], "<f4").tobytes() + body.tobytes())
    assert pose.shape[0] == 24 and picture.shape == (thumbnails.SIZE, thumbnails.SIZE, 4)
    assert 0.02 < (picture[..., 3] == 1).mean() < 0.6


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("http://example.org:8765/?token=abc", "studio on this machine"),
        ("", "studio on this machine"),
        ("http://127.0.0.1:9/?token=abc", "does not answer"),
    ],
)
def test_an_address_that_is_none_is_one_sentence(address, words):
    with pytest.raises(StudioError, match=words):
        Studio(address).info()


def test_a_library_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(StudioError, match="There is no library"):
        Studio.start(tmp_path / "no.dousa", DOUSA)
    (tmp_path / "bad.dousa").write_text("not a library")
    with pytest.raises(StudioError, match=r"dousa studio ended: .*bad.dousa"):
        Studio.start(tmp_path / "bad.dousa", DOUSA)
    with pytest.raises(StudioError, match="was not found"):
        Studio.start(tmp_path / "bad.dousa", "no-such-program")


def test_an_armature_without_bones_and_several_roots():
    empty = bpy.data.objects.new("empty", bpy.data.armatures.new("empty"))
    with pytest.raises(bvh.BvhError, match="no bones"):
        bvh.read_skeleton(empty)
    hero = make_character()
    bpy.context.view_layer.objects.active = hero
    bpy.ops.object.mode_set(mode="EDIT")
    prop = hero.data.edit_bones.new("a prop")
    prop.head, prop.tail = (3, 0, 0), (3, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    joints = bvh.read_skeleton(hero)
    assert [joint.name for joint in joints if joint.parent < 0] == ["all_roots"]
    assert "a_prop" in [joint.name for joint in joints]
    assert joints[0].rest == Matrix.Identity(3)
    assert tuple(joints[1].head) == pytest.approx((100, 80, -200), abs=1e-3)  # cm, y up
