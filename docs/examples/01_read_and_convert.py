"""Read a motion file and convert it.

Every reader returns metres with Y up and seconds, whatever the file says. A BVH file holds joint rotations, a C3D file
positions: converting one to the other is reading and writing.
"""

import matplotlib.pyplot as plt

import dousa
from dousa.motion.synthetic import draw_performer, make_motion

dousa.write_motion(make_motion("jumping_jack", draw_performer(4)), "jack.bvh")

motion = dousa.read_motion("jack.bvh")
print(f"jack.bvh: {len(motion.skeleton.names)} joints, {motion.n_frames} frames at {motion.frame_rate:g} Hz")

points = dousa.compute_trajectories(motion)  # positions of all joints
dousa.write_motion(points, "jack.c3d")
again = dousa.read_motion("jack.c3d")
print(f"jack.c3d: {len(again.names)} points, at most {abs(again.positions - points.positions).max():.1e} m off")

figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
seconds = [frame / again.frame_rate for frame in range(again.n_frames)]
for name in ("left_hand", "right_hand", "pelvis", "left_toe"):
    axes.plot(seconds, again.positions[:, again.names.index(name), 1], label=name.replace("_", " "))
axes.set(xlabel="s", ylabel="height, m", title="A jumping jack, read from jack.c3d")
axes.legend(loc="upper right", ncols=4)
figure.savefig("heights.png", dpi=120)
