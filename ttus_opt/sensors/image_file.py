"""Image files decoded by OpenCV, a damaged PNG refused, which it would fill in."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.errors import FileError

#: Level at which OpenCV logs nothing
SILENT = 0

#: First bytes of a PNG
PNG = b"\x89PNG\r\n\x1a\n"


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
    """Refuse a PNG with damaged chunks, which the decoder would fill in.

    Raises:
        FileError: A wrong checksum, missing chunks, or too many pixels announced.
    """
    at, kinds, size = len(PNG), [], 0
    while content.startswith(PNG) and at + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        body = content[at + 4 : at + 8 + length]
        end = content[at + 8 + length : at + 12 + length]
        if end != zlib.crc32(body).to_bytes(4, "big"):
            break
        if kind == b"IHDR" and length == 13:
            size = math.prod(struct.unpack_from(">II", body, 4))
        kinds.append(kind)
        at += 12 + length
    if size > most:
        raise FileError(f"{file} declares {size:,} pixels, at most {most:,} are read")
    if not kinds or kinds[0] != b"IHDR" or kinds[-1] != b"IEND":
        raise FileError(
            f"{file} is a damaged or truncated PNG: copy or export it again"
        )
