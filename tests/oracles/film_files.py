"""Small films as files, with any time stamps and display matrix."""

from fractions import Fraction

import numpy as np
import pytest

av = pytest.importorskip("av", reason="PyAV is not installed (dousa[film])")

N_FRAMES = 24
MS = Fraction(1, 1000)


def write_film(path, times=None, size=(96, 64), codec="mpeg4"):
    """A film whose left half is dark and whose upper part is light, a frame at each time in ms."""
    times = list(range(0, N_FRAMES * 40, 40)) if times is None else times
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.time_base = MS
        for number, time in enumerate(times):
            picture = np.full((size[1], size[0], 3), 40, np.uint8)
            picture[: size[1] // 2, size[0] // 2 :] = 220
            picture[-8:, : 2 * number + 1] = 255
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = time, MS
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def turn_film(path, target, matrix):
    """The same film with another display matrix in its header."""
    data = bytearray(path.read_bytes())
    place = data.index(b"tkhd") + 4
    place += 40 if data[place] == 0 else 52
    for k, value in zip((0, 1, 3, 4), matrix, strict=True):
        data[place + 4 * k : place + 4 * k + 4] = int(value * 65536).to_bytes(4, "big", signed=True)
    target.write_bytes(bytes(data))
    return target
