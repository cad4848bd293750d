"""Files of others that tests write."""

import numpy as np


def write_ply(path, points, *, text=False):
    """Points [n, 3] as PLY: binary little endian, or exact text."""
    name, code = ("double", "<f8") if points.dtype == np.float64 else ("float", "<f4")
    lines = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0"]
    lines += [f"element vertex {len(points)}", *(f"property {name} {axis}" for axis in "xyz")]
    head = "\n".join([*lines, "end_header", ""])
    rows = "".join(" ".join(map(str, point)) + "\n" for point in points.astype(code))
    path.write_bytes(head.encode() + (rows.encode() if text else points.astype(code).tobytes()))
