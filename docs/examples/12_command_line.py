"""Use the command line.

The same work without Python: the commands below are what you would type. Every answer can also be had as JSON
(`--json`), and `plot` draws a contact sheet of any motion file.
"""

import subprocess
from pathlib import Path

import dousa
from dousa.motion.synthetic import draw_performer, make_library, make_motion

categories = ("clap", "kick_left", "squat", "walk")
for category, performer, _, motion in make_library(n_performers=6, categories=categories):
    path = Path("motions", category, f"{performer.name}.bvh")
    path.parent.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, path)
dousa.write_motion(make_motion("squat", draw_performer(99)), "new.bvh")

for command in (
    "dousa add moves.dousa motions",
    "dousa train moves.dousa",
    "dousa search moves.dousa new.bvh -k 3",
    "dousa convert new.bvh new.c3d",
    "dousa plot new.bvh -o sheet.png",
):
    print("$", command)
    print(subprocess.run(command.split(), capture_output=True, text=True, check=True).stdout)
