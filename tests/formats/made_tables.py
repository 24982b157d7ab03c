"""Tables of points of a walking body as programs write them."""

import numpy as np

from formats import made_points as made

KINECT, MEDIAPIPE, SMPL = "Azure Kinect", made.MEDIAPIPE, "HumanML3D"


def names_of(title):
    return next(layout.names for layout in made.list_layouts() if layout.title == title)


def join(rows, mark=","):
    return "\n".join(mark.join(map(str, row)) for row in rows) + "\n"


def table(
    title, axis="{}_{}", mark=",", *, rate=50.0, scale=1.0, axes="xyz", before=(), points=None, columns=("time",)
):
    """Titles by a pattern, and rows of times or frame numbers and places."""
    places = made.make_points(title)[0] if points is None else points
    titles = [*columns, *(axis.format(name, letter) for name in names_of(title) for letter in axes)]
    clock = {"time": lambda n: f"{n / rate:.4f}", "Frame": lambda n: n, "time (ms)": lambda n: round(1000 * n / rate)}
    rows = [
        [*(clock[c](n) for c in columns), *np.round(scale * frame, 5).ravel()] for n, frame in enumerate(places)
    ]  # fmt: skip
    return join([*before, titles, *rows], mark)


def nexus(title, subject="Ann"):
    """Vicon Nexus: analog values first, then the section of the trajectories, of two parts of a frame each."""
    names = names_of(title)
    head = [
        ["Devices"], [1000], ["", "", "Force plate", "", ""], ["Frame", "Sub Frame", "Fx", "Fy", "Fz"],
        ["", "", "N", "N", "N"], [1, 0, 5, 6, 7], [1, 1, 5, 6, 7], [], ["Trajectories"], [100],
        ["", "", *(cell for name in names for cell in (f"{subject}:{name}", "", ""))],
        ["Frame", "Sub Frame", *"XYZ" * len(names)], ["", "", *["mm"] * (3 * len(names))],
    ]  # fmt: skip
    places = made.make_points(title)[0][..., [2, 0, 1]]
    return join([*head, *([n + 1, 0, *np.round(1000 * frame, 3).ravel()] for n, frame in enumerate(places))])


def long_table(title, mark=","):
    """A row for every point of a frame, as FreeMoCap's tidy tables."""
    rows = [
        [n, f"{n / 30:.5f}", name, *np.round(place, 5), model, 0.1]
        for n, frame in enumerate(made.make_points(title)[0])
        for model in ("mediapipe.body", "mediapipe.face")
        for name, place in zip(names_of(title), frame, strict=True)
    ]
    return join([["frame", "timestamp", "keypoint", "x", "y", "z", "model", "reprojection_error"], *rows], mark)


def two_rows(title):
    """DeepLabCut's three rows of titles, with names above every axis and a likelihood."""
    names, places = names_of(title), made.make_points(title)[0]
    head = [
        ["bodyparts", *(n for n in names for _ in range(4))],
        ["coords", *["x", "y", "z", "likelihood"] * len(names)],
    ]
    head.insert(0, ["scorer", *["model"] * (4 * len(names))])
    scored = np.concatenate((places, np.ones((*places.shape[:2], 1))), axis=2)
    return join([*head, *([n, *np.round(frame, 5).ravel()] for n, frame in enumerate(scored))])


def count_points(text):
    """The titles with numbers in the place of names."""
    titles, rest = text.split("\n", 1)
    cells = titles.split(",")
    return ",".join([cells[0], *(f"{cell[-1]}{n // 3}" for n, cell in enumerate(cells[1:]))]) + "\n" + rest


def visual3d(title):
    """The standard export of Visual3D: names above three other rows of titles, and the axes."""
    names, places = names_of(title), made.make_points(title)[0]
    wide = [n for n in names for _ in range(3)]
    head = [["", *cells] for cells in (["a.c3d"] * len(wide), wide, ["TARGET"] * len(wide), ["ORIGINAL"] * len(wide))]
    head.append(["ITEM", *"XYZ" * len(names)])
    return join([*head, *([n + 1, *np.round(frame, 5).ravel()] for n, frame in enumerate(places))], "\t")


def at_times_of_day(text):
    """The same table with dates and times for seconds."""
    head, *rows = text.strip().split("\n")
    cells = [row.split(",", 1) for row in rows]
    return "\n".join([head, *(f"2024-03-01 23:59:{58 + float(t):09.6f},{rest}" for t, rest in cells)]) + "\n"
