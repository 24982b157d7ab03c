"""Upright frames of a film with their time stamps, for keypoints and silhouettes alike.

Phones film at an uneven rate and store rotation as a flag. Frames are decoded one at a time in the order of display.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, Image
from dousa.errors import KeypointError
from dousa.extras import require
from dousa.messages import Message

Frame = tuple[int, float, Image]
"""Number, s since the first frame, picture (H, W, 3)."""


class FilmFrames(ExitStack):
    """A film, `read` once from beginning to end or any frame of which can be found.

    ``size`` is width and height in px, upright; ``n_stated`` the number of frames in the header, 0 if absent;
    ``nominal_rate`` Hz; ``n_damaged`` packets that could not be decoded so far.

    Parameters
    ----------
    path : of the film.
    usual_rate : Hz, of a film that states none.
    most_pixels : of an image; larger ones are refused.

    Raises
    ------
    KeypointError : missing, no film, an unsupported codec, no frame that can be decoded.
    MissingExtraError : PyAV is not installed.
    """

    def __init__(
        self, path: str | os.PathLike[str], *, usual_rate: float = 30.0, most_pixels: int = 100_000_000
    ) -> None:
        super().__init__()
        self.path = os.fspath(path)
        self.n_damaged = 0
        if not os.path.exists(path):
            raise KeypointError("film.missing").at(path)
        if not os.path.isfile(path):
            raise KeypointError("film.no_file").at(path)
        if not os.access(path, os.R_OK):
            raise KeypointError("film.permission").at(path)
        if not os.path.getsize(path):
            raise KeypointError("disk.empty").at(path)
        self._av = require("av", "film")
        self._errors = (self._av.error.FFmpegError, ValueError)
        self._start()
        rate = float(self._stream.average_rate or self._stream.guessed_rate or usual_rate)
        self.nominal_rate = rate if 0 < rate <= 2000 else usual_rate
        self.n_stated = self._count()
        first = self._frame
        if first is None:
            self.close()
            raise KeypointError("film.no_frame").at(path)
        width, height = int(first.width), int(first.height)
        if width * height > most_pixels:
            self.close()
            raise KeypointError("keypoint_film.large", width=width, height=height).at(path)
        self._size = (width, height)
        self._turns = count_turns(first)
        self.size = (height, width) if self._turns % 2 else (width, height)

    def _start(self) -> None:
        """Open the film and decode its first frame."""
        self.close()
        try:
            self._container = self._av.open(self.path)
        except (self._av.error.FFmpegError, OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)[:200]  # not the log of FFmpeg
            raise KeypointError("keypoint_film.unreadable", reason=reason).at(self.path) from error
        self.callback(self._container.close)
        streams = self._container.streams.video
        if not streams:
            self.close()
            raise KeypointError("keypoint_film.no_pictures").at(self.path)
        self._stream = streams[0]
        self._stream.thread_type = "AUTO"
        self._frames = self._decode()
        self._frame: Any = next(self._frames, None)
        self._number, self._sought = 0, False

    def _count(self) -> int:
        if self._stream.frames > 0:
            return int(self._stream.frames)
        seconds = 0.0
        if self._stream.duration is not None and self._stream.time_base is not None:
            seconds = float(self._stream.duration * self._stream.time_base)
        elif self._container.duration is not None:
            seconds = self._container.duration / self._av.time_base
        return max(0, round(seconds * self.nominal_rate))

    def _decode(self) -> Iterator[Any]:
        """Yield decoded frames; damaged packets are left out."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except self._errors:  # the container itself is damaged from here on
                self.n_damaged += 1
                return
            if packet is None:
                return
            try:
                yield from packet.decode()
            except self._errors:
                self.n_damaged += 1

    def read(self, skip: int = 0) -> Iterator[Frame]:
        """Yield frame number, s since the first frame, and image (H, W, 3) red, green, blue; only once.

        The first ``skip`` frames are not yielded.

        Raises
        ------
        KeypointError : the size of the images changes.
        """
        start, last = None, -np.inf
        frame, waiting = 0, self._frame
        self._frame = None
        while waiting is not None:
            time = waiting.time
            if start is None:
                start = 0.0 if time is None else float(time)
            elapsed = frame / self.nominal_rate if time is None else float(time) - start
            if elapsed <= last:  # stamps that stand still or go back
                elapsed = last + 0.25 / self.nominal_rate
            last = elapsed
            if frame >= skip:
                yield frame, elapsed, self._show(waiting, frame)
            frame, waiting = frame + 1, next(self._frames, None)

    @cached_property
    def _stamps(self) -> list[int | None]:
        """Time stamps (T,) of the frames, in units of the stream; None where a bare stream has none."""
        stamps: list[int | None] = []
        broken = False
        with suppress(*self._errors), self._av.open(self.path) as container:
            for packet in container.demux(container.streams.video[0]):
                if packet.size and not packet.is_discard:
                    stamps.append(packet.pts)
                    broken = packet.is_corrupt
        if broken:  # the film is cut off within its last frame
            stamps.pop()
        return stamps if None in stamps else sorted(stamps)  # type: ignore[type-var]

    @property
    def times(self) -> FloatArray:
        """(T,) s of each frame since the first, read from the whole file without decoding it."""
        if None in self._stamps:
            return np.arange(len(self._stamps)) / self.nominal_rate
        stamps = np.array(self._stamps, np.int64)
        return np.asarray((stamps - stamps[:1]) * float(self._stream.time_base))

    def find(self, frame: int, seek_beyond: int = 64) -> Image | None:
        """Return a frame (H, W, 3) blue, green, red; None where it cannot be decoded.

        Decoding ``seek_beyond`` frames costs more than seeking. Frames are counted from the beginning where a format
        cannot seek.
        """
        if not 0 <= frame - self._number <= seek_beyond:
            self._seek(frame)
        while True:
            while self._frame is not None and self._number < frame:
                self._frame, self._number = next(self._frames, None), self._number + 1
            if self._frame is not None:
                return self._show(self._frame, frame, "bgr24")
            if not self._sought:
                return None
            self._start()

    def _seek(self, frame: int) -> None:
        stamp = self._stamps[frame]
        try:
            self._container.seek(stamp, stream=self._stream)
            self._frames = self._decode()
            self._frame = next(self._frames, None)
            self._number, self._sought = self._stamps.index(self._frame.pts), True
        except (*self._errors, TypeError, AttributeError):
            self._start()
        if self._number > frame:
            self._start()

    def note_lacking(self, name: str, n_frames: int) -> list[Message]:
        """Say so where clearly fewer frames were found than the header states, which may be rounded."""
        if n_frames >= 0.98 * self.n_stated - 1:
            return []
        return [Message("film.truncated", view=name, frames=n_frames, stated=self.n_stated)]

    def _show(self, decoded: Any, frame: int, colours: str = "rgb24") -> Image:
        if (decoded.width, decoded.height) != self._size:
            raise KeypointError("keypoint_film.size_changes", frame=frame).at(self.path)
        picture = np.asarray(decoded.to_ndarray(format=colours), np.uint8)
        return np.ascontiguousarray(np.rot90(picture, self._turns)) if self._turns else picture


@contextmanager
def read_ahead(frames: Iterator[Frame], count: int = 2) -> Iterator[Iterator[Frame]]:
    """Yield the same frames while a thread decodes the next ``count``."""
    waiting: deque[Future[Frame | None]] = deque()
    with ThreadPoolExecutor(1) as pool:

        def follow() -> Iterator[Frame]:
            while (frame := waiting.popleft().result()) is not None:
                waiting.append(pool.submit(next, frames, None))
                yield frame

        waiting.extend(pool.submit(next, frames, None) for _ in range(count))
        yield follow()


def count_turns(frame: Any) -> int:
    """Return the quarter turns counter-clockwise, 0 to 3, that make a decoded frame upright, by its display matrix."""
    return round(int(getattr(frame, "rotation", 0)) / 90) % 4
