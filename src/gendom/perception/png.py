"""Read PNG pictures, with checks for damage."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

from PIL import Image

from gendom.arguments import require
from gendom.errors import RecordingError
from gendom.reading import MOST_PIXELS, read_bytes

# Exceptions that Pillow raises for damaged PNG data.
_PNG_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)


def read_png(path: Path) -> Image.Image:
    """A decoded PNG file whose checksums hold.

    Raises:
        RecordingError: It is missing, damaged or too large.
    """
    fix = "the recording was cut off; record it again"
    return decode_png(read_bytes(path, RecordingError, fix=fix), str(path))


def decode_png(data: bytes, where: str) -> Image.Image:
    """A decoded PNG whose checksums hold.

    Args:
        data: The PNG file's bytes.
        where: What messages call it.

    Raises:
        RecordingError: It is damaged, or has more than `MOST_PIXELS`.
    """
    if data[12:16] == b"IHDR" and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        what, fits = f"has {width} x {height} pixels", width * height <= MOST_PIXELS
        fix = f"give pictures of {MOST_PIXELS} at most"
        require(fits, what, where=where, fix=fix, error=RecordingError)
    try:
        # Decoding alone lets some damage pass as wrong pixels; verifying uses the picture up.
        with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
            picture.verify()
        picture = Image.open(io.BytesIO(data), formats=["PNG"])
        picture.load()
    except _PNG_ERRORS as error:
        reason = "no PNG" if isinstance(error, Image.UnidentifiedImageError) else str(error)
        what = f"is damaged ({reason[:80] or type(error).__name__})"
        raise RecordingError(what, where=where, fix="copy it again") from None
    return picture
