"""The correlation matrix of two dances.

How alike is every pose of one dance to every pose of another, whichever way the dancers face? The bright line is the
correspondence in time, found by dynamic time warping; where a figure comes again there are further bright lines.
"""

import matplotlib.pyplot as plt

from dousa.evaluation import compute_correlation_matrix, compute_postures, find_path
from dousa.motion import canonicalise
from dousa.motion.synthetic import Performer, draw_performer, make_dance

teacher = compute_postures(canonicalise(make_dance(Performer("teacher")).motion))
pupil = compute_postures(canonicalise(make_dance(draw_performer(6)).motion))
matrix = compute_correlation_matrix(teacher.segments, pupil.segments)
path = find_path(teacher.segments, pupil.segments)
alike = matrix[path[:, 0], path[:, 1]].mean()
print(f"{matrix.shape[0]} x {matrix.shape[1]} poses; along the path S is {alike:.3f} on average")

figure, axes = plt.subplots(figsize=(6, 5), layout="constrained")
extent = (0, pupil.duration, 0, teacher.duration)
image = axes.imshow(matrix, origin="lower", extent=extent, vmin=0.6, aspect="auto")
axes.plot(*path[:, ::-1].T / teacher.frame_rate, color="#ff8c3a", lw=1.5)
axes.set(xlabel="pupil, s", ylabel="teacher, s", title="How alike two poses are")
figure.colorbar(image, label="S")
figure.savefig("matrix.png", dpi=120)
