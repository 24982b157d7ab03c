"""Label a long take.

An uncut recording is labelled from beginning to end; what is of no category of the library is called unknown.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dousa
from dousa.motion.synthetic import draw_performer, make_library, make_motion

categories = ("bow", "clap", "kick_left", "squat", "walk", "wave_left")
for category, performer, _, motion in make_library(n_performers=6, categories=categories):
    path = Path("motions", category, f"{performer.name}.bvh")
    path.parent.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, path)

done = (
    "walk",
    "clap",
    "jumping_jack",
    "kick_left",
    "wave_left",
    "squat",
)  # one of them is not in the library
clips = [dousa.compute_trajectories(make_motion(name, draw_performer(30))) for name in done]
joined = np.concatenate([clip.positions - clip.positions[0, 0] * [1, 0, 1] for clip in clips])
dousa.write_motion(dousa.Trajectories(clips[0].names, joined, 30.0), "take.c3d")
ends = np.cumsum([clip.n_frames for clip in clips]) / 30.0

with dousa.Library.open("moves.dousa", create=True) as library:
    library.add("motions")
    library.train()
    segments = library.label("take.c3d").timeline.segments
for part in segments:
    print(f"{part.start:5.1f} s to {part.stop:5.1f} s  {part.category or 'unknown'}")

figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
colours = dict(zip(categories, plt.get_cmap("tab10").colors, strict=False))
truth = zip(np.r_[0, ends[:-1]], ends, done, strict=True)
found = [(part.start, part.stop, part.category or "unknown") for part in segments]
for row, parts in enumerate((found, truth)):
    for start, end, name in parts:
        axes.barh(row, end - start, left=start, color=colours.get(name, "#cccccc"), edgecolor="white")
        if end - start > 0.8:
            axes.text((start + end) / 2, row, name.replace("_", "\n"), ha="center", va="center", fontsize=8)
axes.set(yticks=(0, 1), yticklabels=("labelled", "truth"), xlabel="s", title="What happens in take.c3d")
figure.savefig("timeline.png", dpi=120)
