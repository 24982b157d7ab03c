"""Boards drawn by OpenCV and seen by known cameras: the cameras are found again."""

import cv2
import numpy as np
import pytest

from dousa.errors import CalibrationError, OptionError
from dousa.estimation import (
    Board,
    PersonTrack,
    ViewKeypoints,
    calibrate_from_board,
    calibrate_lens,
    find_board,
    make_view,
    parse_board,
)
from dousa.estimation.calibration.board import find_corners
from dousa.motion.rotations import from_axis_angle, to_matrix

SIZE, FOCAL = (960, 720), 900.0
CHARUCO = Board(7, 5, 0.06, 0.045)
CHESS = Board(9, 6, 0.05)


def draw(board, pixels=40):
    """The board's picture, and from board coordinates (m) to its pixels (3, 3)."""
    border = 2 * pixels
    if board.marker is not None:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
        image = drawn.generateImage((board.columns * pixels, board.rows * pixels))
    else:
        squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        image = np.kron(255 * squares, np.ones((pixels, pixels))).astype(np.uint8)
    image = np.pad(image, border, constant_values=255)
    scale = pixels / board.square
    first = border + pixels - 0.5  # the first inner corner
    return image, np.array([[scale, 0, first], [0, scale, first], [0, 0, 1.0]])


def look(board, camera, rotation, place):
    """What a camera without distortion sees of a board."""
    image, to_pixels = draw(board)
    turned, moved = camera.rotation @ rotation, camera.rotation @ place + camera.translation
    plane = camera.matrix @ np.column_stack((turned[:, 0], turned[:, 1], moved))
    return cv2.warpPerspective(image, plane @ np.linalg.inv(to_pixels), camera.size, borderValue=(128,))


def carry(seed=0, count=30):
    """Poses of a board that is carried about, flat on the floor at first."""
    rng = np.random.default_rng(seed)
    flat = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # the board's normal points down
    poses = [(flat, np.array([-0.15, 0.0, -0.1]))]
    for step in range(count):
        toward = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
        turn = to_matrix(from_axis_angle(rng.uniform(-0.35, 0.35, 3) + np.array((0.0, 0.5 * np.sin(step), 0.0))))
        poses.append((turn @ toward, rng.uniform((-0.5, 0.6, -0.4), (0.2, 1.3, 0.3))))
    return poses


def make_cameras():
    places = ((-1.0, 1.6, 2.2), (1.0, 1.4, 2.2))
    return tuple(
        make_view(place, (-0.1, 0.7, 0.0), size=SIZE, focal=FOCAL, name=f"cam{n}") for n, place in enumerate(places)
    )


def project(board, camera, poses, rng):
    """Corners as `find_board` gives them, with detection noise; each pose is held for five frames."""
    corners = np.stack([camera.project(board.corners @ r.T + t) for r, t in poses for _ in range(5)])
    corners += rng.normal(0, 0.15, corners.shape)
    times = np.arange(len(corners)) / 30.0
    return ViewKeypoints(board.names, (PersonTrack(corners, np.ones(corners.shape[:2])),), times, SIZE, camera.name)


@pytest.mark.parametrize("board", [CHARUCO, CHESS], ids=["charuco", "chessboard"])
def test_corners_are_found_to_a_third_of_a_pixel(board):
    camera = make_cameras()[0]
    for rotation, place in carry(3, 4)[1:]:
        image = look(board, camera, rotation, place)
        found = find_corners(image, board)
        assert found is not None
        places, pixels = found
        expected = camera.project(board.corners @ rotation.T + place)[places]
        if board is CHESS and np.abs(pixels - expected).max() > 5:  # numbered from the other end: told by the colour
            pytest.fail("the corners begin at the wrong end")
        assert np.median(np.linalg.norm(pixels - expected, axis=1)) < 0.34
    assert find_corners(np.full((200, 200, 3), 90, np.uint8), board) is None


def test_a_chessboard_upside_down_begins_at_the_same_corner():
    camera = make_cameras()[0]
    rotation, place = carry(3, 2)[1]
    image = look(CHESS, camera, rotation, place)
    _, upright = find_corners(image, CHESS)
    _, turned = find_corners(np.ascontiguousarray(image[::-1, ::-1]), CHESS)
    size = np.array(SIZE) - 1
    np.testing.assert_allclose(size - turned, upright, atol=0.5)


def test_lens_and_places_are_found(tmp_path):
    cameras, poses, rng = make_cameras(), carry(), np.random.default_rng(1)
    views = [project(CHARUCO, camera, poses, rng) for camera in cameras]
    lens = calibrate_lens(views[0], CHARUCO, "cam0")
    assert lens.matrix[0, 0] == pytest.approx(FOCAL, rel=0.01)
    for given in ({"cameras": cameras}, {"focals": [FOCAL, FOCAL]}, {}):
        found = calibrate_from_board(views, CHARUCO, **given)
        assert all(view.residual < 0.5 for view in found.views) and not found.warnings
        apart = np.linalg.norm(found.cameras[0].position - found.cameras[1].position)
        assert apart == pytest.approx(2.01, abs=0.03)
        assert found.cameras[0].position[1] == pytest.approx(1.6, abs=0.05)  # above the board on the floor
        assert found.cameras[1].position[1] == pytest.approx(1.4, abs=0.05)
    found = calibrate_from_board(
        [ViewKeypoints(v.names, (PersonTrack(v.people[0].points[10:], v.people[0].visibility[10:]),),
                       v.times[10:] - v.times[10], SIZE, v.source) for v in views],
        CHARUCO, cameras=cameras,
    )  # fmt: skip
    assert [note.code for note in found.warnings] == ["board.not_flat"]


def test_cameras_that_never_see_the_board_together():
    cameras, poses, rng = make_cameras(), carry(), np.random.default_rng(1)
    views = [project(CHARUCO, camera, poses, rng) for camera in cameras]
    with pytest.raises(CalibrationError) as caught:
        calibrate_from_board(views, CHARUCO, cameras=cameras, offsets=(0.0, 100.0))
    assert caught.value.code == "board.no_common"
    few = ViewKeypoints(
        views[0].names, (PersonTrack(views[0].people[0].points[:3], views[0].people[0].visibility[:3]),),
        views[0].times[:3], SIZE, "few",
    )  # fmt: skip
    with pytest.raises(CalibrationError) as caught:
        calibrate_lens(few, CHARUCO, "few")
    assert caught.value.code == "board.few_frames"
    with pytest.raises(CalibrationError) as caught:
        calibrate_lens(views[0], Board(7, 5, 0.06, 0.045), "x") and calibrate_lens(
            ViewKeypoints(views[0].names, (PersonTrack(rng.uniform(0, 700, views[0].people[0].points.shape),
                          views[0].people[0].visibility),), views[0].times, SIZE, "x"), CHARUCO, "x")  # fmt: skip
    assert caught.value.code == "board.no_lens"


def test_a_film_of_a_board_is_read(tmp_path):
    camera, poses = make_cameras()[0], carry(0, 3)
    writer = cv2.VideoWriter(str(tmp_path / "board.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 20.0, SIZE)
    for rotation, place in poses[1:]:
        writer.write(cv2.cvtColor(look(CHARUCO, camera, rotation, place), cv2.COLOR_GRAY2BGR))
    writer.release()
    found = find_board(tmp_path / "board.mp4", CHARUCO)
    expected = np.stack([camera.project(CHARUCO.corners @ r.T + t) for r, t in poses[1:]])
    assert np.nanmedian(np.linalg.norm(found.people[0].points - expected, axis=-1)) < 0.6
    with pytest.raises(CalibrationError) as caught:
        find_board(tmp_path / "board.mp4", CHESS)
    assert caught.value.code == "board.not_seen" and "board.mp4" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("charuco:5x7:40mm:30mm", Board(5, 7, 0.04, 0.03)),
        ("charuco:7x5:6cm:0.045m:DICT_5X5_100", Board(7, 5, 0.06, 0.045, "DICT_5X5_100")),
        ("chessboard:9x6:25mm", Board(9, 6, 0.025)),
    ],
)
def test_boards_are_understood(text, board):
    found = parse_board(text)
    assert (found.columns, found.rows, found.dictionary) == (board.columns, board.rows, board.dictionary)
    assert found.square == pytest.approx(board.square) and found.marker == pytest.approx(board.marker)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "board.unknown"),
        ("charuco:5x7:40mm", "board.unknown"),
        ("chessboard:9x6:2.5.1mm", "board.unknown"),
        ("chessboard:9x7:25mm", "board.same"),
        ("chessboard:2x3:25mm", "board.size"),
        ("charuco:5x7:40mm:50mm", "board.size"),
        ("charuco:5x7:40mm:30mm:DICT_NONE", "board.dictionary"),
        ("charuco:50x70:40mm:30mm", "board.dictionary"),
    ],
)
def test_boards_that_cannot_be_are_said(text, code):
    with pytest.raises(OptionError) as caught:
        parse_board(text)
    assert caught.value.code == code
