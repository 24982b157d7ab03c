"""Background subtraction: learns the scene without the person, and finds the pixels of a frame that differ from it.

- ``plate``: an image of the empty scene, shifted and fitted in exposure to the video. Static areas take the video's
  median, so the plate counts only where a person moves; see `_choose_sources` where it shows a person itself.
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
from dousa.extras import cv2
from dousa.messages import Message

BackgroundMethod = Literal["plate", "median", "mog2"]
FloatImage = NDArray[np.float32]

_DIFFERS = 30.0  # grey levels between video and plate that are another surface, see docs/silhouettes.md
_AROUND = np.ones((3, 3), np.uint8)  # a pixel and its neighbours, by definition of a square grid


def _propagate(
    sources: FloatImage, prices: FloatImage, open_pixels: Mask, known: FloatImage, rounds: int = 150
) -> NDArray[np.intp]:
    """Return labels (H, W) of least cost by ``rounds`` of min-sum belief propagation on the grid."""
    unary = np.where(open_pixels, prices, np.float32(0))
    sources = np.where(open_pixels[..., None], sources, known)
    across = _edge_costs(sources[:, :, :-1], sources[:, :, 1:], open_pixels[:, :-1] & open_pixels[:, 1:])
    down = _edge_costs(sources[:, :-1], sources[:, 1:], open_pixels[:-1] & open_pixels[1:])
    to_right, to_left, to_below, to_above = (np.zeros_like(unary) for _ in range(4))
    for _ in range(rounds):
        belief = unary + to_right + to_left + to_below + to_above
        sent = (
            (to_right[:, :, 1:], _message((belief - to_left)[:, :, :-1], across)),
            (to_left[:, :, :-1], _message((belief - to_right)[:, :, 1:], across.swapaxes(0, 1))),
            (to_below[:, 1:], _message((belief - to_above)[:, :-1], down)),
            (to_above[:, :-1], _message((belief - to_below)[:, 1:], down.swapaxes(0, 1))),
        )
        for place, message in sent:  # half old, half new: it settles instead of swinging
            place[...] = 0.5 * (place + message)
    return np.asarray((unary + to_right + to_left + to_below + to_above).argmin(axis=0))


def _edge_costs(
    one: FloatImage, other: FloatImage, both_open: Mask, limit: float = 60.0, seen: float = 0.1
) -> FloatImage:
    """Compute costs (3, 3, H, W) in grey levels of edges between neighbours by the sources of both, at most ``limit``.

    Edges inside the plate are its own and free; of those inside a colour of the video the share ``seen`` counts.
    """
    costs = np.minimum(np.abs(one[:, None] - other[None]).max(axis=4), np.float32(limit))
    for label in range(len(one)):
        costs[label, label][both_open] *= 0.0 if label == 0 else seen
    return np.asarray(costs)


def _message(sender: FloatImage, costs: FloatImage) -> FloatImage:
    message = (sender[:, None] + costs).min(axis=0)
    return np.asarray(message - message.min(axis=0), np.float32)


def smooth_image(image: NDArray[Any], small: int = 800) -> NDArray[Any]:
    """Remove the noise of single pixels, more in an image of over ``small`` px, which shows that of the sensor.

    Use it on frames and background, or their edges differ.
    """
    side = 3 if max(image.shape) <= small else 5
    return np.asarray(cv2.GaussianBlur(image, (side, side), 0))


def _complete_plate(
    smooth: NDArray[np.uint8],
    median: FloatImage,
    moving: Mask,
    plate: Image,
    warnings: list[Message],
    agree: float = 12.0,
    least_seen: float = 0.06,
) -> FloatImage:
    """Return the background (H, W, 3) from smoothed frames of a video, their median, and an image of the empty scene.

    It is the median where the video is static, the plate where a person moves, and the video's colours where the plate
    is wrong. Plate and video show the same surface where they differ by less than ``agree`` grey levels, in at least
    the share ``least_seen`` of the frames.
    """
    placed = _align(plate, median, moving, warnings)
    fitted = np.asarray(smooth_image(_fit_exposure(placed, median, moving, warnings)), np.float32)
    image = median.copy()
    stays = _standing_parts(median, fitted, moving)
    image[stays] = fitted[stays]
    rows, columns = np.nonzero(moving)
    if len(rows) == 0:
        warnings.append(Message("background.nothing_moves"))
        return fitted
    seen_sum = np.zeros((len(rows), 3), np.float32)
    count = np.zeros(len(rows), np.float32)
    own = fitted[rows, columns]
    for frame in smooth:
        colours = frame[rows, columns].astype(np.float32)
        agrees = np.abs(colours - own).max(axis=1) < agree
        seen_sum[agrees] += colours[agrees]
        count += agrees
    sure = count >= max(1.0, least_seen * len(smooth))
    image[rows[sure], columns[sure]] = seen_sum[sure] / count[sure, None]
    rows, columns = rows[~sure], columns[~sure]
    if len(rows) == 0:
        return image
    still = smooth[:, ~moving][:, ::97].astype(np.float32)
    noise = float(np.abs(still - np.median(still, axis=0)).max(axis=2).mean()) if still.size else 2.0
    return _choose_sources(smooth, image, fitted, noise, (rows, columns))


def _standing_parts(
    median: FloatImage, plate: FloatImage, moving: Mask, differs: float = _DIFFERS, least: float = 0.0003
) -> Mask:
    """Find parts of the moving person that stay, such as a foot.

    They differ from the plate by more than ``differs`` grey levels, touch moving pixels, have at least the share
    ``least`` of the image, and their outline is an edge of the video and not of the plate.
    """
    unlike = ((np.abs(median - plate).max(axis=2) > differs) & ~moving).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.morphologyEx(unlike, cv2.MORPH_OPEN, _AROUND))
    near = cv2.dilate(moving.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    edges = [_edges(image) for image in (median, plate)]
    found = np.zeros(moving.shape, bool)
    for part in range(1, count):
        there = labels == part
        if stats[part, cv2.CC_STAT_AREA] < least * moving.size or not (there & near).any():
            continue
        shape = there.astype(np.uint8)
        outline = _outline(shape)
        rim = outline & ~near
        surrounded = rim.sum() < 0.3 * outline.sum()
        if surrounded or edges[0][rim].mean() > 1.3 * edges[1][rim].mean():
            found |= cv2.dilate(shape, np.ones((5, 5), np.uint8)) > 0
    return found & ~moving


def _outline(shape: NDArray[np.uint8]) -> Mask:
    return np.asarray(cv2.dilate(shape, _AROUND) != cv2.erode(shape, _AROUND))


def _edges(image: FloatImage) -> FloatImage:
    """Compute the slope (H, W) in grey levels per pixel."""
    across, down = (cv2.Sobel(image, cv2.CV_32F, *axes, scale=0.125) for axes in ((1, 0), (0, 1)))
    return np.asarray(np.sqrt(across * across + down * down).max(axis=2), np.float32)


def _choose_sources(
    smooth: NDArray[np.uint8],
    image: FloatImage,
    plate: FloatImage,
    noise: float,
    where: tuple[NDArray[np.intp], NDArray[np.intp]],
    *,
    not_scenic: float = 12.0,
    wavering: float = 4.0,
    unusable: float = 1000.0,
    side: int = 240,
) -> FloatImage:
    """Return the background with the pixels filled in where the video never agreed with the plate.

    Each takes the plate or one of two frequent colours of the video, so that they and the edges between them cost least
    in an image of ``side`` px. Costs in grey levels: ``not_scenic`` of the plate where the video shows scenery,
    ``wavering`` of a colour that wavers twice as much as the scene, ``unusable`` of a second colour that is hardly
    seen.
    """
    colours, shares, spreads = _frequent_colours(smooth[:, where[0], where[1]].astype(np.float32))
    # A colour that stays within the noise of the scene is scenery; one that wavers is a standing person.
    wavers = np.clip(spreads / max(noise, 1.0) - 1.0, 0.0, 2.0)
    sources = np.stack((plate, image, image))
    costs = np.zeros(sources.shape[:3], np.float32)
    sources[1][where], sources[2][where] = colours
    costs[0][where] = ((wavers < 0.5) & (shares >= 0.15) & (shares <= 0.85)).any(axis=0)
    # Outlines of the person are mixed colours, and thin; one colour all the time may be either.
    costs[0] = not_scenic * cv2.erode(costs[0], _AROUND)
    costs[1][where] = 0.1 + wavering * wavers[0]
    costs[2][where] = np.where(shares[1] >= 0.08, 0.3 + wavering * wavers[1], unusable)
    height, width = image.shape[:2]
    open_pixels = np.zeros((height, width), bool)
    open_pixels[where] = True
    step = max(1, round(max(height, width) / side))
    size = (max(1, width // step), max(1, height // step))

    def shrink(array: FloatImage) -> FloatImage:
        return np.asarray(cv2.resize(array, size, interpolation=cv2.INTER_AREA), np.float32)

    share = shrink(open_pixels.astype(np.float32))
    weight, masked = share[..., None] + 1e-6, open_pixels[..., None]
    small = np.stack([shrink(np.where(masked, source, np.float32(0))) / weight for source in sources])
    around = shrink(np.where(masked, np.float32(0), image)) / (1 - share[..., None] + 1e-6)
    prices = np.stack([shrink(np.where(open_pixels, cost, np.float32(0))) / weight[..., 0] for cost in costs])
    chosen = _propagate(small, prices, share > 0.25, around).astype(np.uint8)
    labels = np.asarray(cv2.resize(chosen, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    price = np.take_along_axis(costs, labels[None].astype(np.intp), 0)[0]
    labels[price >= unusable] = 1
    filled = image.copy()
    filled[where] = sources[labels[where], where[0], where[1]]
    return filled


def _frequent_colours(
    colours: FloatImage, same: float = 10.0, other: float = 20.0
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Return the two most frequent colours (2, K, 3) of series (N, K, 3), their shares and spreads (2, K).

    Colours within ``same`` grey levels are one; the second is more than ``other`` from the first.
    """
    counts = np.zeros(colours.shape[:2], np.int32)
    for colour in colours:
        counts += np.abs(colours - colour).max(axis=2) < same
    pixels = np.arange(colours.shape[1])
    found, shares, spreads = [], [], []
    for _ in range(2):
        best = colours[counts.argmax(axis=0), pixels]
        distance = np.abs(colours - best).max(axis=2)
        members = distance < same
        weight = members.astype(np.float32)
        total = np.maximum(weight.sum(axis=0), 1.0)
        mean = np.einsum("nk,nkc->kc", weight, colours) / total[:, None]
        deviation = np.abs(colours - mean).max(axis=2)
        found.append(mean)
        shares.append(np.where(counts.max(axis=0) > 0, total / len(colours), 0.0))
        spreads.append((deviation * weight).sum(axis=0) / total)
        counts = np.where(distance <= other, 0, counts)
    return np.stack(found), np.stack(shares).astype(np.float32), np.stack(spreads).astype(np.float32)


def _align(plate: Image, median: FloatImage, moving: Mask, warnings: list[Message]) -> Image:
    """Return the plate placed on the video by an affine transform that moves it by at most 5 %.

    Enhanced correlation (Evangelidis and Psarakis 2008) over static pixels; a fit that is worse than none is dropped.
    """
    target = cv2.cvtColor(median.astype(np.uint8), cv2.COLOR_BGR2GRAY)
    source = cv2.cvtColor(plate, cv2.COLOR_BGR2GRAY)
    similar = np.abs(median - smooth_image(plate)).max(axis=2) < 60
    static = (~moving & similar).astype(np.uint8)
    warp = np.eye(2, 3, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)
    try:
        found = cv2.findTransformECC(target, source, warp, cv2.MOTION_AFFINE, criteria, static, 5)
        warp = np.asarray(found[1], np.float32)
    except cv2.error:  # it does not converge on images without texture
        return plate
    corners = np.array([[0, 0, 1], [plate.shape[1], 0, 1], [0, plate.shape[0], 1]], np.float32)
    moved = float(np.linalg.norm(corners @ warp.T - corners[:, :2], axis=1).max())
    if not moved <= 0.05 * max(plate.shape):
        return plate
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    placed = cv2.warpAffine(plate, warp, plate.shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    where = static > 0
    before, after = (float(np.abs(median[where] - smooth_image(image)[where]).mean()) for image in (plate, placed))
    if after >= before:
        return plate
    if moved > 0.004 * max(plate.shape):
        warnings.append(Message("background.plate_moved", pixels=moved))
    return np.asarray(placed, np.uint8)


def _fit_exposure(
    plate: Image,
    median: FloatImage,
    moving: Mask,
    warnings: list[Message],
    differs: float = _DIFFERS,
    least_alike: float = 0.4,
) -> FloatImage:
    """Return the plate with gain and offset of each colour fitted where plate and video agree.

    Warns where less than the share ``least_alike`` of the static scene differs by less than ``differs`` grey levels.
    """
    fitted = plate.astype(np.float32)
    usable = ~moving & (plate.max(axis=2) < 250) & (np.abs(median - fitted).max(axis=2) < 80)
    if usable.sum() < 0.05 * usable.size:
        warnings.append(Message("background.unlike"))
        return fitted
    step = max(1, int(usable.sum()) // 100_000)
    for channel in range(3):
        x = plate[..., channel][usable][::step].astype(np.float64)
        y = median[..., channel][usable][::step].astype(np.float64)
        gain, offset = _fit_line(x, y)
        if 0.4 <= gain <= 2.5:
            fitted[..., channel] = gain * fitted[..., channel] + offset
    similar = (np.abs(median - fitted).max(axis=2) < differs)[~moving].mean()
    if similar < least_alike:
        warnings.append(Message("background.unlike"))
    return np.clip(fitted, 0, 255)


def _fit_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Compute gain and offset by least squares, outliers left out in five rounds."""
    kept = np.ones(len(x), bool)
    gain, offset = 1.0, 0.0
    for _ in range(5):
        centre = x[kept].mean()
        spread = float(((x[kept] - centre) ** 2).sum())
        if spread < 1e-6:
            return 1.0, float(np.median(y - x))
        gain = float(((x[kept] - centre) * y[kept]).sum()) / spread
        offset = float(y[kept].mean() - gain * centre)
        rest = np.abs(y - gain * x - offset)
        kept = rest <= max(3.7 * float(np.median(rest)), 2.0)
    return gain, offset


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The scene without the person.

    Parameters
    ----------
    image : (H, W, 3) float32, blue, green, red in grey levels.
    noise : (H, W) float32, standard deviation of the static scene in grey levels.
    still : (H, W) bool, where nothing moved in the frames it was learnt on.
    mixture : the model of OpenCV for ``mog2``, else None.
    warnings : notes for the user.
    """

    image: FloatImage
    noise: FloatImage
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
    OptionError : unknown method, ``"plate"`` without a plate.
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
        image = _complete_plate(smooth, median, moving, plate, warnings)
    elif moving.mean() > 0.6:
        warnings.append(Message("background.all_moves"))
    if method == "mog2":
        mixture = cv2.createBackgroundSubtractorMOG2(history=len(samples), varThreshold=25, detectShadows=True)
        mixture.setBackgroundRatio(0.6)  # a colour seen in a fifth of the frames is the person
        for index in np.random.default_rng(0).permutation(len(samples)):  # in order of time the last pose would win
            mixture.apply(samples[index])
    return Background(image, noise, ~moving, mixture, tuple(warnings))


def _ellipse(share: float, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return a round structuring element of an odd size, a share of the image's longer side."""
    side = max(3, 2 * round(0.5 * share * max(shape[:2])) + 1)
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _movement(smooth: NDArray[np.uint8], median: FloatImage, least: float = 0.002) -> tuple[FloatImage, Mask]:
    """Compute the noise (H, W) of each pixel, and where at least the share ``least`` of the image moved."""
    deviation = np.stack([np.abs(frame - median).max(axis=2).astype(np.uint8) for frame in smooth])
    place = int(0.9 * (len(deviation) - 1))
    spread = np.partition(deviation, place, axis=0)[place]
    noise = (1.4826 * np.median(deviation, axis=0)).astype(np.float32)
    moving = (spread > 4 * np.median(spread) + 6).astype(np.uint8)
    moving = np.asarray(cv2.morphologyEx(moving, cv2.MORPH_OPEN, _ellipse(0.005, moving.shape)), np.uint8)
    moving = np.asarray(cv2.morphologyEx(moving, cv2.MORPH_CLOSE, _ellipse(0.016, moving.shape)), np.uint8)
    framed = cv2.copyMakeBorder(moving, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    cv2.floodFill(framed, None, (0, 0), 2)
    filled = (framed[1:-1, 1:-1] != 2).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(filled)
    kept = stats[:count, cv2.CC_STAT_AREA] > least * filled.size
    kept[0] = False
    grown = cv2.dilate(kept[labels].astype(np.uint8), _ellipse(0.009, moving.shape))
    there = np.asarray(grown, bool)
    if not there.all():  # where a person moved the spread is theirs, not the scene's
        noise[there] = np.median(noise[~there])
    return noise, there


def subtract_background(
    frame: Image, background: Background, *, threshold: float = 24.0, low: float = 9.0, shadow: float = 0.35
) -> Mask:
    """Return the pixels (H, W) of a frame that differ from the background, before cleaning.

    Parameters
    ----------
    frame : (H, W, 3) uint8, blue, green, red.
    background : of this view and size.
    threshold : grey levels that a fifth of a piece must exceed; more where the scene is noisy.
    low : grey levels to which the piece then extends.
    shadow : darkening in shares of the background that counts as shadow if the colour stays; 0 for none.
    """
    if background.mixture is not None:
        found = background.mixture.apply(frame, learningRate=0)
        mask = (found == 255).astype(np.uint8)  # 127 is shadow
        return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, _AROUND), bool)
    difference = _difference(frame, background, shadow)
    margin = np.clip(2.0 * (background.noise - 3.0), 0.0, 20.0)
    candidate = (difference > low + margin).astype(np.uint8)
    if max(frame.shape) >= 400:
        candidate = np.asarray(cv2.morphologyEx(candidate, cv2.MORPH_OPEN, _AROUND), np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(candidate, connectivity=8)
    strong = np.bincount(labels[difference > threshold + margin], minlength=count)
    kept = strong > 0.2 * stats[:, cv2.CC_STAT_AREA]
    kept[0] = False
    trimmed = _trim(kept[labels], difference).astype(np.uint8)
    # Cracks where the person has the colour of the background are closed.
    return np.asarray(cv2.morphologyEx(trimmed, cv2.MORPH_CLOSE, _ellipse(0.008, trimmed.shape)), bool)


def _difference(
    frame: Image, background: Background, shadow: float, dark: float = 30.0, highlight: float = 0.08
) -> FloatImage:
    """Compute the difference (H, W) of colour and brightness in grey levels, without shadow.

    What is darker than ``dark`` has no shadow, but dark clothes differ from it by little. Brightening up to the share
    ``highlight`` of the background is light, not a thing.
    """
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
        np.minimum(change + shadow * np.maximum(grey - dark, 0.0), 0.0),
        np.maximum(change - highlight * grey, 0.0),
    )
    return np.asarray(np.sqrt(colour + change * change))


def _exposure(image: FloatImage, background: Background) -> FloatImage:
    """Compute factors (3,) that match a frame's exposure to the background, from static pixels."""
    step = max(1, max(image.shape) // 100)
    part = (slice(None, None, step), slice(None, None, step))
    scene, values = background.image[part], image[part]
    usable = background.still[part] & (scene.min(axis=2) > 20) & (values.max(axis=2) < 250)
    if usable.sum() < 50:
        return np.ones(3, np.float32)
    factors = np.median(scene[usable] / np.maximum(values[usable], 1.0), axis=0)
    return np.asarray(np.clip(factors, 0.5, 2.0), np.float32)


def _trim(mask: Mask, difference: FloatImage) -> Mask:
    """Remove outermost pixels that differ by less than half of their neighbours' difference.

    A low threshold on smoothed images makes a figure up to a pixel fatter all round.
    """
    inner = cv2.erode(mask.astype(np.uint8), _AROUND, borderValue=1) > 0
    return np.asarray(mask & (inner | (difference >= 0.5 * cv2.dilate(difference, _AROUND))))


def fill_camouflage(mask: Mask, frame: Image, most: float = 0.08, weak_edge: float = 6.0) -> None:
    """Fill holes without an edge in the frame, in place: clothes before something of their colour.

    Parameters
    ----------
    mask : (H, W) bool, one person.
    frame : (H, W, 3) uint8.
    most : holes larger than this share of the person stay.
    weak_edge : grey levels per pixel; less is no edge.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).view(np.uint8), connectivity=4)
    if count <= 2:
        return
    area = float(mask.sum())
    height, width = mask.shape
    for hole in range(1, count):
        x, y, w, h, size = (int(value) for value in stats[hole])
        if size > most * area or x < 2 or y < 2 or x + w > width - 2 or y + h > height - 2:
            continue
        part = (slice(y - 2, y + h + 2), slice(x - 2, x + w + 2))
        inside = (labels[part] == hole).astype(np.uint8)
        slope = _edges(frame[part].astype(np.float32))
        if np.mean(slope[_outline(inside)] < weak_edge) > 0.5:
            mask[part] |= inside > 0
