"""Script ``python usd_job.py IN OUT.npz [N]`` for its own process: damaged files can crash usd-core, which is C++.

Needs numpy and usd-core, and nothing of dousa. Writes skeleton N (from 0, by default 0) of those that are animated,
else of all:

names (J,) text, parents (J,), rest (J, 4, 4) and frames (T, J, 4, 4): from joint to world, for row vectors, in the
units and axes of the stage; rate (1,) Hz, unit (1,) m, up (1,) text, people (N,) names of the skeletons to choose from.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import numpy as np


def _limit_memory(size: int, least: int = 12 << 30) -> None:
    """Limit the memory to ``least`` bytes and 50 times the size of the file."""
    try:
        resource: Any = importlib.import_module("resource")
        most = least + 50 * size
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, AttributeError, ValueError, OSError):  # not on this system
        return


def _fail(code: str) -> None:
    print(f"code {code}")
    sys.exit(4)


def _list_skeletons(usd: Any, skel: Any, stage: Any) -> list[tuple[Any, Any]]:
    """(skeleton, its query), of all below a SkelRoot."""
    cache = skel.Cache()
    found = []
    for prim in stage.Traverse():
        if prim.IsA(skel.Root):
            root = skel.Root(prim)
            cache.Populate(root, usd.PrimDefaultPredicate)
            for inner in usd.PrimRange(prim):
                if inner.IsA(skel.Skeleton):
                    query = cache.GetSkelQuery(skel.Skeleton(inner))
                    if query and len(query.GetJointOrder()):
                        found.append((inner, query))
    return found


def _sample_times(query: Any) -> list[float]:
    animation = query.GetAnimQuery()
    return sorted(animation.GetJointTransformTimeSamples()) if animation else []


def _choose_times(samples: list[float], per_second: float, most: int = 1_000_000) -> tuple[np.ndarray, float]:
    """Even times that meet the samples, and the rate in Hz."""
    if len(samples) < 2:
        return np.array(samples or [0.0]), per_second
    steps = np.diff(samples)
    step = float(np.median(steps[steps > 1e-6])) if (steps > 1e-6).any() else 1.0
    count = round((samples[-1] - samples[0]) / step) + 1
    if count > most:
        _fail("usd.frames")
    return samples[0] + step * np.arange(count), per_second / step


def main() -> None:
    """Write the content of a stage."""
    source, target = sys.argv[1:3]
    chosen = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    _limit_memory(os.path.getsize(source))
    usd, skel, geom = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdSkel", "UsdGeom"))
    stage = usd.Stage.Open(source)
    skeletons = _list_skeletons(usd, skel, stage)
    if not skeletons:
        _fail("usd.no_skeleton")
    moving = [row for row in skeletons if len(_sample_times(row[1])) > 1]
    prim, query = (moving or skeletons)[chosen]
    if not query.GetAnimQuery():
        _fail("usd.no_animation")
    times, rate = _choose_times(_sample_times(query), stage.GetTimeCodesPerSecond())
    topology = query.GetTopology()
    count = len(query.GetJointOrder())
    if len(times) * count > 20_000_000:
        _fail("usd.frames")
    parents = [topology.GetParent(joint) for joint in range(count)]
    frames = np.empty((len(times), count, 4, 4))
    for number, time in enumerate(times):
        local = query.ComputeJointLocalTransforms(usd.TimeCode(time))
        if local is None or len(local) != count:
            _fail("usd.no_animation")
        world = np.array(geom.XformCache(usd.TimeCode(time)).GetLocalToWorldTransform(prim))
        frames[number] = _to_world(np.array(local).reshape(count, 4, 4), parents, world)
    skeleton = skel.Skeleton(prim)
    placed = np.array(geom.XformCache(usd.TimeCode(times[0])).GetLocalToWorldTransform(prim))
    bind = skeleton.GetBindTransformsAttr().Get()
    rest = skeleton.GetRestTransformsAttr().Get()
    if bind is not None and len(bind) == count:
        at_rest = np.array(bind).reshape(count, 4, 4) @ placed
    elif rest is not None and len(rest) == count:
        at_rest = _to_world(np.array(rest).reshape(count, 4, 4), parents, placed)
    else:
        at_rest = frames[0]
    np.savez(
        target, names=np.array([str(name) for name in query.GetJointOrder()]), parents=np.array(parents, np.int64),
        rest=at_rest, frames=frames, rate=np.array([rate], float),
        people=np.array([_name(row[0]) for row in moving or skeletons]),
        unit=np.array([geom.GetStageMetersPerUnit(stage)], float), up=np.array([str(geom.GetStageUpAxis(stage))]),
    )  # fmt: skip


def _name(prim: Any) -> str:
    """Name of the SkelRoot above, which is the character's; that of the skeleton may be any."""
    return str(prim.GetParent().GetName() or prim.GetName())


def _to_world(local: np.ndarray, parents: list[int], world: np.ndarray) -> np.ndarray:
    placed = np.empty_like(local)
    for joint, parent in enumerate(parents):
        placed[joint] = local[joint] @ (placed[parent] if 0 <= parent < joint else world)
    return placed


if __name__ == "__main__":
    main()
