"""Linear elasticity on hexahedra and the compliance of a patch of skin.

The body obeys div σ = 0 with Hooke's law σ = 2μ ε(u) + λ tr ε(u) I. Trilinear elements
lock when λ/μ grows (ν → ½), so the volumetric part is integrated with one point per
element (selective reduced integration, Hughes 1980), the deviatoric part with eight.
The stiffness is factored once and yields the compliance

    C[i, j] = inward displacement of skin node i per inward unit force on node j,

which is symmetric positive definite. A contact needs neither mesh nor stiffness then.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ttus_opt.core import io
from ttus_opt.core.arguments import expect_shape
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.optional import load

#: Exceptions from reading a damaged NPZ file, in addition to the usual ones
DAMAGED = (KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError)

#: Unit loads solved at once: enough for matrix-matrix speed with little memory
BATCH = 64


@dataclass(frozen=True)
class ElasticBody:
    """A meshed elastic body with supports and a patch of skin to press on.

    Attributes:
        mesh: Hexahedra (`skfem.MeshHex`) with n nodes in metres.
        young: Young's modulus [Pa] at points of shape (3, ...) [m], shape (...).
        poisson: Poisson's ratio, below ½ [–].
        fixed: Displacement components held at zero, shape (n, 3).
        patch: Numbers of the skin nodes to press on, shape (k,).
        normals: Outward unit normals of the skin at these nodes, shape (k, 3) [–].
        rim: Whether each of these nodes is on the patch's border, shape (k,).
    """

    mesh: Any = field(repr=False)
    young: Callable[[Array], Array]
    poisson: float
    fixed: NDArray[np.bool_] = field(repr=False)
    patch: NDArray[np.intp] = field(repr=False)
    normals: Array = field(repr=False)
    rim: NDArray[np.bool_] = field(repr=False)

    def __post_init__(self) -> None:
        """Check ratio, shapes and that the supports make the solution unique."""
        if not 0.0 <= self.poisson < 0.5:
            raise InputError(
                f"Poisson's ratio must be in [0, 0.5), got {self.poisson}: use 0.45 "
                "for soft tissue"
            )
        n_nodes = self.mesh.p.shape[1]
        expect_shape(self.fixed, (n_nodes, 3), "fixed")
        if self.fixed.sum() < 6:
            raise InputError(
                "fewer than 6 displacements are fixed, so that the body would float: "
                "fix more"
            )
        k = len(self.patch)
        if self.normals.shape != (k, 3) or self.rim.shape != (k,):
            raise InputError(
                f"{k} patch nodes need normals ({k}, 3) and rim ({k},), got "
                f"{self.normals.shape} and {self.rim.shape}"
            )


@dataclass(frozen=True)
class SkinPatch:
    """The skin nodes of a body and their compliance: all that a contact needs.

    Attributes:
        points: Undeformed skin nodes, shape (k, 3) [m].
        normals: Outward unit normals, shape (k, 3) [–].
        rim: Whether each node is on the patch's border, shape (k,).
        compliance: Inward displacement per inward nodal force, (k, k) [m/N].
    """

    points: Array = field(repr=False)
    normals: Array = field(repr=False)
    rim: NDArray[np.bool_] = field(repr=False)
    compliance: Array = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Store the patch as ``.npz``; an existing file is replaced only on success."""
        with io.replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **vars(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SkinPatch:
        """Read what `save` wrote.

        Raises:
            FileError: The file is missing, truncated, or not a stored patch.
        """
        file = io.existing_file(path, "compliance")
        try:
            with file.open("rb") as stream, np.load(stream) as stored:
                return cls(**{each.name: stored[each.name] for each in fields(cls)})
        except (OSError, ValueError, TypeError, *DAMAGED) as error:
            raise FileError(
                f"{file} is not a stored compliance: delete it and compute it again"
            ) from error


def skin_compliance(
    body: ElasticBody, progress: Callable[[int, int], None] | None = None
) -> SkinPatch:
    """Factor the body's stiffness and solve for a unit load on every patch node.

    Args:
        body: The body.
        progress: Called after every `BATCH` loads with (loads solved, all loads).
    """
    basis, stiffness = _assemble(body)
    held = np.zeros(stiffness.shape[0], dtype=bool)
    held[np.asarray(basis.nodal_dofs)[body.fixed.T]] = True
    free = np.flatnonzero(~held)
    # minimum degree keeps the fill-in low; a definite matrix needs no pivoting
    factor = splu(
        stiffness[free][:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    k = len(body.patch)
    rows = np.asarray(basis.nodal_dofs)[:, body.patch].T.reshape(-1)
    entries = -body.normals.reshape(-1), (rows, np.repeat(np.arange(k), 3))
    inward = sp.csr_array(entries, shape=(stiffness.shape[0], k))[free].tocsc()
    compliance: Array = np.empty((k, k))
    for start in range(0, k, BATCH):
        loads = inward[:, start : start + BATCH].toarray()
        responses = inward.T @ factor.solve(loads)
        compliance[:, start : start + BATCH] = np.asarray(responses)
        if progress is not None:
            progress(min(start + BATCH, k), k)
    points = np.ascontiguousarray(body.mesh.p.T[body.patch])
    return SkinPatch(points, body.normals, body.rim, compliance)


def _assemble(body: ElasticBody) -> tuple[Any, sp.csr_array]:
    """The vector basis and the stiffness matrix over all nodes [N/m]."""
    skfem = load("skfem", "phantom")
    from skfem.helpers import ddot, div, sym_grad

    nu = body.poisson

    @skfem.BilinearForm  # type: ignore[untyped-decorator, unused-ignore]
    def shear(u: Any, v: Any, w: Any) -> Any:
        mu = w["young"] / (2.0 * (1.0 + nu))
        return 2.0 * mu * ddot(sym_grad(u), sym_grad(v))

    @skfem.BilinearForm  # type: ignore[untyped-decorator, unused-ignore]
    def volume(u: Any, v: Any, w: Any) -> Any:
        lam = w["young"] * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return lam * div(u) * div(v)

    element = skfem.ElementVector(skfem.ElementHex1())
    full = skfem.Basis(body.mesh, element, intorder=3)
    # one quadrature point in the centre of the unit cube, and its weight
    centre = np.full((3, 1), 0.5), np.ones(1)
    reduced = skfem.Basis(body.mesh, element, quadrature=centre)
    # The modulus is evaluated here, once: a form is called per pair of shape functions.
    stiffness = sum(
        form.assemble(basis, young=body.young(np.asarray(basis.global_coordinates())))
        for form, basis in ((shear, full), (volume, reduced))
    )
    return full, sp.csr_array(stiffness)
