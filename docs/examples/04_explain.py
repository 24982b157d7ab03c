"""Explain an answer.

A forest can say why. Each reason is a relation of the body that its trees asked about; taking the relation away lowers
the vote for the category, and by how much is measured.
"""

import textwrap
from pathlib import Path

import matplotlib.pyplot as plt

import dousa
from dousa.motion.synthetic import draw_performer, make_library, make_motion

categories = ("clap", "kick_left", "march", "throw", "walk", "wave_left")
for category, performer, _, motion in make_library(n_performers=6, categories=categories):
    path = Path("motions", category, f"{performer.name}.bvh")
    path.parent.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, path)
dousa.write_motion(make_motion("wave_left", draw_performer(99)), "query.bvh")

with dousa.Library.open("moves.dousa", create=True) as library:
    library.add("motions")
    library.train()
    verdict = library.classify("query.bvh", explain=True)[0].verdict

explanation = verdict.explanation
print(f"{verdict.category}: {explanation.vote:.0%} of the trees")
for reason in explanation.reasons:
    print(f"- {reason.text} (without it {reason.vote_without:.0%})")

figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
names = ["all relations", *(textwrap.fill(f"without: {one.text}", 62) for one in explanation.reasons)]
votes = [explanation.vote, *(one.vote_without for one in explanation.reasons)]
axes.barh(names, votes, color=["#0072b2", *["#d55e00"] * len(explanation.reasons)])
axes.invert_yaxis()
axes.set(xlim=(0, 1), xlabel="share of the trees that vote for wave_left")
figure.savefig("explain.png", dpi=120)
