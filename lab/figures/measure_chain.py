"""The chain of docs/tutorial.md on real silhouettes: film -> motion -> which figure -> grade, measured.

    python -m lab.figures.measure_chain ../shared/data/utd_mhad [-o FOLDER] [--people 1,3,5,7] [--start told|found]

For each person and action of UTD-MHAD the silhouettes of one camera are estimated, the motion is asked for in libraries
of the other people, and graded against another person's takes of the same action and of others; the same for the
Kinect's own skeleton. ``--start told``: first pose and limbs are told from the skeleton; ``found``: the stature alone.
What was made stays in FOLDER, and the same command goes on where it was stopped: empty the folder after a change of
dousa. Prints tables in Markdown. All four people took 22 minutes on two busy cores; the first alone takes most of that,
for the libraries, which the others share.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from dousa.app.output import progress_bar
from lab.figures.measured_chain import LIBRARIES, PEOPLE, STARTS, Chain, list_steps, measure_clip

Row = dict[str, Any]

_TITLES = {
    "skeletons": "the others' skeletons",
    "rendered": "the others' skeletons, seen by this camera and estimated",
    "filmed": "the others' silhouettes, estimated",
}
_REFERENCES = {"skeletons": "takes by the Kinect", "filmed": "film, estimated"}
_GRADED = (("estimate", "skeletons"), ("estimate", "filmed"), ("skeleton", "skeletons"))
_QUERIES = {"estimate": "**estimated from one view**", "skeleton": "the Kinect's skeleton"}


def main() -> None:
    """Read the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with the folders silhouette and skeleton")
    parser.add_argument("-o", "--output", type=Path, default=Path("chain-output"), metavar="FOLDER")
    parser.add_argument("--people", default="1", help="with commas; default: 1")
    parser.add_argument("--trials", default="1", help="1, 2, or 1,2; default: 1")
    parser.add_argument("--start", choices=STARTS, default="told")
    parser.add_argument("--actions", help="names of folders, with commas; all by default")
    parser.add_argument("--wrong", type=int, default=8, help="other actions each motion is graded against")
    given = parser.parse_args()
    actions = given.actions or ",".join(sorted(path.name for path in (given.folder / "silhouette").glob("*")))
    chain = Chain(given.folder, given.output, tuple(given.trials.split(",")), tuple(actions.split(",")), given.wrong)
    people = [one for one in PEOPLE if one in given.people.split(",")]
    if not chain.clips(people):
        raise SystemExit(
            f"{given.folder}: expected silhouette/ACTION/aNN_sN_tN.npz of the people {given.people}, found none"
        )
    rows = run(chain, people, given.start)
    print(f"{len(rows)} clips of {len(people)} of {len(PEOPLE)} people, start {given.start}\n")
    print_figures(rows)
    print_grades(rows)
    print_tendencies(rows)
    print_actions(rows)


def run(chain: Chain, people: Sequence[str], start: str) -> list[Row]:
    """All steps under a progress bar, then the answers."""
    steps = list(list_steps(chain, people, start))
    with progress_bar() as progress:
        for done, (what, step) in enumerate(steps):
            progress(done, len(steps), what)
            step()
    return [measure_clip(chain, clip, start) for clip in chain.clips(people)]


def print_figures(rows: Sequence[Row]) -> None:
    """How often the figure is told, by library and query."""
    print("| library | asked for | first | of the first three | nearest clip | said known | right of those |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for kind in LIBRARIES:
        for query, title in _QUERIES.items():
            found = [(row["action"], row[query][kind]) for row in rows]
            said = [(action, one) for action, one in found if one["category"] is not None]
            right = sum(one["category"] == action for action, one in said)
            cells = (
                _share(found, lambda action, one: one["guess"] == action),
                _share(found, lambda action, one: one["rank"] <= 3),
                _share(found, lambda action, one: one["nearest"][0] == action),
            )
            print(f"| {_TITLES[kind]} | {title} |", " | ".join(cells), f"| {len(said)} | {right} |")
    print()


def _share(found: Sequence[tuple[str, Row]], is_right: Callable[[str, Row], bool]) -> str:
    return f"{np.mean([is_right(action, one) for action, one in found]):.2f}"


def print_grades(rows: Sequence[Row]) -> None:
    """Grades against another person's takes of the right figure and of wrong ones."""
    print(
        "| graded | against another person's | grade: right figure | wrong figures | degrees off: right figure "
        "| wrong figures | right beats wrong, by grade | by degrees | of less than half of the frames |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for query, reference in _GRADED:
        graded = [row[query]["grades"][reference] for row in rows]
        cells = []
        for key in ("grade", "off"):
            right = [one["right"][key] for one in graded]
            wrong = [other[key] for one in graded for other in one["wrong"].values()]
            cells += [f"{np.median(right):.0f}", f"{np.median(wrong):.0f}" if wrong else "-"]
        cells += [f"{compare(graded, key, sign):.2f}" for key, sign in (("grade", 1.0), ("off", -1.0))]
        little = sum(one["right"]["compared"] < 0.5 for one in graded)
        print(f"| {_QUERIES[query]} | {_REFERENCES[reference]} |", " | ".join(cells), f"| {little} |")
    print()


def compare(graded: Sequence[Row], key: str, sign: float) -> float:
    """Share of wrong figures that the right one beats, equals counting half: 0.5 is chance."""
    scores = []
    for one in graded:
        ahead = [np.sign(sign * (one["right"][key] - other[key])) for other in one["wrong"].values()]
        if ahead:
            scores.append(0.5 + 0.5 * np.mean(ahead))
    return float(np.mean(scores)) if scores else float("nan")


def print_tendencies(rows: Sequence[Row]) -> None:
    """What is said most often, and whether the place of the true figure has to do with how somebody moves."""
    places = {kind: [row["estimate"][kind]["rank"] for row in rows] for kind in LIBRARIES}
    for kind in LIBRARIES:
        guesses = Counter(row["estimate"][kind]["guess"] for row in rows).most_common(1)[0]
        ways = [(name, [row["moves"][name] for row in rows]) for name in ("across", "depth", "travel")]
        cells = ", ".join(f"{name} {correlate(way, places[kind]):+.2f}" for name, way in ways)
        print(f"{kind}: said most often {guesses[0]} ({guesses[1]}); rank correlation of the place with {cells}")
    leans = [f"{np.mean([row[query]['lean'] for row in rows]):.0f}" for query in _QUERIES]
    print(f"leaning towards or away from the camera, degrees: estimates {leans[0]}, skeletons {leans[1]}\n")


def correlate(ways: Sequence[float], places: Sequence[int]) -> float:
    """Rank correlation; nan where all are alike."""
    if np.ptp(ways) == 0 or np.ptp(places) == 0:
        return float("nan")
    return float(spearmanr(ways, places)[0])


def print_actions(rows: Sequence[Row]) -> None:
    """Action by action: places of the true one for each person, degrees off, and how far the body moves."""
    print(
        "| action | place: skeletons | rendered | filmed | off, deg: estimate | skeleton | across, depth, travel, m |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    actions = sorted({row["action"] for row in rows})
    grouped = [[row for row in rows if row["action"] == action] for action in actions]
    grouped.sort(key=lambda own: np.mean([np.log(row["estimate"]["rendered"]["rank"]) for row in own]))
    for own in grouped:
        places = [" ".join(str(row["estimate"][kind]["rank"]) for row in own) for kind in LIBRARIES]
        off = [np.mean([row[query]["grades"]["skeletons"]["right"]["off"] for row in own]) for query in _QUERIES]
        ways = [np.mean([row["moves"][name] for row in own]) for name in ("across", "depth", "travel")]
        cells = [*places, *(f"{value:.0f}" for value in off), " ".join(f"{way:.2f}" for way in ways)]
        print(f"| {own[0]['action']} |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
