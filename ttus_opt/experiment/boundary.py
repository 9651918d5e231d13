"""Sensitivity to the boundary value, without and with measured forces.

The paper chooses the value of the inner layer by hand. Here it varies over a decade
around the best one for the Laplace field, and the error on unseen motion is reported
for each value.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ttus_opt.core.saved_results import computed_once, restored
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.settings import LAPLACE
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.solution import Status
from ttus_opt.voxmap.field import PotentialField

#: Factors of the boundary value: half a decade to either side [–]
FACTORS = tuple(float(f) for f in 10.0 ** np.linspace(-0.5, 0.5, 5))

#: The recordings of new motion
UNSEEN = ("press_test", "sweep_test")


@dataclass(frozen=True)
class BoundaryError:
    """Error of one patient at one boundary value.

    Attributes:
        patient: Name.
        factor: Boundary value over the best one for the Laplace field [–].
        inner: The value on the inner layer [N/cm²].
        before_N: Mean magnitude error of the Laplace field on unseen motion.
        after_N: Mean magnitude error of eq. 10.
    """

    patient: str
    factor: float
    inner: float
    before_N: float
    after_N: float


def boundary_errors(fits: PatientFits, weight: float) -> tuple[BoundaryError, ...]:
    """Errors over a decade of boundary values, computed or from their file.

    Args:
        fits: Fits of the patient.
        weight: λ_f = λ_τ of eq. 10.
    """
    return computed_once(
        fits.folder / "boundary.json",
        {"digest": fits.stamp, "weight": weight, "factors": list(FACTORS)},
        lambda: tuple(_at(fits, weight, factor) for factor in FACTORS),
        save=lambda rows: {"rows": [asdict(row) for row in rows]},
        load=lambda content: tuple(
            restored(BoundaryError, row) for row in content["rows"]
        ),
    )


def _at(fits: PatientFits, weight: float, factor: float) -> BoundaryError:
    scene = fits.scene(LAPLACE)
    scene = scene.with_boundary(factor * scene.inner, factor * scene.outer)
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    before = PotentialField(scene.voxmap, values, scene.sampling)
    solution = fit(scene, "eq10", force_weight=weight, torque_weight=weight)
    after = float("nan")
    if solution.status is Status.SOLVED:
        after = _error(fits, solution.field)
    patient = fits.examination.patient.name
    return BoundaryError(patient, factor, scene.inner, _error(fits, before), after)


def _error(fits: PatientFits, field: PotentialField) -> float:
    """Mean magnitude error over the unseen recordings [N]."""
    evaluations = [fits.evaluation(field, name, "measured") for name in UNSEEN]
    return float(np.mean([e.errors.force_magnitude_error_N for e in evaluations]))
