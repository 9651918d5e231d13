"""Uncertainty in a field file: draws of the error near the skin, and a map of presses.

The file is a field file with one more variable, the draws, as 16-bit integers times one
factor; their rounding is negligible. A renderer reads the map only.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.fitting.uncertainty.field_uncertainty import DEPTH, Uncertainty
from ttus_opt.fitting.uncertainty.posterior import PosteriorDraws, skin_voxels
from ttus_opt.fitting.uncertainty.skin_uncertainty import require_own, uncertainty_map
from ttus_opt.fitting.uncertainty.wrench_noise import WrenchNoise
from ttus_opt.fitting.uncertainty.wrench_uncertainty import WrenchUncertainty
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap import field as field_file
from ttus_opt.voxmap.field import PotentialField

#: Dimensions of the draws in the file
DIMS = ("uncertainty_draw", "uncertainty_voxel")

#: Draws in a file, for standard deviations to 6 % [–]
FILE_DRAWS = 128

#: Largest integer of a draw
LARGEST = 32_767

#: Attribute with depth and noise as JSON; older files, with the noise as one number, do
#: not have it
FACTS = "uncertainty_noise"


@dataclass(frozen=True)
class SavedUncertainty:
    """The uncertainty of a field, read from its file.

    Attributes:
        potential: The fitted field.
        shell: The probe that is rendered.
        draws: Draws of the field's error, near the skin.
        noise: Noise of measured wrenches.
    """

    potential: PotentialField
    shell: PointShell = field(repr=False)
    draws: PosteriorDraws = field(repr=False)
    noise: WrenchNoise

    def std(self, trajectory: Trajectory) -> WrenchUncertainty:
        """Like `ttus_opt.fitting.uncertainty.field_uncertainty.Uncertainty.std`."""
        at = self.potential, self.shell, trajectory
        return WrenchUncertainty.of(*at, self.draws.covariance, self.noise)


def save_with_uncertainty(
    fitted: PotentialField,
    uncertainty: Uncertainty,
    path: str | os.PathLike[str],
    *,
    count: int = FILE_DRAWS,
    depth: float = DEPTH,
) -> PotentialField:
    """Write a field with its uncertainty: draws, and the map for the renderer.

    Args:
        fitted: The field.
        uncertainty: Its uncertainty.
        path: The file, replaced only on success.
        count: Number of draws [–].
        depth: Depth below the skin down to which they are kept [m].

    Returns:
        The field with its map.

    Raises:
        InputError: As in `Uncertainty.draws` and `uncertainty_map`.
        FileError: The file cannot be written.
    """
    require_own(uncertainty, fitted)
    sampled = uncertainty.sampled(count, depth)
    draws = sampled.draws(count, depth)
    mapped = replace(fitted, uncertainty=uncertainty_map(sampled, fitted))
    factor = float(np.abs(draws.values).max(initial=0.0)) / LARGEST or 1.0
    whole = np.rint(draws.values / np.float32(factor)).astype(np.int16)
    facts = {
        "depth": draws.depth,
        "noise": uncertainty.noise.as_dict(),
        "sizes": draws.sizes.tolist(),
    }
    about = {"units": fitted.unit, "factor": factor}
    dataset = mapped.to_xarray().assign({field_file.DRAWS: (DIMS, whole, about)})
    dataset[field_file.DRAWS].encoding.update(zlib=True, complevel=1)
    io.write_dataset(
        dataset.assign_attrs({FACTS: json.dumps(facts)}),
        path,
        kind=field_file.KIND,
        version=field_file.VERSION,
    )
    return mapped


def read_uncertainty(
    path: str | os.PathLike[str], shell: PointShell
) -> SavedUncertainty:
    """Read the uncertainty of a field file.

    Args:
        path: A file of `save_with_uncertainty` or ``ttus-opt fit --uncertainty``.
        shell: The probe that is rendered.

    Raises:
        FileError: Not a field file, or damaged.
        InputError: The file has no saved uncertainty.
    """
    fitted = PotentialField.load(path)
    data = io.read_content(path, kind=field_file.KIND, version=field_file.VERSION)
    if FACTS not in data.attrs or field_file.DRAWS not in data.variables:
        raise InputError(
            f"{path} has no saved uncertainty, or an older form of it: fit again with "
            "ttus-opt fit --uncertainty"
        )
    try:
        facts = json.loads(data.attrs[FACTS])
        depth, noise = float(facts["depth"]), WrenchNoise.from_dict(facts["noise"])
        whole = io.array_of(data, field_file.DRAWS, DIMS, fitted.unit)
        factor = np.float32(data.variables[field_file.DRAWS].attrs["factor"])
        if not 0.0 < factor < np.inf:
            raise InputError(f"factor {factor:g}")
        voxels = skin_voxels(fitted.voxmap, depth)
        if whole.shape[1] != len(voxels) or whole.shape[0] < 2:
            raise InputError(f"draws at {whole.shape[1]} voxels, not {len(voxels)}")
        sizes = np.array(facts.get("sizes", np.zeros(len(whole))), np.float64)
        if sizes.shape != whole.shape[:1] or not np.isfinite(sizes).all():
            raise InputError(f"sizes of {sizes.shape} draws, not {len(whole)}")
        values = whole.astype(np.float32) * factor
        draws = PosteriorDraws(values, sizes, voxels, depth)
        return SavedUncertainty(fitted, shell, draws, noise)
    except (KeyError, InputError, TypeError, ValueError) as error:
        raise FileError(f"{path}: damaged uncertainty: {error}") from error
