"""Read PNG pictures, with checks for damage."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

from PIL import Image

from gendom.errors import RecordingError

# Exceptions that Pillow raises for damaged PNG data.
_PNG_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)


def read_png(path: Path) -> Image.Image:
    """A decoded PNG file whose checksums hold.

    Raises:
        RecordingError: It is missing or damaged.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        what = "no such file" if missing else f"cannot be read ({error.strerror})"
        fix = "the recording was cut off; record it again" if missing else "copy it again"
        raise RecordingError(what, where=str(path), fix=fix) from None
    return decode_png(data, str(path))


def decode_png(data: bytes, where: str) -> Image.Image:
    """A decoded PNG whose checksums hold.

    Args:
        data: The PNG file's bytes.
        where: What messages call it.

    Raises:
        RecordingError: It is damaged.
    """
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
