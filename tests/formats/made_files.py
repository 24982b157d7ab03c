"""Small made files of the formats that dousa reads and does not write, for the tests and the fuzzer."""

import gzip
import io
import pickle
import zipfile
from typing import ClassVar

import joblib
import numpy as np
import pytest

from dousa.errors import MotionFileError
from dousa.formats.registry import read_motion

SEGMENTS = {"Pelvis": "", "L5": "Pelvis", "RightUpperLeg": "Pelvis", "RightLowerLeg": "RightUpperLeg"}
PLACES = np.array([[0, 0, 0.9], [0, 0, 1.0], [0, -0.1, 0.9], [0, -0.1, 0.5]])


def make_mvnx(n_frames=3, turn=0.0):
    """Four segments that stand still, the pelvis turned about Z by so many rad."""
    half = turn / 2
    turned = np.cos(half), 0.0, 0.0, np.sin(half)
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])

    def frame(kind, orientation, places):
        numbers = " ".join(f"{value:.9f}" for value in np.tile(orientation, len(SEGMENTS)))
        return (
            f'<frame time="0" type="{kind}"><orientation>{numbers}</orientation>'
            f"<position>{' '.join(f'{value:.9f}' for value in np.ravel(places))}</position></frame>"
        )

    labels = "".join(f'<segment label="{name}" id="1"><points/></segment>' for name in SEGMENTS)
    joints = "".join(
        f'<joint label="j"><connector1>{above}/j</connector1><connector2>{name}/j</connector2></joint>'
        for name, above in SEGMENTS.items()
        if above
    )
    frames = frame("identity", (1, 0, 0, 0), PLACES)
    frames += "".join(frame("normal", turned, PLACES @ matrix.T + (0.1 * n, 0, 0)) for n in range(n_frames))
    return (
        '<?xml version="1.0"?><mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">'
        '<subject label="a" frameRate="60" segmentCount="4">'
        f"<segments>{labels}</segments><joints>{joints}</joints><frames>{frames}</frames></subject></mvnx>"
    ).encode()


def make_qualisys():
    """Two markers, the second not seen in the second of three frames."""
    head = (
        "NO_OF_FRAMES\t3\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nNO_OF_ANALOG\t0\nDATA_INCLUDED\t3D\n"
        "MARKER_NAMES\tLASI\tRASI\n"
    )
    return (head + "1\t2\t900\t-1\t2\t901\n1.5\t2\t900\t0\t0\t0\n2\t2\t900\t-1\t2\t901\n").encode()


def make_qualisys_skeleton():
    """Hips and a leg, turned by half a turn about Z."""
    head = "NO_OF_FRAMES\t2\nFREQUENCY\t100\nREFERENCE\tGLOBAL\n"
    names = ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot")
    titles = "Frame\tTime\t" + "\t".join("\t".join((n, "X", "Y", "Z", "QX", "QY", "QZ", "QW")) for n in names)
    row = "\t".join("\t".join(("", "10", "20", str(1000 - 300 * k), "0", "0", "1", "0")) for k in range(4))
    return (head + titles + "\n" + "".join(f"{n}\t{n / 100}\t{row}\n" for n in (1, 2))).encode()


def make_motive(kind="Marker"):
    """Two markers of version 1.23, one blank cell."""
    return (
        "Format Version,1.23,Take Name,a,Capture Frame Rate,120.0,Export Frame Rate,120.0,Rotation Type,Quaternion,"
        "Length Units,Millimeters,Coordinate Space,Global\r\n\r\n"
        f",Type,{','.join([kind] * 6)}\r\n,Name,Bob:WaistL,Bob:WaistL,Bob:WaistL,Bob:Head,Bob:Head,Bob:Head\r\n"
        ",ID,1,1,1,2,2,2\r\n,,Position,Position,Position,Position,Position,Position\r\n"
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z\r\n0,0.0,1,1000,3,4,1700,6\r\n1,0.008333,1,1000,3,,,\r\n"
    ).encode()


def make_npy(points):
    """The bytes of an npy file."""
    packed = io.BytesIO()
    np.save(packed, points)
    return packed.getvalue()


def make_npz(**arrays):
    """The bytes of an npz file."""
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    return packed.getvalue()


def make_smpl(n_frames=4, n_joints=24, seed=0):
    """Arrays of poses: everything turned a little."""
    rng = np.random.default_rng(seed)
    return {"poses": 0.2 * rng.normal(size=(n_frames, 3 * n_joints)), "trans": rng.normal(size=(n_frames, 3))}


def make_aist(n_frames=4):
    """A pickle as AIST++ has them."""
    poses = make_smpl(n_frames)
    return pickle.dumps(
        {
            "smpl_poses": poses["poses"].astype(np.float32),
            "smpl_trans": (90 * poses["trans"]).astype(np.float32),
            "smpl_scaling": np.array([90.0], np.float32),
            "smpl_loss": 1.5,
        }
    )


def make_joblib(content, **options):
    """The bytes of a dump of joblib."""
    packed = io.BytesIO()
    joblib.dump(content, packed, **options)
    return packed.getvalue()


class _TorchPickler(pickle._Pickler):
    """Pickles arrays as torch pickles tensors: a function, and numbers that stand elsewhere under a key."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)

    def __init__(self, file):
        super().__init__(file, 2)
        self.storages = {}

    def save_tensor(self, array):
        key = str(len(self.storages))
        self.storages[key] = np.ascontiguousarray(array, np.float32)
        self.write(b"ctorch._utils\n_rebuild_tensor_v2\n(")
        self.write(pickle.MARK)
        self.save("storage")
        self.write(b"ctorch\nFloatStorage\n")
        for part in (key, "cuda:0", array.size):
            self.save(part)
        self.write(pickle.TUPLE + pickle.BINPERSID)
        for part in (0, array.shape, tuple(step // 4 for step in self.storages[key].strides), False, {}):
            self.save(part)
        self.write(pickle.TUPLE + pickle.REDUCE)

    dispatch[np.ndarray] = save_tensor


def make_torch(content):
    """The bytes of a file of torch.save, arrays as tensors of float32."""
    stream, packed = io.BytesIO(), io.BytesIO()
    pickler = _TorchPickler(stream)
    pickler.dump(content)
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("x/data.pkl", stream.getvalue())
        for key, array in pickler.storages.items():
            archive.writestr(f"x/data/{key}", array.tobytes())
    return packed.getvalue()


def make_mot(rows, rate=100.0, in_degrees="yes"):
    """A file of coordinates by name, each a list of values."""
    count = len(next(iter(rows.values())))
    rows = {"time": np.arange(count) / rate, **rows}
    table = "\n".join("\t".join(f"{value:.9f}" for value in row) for row in zip(*rows.values(), strict=True))
    head = f"Coordinates\nversion=1\nnRows={count}\nnColumns={len(rows)}\ninDegrees={in_degrees}\n\nendheader\n"
    return (head + "\t".join(rows) + "\n" + table + "\n").encode()


def pack_gzip(data):
    """The bytes of a gzip file, the same every time."""
    return gzip.compress(data, mtime=0)


def pack_zip(**files):
    """The bytes of a zip archive; in the names, ``__`` stands for a dot."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name.replace("__", "."), data)
    return packed.getvalue()


def save(path, data):
    """The path of a file that holds these bytes."""
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(data)
    return path


def code_of(path, **options):
    """The code of the error that reading a file ends in, which names the file."""
    with pytest.raises(MotionFileError) as caught:
        read_motion(path, **options)
    assert caught.value.path in (str(path), str(options.get("skeleton"))) and "\n" not in str(caught.value)
    return caught.value.code


def refused(path, data, code):
    """Whether a file of these bytes is refused with this code."""
    assert code_of(save(path, data)) == code
