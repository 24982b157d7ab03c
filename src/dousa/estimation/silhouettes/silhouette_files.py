"""Silhouettes from npz files, folders of masks and videos."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal

from dousa.arrays import Mask
from dousa.errors import OptionError, SilhouetteError
from dousa.estimation.silhouettes.background import BackgroundMethod
from dousa.estimation.silhouettes.images import IMAGE_ENDINGS, MaskFolder, find_mask_folders, resize_mask
from dousa.estimation.silhouettes.mask_npz import read_silhouettes
from dousa.estimation.silhouettes.silhouettes import Silhouettes, View, synchronise
from dousa.estimation.silhouettes.video import LONGEST_SIDE, VideoKind, open_video
from dousa.messages import Progress

Path = str | os.PathLike[str]


class _ViewOf(View):
    """One view of silhouettes."""

    def __init__(self, source: Silhouettes, view: int, size: tuple[int, int] | None) -> None:
        self._source, self._view = source, view
        self.name, self.size = source.names[view], size or source.sizes[view]
        self.n_frames, self.frame_rate = source.n_frames, source.frame_rate
        self.warnings = source.warnings if view == 0 else ()

    def read(self, frame: int) -> Mask | None:
        mask = self._source.read_view(self._view, frame)
        return None if mask is None else resize_mask(mask, self.size)


def open_silhouettes(
    sources: Sequence[Path] | Path,
    backgrounds: Sequence[Path] = (),
    method: BackgroundMethod | None = None,
    kind: VideoKind | None = None,
    frame_rate: float | None = None,
    sizes: Sequence[tuple[int, int]] | None = None,
    offsets: Sequence[float] | None = None,
    frames: tuple[int, int] | None = None,
    progress: Progress | None = None,
    longest_side: int = LONGEST_SIDE,
) -> Silhouettes:
    """Open the silhouettes of one or more views; close them, or use ``with``.

    Parameters
    ----------
    sources : one npz file with all views (see `mask_npz`); or per view an npz file, a folder of mask images, or a
        video; a folder of such folders stands for them all.
    backgrounds : of videos, an image of the empty scene per view, in the order of the views.
    method : background of videos: ``"plate"`` (by default with ``backgrounds``), ``"median"`` (without) or ``"mog2"``.
    kind : ``"mask"`` or ``"video"``, the content of videos; by default recognised from their frames.
    frame_rate : Hz of sources without a (correct) frame rate.
    sizes : (V,) width and height of the masks, such as those of the (scaled) cameras; or one for all. By default
        as masks are stored, and for videos of a scene that of the background or the video, reduced.
    offsets : (V,) s from the start of each view to one common moment.
    frames : first frame and the one after the last; all by default.
    progress : called with (done, total, what) while backgrounds are learnt.
    longest_side : px to which videos of a scene are reduced without ``sizes``.

    Raises
    ------
    SilhouetteError : an unreadable or unknown source, views that do not fit together.
    OptionError : options that do not fit the sources.
    """
    paths = [sources] if isinstance(sources, str | os.PathLike) else list(sources)
    views = open_views(paths, backgrounds, method, kind, frame_rate, sizes, progress, longest_side)
    try:
        return synchronise(views, None, offsets, frames)
    except BaseException:
        for opened in views:
            opened.close()
        raise


def open_views(
    paths: Sequence[Path],
    backgrounds: Sequence[Path] = (),
    method: BackgroundMethod | None = None,
    kind: VideoKind | None = None,
    frame_rate: float | None = None,
    sizes: Sequence[tuple[int, int]] | None = None,
    progress: Progress | None = None,
    longest_side: int = LONGEST_SIDE,
) -> list[View]:
    """Open views, each on its own clock; arguments and errors are those of `open_silhouettes`."""
    if not paths:
        raise SilhouetteError("mask_files.no_source")
    places = _list_places(paths)
    packed = [read_silhouettes(path, frame_rate) if what == "npz" else None for path, what in places]
    n_views = [1 if source is None else source.n_views for source in packed]
    if len(places) > 1 and max(n_views) > 1:
        raise SilhouetteError("mask_files.alone").at(places[0][0])
    wanted = _per_view(sizes, sum(n_views))
    method, plates = _plates(method, backgrounds, places, sum(n_views))
    views: list[View] = []
    try:
        for (path, what), source, count in zip(places, packed, n_views, strict=True):
            for view in range(count):
                size, plate = wanted[len(views)], plates[len(views)]
                if source is not None:
                    views.append(_ViewOf(source, view, size))
                elif what == "folder":
                    views.append(MaskFolder(path, frame_rate, size))
                else:
                    views.append(open_video(path, kind, method, plate, frame_rate, size, progress, longest_side))
        return views
    except BaseException:
        for opened in views:
            opened.close()
        raise


def _list_places(paths: Sequence[Path]) -> list[tuple[str, Literal["npz", "folder", "video"]]]:
    """Each view's path and what it is."""
    places: list[tuple[str, Literal["npz", "folder", "video"]]] = []
    for path in paths:
        name = os.fspath(path)
        if os.path.isdir(name):
            places += [(folder, "folder") for folder in find_mask_folders(name)]
        elif not os.path.exists(name):
            raise SilhouetteError("mask_files.missing").at(name)
        elif name.lower().endswith(".npz"):
            places.append((name, "npz"))
        elif name.lower().endswith(IMAGE_ENDINGS):
            raise SilhouetteError("mask_files.single_image").at(name)
        else:
            places.append((name, "video"))
    return places


def _per_view(sizes: Sequence[tuple[int, int]] | None, n_views: int) -> list[tuple[int, int]] | list[None]:
    if sizes is None:
        return [None] * n_views
    values = [(int(width), int(height)) for width, height in sizes]
    if len(values) == 1:
        values *= n_views
    if len(values) != n_views:
        raise SilhouetteError("mask_files.sizes", expected=n_views, found=len(values))
    if any(min(value) < 8 or max(value) > 20_000 for value in values):
        raise OptionError("mask_files.size_range", found=str(values))
    return values


def _plates(
    method: BackgroundMethod | None, backgrounds: Sequence[Path], places: Sequence[tuple[str, str]], n_views: int
) -> tuple[BackgroundMethod, list[Path | None]]:
    """Return the method, and the plate of each view."""
    if method not in (None, "plate", "median", "mog2"):
        raise OptionError("background.method", found=str(method))
    given = list(backgrounds)
    if not given:
        if method == "plate":
            raise OptionError("background.no_plate")
        return method or "median", [None] * n_views
    if method not in (None, "plate"):
        raise OptionError("mask_files.plate_method", found=str(method))
    if not any(what == "video" for _, what in places):
        raise OptionError("mask_files.plates_for_masks")
    if len(given) != n_views:
        raise OptionError("mask_files.plates", expected=n_views, found=len(given))
    return "plate", [*given]
