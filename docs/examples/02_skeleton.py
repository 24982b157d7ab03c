"""Draw the skeleton of a motion.

`canonicalise` gives the same 20 joints for every skeleton, found by name, by the shape of the tree or by the geometry
of the body. So a few lines draw any motion file.
"""

import matplotlib.pyplot as plt
import numpy as np

import dousa
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.synthetic import draw_performer, make_motion

person = dousa.canonicalise(make_motion("kick_left", draw_performer(8)))

figure, axes = plt.subplots(figsize=(9, 3.4), layout="constrained")
for place, frame in enumerate(np.linspace(0, person.n_frames - 1, 8).astype(int)):
    joints = person.positions[frame] - person.positions[frame, 0] * [1, 0, 1]  # the pelvis stays in place
    across = -joints[:, 2] + 1.1 * place  # seen from the performer's left
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            side = CANONICAL_JOINTS[joint].partition("_")[0]
            colour = {"left": "#0072b2", "right": "#d55e00"}.get(side, "#333333")
            axes.plot(across[[parent, joint]], joints[[parent, joint], 1], color=colour, lw=2.5)
    axes.text(1.1 * place, -0.15, f"{frame / person.frame_rate:.1f} s", ha="center")
axes.set(aspect="equal", title="A kick with the left leg (blue: left, orange: right)")
axes.axis("off")
figure.savefig("skeleton.png", dpi=120)
