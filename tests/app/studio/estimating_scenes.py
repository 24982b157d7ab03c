"""Small silhouettes for tests of estimation: a synthetic person, two cameras."""

from pathlib import Path

import numpy as np


def write_scene(path: Path, n_frames: int) -> Path:
    """Write an npz of silhouettes: jumping jacks forth and back, two views of 160 x 120."""
    from dousa.app.pipelines.render import render_file
    from dousa.app.requests.estimation import RenderRequest
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.performers import draw_performer, make_motion

    whole = make_motion("jumping_jack", draw_performer(10))
    order = np.concatenate((np.arange(10, 40), np.arange(40, 10, -1)))
    frames = np.resize(order, n_frames)
    motion = path.with_suffix(".bvh")
    write_motion(whole.replace(rotations=whole.rotations[frames], translations=whole.translations[frames]), motion)
    render_file(RenderRequest(motion, path, n_ring=2, size=(160, 120)))
    return path


def write_films(seen: Path, folder: Path, thing: tuple[slice, slice, int] | None = None) -> list[Path]:
    """Films of the silhouettes of an npz before a grey room, with pictures of the empty room and the calibration.

    Parameters
    ----------
    seen : of `write_scene`.
    folder : that takes the files.
    thing : rows, columns and the frame of something in the first film that is not in the picture of the empty room.
    """
    from dousa.estimation import read_cameras, read_silhouettes, write_cameras
    from dousa.extras import cv2

    silhouettes = read_silhouettes(seen)
    written = []
    for view, (name, (width, height)) in enumerate(zip(silhouettes.names, silhouettes.sizes, strict=True)):
        room = np.repeat(np.linspace(120, 180, width)[None], height, axis=0)[..., None].repeat(3, axis=2)
        room = room.astype(np.uint8)
        cv2.imwrite(str(folder / f"background_{name}.png"), room)
        path = folder / f"{name}.avi"
        film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), silhouettes.frame_rate, (width, height))
        for frame in range(silhouettes.n_frames):
            picture = room.copy()
            if view == 0 and thing is not None and frame == thing[2]:
                picture[thing[:2]] = (40, 60, 30)
            picture[silhouettes.read(frame)[view]] = (30, 30, 160)
            film.write(picture)
        film.release()
        written += [path, folder / f"background_{name}.png"]
    write_cameras(folder / "calibration.toml", read_cameras(seen))
    return [*written, folder / "calibration.toml"]
