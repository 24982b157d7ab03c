"""Find a motion inside takes.

Where in a long recording is something like this? Takes are kept uncut beside the clips of a library, and searched
at half to twice the tempo of the query. Two of these three takes have a squat in them.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dousa
from dousa.motion.synthetic import draw_performer, make_library, make_motion

categories = ("bow", "clap", "squat", "walk", "wave_left")
for category, performer, _, motion in make_library(n_performers=6, categories=categories):
    path = Path("motions", category, f"{performer.name}.bvh")
    path.parent.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, path)
dousa.write_motion(make_motion("squat", draw_performer(60)), "query.bvh")

Path("takes").mkdir()
for person, done in ((12, "walk clap squat"), (20, "bow squat walk"), (30, "clap walk bow")):
    clips = [dousa.compute_trajectories(make_motion(name, draw_performer(person))) for name in done.split()]
    joined = np.concatenate([clip.positions - clip.positions[0, 0] * [1, 0, 1] for clip in clips])
    dousa.write_motion(dousa.Trajectories(clips[0].names, joined, 30.0), f"takes/{done}.c3d")

with dousa.Library.open("moves.dousa", create=True) as library:
    library.add("motions")
    library.train()
    library.add("takes", kind="take")
    places = library.find("query.bvh", k=3).results

figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
for place in places:
    name = Path(place.take).stem
    print(f"{place.score:.2f}  {name:15} {place.start:5.1f} s to {place.end:5.1f} s, tempo {place.tempo:.2f}")
    axes.barh(name, place.end - place.start, left=place.start, alpha=0.15 + 0.85 * place.score, color="#0072b2")
    axes.text((place.start + place.end) / 2, name, f"{place.score:.2f}", ha="center", va="center")
axes.set(xlabel="s", xlim=(0, None), title="Where is a squat? (score 0 to 1)")
figure.savefig("places.png", dpi=120)
