"""A field as its difference from the Laplace field of a surface the receiver has.

The receiver decodes the surface, makes the grid, solves Laplace's equation for both
boundary values (docs/method/rendering.md, 17.3) and adds the difference, sent within an
error bound. If the surface was rounded after the fit, which changes its Laplace field,
the bound holds only where contact reads the field, and no bytes are spent elsewhere.
"""

from __future__ import annotations

import json
import math
from typing import NamedTuple, get_args

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.message.envelope import (
    FIELD,
    Reader,
    Writer,
    read_integers,
    write_integers,
)
from ttus_opt.message.interpolation import Scheme, differences, restored
from ttus_opt.message.surface_message import check_base, check_bound
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.grid import Sector, checked_sector
from ttus_opt.voxmap.sampling import FIELD_UNIT, SIZED, check_sampling, spoke_table
from ttus_opt.voxmap.voxmap import Boundary, Voxmap

#: Default bound of the potential [N, or N/cm² when trilinear]
MAX_ERROR = 0.005

#: Default bound if the surface was rounded after the fit: rounding by 0.25 mm changes
#: forces by more than this [N, or N/cm² when trilinear]
MAX_ERROR_ROUNDED = 0.01

#: Accepted range of bounds [as the potential]
LEAST_BOUND, GREATEST_BOUND = 1e-9, 1e6

#: Largest field that is encoded, twice case L, and that is decoded unless asked for:
#: one of case M takes 48 MiB and one solve in 11 V-cycles
MOST_SENT, MOST_VOXELS = 2_500_000, 400_000

#: Larger boundary values are refused [as the potential]
LARGEST_BOUNDARY = 1e9

#: Most bytes of parameters
PARAMETER_BYTES = 2**16

#: The last one is followed by its length
SAMPLINGS, BOUNDARIES = (*FIELD_UNIT, f"{SIZED}:"), get_args(Boundary)


class Grid(NamedTuple):
    """The voxel grid without its heights, which are the surface's."""

    n_r: int
    n_theta: int
    n_z: int
    r_inner: float
    r_outer: float
    sector: Sector | None = None


def _scheme(voxmap: Voxmap) -> Scheme:
    """Heights first, radii last; finer from the third level on, which saves bytes.

    Inside, layer and outside are predicted separately, because the field has a kink at
    the surface. The wall of a sector has no field, and is not sent.
    """
    wall = voxmap.grid.wall
    region = voxmap.region[:, :wall]
    closed = (False, wall is None, False)
    return Scheme(region.shape, closed, (2, 1, 0), (1, 1, 2, 6), region)


def sampled(voxmap: Voxmap) -> Mask:
    """Voxels that contact reads, below the surface layer, shape ``grid.shape``."""
    grid = voxmap.grid
    outermost = spoke_table(voxmap)[:, 1].reshape(grid.shape[1:])
    read = np.arange(grid.shape[0])[:, None, None] <= outermost
    read[:, grid.shape[1] if grid.wall is None else grid.wall :] = False
    return np.asarray(read)


def encode_field(
    field: PotentialField,
    surface: Surface,
    name: int,
    max_error: float | None = None,
) -> bytes:
    """A field as a message that builds on its surface's.

    Args:
        field: The field.
        surface: Its surface as the receiver has it.
        name: Name of the surface's message.
        max_error: Largest error of the potential at voxels that contact reads; None for
            `MAX_ERROR`, or `MAX_ERROR_ROUNDED` if the surface was rounded after the fit
            [as the potential].

    Raises:
        InputError: An invalid bound, or a grid that does not begin and end with the
            surface.
        GeometryError: The surface does not fit the grid: it is another patient's.
    """
    voxmap = field.voxmap
    of = voxmap.grid
    if (of.z_min, of.z_max) != (float(surface.z[0]), float(surface.z[-1])):
        raise InputError(
            f"the field's grid reaches from z {of.z_min:.6g} to {of.z_max:.6g} m, the "
            f"surface of the message from {surface.z[0]:.6g} to {surface.z[-1]:.6g}: "
            "encode the surface that the field was fitted to"
        )
    grid = Grid(*of.shape, of.r_inner, of.r_outer, of.sector)
    if of.n_voxels > MOST_SENT:
        raise InputError(
            f"a message takes fields of at most {MOST_SENT:,} voxels, got "
            f"{of.n_voxels:,}: fit it on a coarser grid"
        )
    laid = _laid_over(surface, grid, voxmap.boundary)
    same = np.array_equal(voxmap.surface.radius, surface.radius)
    usual = MAX_ERROR if same else MAX_ERROR_ROUNDED
    asked = usual if max_error is None else max_error
    bound = check_bound(asked, LEAST_BOUND, GREATEST_BOUND, field.unit)
    laplace = _laplace_fields(laid)
    if not same:
        read = of.flatten(sampled(laid))
        before = _laplace_fields(voxmap)
        laplace = (
            np.where(read, laplace[0], before[0]),
            np.where(read, laplace[1], before[1]),
        )
    values = of.flatten(field.values)
    # least squares for any field, independent of its formulation's boundary values
    scales = np.linalg.lstsq(np.stack(laplace, axis=1), values, rcond=None)[0]
    rest = of.unflatten(values - scales[0] * laplace[0] - scales[1] * laplace[1])
    try:
        passes, _ = differences(rest[:, : of.wall], bound, _scheme(laid))
    except OverflowError as error:
        raise InputError(
            f"max_error {bound:g} is too small for this field: choose a larger one"
        ) from error
    tables = json.dumps([dict(field.parameters), dict(field.standard_errors)])
    if len(tables) > PARAMETER_BYTES:
        raise InputError("the field has more parameters than a message takes")
    writer = Writer()
    writer.number("I", name)
    writer.number("3H2d", *grid[:5])
    base, colon, length = field.sampling.partition(":")
    kinds = SAMPLINGS.index(base + colon), BOUNDARIES.index(voxmap.boundary)
    writer.number("2B3d", *kinds, *scales, bound)
    if colon:
        writer.number("d", float(length))
    writer.number("B", grid.sector is not None)
    writer.number(f"{len(grid.sector or ())}d", *(grid.sector or ()))
    writer.packed(tables.encode())
    write_integers(writer, np.concatenate(passes))
    return writer.message(FIELD)


def decode_field(
    reader: Reader, surface: Surface, name: int, most_voxels: int = MOST_VOXELS
) -> PotentialField:
    """The field of a message.

    Args:
        reader: The message.
        surface: The surface it builds on.
        name: Name of the surface's message.
        most_voxels: Largest field, checked before anything is allocated.

    Raises:
        InputError: It builds on another surface, is too large, damaged or hostile.
        GeometryError: The surface does not fit the grid.
        NumericalError: Laplace's equation cannot be solved on this grid.
    """
    check_base(reader.number("I"), name)
    grid = Grid(*reader.numbers("3H2d"))
    size = grid.n_r * grid.n_theta * grid.n_z
    if size > most_voxels:
        raise InputError(
            f"the message has a field of {size:,} voxels, at most {most_voxels:,} are "
            "decoded: raise max_voxels if you trust the sender"
        )
    kind, where, inner, outer, bound = reader.numbers("2B3d")
    check_bound(bound, LEAST_BOUND, GREATEST_BOUND, "of the potential")
    if kind >= len(SAMPLINGS):
        raise InputError("the message has an unknown sampling: update ttus_opt")
    if where >= len(BOUNDARIES):
        raise InputError("the message has an unknown boundary: update ttus_opt")
    sampling = SAMPLINGS[kind]
    if sampling.endswith(":"):
        sampling += f"{reader.number('d')!r}"
    check_sampling(sampling)
    if not all(abs(value) <= LARGEST_BOUNDARY for value in (inner, outer)):
        raise InputError(
            "the message's boundary values are not usable: ask for it again"
        )
    grid = grid._replace(sector=_sector(reader))
    parameters, errors = _parameters(reader.unpacked(PARAMETER_BYTES))
    if grid.sector is not None:
        size -= grid.n_r * grid.n_z  # of the wall
    sent = read_integers(reader, size)
    reader.end()
    voxmap = _laid_over(surface, grid, BOUNDARIES[where])
    system = LaplaceSystem.assemble(voxmap)
    right = system.right_side(inner, outer)  # linear: one solve for both values
    system = system.for_solves()
    values = voxmap.grid.unflatten(system.solve(right))
    del system, right  # more than all else takes
    values[:, : voxmap.grid.wall] += restored(sent, bound, _scheme(voxmap))
    return PotentialField(
        voxmap,
        values,
        sampling,
        parameters,
        {"message": f"decoded within {bound:g}"},
        errors,
    )


def _laid_over(surface: Surface, grid: Grid, boundary: str) -> Voxmap:
    shape = (grid.n_r, grid.n_theta, grid.n_z)
    if not all(map(math.isfinite, (grid.r_inner, grid.r_outer))):
        raise InputError("the message's grid is not finite: ask for it again")
    return Voxmap.from_surface(
        surface,
        shape=shape,
        r_inner=grid.r_inner,
        r_outer=grid.r_outer,
        boundary=boundary,
        sector=grid.sector,
    )


def _laplace_fields(voxmap: Voxmap) -> tuple[Array, Array]:
    """Laplace fields of unit inner and of unit outer boundary value, (V,) each."""
    system = LaplaceSystem.assemble(voxmap)
    return (
        system.solve(system.right_side(1.0, 0.0)),
        system.solve(system.right_side(0.0, 1.0)),
    )


def _sector(reader: Reader) -> Sector | None:
    """The sector of the grid; None for the full turn."""
    kind = reader.number("B")
    if kind > 1:
        raise InputError("the message is damaged: its sector: ask for it again")
    return checked_sector(reader.numbers("2d")) if kind else None


def _parameters(content: bytes) -> tuple[dict[str, float], dict[str, float]]:
    """Parameters and their standard errors, by name.

    Raises:
        InputError: They are not two tables of numbers.
    """
    try:
        pair = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError("the message is damaged: its parameters") from error
    if not isinstance(pair, list) or len(pair) != 2 or not all(map(_numbers, pair)):
        raise InputError("the message is damaged: its parameters are not numbers")
    return pair[0], pair[1]


def _numbers(table: object) -> bool:
    """Whether ``table`` maps names to finite numbers."""
    return isinstance(table, dict) and all(
        type(value) in (int, float) and abs(value) < 1e300 for value in table.values()
    )
