"""The 56 pose features, one at a time in plain Python, from their description."""

import math


def body_axes(pose):
    """Left, up and forward of a pose {joint: (x, y, z)} with a hip line that is not vertical."""
    x = pose["left_hip"][0] - pose["right_hip"][0]
    z = pose["left_hip"][2] - pose["right_hip"][2]
    length = math.hypot(x, z)
    left = (x / length, 0.0, z / length)
    up = (0.0, 1.0, 0.0)
    forward = (left[1] * up[2] - left[2] * up[1], left[2] * up[0] - left[0] * up[2], left[0] * up[1] - left[1] * up[0])
    return left, up, forward


def feature(description, pose, height):
    """One feature of one pose."""
    axes = body_axes(pose)
    if description.kind == "distance":
        one, other = description.joints
        return math.dist(pose[one], pose[other]) / height
    if description.kind == "position":
        joint, origin = description.joints
        vector = [a - b for a, b in zip(pose[joint], pose[origin], strict=True)]
        axis = axes[description.axis]
        return description.sign * sum(a * b for a, b in zip(vector, axis, strict=True)) / height
    base, tip = description.joints
    trunk = [b - a for a, b in zip(pose[base], pose[tip], strict=True)]
    cosine = sum(a * b for a, b in zip(trunk, axes[description.axis], strict=True)) / math.hypot(*trunk)
    angle = math.acos(max(-1.0, min(1.0, cosine)))
    return angle if description.axis == 1 else math.pi / 2 - angle
