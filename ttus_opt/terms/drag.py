"""Drag models: what a drag adds to the rows of measured forces and torques.

A model knows its variables and rows (`ttus_opt.friction`); the terms `drag_force`
and `drag_torque` put them beside N and W.
"""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt import friction
from ttus_opt.errors import InputError
from ttus_opt.friction import DragRows, Sliding
from ttus_opt.scene import Scene

Array = NDArray[np.float64]
Blocks = dict[str, sp.csr_array]


@dataclass(frozen=True)
class DragModel(abc.ABC):
    """How the skin drags on the probe.

    Attributes:
        scene: Probe, motion and rows.
        acts_at: Where drag acts, ``contact`` or ``reference``.
        deadband: Sliding slower than this is on its way to rest [m/s].
    """

    scene: Scene = field(repr=False)
    acts_at: str = "contact"
    deadband: float = friction.DEADBAND

    @property
    @abc.abstractmethod
    def formula(self) -> str:
        """What it takes from N p, for `repr` of a formulation."""

    @cached_property
    def sliding(self) -> Sliding:
        """Patches and sliding of the scene's poses."""
        scene = self.scene
        return Sliding.of(scene.voxmap, scene.shell, scene.trajectory, self.acts_at)

    @cached_property
    def rows(self) -> DragRows:
        """Drag per unit of what drives it."""
        return friction.coulomb_rows(
            self.sliding, self.scene.rows, deadband=self.deadband
        )

    def force_blocks(self) -> Blocks:
        """Force rows by variable: the field's N and what drag takes away."""
        return self._beside(self.scene.N, self.rows.force)

    def torque_blocks(self) -> Blocks:
        """Torque rows by variable [m]."""
        return self._beside(self.scene.W, self.rows.torque)

    @abc.abstractmethod
    def _beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        """The rows of contact and of drag by variable."""

    @abc.abstractmethod
    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Coefficients by the names under which a field carries them."""

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Coefficients and what rendering needs beside them, by name."""
        return self.identified(values) | {
            friction.DRAG_DEADBAND: self.deadband,
            friction.DRAG_AT_REFERENCE: float(self.acts_at == "reference"),
            **dict(zip(friction.DRAG_AXIS, self.sliding.axis.tolist(), strict=True)),
        }


@dataclass(frozen=True)
class GlobalCoulomb(DragModel):
    """One given friction coefficient μ: drag −μ t̂ (n̂ᵀ N p).

    Attributes:
        coefficient: μ [–].
    """

    coefficient: float = 0.0

    @property
    def formula(self) -> str:
        """μ F p with μ as given."""
        return f"{self.coefficient:.4g} F p"

    def __post_init__(self) -> None:
        """Refuse a coefficient that is none.

        Raises:
            InputError: μ is negative or not finite.
        """
        if not (math.isfinite(self.coefficient) and self.coefficient >= 0.0):
            raise InputError(
                f"friction_coefficient must not be negative, got {self.coefficient}"
            )

    def with_coefficient(self, coefficient: float) -> Self:
        """The same drag with another μ; sliding and rows are kept."""
        other = copy.copy(self)
        object.__setattr__(other, "coefficient", float(coefficient))
        other.__post_init__()
        return other

    def _beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        return {"p": sp.csr_array(contact - self.coefficient * drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The given μ."""
        return {friction.FRICTION: self.coefficient}


@dataclass(frozen=True)
class CoulombField(DragModel):
    """Drag −t̂ (n̂ᵀ N q) of a voxel field q, the friction coefficient times p."""

    @property
    def formula(self) -> str:
        """F q."""
        return "F q"

    def _beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        return {"p": contact, "q": sp.csr_array(-drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The one μ for which μ F p is nearest to F q."""
        full = self.rows.force @ values["p"]
        square = float(full @ full)
        dragged = float(full @ (self.rows.force @ values["q"]))
        return {friction.FRICTION: max(dragged / square, 0.0) if square else 0.0}


@dataclass(frozen=True)
class Viscous(DragModel):
    """Drag −c v_t, one coefficient c [N·s/m] per patch of the torso.

    Attributes:
        sectors: Patches around the axis [–].
        bands: Patches along it [–].
    """

    sectors: int = 1
    bands: int = 1

    @property
    def formula(self) -> str:
        """The columns of sliding velocities times c."""
        return "v c"

    @cached_property
    def rows(self) -> DragRows:
        """Velocities, in the column of the patch that is touched."""
        region = self.sliding.regions(self.sectors, self.bands, self.scene.voxmap)
        return friction.viscous_rows(self.sliding, region, self.sectors * self.bands)

    def _beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        return {"p": contact, "c": sp.csr_array(-drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Mean coefficient over the poses in contact, and each patch's own.

        A patch that was never touched, of which nothing is known, has the mean.
        """
        region = self.sliding.regions(self.sectors, self.bands, self.scene.voxmap)
        touched = region[(self.sliding.normal != 0.0).any(axis=1)]
        c = np.maximum(values["c"], 0.0)
        mean = float(c[touched].mean()) if len(touched) else 0.0
        found = {friction.VISCOUS: mean}
        if len(c) > 1:
            known = np.isin(np.arange(len(c)), touched)
            each = np.where(known, c, mean)
            found[friction.SECTORS] = float(self.sectors)
            found[friction.BANDS] = float(self.bands)
            found |= {f"{friction.VISCOUS}_{i}": float(v) for i, v in enumerate(each)}
        return found
