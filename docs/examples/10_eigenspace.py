"""The eigenspace of a figure.

The postures of one figure (furi) of a dance vary in a few directions only. A pupil's postures are compared with the
teacher's in that space (d*) and by their distance from it (d#).
"""

import matplotlib.pyplot as plt
import numpy as np

from dousa.evaluation import compute_distance_from_space, compute_postures, find_furi, fit_furi_eigenspaces
from dousa.motion import canonicalise
from dousa.motion.synthetic import Performer, draw_performer, make_dance

dance = compute_postures(canonicalise(make_dance(Performer("teacher")).motion))
pupil = compute_postures(canonicalise(make_dance(draw_performer(6)).motion))
figures = find_furi(dance)
spaces = fit_furi_eigenspaces(dance, figures)
for label, space in spaces.items():
    print(f"figure {label}: {space.n_dims} of 27 dimensions hold {space.contribution:.1%} of the variance")

label = max(spaces, key=lambda one: spaces[one].variances.sum())  # where most moves
space = spaces[label]
part = next(slice(one.start, one.end) for one in figures if one.label == label)
theirs, ours = space.align(dance.segments[part]), space.align(pupil.segments[part])

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for name, postures, colour in (("teacher", theirs, "#0072b2"), ("pupil", ours, "#d55e00")):
    left.plot(*space.project(postures)[:, :2].T, color=colour, label=name)
    distance = compute_distance_from_space(space, postures)
    right.plot(np.arange(len(distance)) / dance.frame_rate, distance, color=colour)
left.set(xlabel="first axis", ylabel="second axis", title=f"Figure {label} in its eigenspace")
left.legend()
right.set(xlabel="s", ylabel="d#", ylim=(0, None), title="Distance from the eigenspace")
figure.savefig("eigenspace.png", dpi=120)
