"""Silhouettes from videos of a person before a fixed camera, or of masks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal

import numpy as np

from dousa.arrays import Image, Mask, spread_evenly
from dousa.errors import KeypointError, OptionError, SilhouetteError
from dousa.estimation.cameras.camera import format_size
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.silhouettes.background import (
    BackgroundMethod,
    fill_camouflage,
    learn_background,
    subtract_background,
)
from dousa.estimation.silhouettes.cleaning import clean_mask, count_people
from dousa.estimation.silhouettes.images import fit_frame, is_stretched, read_colour_image, resize_mask
from dousa.estimation.silhouettes.silhouettes import View, checked_frame, checked_rate
from dousa.extras import cv2
from dousa.messages import Message, Progress

VideoKind = Literal["mask", "video"]

LONGEST_SIDE = 640
"""px, to which silhouettes are reduced unless asked for (docs/silhouettes.md)."""


class VideoFile:
    """Upright frames of a video file, decoded one at a time; going back or far ahead seeks.

    ``n_frames`` counts the frames that the file holds, not those that the header states; ``times`` (T,) are s since
    the first, perhaps uneven.

    Parameters
    ----------
    path : the file.
    frame_rate : Hz; by default that of the file, with the time stamps of the frames.

    Raises
    ------
    SilhouetteError : missing, no video, an unsupported codec, no frames.
    """

    def __init__(self, path: str | os.PathLike[str], frame_rate: float | None = None) -> None:
        self.path = os.fspath(path)
        self.name = os.path.splitext(os.path.basename(self.path))[0]
        self._film: FilmFrames | None = None
        self._latest: tuple[int, Image | None] = (-1, None)
        try:
            film = self._open()
        except KeypointError as error:
            raise SilhouetteError(error.message).at(path) from None
        self.size, self.times = film.size, film.times
        self.n_frames = len(self.times)
        self.frame_rate = film.nominal_rate
        self.lacking = film.note_lacking(self.name, self.n_frames)
        if frame_rate is not None:
            self.frame_rate = checked_rate(frame_rate, self.path)
            self.times = np.arange(self.n_frames) / self.frame_rate

    def _open(self) -> FilmFrames:
        if self._film is None:
            self._film = FilmFrames(self.path)
        return self._film

    def read(self, frame: int) -> Image | None:
        """Return a frame (H, W, 3) uint8 blue, green, red; None where the data are damaged."""
        frame = checked_frame(frame, self.n_frames)
        if self._latest[0] != frame:
            try:
                self._latest = (frame, self._open().find(frame))
            except KeypointError as error:
                raise SilhouetteError(error.message).at(self.path) from None
        return self._latest[1]

    def close(self) -> None:
        """Close the file; reading opens it again."""
        if self._film is not None:
            self._film.close()
            self._film = None


def guess_video_kind(images: Sequence[Image], least_binary: float = 0.97) -> VideoKind:
    """Return whether frames (H, W, 3) are masks (black or white in at least ``least_binary`` of each) or a scene."""
    for image in images:
        low, high = image.min(axis=2), image.max(axis=2)
        binary = (high <= 40) | (low >= 215)
        if binary.mean() < least_binary or (low >= 215).mean() > 0.9:
            return "video"
    lit = any(bool((image.min(axis=2) >= 215).any()) for image in images)
    return "mask" if images and lit else "video"


def reduce_size(size: tuple[int, int], longest: int = LONGEST_SIDE) -> tuple[int, int]:
    """Return width and height with at most ``longest`` pixels on the longer side, in proportion if possible.

    The tracker gains nothing by larger silhouettes than those of the default.
    """
    long, short = max(size), min(size)
    if long <= longest:
        return size
    side = next((side for side in range(longest, longest * 3 // 4, -1) if side * short % long == 0), longest)
    other = max(1, round(side * short / long))
    return (side, other) if size[0] >= size[1] else (other, side)


class _VideoBased(View):
    """Common base of videos of masks and of scenes."""

    def __init__(self, file: VideoFile, size: tuple[int, int] | None = None) -> None:
        self._file = file
        self.name, self.size = file.name, size or file.size
        self.n_frames, self.frame_rate, self.times = file.n_frames, file.frame_rate, file.times
        self.warnings: list[Message] = list(file.lacking)

    def close(self) -> None:
        """Close the file; reading opens it again."""
        self._file.close()


class MaskVideo(_VideoBased):
    """A video of masks, bright on dark, resized to ``size`` (width, height) if given."""

    def read(self, frame: int) -> Mask | None:
        """Return the mask (height, width) of a frame; None where the data are damaged."""
        image = self._file.read(frame)
        return None if image is None else resize_mask(np.asarray(image.max(axis=2) > 127), self.size)


class VideoView(_VideoBased):
    """A video of one person before a fixed camera; the background is learnt when it is opened.

    The person is followed from frame to frame, so with several people the masks may depend on the order of reading.

    Parameters
    ----------
    file : the video.
    size : width and height of the masks and of the resized frames; by default that of the plate, or of the video,
        reduced to ``longest_side`` in proportion.
    method : of the background, see `dousa.estimation.silhouettes.background`.
    plate : image file of the scene without the person, for ``"plate"``.
    progress : called with (frames done, frames in all, what) while the background is learnt.
    longest_side : px, see ``size``.

    Raises
    ------
    SilhouetteError : fewer than two frames can be decoded, a plate that cannot be read.
    """

    def __init__(
        self,
        file: VideoFile,
        size: tuple[int, int] | None = None,
        method: BackgroundMethod = "median",
        plate: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
        longest_side: int = LONGEST_SIDE,
    ) -> None:
        scene = None if plate is None else read_colour_image(plate)
        if size is None:
            size = reduce_size(file.size if scene is None else (scene.shape[1], scene.shape[0]), longest_side)
        super().__init__(file, size)
        self._previous: tuple[int, Mask] | None = None
        self._several = False
        self._find_part()
        samples = self._sample(progress)
        image = None if scene is None else self._resize(scene)
        if scene is not None and is_stretched((scene.shape[1], scene.shape[0]), self.size):
            self.warnings.append(Message("film.plate_stretched", view=self.name))
        self._background = learn_background(samples, method, image)
        self.warnings += [Message("film.of_view", view=self.name, note=note) for note in self._background.warnings]

    def _find_part(self) -> None:
        """Crop black bars of a format conversion, where the rest has the proportions of the masks."""
        file = self._file
        self._part = (slice(0, file.size[1]), slice(0, file.size[0]))
        if file.size == self.size:
            return
        sample = file.read(0)
        if sample is None:
            raise SilhouetteError("film.no_frame").at(file.path)
        self._part = fit_frame(file.size, self.size, sample)
        height, width = sample[self._part].shape[:2]
        if (width, height) != file.size:
            sizes = {"size": format_size(file.size), "other": format_size((width, height))}
            self.warnings.append(Message("film.bars", view=self.name, **sizes))
        if is_stretched((width, height), self.size):
            sizes = {"size": format_size((width, height)), "other": format_size(self.size)}
            self.warnings.append(Message("film.stretched", view=self.name, **sizes))

    def look(self, frame: int) -> Image | None:
        """Return the image (height, width, 3) behind the mask of a frame; None where the data are damaged."""
        image = self._file.read(frame)
        return None if image is None else self._resize(image[self._part])

    def _resize(self, image: Image) -> Image:
        if (image.shape[1], image.shape[0]) == self.size:
            return image
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA), np.uint8)

    def _sample(self, progress: Progress | None, count: int = 32) -> Image:
        """Return frames (count, height, width, 3) spread over the video, from which the background is learnt."""
        frames = spread_evenly(self.n_frames, count).tolist()
        samples = []
        for done, frame in enumerate(frames):
            image = self._file.read(frame)
            if image is not None:
                samples.append(self._resize(image[self._part]))
            if progress is not None:
                progress(done + 1, len(frames), Message("film.learning", view=self.name))
        if len(samples) < 2:
            raise SilhouetteError("film.samples", found=len(samples)).at(self._file.path)
        return np.stack(samples)

    def read(self, frame: int, last_known: int = 5) -> Mask | None:
        """Return the mask (height, width) of a frame; None where the data are damaged.

        The person is followed where up to ``last_known`` - 1 frames are skipped.
        """
        image = self.look(frame)
        if image is None:
            return None
        found = subtract_background(image, self._background)
        if not self._several and count_people(found) > 1:
            self._several = True
            self.warnings.append(Message("film.several", view=self.name, frame=frame))
        previous = None
        if self._previous is not None and 0 < frame - self._previous[0] <= last_known:
            previous = self._previous[1]
        mask = clean_mask(found, previous=previous)
        fill_camouflage(mask, image)
        if mask.any():
            self._previous = (frame, mask)
        return mask


def open_video(
    path: str | os.PathLike[str],
    kind: VideoKind | None = None,
    method: BackgroundMethod = "median",
    plate: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    size: tuple[int, int] | None = None,
    progress: Progress | None = None,
    longest_side: int = LONGEST_SIDE,
) -> View:
    """Open a video of masks or of a scene as one view; by default the kind is recognised from a few frames."""
    if kind not in (None, "mask", "video"):
        raise OptionError("film.kind", found=str(kind))
    file = VideoFile(path, frame_rate)
    shown = kind
    if shown is None:
        images = [file.read(frame) for frame in spread_evenly(file.n_frames, 5).tolist()]
        shown = guess_video_kind([image for image in images if image is not None])
    if shown == "video":
        return VideoView(file, size, method, plate, progress, longest_side)
    view = MaskVideo(file, size)
    if kind is None:
        view.warnings.append(Message("film.taken_for_masks", view=view.name))
    return view
