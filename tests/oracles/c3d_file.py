"""C3D files made byte by byte after the user guide, in every storage that exists; slow and literal."""

import struct

import numpy as np

INTEL, DEC, MIPS = 84, 85, 86


def pack_float(value, processor):
    """Four bytes of a 32-bit float."""
    if processor == MIPS:
        return struct.pack(">f", value)
    if processor == INTEL:
        return struct.pack("<f", value)
    # DEC: exponent two higher, the 16-bit halves change places.
    low, high = struct.unpack("<HH", struct.pack("<f", value * 4))
    return struct.pack("<HH", high, low)


def pack_word(value, processor):
    return struct.pack(">H" if processor == MIPS else "<H", value % 65_536)


def parameter(name, group, values, processor=INTEL, *, kind=None):
    """One parameter: texts, floats or integers by the type of the first value."""
    if kind is None:
        kind = -1 if isinstance(values[0], str) else (4 if isinstance(values[0], float) else 2)
    if kind == -1:
        length = max(map(len, values))
        axes, data = [length, len(values)], b"".join(text.ljust(length).encode("latin-1") for text in values)
    else:
        pack = pack_float if kind == 4 else pack_word
        axes = [] if len(values) == 1 else [len(values)]
        data = b"".join(pack(value, processor) for value in values)
    content = struct.pack("bB", kind, len(axes)) + bytes(axes) + data + b"\0"
    link = pack_word(len(content) + 2, processor)
    return struct.pack("bb", len(name), group) + name.encode() + link + content


def group(name, number, processor=INTEL):
    return struct.pack("bb", len(name), -number) + name.encode() + pack_word(3, processor) + b"\0"


def make_c3d(
    positions,
    labels,
    *,
    processor=INTEL,
    scale=-1.0,
    rate=50.0,
    missing=None,
    n_analog=0,
    extra=b"",
    units="mm",
    frames=None,
):
    """A whole file. positions (T, K, 3) as stored (integers where scale > 0); missing (T, K) bool."""
    n_frames, n_points = positions.shape[:2]
    section = bytes([1, 0x50, 0, processor]) + group("POINT", 1, processor)
    section += parameter("USED", 1, [n_points], processor)
    section += parameter("LABELS", 1, labels, processor)
    section += parameter("RATE", 1, [float(rate)], processor)
    section += parameter("SCALE", 1, [float(scale)], processor)
    section += parameter("UNITS", 1, [units], processor)
    section += parameter("FRAMES", 1, [n_frames if frames is None else frames], processor)
    section += extra + b"\0\0"
    blocks = -(-len(section) // 512)
    section = section[:2] + bytes([blocks]) + section[3:].ljust(blocks * 512 - 3, b"\0")
    words = [n_points, n_analog, 1, n_frames if frames is None else frames, 0]
    header = bytes([2, 0x50]) + b"".join(pack_word(word, processor) for word in words)
    header += pack_float(scale, processor) + pack_word(2 + blocks, processor) + pack_word(1, processor)
    header += pack_float(rate, processor)
    data = bytearray()
    for t in range(n_frames):
        for k in range(n_points):
            gone = missing is not None and missing[t, k]
            for value in (*positions[t, k], -1 if gone else 0):
                data += pack_float(float(value), processor) if scale < 0 else pack_word(int(value), processor)
        for _ in range(n_analog):
            data += pack_float(7.0, processor) if scale < 0 else pack_word(7, processor)
    data += bytes(-len(data) % 512)
    return header.ljust(512, b"\0") + section + bytes(data)


def random_points(n_frames=5, n_points=3, seed=0):
    """Whole numbers, which every storage holds exactly."""
    return np.random.default_rng(seed).integers(-2000, 2000, (n_frames, n_points, 3))
