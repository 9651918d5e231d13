"""Drag models: rows that drag adds to measured forces and torques.

A model has its variables and rows (`ttus_opt.contact.friction`); the terms of
`ttus_opt.problem.terms.wrench` combine them with N and W.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.contact import friction
from ttus_opt.contact.friction import DragRows, Sliding, coulomb_rows
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array
from ttus_opt.haptic.drag import DragLaw
from ttus_opt.haptic.presliding import with_bristle
from ttus_opt.problem.terms.base import Fitted
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.problem.terms.distinct_drag import (
    LEAST_DISTINCT,
    ONE_SENSE,
    distinct_drag,
)
from ttus_opt.problem.terms.laplace import MEAN_FRICTION
from ttus_opt.problem.terms.rows import replaced

Blocks = dict[str, sp.csr_array]

#: Sliding below this share of the deadband counts as rest [–]: 2 µm/s are 0.1 µm in a
#: frame of 50 ms, less than any tracker resolves
AT_REST = 1e-3

#: Drag of every point for itself, among the places where drag may act
AT_POINTS = "points"


@dataclass(frozen=True)
class DragModel(abc.ABC):
    """A model of the friction force on the probe.

    Attributes:
        scene: Probe, motion and rows.
        acts_at: Where drag acts, ``contact``, ``reference`` or ``points``.
        deadband: Sliding speed below which drag decreases in proportion [m/s].
        presliding: Length over which drag builds up instead, and then holds a probe at
            rest (`ttus_opt.haptic.presliding`); 0 for none [m].
        no_presliding: Why no pose determines it; empty if one does, or nobody asked.
    """

    scene: Scene = field(repr=False)
    acts_at: str = "contact"
    deadband: float = friction.DEADBAND
    presliding: float = field(default=0.0, kw_only=True)
    no_presliding: str = field(default="", kw_only=True, repr=False)

    @property
    @abc.abstractmethod
    def formula(self) -> str:
        """The drag subtracted from N p, for `repr` of a formulation."""

    @cached_property
    def sliding(self) -> Sliding:
        """Patches and sliding velocities of the scene's poses."""
        scene = self.scene
        where = scene.voxmap, scene.shell, scene.trajectory
        found = Sliding.of(*where, self.acts_at, patches=scene.patches)
        if not self.presliding:
            return found
        law = DragLaw.of(
            self._places(found) | {friction.FRICTION: 1.0}, scene.voxmap.grid
        )
        # in proportion to depth: only the ratio of successive forces matters
        force = scene.N @ np.maximum(voxel_depths(scene.voxmap), 0.0)
        how = law.numbers, scene.shell, scene.trajectory, force.reshape(-1, 3)
        return with_bristle(found, *how)

    @cached_property
    def rows(self) -> DragRows:
        """Rows of drag over its unknowns, those of Coulomb's drag = −F (μ p)."""
        scene, deadband = self.scene, self.deadband
        if self.acts_at != AT_POINTS:
            return coulomb_rows(self.sliding, scene.rows, deadband=deadband)
        if deadband == friction.DEADBAND:
            return scene.point_drag  # the same for every model
        where = scene.voxmap, scene.shell, scene.trajectory
        return point_drag_rows(*where, sampling=scene.sampling, deadband=deadband)

    @abc.abstractmethod
    def beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        """Rows by variable, of contact for the field and the same `rows` of drag."""

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The coefficients that are variables, by name."""
        return {}

    @abc.abstractmethod
    def not_identifiable(self) -> dict[str, str]:
        """Reasons for coefficients that no pose determines, by name."""

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same model with these of its coefficients at 0."""
        return self

    @cached_property
    def touching(self) -> NDArray[np.bool_]:
        """Poses in contact, shape (T,)."""
        return np.asarray((self.sliding.normal != 0.0).any(axis=1))

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Poses that slide in contact, shape (T,)."""
        if self.acts_at == AT_POINTS:  # the flanks slide where the patch does not
            drag, contact = (
                abs(rows).sum(axis=1).reshape(-1, 3).sum(axis=1)
                for rows in (self.rows.force, self.scene.N)
            )
            return np.asarray(drag > AT_REST * contact)
        size = np.linalg.norm(self.sliding.direction(self.deadband), axis=1)
        return np.asarray(self.touching & (size > AT_REST))

    def no_sliding(self) -> str:
        """Why no pose determines drag; empty if one does."""
        if self.moving.any():
            return ""
        return "no sliding" if self.touching.any() else "no contact"

    def no_friction(self) -> str:
        """Why no pose tells friction from an elastic force; empty if one does."""
        why = self.no_sliding()
        if not why and distinct_drag(self.scene, self.rows.force) < LEAST_DISTINCT:
            why = ONE_SENSE
        return why

    @abc.abstractmethod
    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Coefficients by their names among a field's parameters."""

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Coefficients and the other parameters that rendering needs, by name."""
        return self.identified(values) | self._places(self.sliding)

    def _places(self, sliding: Sliding) -> dict[str, float]:
        """Where and from which motion on drag acts, by name."""
        asked = self.presliding > 0.0 or bool(self.no_presliding)
        preslides = {friction.PRESLIDING: self.presliding} if asked else {}
        return preslides | {
            friction.DRAG_DEADBAND: self.deadband,
            friction.DRAG_AT_REFERENCE: float(self.acts_at == "reference"),
            friction.DRAG_AT_POINTS: float(self.acts_at == AT_POINTS),
            **dict(zip(friction.DRAG_AXIS, sliding.axis.tolist(), strict=True)),
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
        """The formula μ F p with the value of μ."""
        return f"{self.coefficient:.4g} F p"

    def __post_init__(self) -> None:
        """Refuse a μ that is negative or not finite."""
        expect_not_negative(self.coefficient, friction.FRICTION)

    def with_coefficient(self, coefficient: float) -> Self:
        """The same drag with another μ; sliding and rows are shared."""
        return replaced(self, "sliding", "rows", coefficient=float(coefficient))

    def per_unit(self, p: Array) -> tuple[Array, Array]:
        """Force [N] and torque [N·m] of −drag of a field for μ = 1, (3T,) each."""
        if self.acts_at == AT_POINTS:
            return self.rows.force @ p, self.rows.torque @ p
        sliding, force = self.sliding, (self.scene.N @ p).reshape(-1, 3)
        pressed = np.einsum("ti,ti->t", sliding.normal, force)[:, None]
        drag = pressed * sliding.direction(self.deadband)
        return drag.ravel(), np.cross(sliding.arm, drag).ravel()

    def with_presliding(self, length: float) -> Self:
        """The same drag with another presliding length [m]."""
        if length == self.presliding:
            return self
        return replace(self, presliding=length)

    def beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        """Implements `DragModel`."""
        return {"p": sp.csr_array(contact - self.coefficient * drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The given μ."""
        return {friction.FRICTION: self.coefficient}

    def not_identifiable(self) -> dict[str, str]:
        """The coefficient μ and its presliding length, if no pose tells them."""
        why = self.no_friction()
        found = {friction.FRICTION: why} if why else {}
        if self.no_presliding:
            found[friction.PRESLIDING] = why or self.no_presliding
        return found


@dataclass(frozen=True)
class CoulombField(DragModel):
    """Drag −t̂ (n̂ᵀ N q) of a voxel field q, the friction coefficient times p.

    Attributes:
        largest: μ_max, the largest ratio of q to p [–].
        excluded: Whether q is omitted from the rows.
    """

    largest: float = 1.0
    excluded: bool = False

    formula = "F q"

    def beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        """Implements `DragModel`."""
        if self.excluded:
            return {"p": contact}
        return {"p": contact, "q": sp.csr_array(-drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The single μ for which μ F p is closest to F q."""
        return {friction.FRICTION: max(self._nearest(values)[0], 0.0)}

    def _nearest(self, values: Mapping[str, Array]) -> tuple[float, Array, Array]:
        """The ratio μ = (F p)ᵀ(F q)/‖F p‖² (0 without sliding), F p and F q."""
        full = self.rows.force @ values["p"]
        square = float(full @ full)
        if self.excluded or not square:
            return 0.0, full, np.zeros_like(full)
        dragged = self.rows.force @ values["q"]
        return float(full @ dragged) / square, full, dragged

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The coefficient μ with its derivatives with respect to q and p."""
        mu, full, dragged = self._nearest(values)
        square = float(full @ full)
        if self.excluded or not self.moving.any():
            return {}
        if not square:
            return {friction.FRICTION: Fitted({}, 1.0)}
        turned = self.rows.force.T
        gradient = {
            "q": turned @ full / square,
            "p": turned @ (dragged - 2.0 * mu * full) / square,
        }
        return {friction.FRICTION: Fitted(gradient, 1.0, self.largest)}

    def not_identifiable(self) -> dict[str, str]:
        """The coefficient μ and its mean, if no pose tells it or q is omitted."""
        why = "the drag field is left out" if self.excluded else self.no_friction()
        return {friction.FRICTION: why, MEAN_FRICTION: why} if why else {}

    def with_neutral(self, names: Collection[str]) -> Self:
        """Without q if μ is among the names."""
        return replace(self, excluded=True) if friction.FRICTION in names else self


@dataclass(frozen=True)
class Viscous(DragModel):
    """Drag −c v_t with one coefficient c [N·s/m] per region of the torso.

    Attributes:
        sectors: Number of regions around the axis [–].
        bands: Number of regions along it [–].
        excluded: Regions whose coefficient is fixed at 0.
    """

    sectors: int = 1
    bands: int = 1
    excluded: frozenset[int] = frozenset()

    formula = "v c"  # columns of sliding velocities times c

    @cached_property
    def rows(self) -> DragRows:
        """Sliding velocities, in the column of the region in contact."""
        n = self.sectors * self.bands
        rows = friction.viscous_rows(self.sliding, self.region, n)
        if not self.excluded:
            return rows
        included = sp.diags_array(
            np.where(np.isin(np.arange(n), [*self.excluded]), 0.0, 1)
        )
        force, torque = (sp.csr_array(m @ included) for m in (rows.force, rows.torque))
        return DragRows(force, torque)

    @cached_property
    def region(self) -> NDArray[np.int64]:
        """The region of every pose, shape (T,)."""
        return self.sliding.regions(self.sectors, self.bands, self.scene.voxmap)

    def _name(self, patch: int) -> str:
        """Name of a region's coefficient."""
        alone = self.sectors * self.bands == 1
        return friction.VISCOUS if alone else f"{friction.VISCOUS}_{patch}"

    def beside(self, contact: sp.csr_array, drag: sp.csr_array) -> Blocks:
        """Implements `DragModel`."""
        return {"p": contact, "c": sp.csr_array(-drag)}

    def identified(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Mean coefficient over the poses in contact, and that of each region.

        A region that was never touched gets the mean.
        """
        touched = self.region[self.touching]
        c = np.maximum(values["c"], 0.0)
        c[[*self.excluded]] = 0.0
        mean = float(c[touched].mean()) if len(touched) else 0.0
        found = {friction.VISCOUS: mean}
        if len(c) > 1:
            known = np.isin(np.arange(len(c)), touched)
            each = np.where(known, c, mean)
            found[friction.SECTORS] = float(self.sectors)
            found[friction.BANDS] = float(self.bands)
            found |= {self._name(i): float(v) for i, v in enumerate(each)}
        return found

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The coefficients of regions with sliding, and their mean.

        At the largest plausible coefficient drag equals the contact force at the
        sliding speed, or at the deadband if that is faster. The mean is identified if
        the regions are.
        """
        n, own = self.sectors * self.bands, self.region[self.moving]
        included = sorted(set(own.tolist()) - self.excluded)
        if not included:
            return {}
        contact = (self.scene.N @ values["p"]).reshape(-1, 3)
        found = {}
        for i in included:
            here = self.moving & (self.region == i)
            force, speed = (
                float(np.sqrt(np.mean(np.sum(v[here] ** 2, axis=1))))
                for v in (contact, self.sliding.velocity)
            )
            span = force / max(speed, self.deadband)
            found[self._name(i)] = Fitted({"c": np.eye(n)[i]}, span)
        if n > 1:
            counts = np.bincount(self.region[self.touching], minlength=n)
            counts[[i for i in range(n) if i not in included]] = 0
            share = counts / max(int(self.touching.sum()), 1)
            found[friction.VISCOUS] = Fitted({"c": share}, math.inf)
        return found

    def not_identifiable(self) -> dict[str, str]:
        """Regions without sliding, and the mean if there is no other region."""
        n = self.sectors * self.bands
        slid, touched = self.region[self.moving], self.region[self.touching]
        if n == 1:
            why = self.no_sliding()
            return {friction.VISCOUS: why} if why else {}
        found = {}
        for i in range(n):
            if i not in touched:
                found[self._name(i)] = "never touched, as the mean of the others"
            elif i not in slid:
                found[self._name(i)] = "no sliding"
        if set(slid.tolist()) <= self.excluded:
            found[friction.VISCOUS] = (
                self.no_sliding() or "none of its regions is identified"
            )
        return found

    def with_neutral(self, names: Collection[str]) -> Self:
        """With the coefficients of these regions fixed at 0.

        A region that was never touched is unchanged: it has the mean.
        """
        n = self.sectors * self.bands
        touched = set(self.region[self.touching].tolist())
        own = {i for i in range(n) if self._name(i) in names}
        more = own if n == 1 else own & touched
        return replace(self, excluded=self.excluded | more) if more else self
