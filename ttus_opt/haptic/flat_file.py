"""A field and its probe as one flat file, for a haptic loop without Python.

``examples/c/ttus_reader.c`` reads the file and renders it in C. All numbers are little
endian and 8 bytes wide, but for the first and the last word:

    magic       8 bytes "TTUSFLT1"
    counts      int64: M points, n_r, n_theta, n_z, surface nodes over theta and over z,
                1 if trilinear (or by contact size) and 0 if voxel-mean
    limits      12 float64: `FrameData.limits`
    layout       4 float64: `FrameData.layout`
    caps         2 float64: largest force [N] and torque [N m]
    points      float64 (3, M) [m]
    lever       float64 (M, 6): `FrameData.lever`
    radius      float64 (nodes over theta, nodes over z) [m]
    spokes      float64 (n_theta n_z, 3): `sampling.spoke_table`
    values      float64 (n_r, n_theta, n_z) [N or N/cm²]
    checksum    uint32: CRC-32 of all bytes before it

These are the arrays that `Renderer` reads itself, so no formula but the frame's is
written twice.
"""

from __future__ import annotations

import os
import zlib

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.drag import DragLaw
from ttus_opt.haptic.field_wrench import FORCE_LIMIT, TORQUE_LIMIT, checked_limits
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField

MAGIC = b"TTUSFLT1"


def write_flat(
    path: str | os.PathLike[str],
    field: PotentialField,
    shell: PointShell,
    *,
    force_limit: float = FORCE_LIMIT,
    torque_limit: float = TORQUE_LIMIT,
) -> None:
    """Write a field and its probe for ``examples/c/ttus_reader.c``.

    Args:
        path: The file; replaced only on success.
        field: The fitted field, without friction.
        shell: The probe's point shell.
        force_limit: As for `ttus_opt.Renderer` [N].
        torque_limit: As for `ttus_opt.Renderer` [N·m].

    Raises:
        InputError: A field with friction, or a limit that is not positive.
        FileError: The file cannot be written.
    """
    if DragLaw.of(field.parameters, field.voxmap.grid).active:
        raise InputError(
            "the field has friction, which depends on motion and which the flat file "
            "does not hold: render it by Renderer.c_function, or fit without friction"
        )
    checked_limits(force_limit, torque_limit)
    data = FrameData.of(field.voxmap, shell, field.sampling)
    counts = [data.points.shape[1], *data.shape, *data.nodes, data.trilinear]
    numbers = (
        *(data.limits, data.layout, [force_limit, torque_limit]),
        *(data.points, data.lever, data.radius, data.spokes, field.values),
    )
    content = MAGIC + np.array(counts, dtype="<i8").tobytes()
    content += b"".join(np.asarray(a, dtype="<f8").tobytes() for a in numbers)
    checksum = np.array(zlib.crc32(content), dtype="<u4").tobytes()
    with io.signals_deferred(), io.replacing(path) as temporary:
        temporary.write_bytes(content + checksum)
