"""Image files decoded by OpenCV, a damaged PNG refused, which it would fill in."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.errors import FileError

#: Level at which OpenCV logs nothing
SILENT = 0

#: First bytes of a PNG
PNG = b"\x89PNG\r\n\x1a\n"

#: Its last chunk, with the checksum, at which Pillow does not look
PNG_END = b"IEND\xaeB`\x82"


def decoded(file: Path, most: int, mode: int) -> NDArray[Any]:
    """The pixels of an image.

    Args:
        file: The file, which exists.
        most: Most pixels.
        mode: OpenCV's, such as ``cv2.IMREAD_GRAYSCALE``.

    Raises:
        FileError: Damaged, too large, or of a kind that OpenCV does not read.
    """
    import cv2

    content = np.fromfile(file, np.uint8)
    if file.suffix.lower() == ".png" or content[: len(PNG)].tobytes() == PNG:
        _check_png(file, content.tobytes(), most)
    # OpenCV 4.10 has its log functions at the top level
    log = getattr(cv2.utils, "logging", cv2)
    level = log.getLogLevel()
    log.setLogLevel(SILENT)
    image, cause = None, None
    try:
        image = cv2.imdecode(content, mode)
    except (cv2.error, MemoryError) as error:
        cause = error
    finally:
        log.setLogLevel(level)
    if image is None:
        raise FileError(
            f"OpenCV cannot read {file} as an image: damaged? export it again"
        ) from cause
    return np.asarray(image)


def _check_png(file: Path, content: bytes, most: int) -> None:
    """Refuse a PNG with damaged chunks, which OpenCV's decoder would fill in.

    Args:
        file: Where it is, for messages.
        content: Its bytes.
        most: Most pixels it may announce.
    """
    from PIL.PngImagePlugin import PngImageFile

    try:
        content.index(PNG_END)
        image = PngImageFile(io.BytesIO(content))
        size = image.width * image.height
        if size <= most:
            image.verify()
    except Exception as error:  # Pillow raises nearly every class on damaged files
        raise FileError(
            f"{file} is a damaged or truncated PNG: copy or export it again"
        ) from error
    if size > most:
        raise FileError(f"{file} declares {size:,} pixels, at most {most:,} are read")
