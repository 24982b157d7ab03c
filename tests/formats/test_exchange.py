"""FBX and Collada through other programs: with programs of the tests' own that work, fail, hang or talk nonsense."""

import json
import os
import struct
import sys
import zlib

import numpy as np
import pytest

from dousa.errors import MotionFileError, MotionWriteError, OptionError
from dousa.formats import read_character
from dousa.formats.exchange import fbx_soundness, programs
from dousa.formats.exchange.assimp_repair import collapse_helpers, read_unit
from dousa.formats.gltf.document import GltfDocument
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from formats import fake_programs as fake
from formats import made_people
from formats.made_files import code_of
from patience import PATIENCE

pytestmark = pytest.mark.skipif(os.name != "posix", reason="programs of the tests are scripts")


@pytest.fixture
def walk():
    return make_motion("walk", draw_performer(1))


@pytest.fixture
def fbx(tmp_path, walk):
    write_motion(walk, tmp_path / "x.glb")
    path = tmp_path / "x.fbx"
    path.write_bytes(fake.FBX_MARK + (tmp_path / "x.glb").read_bytes())
    return path


def codes(motion):
    return [note.code for note in motion.provenance.notes]


@pytest.mark.parametrize("name", ["blender", "assimp"])
def test_read_through_a_program(tmp_path, monkeypatch, fbx, walk, name):
    fake.install(tmp_path, monkeypatch, **{name: "works"})
    motion = read_motion(fbx, unit="m")
    assert (motion.provenance.path, motion.provenance.format) == (str(fbx), "fbx")
    assert codes(motion) == ["exchange.through"]
    np.testing.assert_allclose(
        compute_trajectories(motion).positions, compute_trajectories(walk).positions, atol=1e-5
    )  # fmt: skip
    (tmp_path / "x.dae").write_bytes(fake.DAE_MARK + (tmp_path / "x.glb").read_bytes())
    assert read_motion(tmp_path / "x.dae").provenance.format == "dae"
    assert read_character(fbx).n_frames == 1


def test_the_unit_of_fbx_is_a_centimetre(tmp_path, monkeypatch, walk):
    from dataclasses import replace

    skeleton = replace(walk.skeleton, offsets=100 * walk.skeleton.offsets)
    write_motion(replace(walk, skeleton=skeleton, translations=100 * walk.translations), tmp_path / "x.glb")
    (tmp_path / "x.fbx").write_bytes(fake.FBX_MARK + (tmp_path / "x.glb").read_bytes())
    fake.install(tmp_path, monkeypatch, assimp="works")
    motion = read_motion(tmp_path / "x.fbx")
    assert (motion.provenance.unit, motion.provenance.unit_source) == (0.01, "declared")
    scale = b"UnitScaleFactorS\x06\0\0\0doubleS\x06\0\0\0NumberS\0\0\0\0D" + struct.pack("<d", 2.54)
    assert read_unit(b"..." + scale + b"...") == pytest.approx(0.0254)
    assert read_unit(b'P: "UnitScaleFactor", "double", "Number", "",100\n') == 1.0
    for damaged in (b"", b"UnitScaleFactor", scale[:-3], b'"UnitScaleFactor", .\n', scale[:-8] + bytes(8)):
        assert read_unit(damaged) == 0.01


def test_written_through_blender(tmp_path, monkeypatch, walk):
    fake.install(tmp_path, monkeypatch, blender="works")
    write_motion(walk, tmp_path / "out.fbx")
    back = read_motion(tmp_path / "out.fbx", unit="m", up="y")
    assert back.frame_rate == walk.frame_rate
    np.testing.assert_allclose(compute_trajectories(back).positions, compute_trajectories(walk).positions, atol=1e-5)


def test_without_programs(tmp_path, monkeypatch, fbx, walk):
    fake.install(tmp_path, monkeypatch)
    assert code_of(fbx) == "exchange.no_program"
    with pytest.raises(MotionWriteError) as caught:
        write_motion(walk, tmp_path / "out.fbx")
    assert caught.value.code == "exchange.no_blender"
    monkeypatch.setenv("DOUSA_BLENDER", str(tmp_path / "nowhere"))
    with pytest.raises(OptionError, match="DOUSA_BLENDER"):
        read_motion(fbx)
    assert not (tmp_path / "out.fbx").exists()


def test_the_second_program_helps_where_the_first_fails(tmp_path, monkeypatch, fbx):
    for behaviour in ("crash", "garbage", "silent"):
        fake.install(tmp_path, monkeypatch, blender=behaviour, assimp="works")
        motion = read_motion(fbx, unit="m")
        assert motion.provenance.notes[0].values["program"] == "assimp"
    # One that is named goes first.
    fake.install(tmp_path, monkeypatch, blender="works", assimp="works")
    assert read_motion(fbx, unit="m").provenance.notes[0].values["program"] == "Blender"
    monkeypatch.setenv("DOUSA_ASSIMP", str(tmp_path / "bin" / "assimp"))
    assert read_motion(fbx, unit="m").provenance.notes[0].values["program"] == "assimp"


@pytest.mark.parametrize("name", ["blender", "assimp"])
def test_programs_that_fail(tmp_path, monkeypatch, fbx, walk, name):
    monkeypatch.setattr(programs, "_MOST_LOG", 3_000_000)
    for behaviour, code in (
        ("crash", "exchange.failed"),
        ("silent", "exchange.failed"),
        ("garbage", "exchange.unreadable"),
        ("hang", "exchange.hangs"),
        ("flood", "exchange.failed"),
    ):
        fake.install(tmp_path, monkeypatch, **{name: behaviour})
        # Only what hangs, which would take an hour, is not waited for.
        monkeypatch.setenv("DOUSA_PROGRAM_SECONDS", "1" if behaviour == "hang" else str(PATIENCE))
        assert code_of(fbx) == code, behaviour
        if name == "blender":
            with pytest.raises(MotionWriteError):
                write_motion(walk, tmp_path / "out.fbx")
        assert not (tmp_path / "out.fbx").exists()
    fake.install(tmp_path, monkeypatch, **{name: "crash"})
    with pytest.raises(MotionFileError, match="Error: no such"):
        read_motion(fbx)
    (tmp_path / "bin" / name).write_text("no program")
    assert code_of(fbx) in ("exchange.no_start", "exchange.failed")
    monkeypatch.setenv("DOUSA_PROGRAM_SECONDS", "soon")
    with pytest.raises(OptionError, match="soon"):
        read_motion(fbx)


def test_what_is_no_fbx_starts_no_program(tmp_path, monkeypatch):
    fake.install(tmp_path, monkeypatch, blender="hang", assimp="hang")
    (tmp_path / "x.fbx").write_bytes(b"HIERARCHY\nROOT Hips\n")
    assert code_of(tmp_path / "x.fbx") == "exchange.other_content"


def test_helpers_of_assimp(tmp_path):
    """A joint behind a helper of half a turn about z, its whole transformation animated: the helper must not count."""
    half = [0.0, 0.0, 1.0, 0.0]
    nodes = [
        {"name": "Hips", "translation": [0, 90, 0], "children": [1]},
        {"name": "Leg_$AssimpFbx$_Translation", "translation": [8, -6, 0], "children": [2]},
        {"name": "Leg_$AssimpFbx$_PreRotation", "rotation": half, "children": [3]},
        {"name": "Leg", "children": [4]},
        {"name": "Foot_$AssimpFbx$_Translation", "translation": [0, 40, 0], "children": [5]},
        {"name": "Foot"},
    ]
    tree = {"asset": {"version": "2.0"}, "nodes": json.loads(json.dumps(nodes)),
            "animations": [{"channels": [{"target": {"node": 3, "path": "rotation"}}]}]}  # fmt: skip
    document = GltfDocument(tmp_path / "x", tree, [])
    collapse_helpers(document)
    leg, foot = tree["nodes"][3], tree["nodes"][5]
    assert (leg["translation"], foot["translation"]) == ([8, -6, 0], [0, 40, 0])
    np.testing.assert_allclose(np.abs(leg["rotation"]), half, atol=1e-12)
    assert (tree["nodes"][0]["children"], leg["children"]) == ([3], [5])
    # Helpers that are animated themselves mean what they say.
    other = {"asset": {"version": "2.0"}, "nodes": json.loads(json.dumps(nodes)),
             "animations": [{"channels": [{"target": {"node": 2, "path": "rotation"}}]}]}  # fmt: skip
    collapse_helpers(GltfDocument(tmp_path / "x", other, []))
    assert other["nodes"][:3] == nodes[:3]


def test_a_real_fbx_if_a_program_is_here(shared_data):
    path = shared_data("foreign/unsupported/mixamo_left_turn_90.fbx")
    if all(programs.find_program(name) is None for name in ("blender", "assimp")):
        pytest.skip("neither Blender nor assimp on this machine")
    motion = read_motion(path)
    assert (motion.n_frames, motion.frame_rate) == (29, 30.0)
    points = compute_trajectories(motion)
    hips = points.positions[:, points.names.index("Model:Hips")]
    np.testing.assert_allclose(hips[[0, 10]], [[0.002, 0.963, 0.003], [-0.046, 0.967, -0.075]], atol=1e-3)
    foot = points.positions[:, points.names.index("Model:LeftFoot")]
    np.testing.assert_allclose(foot[[0, 28]], [[0.164, 0.123, 0.067], [0.068, 0.123, -0.164]], atol=1e-3)


def test_the_job_needs_nothing_but_bpy(tmp_path, walk):
    """The script that runs in Blender is plain Python: its calls are recorded by a module that stands for Blender's."""
    import subprocess
    from importlib import resources

    (tmp_path / "bpy.py").write_text(
        "import types\n"
        "class Any:\n"
        "    def __init__(self, name): self.name = name\n"
        "    def __getattr__(self, name):\n"
        "        if name.startswith('__'): raise AttributeError(name)\n"
        "        return Any(self.name + '.' + name)\n"
        "    def __call__(self, *a, **k):\n"
        "        print(self.name, sorted(k)); return Any(self.name + '()')\n"
        "    def __iter__(self): return iter(())\n"
        "    def __sub__(self, other): return 1.0\n"
        "    def __contains__(self, name): return False\n"
        "    fps = 1\n"
        "ops, data, context = Any('ops'), Any('data'), Any('context')\n"
    )
    job = str(resources.files("dousa.formats.exchange").joinpath("blender_job.py"))
    for words, expected in (
        (["read", "a.fbx", "b.glb"], ["ops.import_scene.fbx", "ops.export_scene.gltf"]),
        (["read", "a.dae", "b.glb"], ["ops.wm.collada_import", "ops.export_scene.gltf"]),
        (["write", "a.glb", "b.fbx", "29.97"], ["ops.import_scene.gltf", "ops.export_scene.fbx"]),
    ):
        done = subprocess.run(
            [sys.executable, job, "--", *words], capture_output=True, text=True, cwd=tmp_path, check=True,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
        )  # fmt: skip
        called = [line.split(" ")[0] for line in done.stdout.splitlines()]
        assert [name for name in called if name in expected] == expected, done.stdout


def test_animations_and_people_of_fbx(tmp_path, monkeypatch):
    """They come through the program, and are taken as those of a GLB."""
    made_people.write_glb(tmp_path / "x.glb")
    (tmp_path / "x.fbx").write_bytes(fake.FBX_MARK + (tmp_path / "x.glb").read_bytes())
    fake.install(tmp_path, monkeypatch, blender="works")
    first, second = read_motion(tmp_path / "x.fbx"), read_motion(tmp_path / "x.fbx", person=2, animation="motion")
    assert codes(first) == ["parts.person", "exchange.through"]
    assert codes(second) == ["parts.person_asked", "exchange.through", "parts.alone"]
    assert abs(second.translations[0, 0, 0] - first.translations[0, 0, 0]) > 1
    assert code_of(tmp_path / "x.fbx", animation="Walk") == "parts.no_animation"


def make_record(name, values, children=(), start=27):
    """A record of a binary FBX file of version 7400 that begins at a byte; texts, numbers and arrays of times."""
    held = b""
    for value in values:
        if isinstance(value, str):
            held += b"S" + struct.pack("<I", len(value)) + value.encode()
        elif isinstance(value, int):
            held += b"L" + struct.pack("<q", value)
        else:
            packed = zlib.compress(np.asarray(value, np.int64).tobytes())
            held += b"l" + struct.pack("<III", len(value), 1, len(packed)) + packed
    place = start + 13 + len(name) + len(held)
    inside = b""
    for child in children:
        inside += make_record(*child, start=place + len(inside))
    inside += bytes(13) if children else b""
    head = struct.pack("<IIIB", place + len(inside), len(values), len(held), len(name))
    return head + name.encode() + held + inside


def make_fbx(times=(0, 10, 20, 30)):
    """A model that moves along an axis, by three curves."""

    def properties(*rows):
        return ("Properties70", [], [("P", list(row)) for row in rows])

    move, plain, part = ("Lcl Translation", "Lcl Translation", "", "A"), ("d", "Compound", "", ""), ("d|X", "", "", "A")
    kinds = [
        ("ObjectType", ["AnimationCurve"], [("Count", [3])]),
        ("ObjectType", ["AnimationCurveNode"], [("Count", [1]), ("PropertyTemplate", ["t"], [properties(plain)])]),
        ("ObjectType", ["Model"], [("Count", [1]), ("PropertyTemplate", ["t"], [properties(move)])]),
    ]
    curve = [("KeyTime", [list(times)]), ("KeyValueFloat", [5])]
    objects = [("Model", [1, ""], [properties(move)]), ("AnimationCurveNode", [2, ""], [properties(part)])]
    objects += [("AnimationCurve", [number, ""], curve) for number in (3, 4, 5)]
    links = [("C", ["OO", 1, 0]), ("C", ["OP", 2, 1, move[0]]), *(("C", ["OP", n, 2, part[0]]) for n in (3, 4, 5))]
    data = fake.FBX_MARK[:23] + struct.pack("<I", 7400)
    for name, children in (("Definitions", kinds), ("Objects", objects), ("Connections", links)):
        data += make_record(name, [], children, start=len(data))
    return data + bytes(13) + fbx_soundness._END


def note_codes(data):
    return [note.code.removeprefix("exchange.fbx_") for note in fbx_soundness.check_fbx("x.fbx", data)]


@pytest.mark.parametrize(
    ("old", "new", "codes"),
    [
        (b"", b"", []),
        (b"\x05Model", b"\x05Modem", ["count"]),
        (b"KeyValueFloat", b"KeyValteFloat", ["count"]),
        (b"OPL" + struct.pack("<q", 4), b"OPL" + struct.pack("<q", 5004), ["links"]),
        (b"PS\x0f\0\0\0Lcl T", b"PS\x0f\0\0\0Lcl U", ["property"]),
        (b"d|X", b"e|X", ["property"]),
        (fbx_soundness._END, fbx_soundness._END[:-1], ["end"]),
    ],
)  # fmt: skip
def test_what_a_binary_fbx_declares_is_compared_with_what_it_holds(old, new, codes):
    data = make_fbx()
    assert old in data
    assert note_codes(data.replace(old, new, 1)) == codes


@pytest.mark.parametrize("times", [[0, 10, 5, 20], [0, 10, 20, 1 << 60]])
def test_times_of_fbx_that_fall_or_last_days_are_refused(times):
    with pytest.raises(MotionFileError) as caught:
        fbx_soundness.check_fbx("x.fbx", make_fbx(times))
    assert caught.value.code == "exchange.fbx_times"


@pytest.mark.parametrize("seed", range(3))
def test_bytes_inserted_or_deleted_in_a_binary_fbx_are_refused(seed):
    data, rng = make_fbx(), np.random.default_rng(seed)
    for place in rng.integers(27, len(data) - 60, size=60).tolist():
        for changed in (data[:place] + b"\x05" + data[place:], data[:place] + data[place + 2 :]):
            with pytest.raises(MotionFileError) as caught:
                fbx_soundness.check_fbx("x.fbx", changed)
            assert caught.value.code == "exchange.fbx_record"
