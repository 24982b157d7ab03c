"""Estimate a motion from silhouettes.

The tracker knows the cameras, the silhouettes and the person's stature, nothing else. The true motion is known here, so
the picture shows how far the estimated joints are off.
"""

import matplotlib.pyplot as plt
import numpy as np

from dousa.estimation import (
    PackedSilhouettes,
    body_from_motion,
    estimate,
    make_human,
    make_ring,
    poses_from_motion,
    render,
)
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion.synthetic import draw_performer, make_motion

performer = draw_performer(8)
motion = make_motion("kick_left", performer)
person = canonicalise(motion)
body = body_from_motion(person)  # what the cameras see has the performer's own bones
cameras = make_ring(4)
silhouettes = PackedSilhouettes(render(body, poses_from_motion(body, motion), cameras), motion.frame_rate)

found = estimate(silhouettes, cameras, make_human(performer.stature))
shared = [name for name in found.points.names if name in CANONICAL_JOINTS]
estimated = found.points.positions[:, [found.points.names.index(name) for name in shared]]
true = person.positions[:, [CANONICAL_JOINTS.index(name) for name in shared]]
errors = np.linalg.norm(estimated - true, axis=2)
print(f"overlap with the silhouettes {np.nanmean(found.iou):.2f}, {found.lost.sum()} frames lost")
print(f"mean joint error {1000 * np.nanmean(errors):.0f} mm")

figure, axes = plt.subplots(figsize=(8, 3.4), layout="constrained")
seconds = np.arange(found.n_frames) / motion.frame_rate
axes.plot(seconds, 1000 * np.nanmean(errors, axis=1), color="#0072b2", label="mean of all joints")
axes.plot(seconds, 1000 * np.nanmax(errors, axis=1), color="#d55e00", label="worst joint")
axes.set(xlabel="s", ylabel="joint error, mm", ylim=(0, None), title="A kick estimated from four views")
axes.legend()
figure.savefig("errors.png", dpi=120)
