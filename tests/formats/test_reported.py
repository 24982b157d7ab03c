"""Files of problems that people reported, and the smallest ones of attacks: each comes out as its README says."""

import numpy as np
import pytest

from dousa.errors import DousaError
from dousa.formats.registry import read_motion
from dousa.motion import Motion, canonicalise, compute_trajectories

REPORTED = {  # frames, rate in Hz, and the codes of notes that must be there; or the code of the error
    "bvh_frame_time_is_a_rate/rate.bvh": (8, 24, {"guard.rate_is_time"}),
    "bvh_positions_all_zero/zero.bvh": (8, 30, {"guard.empty_places"}),
    "csv_of_prefixed_markers/subject.trc": (12, 30, set()),
    "easymocap_keypoints3d/keypoints3d": (30, 30, {"arrays.assumed_rate"}),
    "easymocap_smpl/smpl": (3, 30, {"smpl.mean_body"}),
    "glb_mesh_only/statue.glb": "gltf.no_joints",
    "glb_meshopt/packed.glb": "gltf.extension",
    "glb_several_animations/moves.glb": (40, 15, {"parts.animation"}),
    "kinect_and_freemocap_tables/azure.csv": (20, 30, set()),
    "kinect_and_freemocap_tables/azure_offline_processor.json": (20, 30, set()),
    "kinect_and_freemocap_tables/mediapipe_body_3d_xyz.csv": (20, 30, {"arrays.assumed_rate"}),
    "kinect_and_freemocap_tables/nexus.csv": (20, 30, set()),
    "mvnx_without_joints/without.mvnx": (8, 30, set()),
    "text_to_motion/results.npy": (20, 20, {"parts.animation", "arrays.text"}),
    "text_to_motion/sample.npy": (20, 20, set()),
    "text_to_motion/with_scores.npy": (20, 20, set()),
}
FAULTS = {
    "csv/cut.csv": (48, 30, {"guard.frame_count"}),
    "csv/cutnum.csv": (73, 30, {"guard.frame_count"}),
    "csv/dup.csv": (74, 30, {"guard.repeated_rows"}),
    "csv/gap.csv": (74, 30, {"guard.gaps"}),
    "csv/order.csv": (74, 30, {"guard.exchanged_rows"}),
    "glb_c3d/x.c3d": (72, 30, {"guard.frame_count"}),
    **{f"glb_c3d/silent{n}.c3d": (74, 30, {"guard.bytes_over"}) for n in range(1, 5)},
    **{f"glb_c3d/silent{n}.glb": "gltf.surplus" for n in range(1, 5)},
    "offset/base.trc": (68, 30, set()),
    **{f"offset/{name}.trc": (68, 30, {"guard.shifted"}) for name in ("off5e5", "off4e6", "e7")},
}


@pytest.mark.parametrize(
    ("folder", "name"), [("reported", name) for name in REPORTED] + [("faults", name) for name in FAULTS]
)
def test_a_file_comes_out_as_its_readme_says(shared_data, folder, name):
    expected = (REPORTED | FAULTS)[name]
    path = shared_data(f"{folder}/{name}")
    if isinstance(expected, str):
        with pytest.raises(DousaError) as caught:
            read_motion(path)
        assert caught.value.code == expected
        return
    motion = read_motion(path)
    frames, rate, codes = expected
    assert (motion.n_frames, motion.frame_rate) == (frames, pytest.approx(rate, rel=1e-3))
    assert codes <= {note.code for note in motion.provenance.notes}
    points = compute_trajectories(motion) if isinstance(motion, Motion) else motion
    body = canonicalise(motion)
    assert 1.3 < body.height < 1.8 and not body.absent
    if name.startswith("offset"):
        base = read_motion(path.with_name("base.trc")).positions
        np.testing.assert_allclose(
            np.diff(points.positions, axis=0), np.diff(base, axis=0), atol=2e-6
        )  # written to the micrometre
