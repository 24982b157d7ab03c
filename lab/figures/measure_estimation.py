"""Measurements of docs/estimation.md that no command of dousa makes: silhouettes of real people.

    python -m lab.figures.measure_estimation kinect FOLDER [--start kinect|auto] [--quick] [--cache FOLDER]
    python -m lab.figures.measure_estimation retrieval FOLDER [--start kinect|auto] [--quick] [--cache FOLDER]
    python -m lab.figures.measure_estimation video FOLDER [--start reference|auto] [--cache FOLDER]
    python -m lab.figures.measure_estimation films FOLDER [--models heavy,full] [--views 4,2,1]
    python -m lab.figures.measure_estimation project FOLDER [--model full] [--keypoints FOLDER]
    python -m lab.figures.measure_estimation doubt FOLDER [--start auto|truth] [--views 4,2] [--variants clean,noisy]

``kinect`` tracks the silhouettes of UTD-MHAD, one view, and compares with the joints of the Kinect; ``retrieval``
classifies the motions so estimated by forests that were trained on skeletons of other people. ``video`` goes the whole
way from the four videos of the Pose2Sim demo and compares with its markerless reference. ``films`` does so
with nothing but the calibration, from keypoints; ``project`` does so by
the folder, as a user of Pose2Sim has it. ``--cache`` keeps what was
estimated: empty that folder after a change of the tracker. ``doubt`` compares what is said to be lost with the truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lab.figures.measured_doubt import measure_doubt
from lab.figures.measured_films import measure_films
from lab.figures.measured_kinect import list_clips, measure_kinect, measure_retrieval
from lab.figures.measured_project import measure_project
from lab.figures.measured_video import measure_video


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("kinect", "retrieval"):
        command = commands.add_parser(name)
        command.add_argument("folder", type=Path, help="with the folders silhouette and skeleton")
        command.add_argument("--start", choices=("kinect", "auto"), default="kinect")
        command.add_argument("--subjects", default="1,3,5,7")
        command.add_argument("--trials", default="1,2")
        command.add_argument("--actions", help="names of folders, with commas; all by default")
        command.add_argument("--quick", action="store_true", help="the first trial of one subject")
        command.add_argument("--cache", type=Path)
        command.add_argument("--rows", action="store_true", help="print every clip")
    video = commands.add_parser("video")
    video.add_argument("folder", type=Path)
    video.add_argument("--start", choices=("reference", "auto"), default="reference")
    video.add_argument("--cache", type=Path)
    video.add_argument("--views", default="1,2,3,4")
    video.add_argument("--pictures", type=Path, help="folder for an overlay video and a contact sheet")
    films = commands.add_parser("films")
    films.add_argument("folder", type=Path)
    films.add_argument("--models", default="heavy,full")
    films.add_argument("--views", default="4,2,1", help="how many at a time, with commas: every choice of so many")
    project = commands.add_parser("project")
    project.add_argument("folder", type=Path)
    project.add_argument("--model", default="full")
    project.add_argument("--keypoints", type=Path, help="of dousa keypoints -o; else they are found")
    doubt = commands.add_parser("doubt")
    doubt.add_argument("folder", type=Path, help="of clips with the truth")
    doubt.add_argument("--start", choices=("auto", "truth"), default="auto")
    doubt.add_argument("--views", default="4,2")
    doubt.add_argument("--variants", default="clean,noisy")
    given = parser.parse_args()
    if given.command == "doubt":
        views = [int(count) for count in given.views.split(",")]
        measure_doubt(given.folder, views, given.start, given.variants.split(","))
        return
    if given.command == "project":
        measure_project(given.folder, given.model, given.keypoints)
        return
    if given.command == "films":
        measure_films(given.folder, given.models.split(","), [int(count) for count in given.views.split(",")])
        return
    if given.command == "video":
        views = [int(view) for view in given.views.split(",")]
        measure_video(given.folder, given.start, views, given.cache, given.pictures)
        return
    subjects, trials = ("1", "1") if given.quick else (given.subjects, given.trials)
    if given.quick and given.command == "retrieval":
        subjects = given.subjects
    clips = list_clips(given.folder, subjects.split(","), trials.split(","), given.actions)
    if given.command == "kinect":
        measure_kinect(clips, given.start, given.cache, given.rows)
    else:
        measure_retrieval(given.folder, clips, given.start, given.cache)


if __name__ == "__main__":
    main()
