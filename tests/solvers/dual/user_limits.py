"""Constraints as users make them, and scenes whose measurements contest them."""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import small_scene, with_wrenches
from ttus_opt.core.arrays import Array
from ttus_opt.problem.formulation import load

INF = np.inf


@dataclass(frozen=True)
class Within(tt.constraints.Constraint):
    """Bounds made by a user."""

    lower: Array = field(repr=False)
    upper: Array = field(repr=False)

    name = "within"
    formula = "l ≤ p ≤ u"

    def rows(self):
        return tt.terms.Bounds("p", self.lower, self.upper)


@dataclass(frozen=True)
class Rows(tt.constraints.Constraint):
    """Rows made by a user."""

    matrix: sp.csr_array = field(repr=False)
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)

    name = "mine"
    formula = "l ≤ M p ≤ u"

    def rows(self):
        return tt.terms.LinearRows({"p": self.matrix}, self.lower, self.upper)


@dataclass(frozen=True)
class Steeper(tt.constraints.Monotone):
    """A second growth along the same spokes."""

    name = "steeper"


def contested(
    seed=0, shape=(7, 14, 7), *, sampling="trilinear", scale=1.0, noise=2.0, n_poses=10
):
    """A scene with forces scaled (or reversed) and noise on them [N]."""
    return louder(small_scene(sampling, shape, n_poses, seed), seed, scale, noise)


def louder(scene, seed, scale=1.0, noise=2.0):
    """A scene with its forces scaled and noise on them [N]."""
    rng = np.random.default_rng(seed + 100)
    return with_wrenches(scene, scale * scene.f + rng.normal(0.0, noise, scene.f.shape))


def eq10(scene, weight, *constraints):
    """Eq. 10 under constraints, both weights the same."""
    declared = load("eq10", scene, force_weight=weight, torque_weight=weight)
    return declared.with_constraints(*constraints)
