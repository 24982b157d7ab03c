"""Render silhouettes.

What would cameras around a person see of a motion? A body of rigid parts takes the poses of the motion and is drawn in
every view; `spoil` adds the faults of real silhouettes: holes, ragged edges, specks.
"""

import matplotlib.pyplot as plt
import numpy as np

from dousa.estimation import body_from_motion, make_ring, poses_from_motion, render, spoil
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion

motion = make_motion("kick_left", draw_performer(8))
body = body_from_motion(canonicalise(motion))
poses = poses_from_motion(body, motion)[20:60:5]
cameras = make_ring(4)
clean = render(body, poses, cameras)
noisy = [spoil(view, np.random.default_rng(number)) for number, view in enumerate(clean)]
print(f"{len(poses)} frames, {len(cameras)} views of {cameras[0].width} x {cameras[0].height} pixels")

figure, grid = plt.subplots(2, 4, figsize=(9, 3.8), layout="constrained")
for column, camera in enumerate(cameras):
    for row, masks in enumerate((clean, noisy)):
        grid[row, column].imshow(masks[column][4], cmap="gray_r")
        grid[row, column].set(xticks=(), yticks=(), title=camera.name if row == 0 else "")
grid[0, 0].set_ylabel("rendered")
grid[1, 0].set_ylabel("spoiled")
figure.savefig("silhouettes.png", dpi=120)
