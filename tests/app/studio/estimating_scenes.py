"""Small silhouettes for tests of estimation: a synthetic person, two cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np

__all__ = ["write_scene"]


def write_scene(path: Path, n_frames: int) -> Path:
    """Write an npz of silhouettes: jumping jacks forth and back, two views of 160 x 120."""
    from dousa.app.pipelines.render import RenderRequest, render_file
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.performers import draw_performer, make_motion

    whole = make_motion("jumping_jack", draw_performer(10))
    order = np.concatenate((np.arange(10, 40), np.arange(40, 10, -1)))
    frames = np.resize(order, n_frames)
    motion = path.with_suffix(".bvh")
    write_motion(whole.replace(rotations=whole.rotations[frames], translations=whole.translations[frames]), motion)
    render_file(RenderRequest(motion, path, n_ring=2, size=(160, 120)))
    return path
