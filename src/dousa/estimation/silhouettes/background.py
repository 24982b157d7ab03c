"""Background subtraction: what the scene looks like without the person, and which pixels of a frame differ from it.

Three ways to know the background:

- ``plate``: an image of the empty scene, which may be from another moment. It is shifted and its exposure fitted to the
  video; where the video is static the video's own median is used, so the plate counts only where somebody moves; and
  where the plate shows somebody, the video's colours replace it if they are seen (see `choose_sources`).
- ``median``: the median over frames spread over the video. Fails where the person stays.
- ``mog2``: a mixture of Gaussians by pixel (Zivkovic 2004, as in OpenCV), learnt on the same frames.

The difference is split into brightness and colour (Horprasert, Harwood and Davis 1999): a surface in shadow keeps
its colour, so darkening alone counts only beyond ``shadow``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import Image, Mask
from dousa.errors import OptionError, SilhouetteError
from dousa.estimation.silhouettes.background_plate import complete_plate, smooth_image
from dousa.messages import Message

BackgroundMethod = Literal["plate", "median", "mog2"]

FloatImage = NDArray[np.float32]

_HALF = 0.5
_WEAK_EDGE = 6.0  # grey levels per pixel; less is no edge
_LEAST_MOVING = 0.002  # share of the image; smaller movements are noise
_DARK = 30.0  # grey level; what is darker has no real shadow, but dark clothes differ from it by little
_HIGHLIGHT = 0.08  # brightening in shares of the background that is light, not a thing


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The scene without the person.

    Parameters
    ----------
    image : (H, W, 3) float32, blue, green, red in grey levels.
    noise : (H, W) float32, standard deviation of the static scene in grey levels.
    still : (H, W) bool, where nothing moved in the frames it was learnt on.
    mixture : the model of OpenCV for ``mog2``, else None.
    warnings : what a person should know.
    """

    image: FloatImage
    noise: NDArray[np.float32]
    still: Mask
    mixture: Any = None
    warnings: tuple[Message, ...] = ()


def learn_background(
    samples: NDArray[np.uint8], method: BackgroundMethod = "median", plate: Image | None = None
) -> Background:
    """Learn the background of one view.

    Parameters
    ----------
    samples : (N, H, W, 3) uint8, frames spread over the video, blue, green, red; N >= 2.
    method : ``"plate"``, ``"median"`` or ``"mog2"``.
    plate : (H, W, 3) uint8, an image of the scene without the person; for ``"plate"``.

    Raises
    ------
    OptionError : a method that is none, ``"plate"`` without a plate.
    SilhouetteError : too few frames, images of another size.
    """
    if method not in ("plate", "median", "mog2"):
        raise OptionError("background.method", found=str(method))
    if samples.ndim != 4 or samples.shape[3] != 3 or len(samples) < 2:
        raise SilhouetteError("background.samples", found=str(samples.shape))
    if method == "plate" and plate is None:
        raise OptionError("background.no_plate")
    smooth = np.stack([smooth_image(frame) for frame in samples])
    median = np.median(smooth, axis=0).astype(np.float32)
    noise, moving = _movement(smooth, median)
    warnings: list[Message] = []
    image, mixture = median, None
    if method == "plate" and plate is not None:
        if plate.shape != samples.shape[1:]:
            raise SilhouetteError("background.plate_shape", expected=str(samples.shape[1:]), found=str(plate.shape))
        image = complete_plate(smooth, median, moving, plate, warnings)
    elif moving.mean() > 0.6:
        warnings.append(Message("background.all_moves"))
    if method == "mog2":
        mixture = _learn_mixture(samples)
    return Background(image, noise, ~moving, mixture, tuple(warnings))


def _ellipse(share: float, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """A round structuring element of an odd size that is a share of the image's longer side."""
    from dousa.extras import cv2

    side = max(3, 2 * round(0.5 * share * max(shape[:2])) + 1)
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _movement(smooth: NDArray[np.uint8], median: FloatImage) -> tuple[NDArray[np.float32], Mask]:
    """Noise (H, W) of each pixel, and whether something moved there."""
    from dousa.extras import cv2

    deviation = np.stack([np.abs(frame - median).max(axis=2).astype(np.uint8) for frame in smooth])
    spread = np.partition(deviation, int(0.9 * (len(deviation) - 1)), axis=0)[int(0.9 * (len(deviation) - 1))]
    noise = (1.4826 * np.median(deviation, axis=0)).astype(np.float32)
    moving = (spread > 4 * np.median(spread) + 6).astype(np.uint8)
    moving = np.asarray(cv2.morphologyEx(moving, cv2.MORPH_OPEN, _ellipse(0.005, moving.shape)), np.uint8)
    moving = np.asarray(cv2.morphologyEx(moving, cv2.MORPH_CLOSE, _ellipse(0.016, moving.shape)), np.uint8)
    framed = cv2.copyMakeBorder(moving, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    cv2.floodFill(framed, None, (0, 0), 2)
    filled = (framed[1:-1, 1:-1] != 2).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(filled)
    kept = stats[:count, cv2.CC_STAT_AREA] > _LEAST_MOVING * filled.size
    kept[0] = False
    grown = cv2.dilate(kept[labels].astype(np.uint8), _ellipse(0.009, moving.shape))
    there = np.asarray(grown, bool)
    if not there.all():  # where somebody moved the spread is theirs, not the scene's
        noise[there] = np.median(noise[~there])
    return noise, there


def _learn_mixture(samples: NDArray[np.uint8]) -> Any:
    from dousa.extras import cv2

    mixture = cv2.createBackgroundSubtractorMOG2(history=len(samples), varThreshold=25, detectShadows=True)
    mixture.setBackgroundRatio(0.6)  # a colour seen in a fifth of the frames is the person
    order = np.random.default_rng(0).permutation(len(samples))  # in order of time the last pose would win
    for index in order:
        mixture.apply(samples[index])
    return mixture


def subtract_background(
    frame: Image,
    background: Background,
    *,
    threshold: float = 24.0,
    low: float = 9.0,
    shadow: float = 0.35,
) -> Mask:
    """The pixels of a frame that differ from the background, before cleaning.

    Parameters
    ----------
    frame : (H, W, 3) uint8, blue, green, red.
    background : of this view and size.
    threshold : grey levels that a piece must reach somewhere; more where the scene is noisy.
    low : grey levels to which the piece then extends.
    shadow : darkening in shares of the background that counts as shadow as long as the colour stays; 0 for none.

    Returns
    -------
    (H, W) bool.
    """
    from dousa.extras import cv2

    if background.mixture is not None:
        found = background.mixture.apply(frame, learningRate=0)
        mask = (found == 255).astype(np.uint8)  # 127 is shadow
        return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), bool)
    difference = _difference(frame, background, shadow)
    margin = np.clip(2.0 * (background.noise - 3.0), 0.0, 20.0)
    candidate = (difference > low + margin).astype(np.uint8)
    if max(frame.shape) >= 400:
        candidate = np.asarray(cv2.morphologyEx(candidate, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(candidate, connectivity=8)
    strong = np.bincount(labels[difference > threshold + margin], minlength=count)
    kept = strong > 0.2 * stats[:, cv2.CC_STAT_AREA]
    kept[0] = False
    return _close(_trim(kept[labels], difference))


def _difference(frame: Image, background: Background, shadow: float) -> FloatImage:
    """Difference of colour and brightness in grey levels, shadow taken off, (H, W)."""
    image = smooth_image(frame).astype(np.float32)
    image *= _exposure(image, background)
    scene = background.image
    length = np.einsum("ijk,ijk->ij", scene, scene) + 1.0
    ratio = np.einsum("ijk,ijk->ij", image, scene) / length
    rest = image - ratio[..., None] * scene
    colour = np.einsum("ijk,ijk->ij", rest, rest)
    grey = np.sqrt(length / 3.0)
    change = (ratio - 1.0) * grey
    change = np.where(
        change < 0,
        np.minimum(change + shadow * np.maximum(grey - _DARK, 0.0), 0.0),
        np.maximum(change - _HIGHLIGHT * grey, 0.0),
    )
    return np.asarray(np.sqrt(colour + change * change))


def _exposure(image: FloatImage, background: Background) -> FloatImage:
    """Factors (3,) that give a frame the exposure of the background, from pixels that nobody hides."""
    step = max(1, max(image.shape) // 100)
    part = (slice(None, None, step), slice(None, None, step))
    scene, values = background.image[part], image[part]
    usable = background.still[part] & (scene.min(axis=2) > 20) & (values.max(axis=2) < 250)
    if usable.sum() < 50:
        return np.ones(3, np.float32)
    factors = np.median(scene[usable] / np.maximum(values[usable], 1.0), axis=0)
    return np.asarray(np.clip(factors, 0.5, 2.0), np.float32)


def _trim(mask: Mask, difference: FloatImage) -> Mask:
    """The outermost pixels go where they differ by less than half of what is beside them: they are mostly background.

    A low threshold on smoothed images makes a figure up to a pixel fatter all round.
    """
    from dousa.extras import cv2

    around = np.ones((3, 3), np.uint8)
    inner = cv2.erode(mask.astype(np.uint8), around, borderValue=1) > 0
    beside = cv2.dilate(difference, around)
    return np.asarray(mask & (inner | (difference >= _HALF * beside)))


def _close(mask: Mask) -> Mask:
    """Cracks where the person has the colour of the background are closed."""
    from dousa.extras import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _ellipse(0.008, mask.shape)), bool)


def fill_camouflage(mask: Mask, frame: Image, most: float = 0.08) -> None:
    """Fill holes whose rim is no edge in the frame, in place: clothes before something of their colour.

    A hole that is seen through, between an arm and the trunk, has an edge nearly all round.

    Parameters
    ----------
    mask : (H, W) bool, one person.
    frame : (H, W, 3) uint8.
    most : holes larger than this share of the person stay.
    """
    from dousa.extras import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).view(np.uint8), connectivity=4)
    if count <= 2:
        return
    area = float(mask.sum())
    height, width = mask.shape
    around = np.ones((3, 3), np.uint8)
    for hole in range(1, count):
        x, y, w, h, size = (int(value) for value in stats[hole])
        if size > most * area or x < 2 or y < 2 or x + w > width - 2 or y + h > height - 2:
            continue
        part = (slice(y - 2, y + h + 2), slice(x - 2, x + w + 2))
        inside = (labels[part] == hole).astype(np.uint8)
        rim = cv2.dilate(inside, around) != cv2.erode(inside, around)
        image = frame[part].astype(np.float32)
        across, down = (cv2.Sobel(image, cv2.CV_32F, *axes, scale=0.125) for axes in ((1, 0), (0, 1)))
        slope = np.sqrt(across * across + down * down).max(axis=2)
        if np.mean(slope[rim] < _WEAK_EDGE) > 0.5:
            mask[part] |= inside > 0
