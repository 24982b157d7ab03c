"""Calibration of cameras from films of a moving chessboard or ChArUco board, by OpenCV.

Corners are keypoints like those of a person, so that `sync` takes them too. The lens of each camera is calibrated from
its own film (Zhang, A flexible new technique for camera calibration, 2000) unless it is known; cameras are joined where
two of them see the board at one moment, and all are refined together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, Image, IndexArray, spread_evenly
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.calibration.bundle import Freedom, Limb, Rig, Sightings, adjust
from dousa.estimation.calibration.person import Calibration, guess_lenses, measure_parallax, place_lenses, rate_views
from dousa.estimation.calibration.rig_search import triangulate
from dousa.estimation.calibration.sightings import choose_moments, make_track, name_views, read_sightings
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.keypoints.keypoints import PersonTrack, ViewKeypoints
from dousa.extras import cv2
from dousa.messages import Message, Progress

_CHESS = re.compile(r"chessboard:(\d{1,3})x(\d{1,3}):([\d.]+)(mm|cm|m)")
_CHARUCO = re.compile(r"charuco:(\d{1,3})x(\d{1,3}):([\d.]+)(mm|cm|m):([\d.]+)(mm|cm|m)(?::(DICT_\w+))?")
_METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0}  # by definition of the units


@dataclass(frozen=True, slots=True)
class Board:
    """A calibration board.

    Parameters
    ----------
    columns, rows : inner corners of a chessboard, squares of a ChArUco board.
    square : m, side of a square.
    marker : m, side of a marker; None for a chessboard.
    dictionary : of the markers, by OpenCV's name.
    """

    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str = "DICT_4X4_50"

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows of inner corners."""
        return (self.columns, self.rows) if self.marker is None else (self.columns - 1, self.rows - 1)

    @property
    def corners(self) -> FloatArray:
        """(K, 3) m of the inner corners, row by row, on the board's plane."""
        columns, rows = self.shape
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        return np.concatenate((grid * self.square, np.zeros((len(grid), 1))), axis=1)

    @property
    def names(self) -> tuple[str, ...]:
        """(K,) of the corners, as keypoints."""
        return tuple(f"corner_{number}" for number in range(self.shape[0] * self.shape[1]))

    def limbs(self, spread: float = 0.005) -> tuple[Limb, ...]:
        """Return pairs of neighbouring corners, all equally far apart, within the share ``spread``."""
        columns, rows = self.shape
        across = [(r * columns + c, r * columns + c + 1) for r in range(rows) for c in range(columns - 1)]
        down = [(r * columns + c, (r + 1) * columns + c) for r in range(rows - 1) for c in range(columns)]
        return tuple(Limb(first, second, 0, spread) for first, second in (*across, *down))


def parse_board(text: str) -> Board:
    """Parse ``chessboard:9x6:25mm`` or ``charuco:5x7:40mm:30mm[:DICT_4X4_50]``; OptionError for anything else."""
    chess, charuco = _CHESS.fullmatch(text), _CHARUCO.fullmatch(text)
    found = chess or charuco
    try:
        if found is None:
            raise ValueError
        columns, rows = int(found[1]), int(found[2])
        square = float(found[3]) * _METRES[found[4]]
        marker = None if charuco is None else float(charuco[5]) * _METRES[charuco[6]]
    except ValueError:
        raise OptionError("board.unknown", found=text[:80]) from None
    if marker is None and (columns + rows) % 2 == 0:  # it looks the same upside down
        raise OptionError("board.same", found=text[:80])
    if min(columns, rows) < 3 or square <= 0 or (marker is not None and not 0 < marker < square):
        raise OptionError("board.size", found=text[:80])
    dictionary = (charuco[7] if charuco else None) or "DICT_4X4_50"
    if not isinstance(getattr(cv2.aruco, dictionary, None), int):
        raise OptionError("board.dictionary", found=dictionary)
    board = Board(columns, rows, square, marker, dictionary)
    if marker is not None:
        _make_detector(board)
    return board


def _make_detector(board: Board) -> Any:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    if board.columns * board.rows // 2 > len(dictionary.bytesList):
        raise OptionError("board.dictionary", found=board.dictionary)
    drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker or 0.0, dictionary)
    return cv2.aruco.CharucoDetector(drawn)


def find_corners(
    image: Image, board: Board, detector: Any = None, least_corners: int = 6
) -> tuple[IndexArray, FloatArray] | None:
    """Return the visible corners of a board in an image: places (N,) and px (N, 2); None if it is not seen.

    Parameters
    ----------
    image : (H, W, 3) or (H, W).
    board : the board.
    detector : for many images of one ChArUco board; by default a new one.
    least_corners : of a ChArUco board; with fewer it is not seen.
    """
    grey = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    if board.marker is None:
        good, corners = cv2.findChessboardCornersSB(grey, board.shape)
        if not good:
            return None
        return np.arange(len(corners)), _begin_at_dark(grey, np.asarray(corners, np.float64).reshape(-1, 2), board)
    corners, places, _, _ = (detector or _make_detector(board)).detectBoard(grey)
    if places is None or len(places) < least_corners:
        return None
    return np.asarray(places, np.intp).ravel(), np.asarray(corners, np.float64).reshape(-1, 2)


def _begin_at_dark(grey: Image, corners: FloatArray, board: Board) -> FloatArray:
    """Order the corners (K, 2) from the end whose first square between corners is black."""
    grid = corners.reshape(board.rows, board.columns, 2)
    middles = [grid[:2, place : place + 2].mean(axis=(0, 1)).round().astype(int) for place in (0, 1)]
    first, second = (int(grey[y, x]) for x, y in middles)
    return corners if first < second else corners[::-1]


def find_board(
    film: str | os.PathLike[str], board: Board, progress: Progress | None = None, most_frames: int = 900
) -> ViewKeypoints:
    """Find the corners of a board in a film, as the points of one person.

    Parameters
    ----------
    film : any format of FFmpeg.
    board : the board.
    progress : called with (frames done, frames in all, what).
    most_frames : of long films some so many frames are used.

    Raises
    ------
    KeypointError : missing, damaged, or no film.
    CalibrationError : the board is not seen.
    """
    from dousa.estimation.keypoints.films import FilmFrames

    detector = None if board.marker is None else _make_detector(board)
    times, points = [], []
    with FilmFrames(film) as frames:
        step = max(1, -(-frames.n_stated // most_frames))
        for number, time, image in frames.read():
            if progress is not None:
                progress(number, frames.n_stated, Message("board.progress"))
            if number % step:
                continue
            row = np.full((len(board.corners), 2), np.nan)
            found = find_corners(image, board, detector)
            if found is not None:
                row[found[0]] = found[1]
            times.append(time)
            points.append(row)
        size = frames.size
    track = np.array(points)
    seen = np.isfinite(track[..., 0])
    if not seen.any():
        raise CalibrationError("board.not_seen").at(film)
    return ViewKeypoints(board.names, (PersonTrack(track, seen.astype(np.float64)),), np.array(times), size, str(film))


def calibrate_from_board(
    views: Sequence[ViewKeypoints],
    board: Board,
    *,
    cameras: Sequence[Camera] | None = None,
    focals: Sequence[float] | None = None,
    offsets: Sequence[float] | None = None,
    least_corners: int = 6,
    corner_spread: float = 0.5,
) -> Calibration:
    """Calibrate cameras from films of a board.

    The floor is the board at the first common moment if it lies flat there; otherwise the cameras stand upright and the
    board's middle has height 0, with a note.

    Parameters
    ----------
    views : (V,) of `find_board`.
    board : its size sets the metres.
    cameras : (V,) with known lenses; their poses are ignored.
    focals : (V,) px, of lenses without distortion. Without either the lenses are calibrated too.
    offsets : (V,) s, added to the time of each film to get the common time; 0 by default.
    least_corners : with fewer the board is not seen.
    corner_spread : px, by which corners are off.

    Raises
    ------
    CalibrationError : too few sightings for a lens, or no moment at which two cameras see the board.
    """
    names = name_views(views)
    if cameras is not None:
        lenses = tuple(cameras)
    elif focals is not None:
        lenses = guess_lenses(views, focals)
    else:
        lenses = tuple(
            calibrate_lens(view, board, name, least_corners=least_corners)
            for view, name in zip(views, names, strict=True)
        )
    tracks = [
        make_track(view.times, view.people[0].points, view.people[0].visibility, lens)
        for view, lens in zip(views, lenses, strict=True)
    ]
    late = np.zeros(len(views)) if offsets is None else np.array(offsets, np.float64)
    sightings = read_sightings(tracks, late, choose_moments(tracks, late, 2000))
    kept = np.flatnonzero(((sightings.weights > 0).sum(axis=2) >= least_corners).sum(axis=0) >= 2)
    if not len(kept):
        raise CalibrationError("board.no_common", films=names)
    sightings = sightings.pick(kept[spread_evenly(len(kept), 100)])
    sightings = replace(sightings, spreads=np.full(len(views), corner_spread))
    focal = np.array([lens.matrix[0, 0] for lens in lenses])
    rig = _chain(sightings, focal, board, names, least_corners)
    fit = adjust(sightings, rig, triangulate(sightings, rig), board.limbs(), Freedom(), 40)
    scale = board.square / float(fit.lengths[0])
    rig = replace(fit.rig, translations=fit.rig.translations * scale)
    found, placed, flat = _find_floor(rig, fit.points * scale, least_corners)
    rated = rate_views(fit, sightings, names)
    notes = () if flat else (Message("board.not_flat"),)
    made = place_lenses(lenses, found, names)
    return Calibration(made, rated, measure_parallax(fit, sightings), placed, (), notes)


def calibrate_lens(
    view: ViewKeypoints,
    board: Board,
    name: str,
    *,
    least_corners: int = 6,
    least_frames: int = 6,
    most_frames: int = 40,
    most_off: float = 2.0,
) -> Camera:
    """Calibrate focal length, principal point and distortion of one camera from its own film of a board.

    At least ``least_frames`` show ``least_corners``, of which at most ``most_frames`` are used, and the root mean
    square residual is below ``most_off`` px.

    Raises
    ------
    CalibrationError : too few frames show the board, or they do not fit any lens.
    """
    points = view.people[0].points
    seen = np.flatnonzero(np.isfinite(points[..., 0]).sum(axis=1) >= least_corners)
    if len(seen) < least_frames:
        raise CalibrationError("board.few_frames", film=name, found=len(seen), least=least_frames)
    some = seen[spread_evenly(len(seen), most_frames)]
    there = [np.isfinite(points[frame, :, 0]) for frame in some]
    objects = [board.corners[good].astype(np.float32) for good in there]
    images = [points[frame, good].astype(np.float32) for frame, good in zip(some, there, strict=True)]
    focal = float(max(view.size))
    guess = np.array([[focal, 0, (view.size[0] - 1) / 2], [0, focal, (view.size[1] - 1) / 2], [0, 0, 1.0]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3
    try:
        off, matrix, bent, _, _ = cv2.calibrateCamera(objects, images, view.size, guess, np.zeros(5), flags=flags)
    except cv2.error as error:
        raise CalibrationError("board.no_lens", film=name, residual=np.nan) from error
    if not off < most_off or not np.isfinite(matrix).all():
        raise CalibrationError("board.no_lens", film=name, residual=off)
    lens = guess_lenses([view], [focal])[0]
    return replace(
        lens, name=name, matrix=np.asarray(matrix, np.float64), distortion=np.asarray(bent, np.float64).ravel()[:5]
    )


def _chain(sightings: Sightings, focals: FloatArray, board: Board, names: Sequence[str], least_corners: int) -> Rig:
    """Return the rig in metres in the axes of its first camera, joined by moments that two views share."""
    n_views = len(focals)
    poses = [
        [
            _find_pose(board.corners[good], seen[good] / focal) if good.sum() >= least_corners else None
            for seen, good in zip(points, weights > 0, strict=True)
        ]
        for points, weights, focal in zip(sightings.points, sightings.weights, focals, strict=True)
    ]
    rotations, translations = np.tile(np.eye(3), (n_views, 1, 1)), np.zeros((n_views, 3))
    placed = {0}
    while len(placed) < n_views:
        count, one, other = max(
            (sum(a is not None and b is not None for a, b in zip(poses[one], poses[other], strict=True)), one, other)
            for one in placed
            for other in range(n_views)
            if other not in placed
        )
        if not count:
            left = tuple(names[view] for view in range(n_views) if view not in placed)
            raise CalibrationError("board.no_common", films=left)
        pairs = [(a, b) for a, b in zip(poses[one], poses[other], strict=True) if a is not None and b is not None]
        turns = np.stack([b[0] @ a[0].T for a, b in pairs])
        moves = np.stack([b[1] - turn @ a[1] for (a, b), turn in zip(pairs, turns, strict=True)])
        apart = np.abs(moves[:, None] - moves[None]).sum(axis=-1)
        apart += np.abs(turns[:, None] - turns[None]).sum(axis=(-2, -1))
        best = int(np.argmin(np.median(apart, axis=1)))
        rotations[other] = turns[best] @ rotations[one]
        translations[other] = turns[best] @ translations[one] + moves[best]
        placed.add(other)
    return Rig(rotations, translations, focals, sightings.offsets)


def _find_pose(corners: FloatArray, flat: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return rotation and translation from the board's axes to a camera's; None without a solution."""
    found, turn, place = cv2.solvePnP(corners, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        return None
    return np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64).ravel()


def _find_floor(
    rig: Rig, points: FloatArray, least_corners: int, most_tilted: float = 25.0
) -> tuple[Rig, FloatArray, bool]:
    """Return the rig and the points with Y up and the floor at 0, and whether the board lay on it.

    A board lies on the floor that is tilted by less than ``most_tilted`` degrees.
    """
    first = next(frame for frame in points if np.isfinite(frame).all(axis=-1).sum() >= least_corners)
    known = first[np.isfinite(first).all(axis=-1)]
    centre = known.mean(axis=0)
    normal = np.linalg.svd(known - centre)[2][2]
    cameras = -rig.rotations[:, 1].mean(axis=0)
    level = np.linalg.eigh(np.einsum("vi,vj->ij", rig.rotations[:, 0], rig.rotations[:, 0]) + 1e-3 * (
        np.eye(3) - np.outer(cameras, cameras) / (cameras @ cameras)))[1][:, 0]  # fmt: skip
    level = level if level @ cameras > 0 else -level
    normal = normal if normal @ level > 0 else -normal
    flat = bool(normal @ level > np.cos(np.radians(most_tilted)))
    axes = rig.face(centre, normal if flat else level)
    return rig.move(axes, -axes @ centre), (points - centre) @ axes.T, flat
