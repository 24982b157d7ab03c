"""Build a library and search it.

The folders are the categories. `add` reads the files, `train` learns the categories, and `search` answers "what is like
this?" for a performer whom the library has never seen.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import dousa
from dousa.motion.synthetic import draw_performer, make_library, make_motion

categories = ("bow", "clap", "jump", "kick_left", "walk", "wave_left")
for category, performer, _, motion in make_library(n_performers=6, categories=categories):
    path = Path("motions", category, f"{performer.name}.bvh")
    path.parent.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, path)
dousa.write_motion(make_motion("kick_left", draw_performer(99)), "query.bvh")

with dousa.Library.open("moves.dousa", create=True) as library:
    library.add("motions")
    library.train()
    answer = library.search("query.bvh", k=12)

print("query.bvh is", answer.category)
for hit in answer.results[:7]:
    print(f"{hit.rank:3} {hit.rank_distance:6.3f}  {hit.category:10} {Path(hit.path).stem}")

figure, axes = plt.subplots(figsize=(8, 3.8), layout="constrained")
colours = ["#0072b2" if hit.category == "kick_left" else "#bbbbbb" for hit in answer.results]
names = [f"{hit.category}, {Path(hit.path).stem}" for hit in answer.results]
axes.barh(names, [hit.rank_distance for hit in answer.results], color=colours)
axes.invert_yaxis()
axes.set(xlabel="distance", title="What is like this kick? (blue: the six kicks of the library)")
figure.savefig("search.png", dpi=120)
