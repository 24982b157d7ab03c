"""Made sightings of people who walk about, as the follower would keep them."""

import numpy as np

from dousa.estimation.keypoints.people import SIGHTING

SIZE = 200.0  # px of a crop


def make_colours(number):
    """All of a person's pixels in one bin of colour, for each half."""
    colours = np.zeros(SIGHTING["colours"].shape)
    colours[0, number], colours[1, number + 7] = 1, 1
    return colours


def see(frame, stretch, x, y=300.0, colour=0, score=1.0, size=SIZE, ghost=False):
    """One sighting."""
    row = np.zeros((), SIGHTING)
    row["frame"], row["stretch"], row["score"] = frame, stretch, score
    shape = np.random.default_rng(5).normal(size=(33, 2)) * size / 8
    row["points"] = shape + np.array([x, y])
    row["visibility"] = 0.95
    row["crop"] = row["next_crop"] = (x, y, size, 0.0)
    row["colours"] = make_colours(colour)
    row["mask"] = 255 * (not ghost)
    return row


def collect(rows):
    """Sightings in the order of time."""
    return np.array(sorted(rows, key=lambda row: int(row["frame"])), SIGHTING)
