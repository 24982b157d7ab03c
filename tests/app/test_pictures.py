"""Pictures: valid files of sane size with something on them, in any script, whole or not at all."""

import re

import numpy as np
import pytest
from matplotlib.image import imread

from dousa.app.drawing import body as _poses
from dousa.app.pictures import canvas as _canvas
from dousa.app.pictures.sheets import Strip, draw_contact_sheet, draw_search_sheet
from dousa.errors import InvalidMotionError, MotionWriteError, OptionError
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX, Trajectories, canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="module")
def walk():
    return make_motion("walk", draw_performer(1))


def markers(n_frames=20, n_points=9, **fields):
    rng = np.random.default_rng(0)
    names = tuple(f"M{number}" for number in range(n_points))
    return Trajectories(names, rng.uniform(-1, 1, (n_frames, n_points, 3)), 60.0, **fields)


def pixels(path):
    image = imread(path)
    assert 700 < image.shape[1] < 2500
    assert 250 < image.shape[0] < 6000
    shades = np.unique(np.round(image[..., :3].reshape(-1, 3), 1), axis=0)
    assert len(shades) > 8  # ink of several colours
    assert 0.001 < (image[..., :3].min(axis=2) < 0.9).mean() < 0.5
    return image


def is_near(image, colour):
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.abs(image[..., :3] - wanted).max(axis=2) < 0.03


def test_points_beyond_any_measure_are_not_drawn(tmp_path):
    far = markers()
    with pytest.raises(InvalidMotionError, match="too far apart to be drawn"):
        draw_contact_sheet(far.replace(positions=far.positions * 1e300), tmp_path / "far.png")


@pytest.mark.parametrize(
    "kind",
    ["motion", pytest.param("trajectories", marks=pytest.mark.slow), pytest.param("canonical", marks=pytest.mark.slow)],
)
def test_contact_sheet_of_every_kind_of_motion(kind, walk, tmp_path):
    drawn = {"motion": walk, "trajectories": compute_trajectories(walk), "canonical": canonicalise(walk)}[kind]
    path = tmp_path / "sheet.png"
    draw_contact_sheet(drawn, path, title="walk.bvh")
    image = pixels(path)
    assert is_near(image, _canvas.BLUE).sum() > 500
    assert is_near(image, _canvas.VERMILLION).sum() > 300


@pytest.mark.parametrize(("suffix", "start"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".PNG", b"\x89PNG")])
def test_format_follows_the_suffix_and_the_same_picture_gives_the_same_bytes(suffix, start, walk, tmp_path):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    for path in (first, second):
        draw_contact_sheet(walk, path, n_poses=3)
    assert first.read_bytes().startswith(start)
    assert first.read_bytes() == second.read_bytes()


@pytest.fixture
def written(monkeypatch):
    """What is written on the pictures of sheets, one list a picture."""
    found = []

    def keep(figure, path):
        found.append([text.get_text() for part in (figure, *figure.axes) for text in part.texts])
        _canvas.save_figure(figure, path)

    for module in ("sheets", "charts"):
        monkeypatch.setattr(f"dousa.app.pictures.{module}.save_figure", keep)
    return found


def times(texts):
    return [text for text in texts if re.fullmatch(r"\d+\.\d\d s", text)]


@pytest.mark.slow
@pytest.mark.parametrize("n_poses", [1, 2, 10, 30])
def test_any_number_of_poses(n_poses, walk, tmp_path, written):
    draw_contact_sheet(walk, tmp_path / "sheet.png", n_poses=n_poses)
    pixels(tmp_path / "sheet.png")
    shown = times(written[0])
    assert len(shown) == min(n_poses, walk.n_frames) and shown[0] == "0.00 s"
    assert shown == sorted(shown, key=lambda text: float(text[:-2]))
    if n_poses > 1:
        assert shown[-1] == f"{(walk.n_frames - 1) / walk.frame_rate:.2f} s"


def test_missing_points_leave_gaps_only(tmp_path):
    positions = np.array(markers().positions)
    positions[3:9, 2] = np.nan
    positions[5] = np.nan
    draw_contact_sheet(markers().replace(positions=positions), tmp_path / "gaps.png", n_poses=20)
    draw_contact_sheet(markers(), tmp_path / "whole.png", n_poses=20)
    draw_contact_sheet(markers().replace(positions=np.full_like(positions, np.nan)), tmp_path / "none.png")
    dots = {
        name: int(is_near(imread(tmp_path / f"{name}.png"), _canvas.BLUE).sum()) for name in ("gaps", "whole", "none")
    }
    assert dots["none"] == 0 < dots["gaps"] < dots["whole"]


@pytest.mark.parametrize(
    "title",
    [
        "動作_歩く.bvh $\\frac{1}{$_a^b$ tab\tnew\nline \u200f\ufffe😀",
        "x" * 400,
        pytest.param("", marks=pytest.mark.slow),
    ],
)
def test_titles_in_any_script_draw_without_warnings(title, walk, tmp_path, caplog, written):
    draw_contact_sheet(walk, tmp_path / "sheet.png", n_poses=2, title=title)
    pixels(tmp_path / "sheet.png")
    assert not caplog.records
    shown = _canvas.drawable(title or "motion")
    assert any(text == shown or text.startswith(shown[:60] + "x") for text in written[0])


def test_the_viewer_sees_the_front_and_then_the_right_side(walk):
    figurine = _poses.to_figurine(walk)
    names = ["left_shoulder", "right_shoulder", "left_ankle", "left_toe"]
    left, right, ankle, toe = (figurine.positions[0, JOINT_INDEX[name]] for name in names)
    front = [_poses.project(point, _poses.FRONT)[0] for point in (left, right)]
    assert front[0] > front[1]  # a person who faces us has the left on our right
    side = [_poses.project(point, _poses.SIDE)[0] for point in (ankle, toe)]
    assert side[0] < side[1]  # and walks to our right, seen from the right side


def test_a_person_facing_anywhere_is_turned_to_face_the_viewer(walk):
    moved = compute_trajectories(walk).select(CANONICAL_JOINTS)
    c, s = np.cos(2.1), np.sin(2.1)
    turned = moved @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    np.testing.assert_allclose(_poses.face_viewer(turned), _poses.face_viewer(moved), atol=1e-9)


def test_search_sheet_says_match_and_differs(walk, tmp_path, written):
    hits = [
        Strip(walk, "walk", "/a/b/walk_1.bvh", "rank 1, distance 0.010", "match"),
        Strip(markers(), "run", "/a/b/走る.c3d", "rank 2, distance 0.500", "differs"),
    ]
    draw_search_sheet(Strip(walk, "walk", "query.bvh"), hits, tmp_path / "search.png")
    image = pixels(tmp_path / "search.png")
    assert is_near(image, _canvas.GREEN).sum() > 20
    assert {"match", "differs"} <= {word for text in written[0] for word in text.split()}
    draw_search_sheet(Strip(walk, "walk", "query.bvh"), hits, tmp_path / "search.svg")
    assert b"<svg" in (tmp_path / "search.svg").read_bytes() and written[1] == written[0]
    draw_search_sheet(Strip(walk, "walk", "query.bvh"), [], tmp_path / "nothing.png")
    assert not is_near(pixels(tmp_path / "nothing.png"), _canvas.GREEN).any()
    assert "rank" not in " ".join(written[2])


def test_what_cannot_be_drawn_is_refused(walk, tmp_path):
    with pytest.raises(OptionError, match=r"expected a picture .png, .svg or .pdf, got '.jpg'"):
        draw_contact_sheet(walk, tmp_path / "sheet.jpg")
    with pytest.raises(OptionError, match="at least one pose"):
        draw_contact_sheet(walk, tmp_path / "sheet.png", n_poses=0)
    with pytest.raises(MotionWriteError, match="folder does not exist"):
        draw_contact_sheet(walk, tmp_path / "no" / "sheet.png")
    assert list(tmp_path.iterdir()) == []
