"""What an estimation from films has found so far: views, people, offsets, cameras and doubts; and pictures of its
films.

The work writes, the studio reads. In the folder of a job:

    film.json         the answer of `FilmRecord.describe`; written last, with a higher ``version``
    frames.npy        (V, T) the frame of each film at each common moment
    points-V.npy      (P, T, K, 2) int16, the people of a view in 1/16384 of its width and height; or `UNSEEN`
    sure-V.npy        (P, T, K) uint8, 255 times their visibility

Pictures of every frame lie beside a film, as the studio itself does not decode films:

    .NAME.jpg.idx     records of `SHOWN`: the frame, and the place of its JPEG in .NAME.jpg.bin
    .NAME.jpg.bin     JPEG files, one after another
    .NAME.jpg.end     exists once the film was read to its end

An interrupted run continues there, and later estimations of the same film use them again.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.player.figures import encode_array
from dousa.app.studio.core.answers import Answer, RefusedError
from dousa.app.studio.core.workspace import write_file
from dousa.arrays import FloatArray, Image, Mask, nearest_frames
from dousa.files.disk import atomic_write
from dousa.messages import Message, Progress

if TYPE_CHECKING:
    from dousa.app.pipelines.film_scene import FilmScene
    from dousa.estimation import Camera, PersonTrack, ViewKeypoints
    from dousa.estimation.multiview.people import MatchedPerson
    from dousa.estimation.tracking.settings import Estimate


FILM_SIDE, MASK_SIDE = 720, 480
"""The longer sides, px, of kept pictures: of films and of what masks are made from; and of fitted silhouettes and what
they were made from. Larger ones show more, and take more of the disk."""

SHOWN = np.dtype([("frame", "<i4"), ("size", "<i4"), ("offset", "<i8")])


def name_pictures(film: Path) -> Path:
    """Return the path of a film's pictures without its last suffix."""
    digest = hashlib.sha256(film.name.encode("utf-8", "replace")).hexdigest()[:16]
    return film.with_name(f".{digest}.jpg")


def choose_stride(n_frames: int, *, most_bytes: int = 1_500_000_000) -> int:
    """Choose every how many frames a picture is stored, for the number of frames of all films of a batch."""
    # most_bytes: of all films of a batch; of longer ones not every frame is kept
    return max(1, -(-n_frames * 45_000 // most_bytes))  # of a picture


def write_pictures(film: Path, stride: int, report: Progress) -> None:
    """Write the missing pictures of a film; KeypointError if it is damaged.

    Parameters
    ----------
    film : to decode.
    stride : of `choose_stride`.
    report : called with (frames done, frames, what).
    """
    from dousa.estimation.keypoints.films import FilmFrames

    place = name_pictures(film)
    end = Path(f"{place}.end")
    if end.exists():
        return
    known = read_records(Path(f"{place}.idx"), SHOWN)
    n_done = int(known["frame"][-1]) + 1 if len(known) else 0
    n_bytes = int(known["offset"][-1] + known["size"][-1]) if len(known) else 0
    what = Message("studio_films.pictures", film=film.name)
    with FilmFrames(film) as frames, open(f"{place}.bin", "ab") as pictures, open(f"{place}.idx", "ab") as index:
        pictures.truncate(n_bytes)
        index.truncate(len(known) * SHOWN.itemsize)
        for frame, _, picture in frames.read(skip=n_done):
            if frame % stride == 0:
                content = encode_jpeg(shrink(picture, FILM_SIDE)[..., ::-1], 74)
                pictures.write(content)
                pictures.flush()  # first: what the index names is there
                index.write(np.array([(frame, len(content), n_bytes)], SHOWN).tobytes())
                n_bytes += len(content)
            if frame % 10 == 0:  # frames
                index.flush()
                report(frame + 1, max(frames.n_stated, frame + 1), what)
    end.touch()


def shrink(image: NDArray[np.uint8], longest: int) -> NDArray[np.uint8]:
    """Shrink an image (H, W) or (H, W, 3) whose longer side has more px than this."""
    from dousa.extras import cv2

    height, width = image.shape[:2]
    factor = longest / max(height, width)
    if factor >= 1.0:
        return image
    size = max(1, round(width * factor)), max(1, round(height * factor))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def encode_jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Encode a picture (H, W, 3) blue, green, red."""
    from dousa.extras import cv2

    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def encode_mask(mask: Mask) -> bytes:
    """Encode a mask (H, W) as PNG, white on black."""
    from dousa.extras import cv2

    image = np.ascontiguousarray(mask, bool).view(np.uint8) * np.uint8(255)
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_BILEVEL, 1])[1].tobytes())


def read_records(path: Path, record: np.dtype[Any], start: int = 0) -> NDArray[Any]:
    """Read the complete records of a file from a byte on; none if the file is missing."""
    try:
        with open(path, "rb") as file:
            file.seek(start)
            content = file.read()
    except FileNotFoundError:
        content = b""
    return np.frombuffer(content[: len(content) // record.itemsize * record.itemsize], record)


class FilmPictures:
    """The pictures of a film as far as they are written; the film itself may be deleted."""

    def __init__(self, film: Path) -> None:
        self._place = name_pictures(film)
        self._index = read_records(Path(f"{self._place}.idx"), SHOWN)

    def read(self, frame: int) -> bytes | None:
        """Return the JPEG of a frame or of the nearest one before it; None if there is none."""
        if not len(self._index) or frame > self._index["frame"][-1]:
            self._index = read_records(Path(f"{self._place}.idx"), SHOWN)
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
    """Encode a picture (H, W, 3) blue, green, red as a data URL, of at most so many px."""
    return "data:image/jpeg;base64," + base64.b64encode(encode_jpeg(shrink(canvas, longest), 85)).decode("ascii")


UNSEEN = int(np.iinfo(np.int16).min)
STAGES = ("films", "found", "placed", "matched", "fitted")
_SCALE = 16384  # of a width or height, by definition of points-V.npy above
_HEAD = ("nose", "left_ear", "right_ear")

Track = tuple[int, int]
"""A view, and the number of a person in it."""


def choose_names(names: Sequence[str]) -> tuple[list[str], list[list[int]]]:
    """Choose the points that are drawn, and the bones between them."""
    from dousa.app.pictures.keypoint_overlay import BONES

    ends = {name for bone in BONES for name in bone}
    kept = [name for name in names if name in ends or name in _HEAD]
    return kept, [[kept.index(one), kept.index(other)] for one, other in BONES if {one, other} <= set(kept)]


class FilmRecordWriter:
    """Writes what is found.

    Parameters
    ----------
    folder : of the job.
    films : (V,) name, and path of the film below the studio's files; None for keypoints without a film.
    left_out : tracks that the user has excluded.
    """

    def __init__(self, folder: Path, films: Sequence[tuple[str, str | None]], left_out: Sequence[Track]) -> None:
        self._folder = folder
        try:
            version = int(json.loads((folder / "film.json").read_bytes())["version"])
        except (OSError, ValueError, KeyError, TypeError):
            version = 0
        self._said: dict[str, Any] = {
            "version": version,
            "stage": STAGES[0],
            "total": 0,
            "frame_rate": 30.0,
            "names": [],
            "bones": [],
            "views": [
                {"name": name, "film": film, "ready": False, "width": 4, "height": 3, "people": []}
                for name, film in films
            ],
            "starts": None,
            "cameras": [],
            "people": [],
            "chosen": None,
            "left_out": [list(track) for track in left_out],
            "lost": [],
            "unsure": [],
            "doubt_mm": [],
            "parents": [],
        }

    def begin(self, sizes: Sequence[tuple[int, int]], n_frames: Sequence[int], rate: float) -> None:
        """Write that the films can be looked at, each on its own clock."""
        self._size_views(sizes)
        total = max(1, min(n_frames))
        frames = np.tile(np.arange(total), (len(sizes), 1))
        self._save("frames", frames.astype("<i4"))
        self._say(STAGES[0], total=total, frame_rate=rate)

    def show(self, film: str) -> None:
        """Write that the pictures of a film are complete."""
        for view in self._said["views"]:
            view["ready"] = view["ready"] or view["film"] == film
        self._say(self._said["stage"])

    def _size_views(self, sizes: Sequence[tuple[int, int]]) -> None:
        for view, (width, height) in zip(self._said["views"], sizes, strict=True):
            view.update(width=width, height=height)

    def find(self, found: Sequence[ViewKeypoints]) -> None:
        """Write all tracks of people of all views, those left out too, on each film's own clock."""
        rate = min(view.frame_rate for view in found)
        moments = np.arange(int(min(view.times[-1] for view in found) * rate + 0.25) + 1) / rate
        self._size_views([view.size for view in found])
        self._keep_tracks(found, [moments] * len(found))
        names, bones = choose_names(found[0].names)
        for own, view in zip(self._said["views"], found, strict=True):
            own["people"] = [_describe_track(person) for person in view.people]
        self._say(STAGES[1], total=len(moments), frame_rate=rate, names=names, bones=bones)

    def place(self, scene: FilmScene, found: Sequence[ViewKeypoints]) -> None:
        """Write the common clock of the films and their cameras."""
        self._keep_tracks(found, [scene.moments + offset for offset in scene.offsets])
        self._say(
            STAGES[2],
            total=len(scene.moments),
            frame_rate=scene.frame_rate,
            starts=(scene.offsets.max() - scene.offsets).round(4).tolist(),
            cameras=[describe_camera(camera) for camera in scene.cameras],
        )

    def match(self, people: Sequence[MatchedPerson], chosen: int, numbers: Sequence[Sequence[int]]) -> None:
        """Write which tracks of the views are one person.

        Parameters
        ----------
        people : those seen most come first.
        chosen : index of the person to estimate.
        numbers : (V,) the number of each track before some were left out.
        """
        said = []
        for person in people:
            members = [[view, numbers[view][own]] for view, some in enumerate(person.members) for own in some]
            share = [0.0 if track is None else float(track.present.mean()) for track in person.tracks]
            said.append({"members": members, "seen": share})
        self._say(STAGES[3], people=said, chosen=chosen)

    def fit(self, estimate: Estimate) -> None:
        """Write how sure the motion is."""
        from dousa.motion import CANONICAL_PARENTS

        doubt = np.nanmean(estimate.uncertainty, axis=1)
        doubt = np.where(np.isfinite(doubt), doubt, 1.0)
        self._say(
            STAGES[4],
            total=estimate.n_frames,
            lost=np.flatnonzero(estimate.lost).tolist(),
            # m, mean uncertainty of the joints of a frame that is marked
            unsure=np.flatnonzero((doubt > 0.07) & ~estimate.lost).tolist(),
            doubt_mm=(1000 * doubt).round(1).tolist(),
            parents=list(CANONICAL_PARENTS),
        )

    def _keep_tracks(self, found: Sequence[ViewKeypoints], moments: Sequence[FloatArray]) -> None:
        frames = np.stack([nearest_frames(view.times, own) for view, own in zip(found, moments, strict=True)])
        for number, (view, rows) in enumerate(zip(found, frames, strict=True)):
            names, _ = choose_names(view.names)
            places = view.find(names)
            shape = (len(view.people), len(rows), len(names))
            points, sure = np.full((*shape, 2), UNSEEN, "<i2"), np.zeros(shape, np.uint8)
            for track, person in enumerate(view.people):
                share = (person.points[rows][:, places] + 0.5) / view.size * _SCALE
                seen = np.isfinite(share).all(axis=2)
                points[track][seen] = np.clip(np.rint(share[seen]), -32767, 32767)
                sure[track] = np.rint(255 * person.visibility[rows][:, places])
            self._save(f"points-{number}", points)
            self._save(f"sure-{number}", sure)
        self._save("frames", frames.astype("<i4"))

    def _save(self, name: str, array: NDArray[Any]) -> None:
        with atomic_write(self._folder / f"{name}.npy") as file:
            np.save(file, array)

    def _say(self, stage: str, **values: Any) -> None:
        self._said |= {"stage": stage, "version": self._said["version"] + 1, **values}
        write_file(self._folder / "film.json", Answer(None).render(self._said))


def _describe_track(person: PersonTrack) -> dict[str, Any]:
    present = person.present
    first = int(np.argmax(present)) if present.any() else 0
    return {"seen": float(present.mean()), "first": first}


def describe_camera(camera: Camera, *, sight_m: float = 0.9) -> dict[str, Any]:
    """Return name, position, and the corners (4, 3) of the view at a short distance; m, Y up."""
    # sight_m: how far the pyramid of a camera is drawn
    right, low = camera.width - 1.0, camera.height - 1.0
    corners = np.array(((0.0, 0.0), (right, 0.0), (right, low), (0.0, low)))
    starts, ways = camera.compute_rays(corners)
    forward = np.maximum(np.nan_to_num(ways) @ camera.rotation[2], 0.2)
    ends = starts + sight_m * np.nan_to_num(ways) / forward[:, None]
    return {
        "name": camera.name,
        "position": camera.position.round(4).tolist(),
        "corners": np.asarray(ends).round(4).tolist(),
    }


class FilmRecord:
    """Reads what was found of films so far.

    Parameters
    ----------
    folder : of the job.
    files : of the studio, with the batches.
    """

    def __init__(self, folder: Path, files: Path) -> None:
        self._folder, self._files = folder, files
        self._stamp: tuple[int, int] | None = None
        self._said: dict[str, Any] = {}
        self._frames: NDArray[Any] = np.zeros((0, 0), np.int32)
        self._pictures: dict[int, FilmPictures] = {}

    def refresh(self) -> None:
        """Read what was written since the last call."""
        try:
            state = (self._folder / "film.json").stat()
        except FileNotFoundError:
            return
        stamp = (state.st_mtime_ns, state.st_ino)
        if stamp == self._stamp:
            return
        self._said = json.loads((self._folder / "film.json").read_bytes())
        self._frames = np.load(self._folder / "frames.npy", allow_pickle=False)
        self._stamp = stamp

    @property
    def version(self) -> int:
        """Version of what was found; 0 for other estimations."""
        return int(self._said.get("version", 0))

    def describe(self) -> dict[str, Any]:
        """Describe all but tracks and pictures; ``film`` of a view tells whether its pictures are complete.

        Raises RefusedError if the estimation is not one from films.
        """
        if not self._said:
            raise RefusedError(404, "studio_films.not_from_films")
        views = [{**view, "film": view["ready"]} for view in self._said["views"]]
        return {**self._said, "views": views}

    def tracks(self, view: int, first: int, count: int) -> dict[str, Any]:
        """Return the people of a view in some frames: ``points`` base64 of (P, n, K, 2) int16 in 1/16384 of width and
        height, -32768 where not seen, and ``sure`` base64 of (P, n, K) uint8.

        Raises RefusedError if there is no such view, or people were not searched for yet.
        """
        self._check_view(view)
        try:
            points, sure = (
                np.load(self._folder / f"{name}-{view}.npy", mmap_mode="r", allow_pickle=False)
                for name in ("points", "sure")
            )
        except FileNotFoundError as error:
            raise RefusedError(404, "studio_films.nobody_yet") from error
        part = slice(first, first + min(count, 2000))  # in one answer
        return {
            "first": first,
            "people": points.shape[0],
            "frames": points[:, part].shape[1],
            "points": encode_array(points[:, part], "<i2"),
            "sure": encode_array(sure[:, part], "u1"),
        }

    def picture(self, view: int, frame: int) -> bytes:
        """Return the JPEG of a view at a common moment; RefusedError if there is none."""
        self._check_view(view)
        if not 0 <= frame < self._frames.shape[1]:
            raise RefusedError(404, "studio_films.no_moment", frame=frame, count=self._frames.shape[1])
        content = self.find_picture(view, frame)
        if content is None:
            raise RefusedError(404, "studio_films.no_picture", view=self._said["views"][view]["name"])
        return content

    def find_picture(self, view: int, frame: int) -> bytes | None:
        """Return the JPEG of a view at a common moment; None if there is none."""
        film = self._said["views"][view]["film"] if self._said and view < len(self._said["views"]) else None
        if film is None or not 0 <= frame < self._frames.shape[1]:
            return None
        if view not in self._pictures:
            self._pictures[view] = FilmPictures(self._files / film)
        return self._pictures[view].read(int(self._frames[view, frame]))

    def _check_view(self, view: int) -> None:
        n_views = len(self.describe()["views"])
        if not 0 <= view < n_views:
            raise RefusedError(404, "studio_estimation.no_view", view=view, count=n_views)
