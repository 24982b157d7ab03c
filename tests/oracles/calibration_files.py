"""Calibration files as their programs write them, small enough to check by hand."""

import cv2
import numpy as np

from dousa.estimation.cameras.camera import Camera
from dousa.motion.rotations import from_axis_angle, to_matrix

Z_FROM_Y = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (z, x, y)

QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration type="regular" source="x">
  <cameras>
    <camera active="1" model="none" serial="21" viewrotation="0">
      <fov_video bottom="1979" left="10" right="1097" top="60"/>
      <transform r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0" x="100" y="-3000" z="1500"/>
      <intrinsic centerPointU="34816" centerPointV="61440" focalLengthU="107520" focalLengthV="106880"
        radialDistortion1="-0.04" radialDistortion2="0.1" radialDistortion3="0.01" sensorMaxU="76736"
        sensorMaxV="130944" sensorMinU="0.0" sensorMinV="0.0" skew="0.0" tangentalDistortion1="0.001"
        tangentalDistortion2="0.002"/>
    </camera>
    <camera active="0" serial="22"/>
  </cameras>
</calibration>
"""

POSE2SIM = """[cam_01]
name = "left"
size = [ 1088.0, 1920.0]
matrix = [ [ 1680.0, 0.0, 534.0], [ 0.0, 1670.0, 900.0], [ 0.0, 0.0, 1.0]]
distortions = [ -0.04, 0.1, 0.001, 0.002]
rotation = [ 1.2, 0.5, -0.4]
translation = [ 0.1, 0.9, 2.9]
fisheye = false

[metadata]
adjusted = false
error = 0.0
"""

ROS = """# written by hand
camera_name: left cam   # a comment
image_width: 640
image_height: 480
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 320,
         0, 510, 240,
         0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0.2, 0.01, 0.02, 0.3]}
R:
- [1, 0, 0]
- [0, -1, 0]
- [0, 0, -1]
T: [0.5, 1.0, 4.0]
"""


def write(folder, text, name="calibration"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def same_cameras(found, expected, atol=1e-9):
    assert [view.name for view in found] == [view.name for view in expected]
    for one, other in zip(found, expected, strict=True):
        assert (one.size, one.kind) == (other.size, other.kind)
        np.testing.assert_allclose(one.to_row(), other.to_row(), atol=atol, rtol=0)


def turned_view(name="cam01", vector=(0.3, 2.5, -0.2)):
    return Camera(
        name,
        1088,
        1920,
        np.array([[1680.5, 0.0, 533.25], [0.0, 1679.1, 948.7], [0.0, 0.0, 1.0]]),
        to_matrix(from_axis_angle(np.array(vector))),
        np.array([0.1, -0.7, 3.3]),
        np.array([-0.05, 0.14, 0.001, -0.0007, 0.0]),
    )


def write_opencv(path, view, pose="RT", size=True):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", 'Fri 01 May 2020 12:00:00 "noon"')
    if size:
        storage.write("image_width", view.width)
        storage.write("image_height", view.height)
    storage.write("camera_matrix", np.array(view.matrix))
    storage.write("distortion_coefficients", np.array(view.distortion).reshape(5, 1))
    vector = cv2.Rodrigues(view.rotation)[0]
    if pose == "RT":
        storage.write("R", np.array(view.rotation))
        storage.write("T", np.array(view.translation).reshape(3, 1))
    elif pose == "rvec":
        storage.write("rvec", vector)
        storage.write("tvec", np.array(view.translation).reshape(3, 1))
    elif pose == "matrix":
        storage.write("extrinsic_matrix", np.block([[view.rotation, view.translation[:, None]], [0, 0, 0, 1]]))
    elif pose == "board":
        storage.write("extrinsic_parameters", np.concatenate((vector.ravel(), view.translation))[None])
    elif pose == "boards":
        storage.write("extrinsic_parameters", np.zeros((7, 6)))
    storage.release()
