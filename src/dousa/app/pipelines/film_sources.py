"""What belongs to one view: a film, its keypoints, and the masks of the person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from dousa.errors import OptionError, SilhouetteError
from dousa.estimation.keypoints.keypoint_files import holds_keypoints
from dousa.formats.registry import READERS

_OF_EITHER = (".npz", ".json", ".csv", ".tsv", ".npy")  # by what is in them, keypoints, masks or motions
_KEYPOINT_SUFFIXES = (*_OF_EITHER, ".trc")


@dataclass(frozen=True, slots=True)
class FilmSource:
    """One view.

    Parameters
    ----------
    name : of the view.
    source : of its keypoints: the film, or a file of keypoints.
    film : whose pictures are shown and whose sound is heard; None for keypoints alone.
    """

    name: str
    source: Path
    film: Path | None

    @property
    def has_keypoints(self) -> bool:
        """Whether the source holds keypoints, and is not the film itself."""
        return self.film != self.source


class PairedSources(NamedTuple):
    """The views, and files or folders of masks, each of one view or of all."""

    views: tuple[FilmSource, ...]
    masks: tuple[Path, ...]

    @property
    def seen(self) -> tuple[Path, ...]:
        """(V,) the film of each view; without one, its keypoints."""
        return tuple(view.film or view.source for view in self.views)


def pair_sources(sources: Sequence[Path]) -> PairedSources:
    """Pair films with the keypoints named after them; what shows masks beside keypoints is no view of its own.

    Raises
    ------
    OptionError : one film is given twice.
    """
    found = [path for path in sources if holds_keypoints(path)]
    masks = [path for path in sources if found and path not in found and holds_masks(path)]
    films = [path for path in sources if path not in found and path not in masks]
    # The longest name that fits: ``left_b.npz`` is of ``left_b.mp4`` and not of ``left.mp4``.
    of = {path: max((film for film in films if _is_of(path, film)), key=lambda film: len(film.stem), default=None)
          for path in found}  # fmt: skip
    alone = [film for film in films if film not in of.values()]
    pairs = [(path, of.get(path, path)) for path in sources if path in of or path in alone]
    names = name_films([film or path for path, film in pairs])
    views = tuple(FilmSource(name, path, film) for name, (path, film) in zip(names, pairs, strict=True))
    return PairedSources(views, tuple(masks))


def _is_of(keypoints: Path, film: Path) -> bool:
    """Whether keypoints are named after a film: ``left.npz`` or ``left_json`` of ``left.mp4``."""
    name, own = keypoints.stem if keypoints.suffix else keypoints.name, film.stem
    return name == own or (name.startswith(own) and not name[len(own)].isalnum())


def is_keypoints(path: Path) -> bool:
    """Whether a source holds keypoints, and is not a film."""
    return path.is_dir() or path.suffix.lower() in _KEYPOINT_SUFFIXES


def is_motion(path: Path) -> bool:
    """Whether a source is of a format of motions alone; a ``.trc`` may be a table of points in pictures."""
    suffix = path.suffix.lower()
    return suffix in READERS and suffix not in _OF_EITHER and not holds_keypoints(path)


def holds_masks(path: Path) -> bool:
    """Whether a source that holds no keypoints is a file, folder or film of masks."""
    from dousa.files.npz_arrays import open_npz

    try:
        if path.is_dir():
            return True
        if path.suffix.lower() == ".npz":
            with open_npz(path, SilhouetteError) as arrays:
                return not {"mask_packed", "mask", "masks"}.isdisjoint(arrays.names)
        return shows_masks(path)
    except (OSError, SilhouetteError):
        return False  # its reader describes the problem


def shows_masks(path: Path) -> bool:
    """Whether a film is one of masks."""
    import numpy as np

    from dousa.estimation.silhouettes.video import VideoFile, guess_video_kind

    try:
        file = VideoFile(path)
    except SilhouetteError:
        return False  # its reader describes the problem
    try:
        places = np.unique(np.linspace(0, file.n_frames - 1, 3).astype(int))
        images = [file.read(int(place)) for place in places]
    finally:
        file.close()
    return guess_video_kind([image for image in images if image is not None]) == "mask"


def name_films(paths: Sequence[Path]) -> tuple[str, ...]:
    """Different names for films: without folder and suffix; of those of one name with the folders that differ.

    Raises
    ------
    OptionError : one film is given twice.
    """
    of_name: dict[str, list[Path]] = {}
    for path in paths:
        of_name.setdefault(path.stem, []).append(path)
    names = [path.stem if len(of_name[path.stem]) == 1 else _tell_apart(path, of_name[path.stem]) for path in paths]
    if len(set(names)) < len(names):
        twice = next(name for name, times in Counter(names).items() if times > 1)
        raise OptionError("films.twice", name=twice)
    return tuple(names)


def _tell_apart(path: Path, others: Sequence[Path]) -> str:
    """Name a film by the nearest folder that tells it from all others with its name, else by all that differ."""
    depths = range(min(len(other.parents) for other in others))
    counts = {depth: len({other.parents[depth].name for other in others}) for depth in depths}
    alone = [depth for depth in depths if counts[depth] == len(others)][:1]
    folders = [path.parents[depth].name for depth in alone or [depth for depth in depths if counts[depth] > 1][::-1]]
    return "_".join([*folders, path.stem if alone else path.name])
