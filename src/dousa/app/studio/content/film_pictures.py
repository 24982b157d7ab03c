"""Small pictures of every frame of a film, beside it in its batch: the work decodes films, the studio does not.

    .NAME.jpg.idx   records of `SHOWN`: which frame, and where in .NAME.jpg.bin its JPEG lies
    .NAME.jpg.bin   those, one after the other
    .NAME.jpg.end   is there when the film was read to its end

An interrupted run goes on where it was, and whoever estimates from the same film again finds them there.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.arrays import Image

LONGEST = 720
"""px, of a picture's longer side."""

SHOWN = np.dtype([("frame", "<i4"), ("size", "<i4"), ("offset", "<i8")])
_QUALITY = 74
_USUAL_BYTES = 45_000  # of a picture
_MOST_BYTES = 1_500_000_000  # of all films of a batch; of longer ones not every frame is kept
_REPORT_EVERY = 10  # frames

Progress = Callable[[int, int, Message], None]


def name_pictures(film: Path) -> Path:
    """The beginning of the names of a film's pictures."""
    digest = hashlib.sha256(film.name.encode("utf-8", "replace")).hexdigest()[:16]
    return film.with_name(f".{digest}.jpg")


def choose_stride(n_frames: int) -> int:
    """Every how many frames a picture is kept, where all films of a batch have so many."""
    return max(1, -(-n_frames * _USUAL_BYTES // _MOST_BYTES))


def write_pictures(film: Path, stride: int, report: Progress) -> None:
    """Write the pictures that are not there yet.

    Parameters
    ----------
    film : that can be decoded.
    stride : of `choose_stride`.
    report : called with (frames done, frames, what).

    Raises
    ------
    KeypointError : the film is damaged.
    """
    from dousa.estimation.keypoints.films import FilmFrames

    place = name_pictures(film)
    end = Path(f"{place}.end")
    if end.exists():
        return
    known = _read_index(place)
    n_done = int(known["frame"][-1]) + 1 if len(known) else 0
    n_bytes = int(known["offset"][-1] + known["size"][-1]) if len(known) else 0
    what = Message("studio_films.pictures", film=film.name)
    with FilmFrames(film) as frames, open(f"{place}.bin", "ab") as pictures, open(f"{place}.idx", "ab") as index:
        pictures.truncate(n_bytes)
        index.truncate(len(known) * SHOWN.itemsize)
        for frame, _, picture in frames.read(skip=n_done):
            if frame % stride == 0:
                content = _pack(picture)
                pictures.write(content)
                pictures.flush()  # first: what the index names is there
                index.write(np.array([(frame, len(content), n_bytes)], SHOWN).tobytes())
                n_bytes += len(content)
            if frame % _REPORT_EVERY == 0:
                index.flush()
                report(frame + 1, max(frames.n_stated, frame + 1), what)
    end.touch()


def _pack(picture: Image) -> bytes:
    from dousa.extras import cv2

    height, width = picture.shape[:2]
    factor = min(1.0, LONGEST / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    _, content = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return bytes(content.tobytes())


def _read_index(place: Path) -> NDArray[Any]:
    try:
        content = Path(f"{place}.idx").read_bytes()
    except FileNotFoundError:
        content = b""
    return np.frombuffer(content[: len(content) // SHOWN.itemsize * SHOWN.itemsize], SHOWN)


class FilmPictures:
    """The pictures of a film as far as they are.

    Parameters
    ----------
    film : its place, whether it is still there or not.
    """

    def __init__(self, film: Path) -> None:
        self._place = name_pictures(film)
        self._index = _read_index(self._place)

    def read(self, frame: int) -> bytes | None:
        """The JPEG of a frame, or of the nearest before it; None where there is none."""
        if not len(self._index) or frame > self._index["frame"][-1]:
            self._index = _read_index(self._place)
        row = int(np.searchsorted(self._index["frame"], frame, side="right")) - 1
        if row < 0:
            return None
        try:
            with open(f"{self._place}.bin", "rb") as file:
                file.seek(int(self._index["offset"][row]))
                return file.read(int(self._index["size"][row])) or None
        except OSError:
            return None


def to_picture_address(canvas: Image, longest: int) -> str:
    """A picture (H, W, 3) blue, green, red as an address that contains it, of so many px at most."""
    from dousa.extras import cv2

    factor = min(1.0, longest / max(canvas.shape[:2]))
    if factor < 1.0:
        size = max(1, round(canvas.shape[1] * factor)), max(1, round(canvas.shape[0] * factor))
        canvas = np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, content = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return "data:image/jpeg;base64," + base64.b64encode(content.tobytes()).decode("ascii")
