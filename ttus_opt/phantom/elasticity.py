"""Linear elasticity on hexahedra and the compliance of a patch of skin.

The body obeys div σ = 0 with Hooke's law σ = 2μ ε(u) + λ tr ε(u) I. Trilinear
elements lock when λ/μ grows (ν → ½), so the volumetric part is integrated with one
point per element (selective reduced integration, Hughes 1980), the deviatoric part
with eight. The stiffness is factored once; the answer kept is

    C[i, j] = inward displacement of skin node i per inward unit force on node j,

symmetric positive definite, so that a contact needs neither mesh nor stiffness.
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

from ttus_opt import io
from ttus_opt.arrays import Array
from ttus_opt.errors import FileError, InputError
from ttus_opt.optional import load

#: What reading a damaged NPZ file raises, beside the usual
DAMAGED = (KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError)

#: Unit loads solved at once: enough for matrix-matrix speed, little memory.
BATCH = 64


@dataclass(frozen=True)
class ElasticBody:
    """A meshed elastic body, held somewhere, with a patch of skin to press on.

    Attributes:
        mesh: Hexahedra (`skfem.MeshHex`), nodes in metres, n nodes.
        young: Young's modulus [Pa] at points of shape (3, ...) [m], shape (...).
        poisson: Poisson's ratio, below ½ [–].
        fixed: Displacement components held at zero, shape (n, 3).
        patch: Skin nodes whose response is wanted, shape (k,).
        normals: Outward unit normals of the skin there, shape (k, 3) [–].
        rim: Patch nodes on the patch's border, shape (k,).
    """

    mesh: Any = field(repr=False)
    young: Callable[[Array], Array]
    poisson: float
    fixed: NDArray[np.bool_] = field(repr=False)
    patch: NDArray[np.intp] = field(repr=False)
    normals: Array = field(repr=False)
    rim: NDArray[np.bool_] = field(repr=False)

    def __post_init__(self) -> None:
        """Validate ratio, shapes and what is held: the answer must be unique."""
        if not 0.0 <= self.poisson < 0.5:
            raise InputError(
                f"Poisson's ratio must be in [0, 0.5), got {self.poisson}: use 0.45 "
                "for soft tissue"
            )
        n_nodes = self.mesh.p.shape[1]
        if self.fixed.shape != (n_nodes, 3):
            raise InputError(
                f"fixed must have shape ({n_nodes}, 3), got {self.fixed.shape}"
            )
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
    """What a contact needs to know of a body: skin nodes and their compliance.

    Attributes:
        points: Undeformed skin nodes, shape (k, 3) [m].
        normals: Outward unit normals, shape (k, 3) [–].
        rim: Nodes on the patch's border, where the patch's answer ends, shape (k,).
        compliance: Inward displacement per inward nodal force, (k, k) [m/N].
    """

    points: Array = field(repr=False)
    normals: Array = field(repr=False)
    rim: NDArray[np.bool_] = field(repr=False)
    compliance: Array = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Store the patch as ``.npz``, replacing only on success."""
        with io.replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **vars(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SkinPatch:
        """Read what `save` wrote.

        Raises:
            FileError: Missing, truncated, or not a stored patch.
        """
        file = io.existing_file(path, "compliance")
        try:
            with file.open("rb") as stream, np.load(stream) as stored:
                return cls(**{own.name: stored[own.name] for own in fields(cls)})
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
        progress: Called with (loads solved, loads in all) now and then.

    Returns:
        The patch and its compliance.
    """
    basis, stiffness = _assemble(body)
    held = np.zeros(stiffness.shape[0], dtype=bool)
    held[np.asarray(basis.nodal_dofs)[body.fixed.T]] = True
    free = np.flatnonzero(~held)
    # minimum degree keeps the fill low; the matrix is definite: no pivoting needed
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
    """The vector basis of the body and its stiffness over all nodes [N/m]."""
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
    # one point in the centre of the unit cube, with its weight
    centre = np.full((3, 1), 0.5), np.ones(1)
    reduced = skfem.Basis(body.mesh, element, quadrature=centre)
    # The modulus is evaluated once here: a form is called for every pair of shapes.
    stiffness = sum(
        form.assemble(basis, young=body.young(np.asarray(basis.global_coordinates())))
        for form, basis in ((shear, full), (volume, reduced))
    )
    return full, sp.csr_array(stiffness)
