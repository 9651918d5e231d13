"""A scene: all data of a fit, assembled once.

Patient (voxmap, L, b), probe (point shell) and measurements (trajectory, N, f, W, τ),
linear in the field: f = N p, τ = W p. `ScenePlan` builds one from a scan or a surface.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.boundary_scale import BOUNDARY_SCALE as BOUNDARY_SCALE
from ttus_opt.contact.boundary_scale import identified_scale
from ttus_opt.contact.contact_size import Patches, patch_factors
from ttus_opt.contact.friction import DragRows
from ttus_opt.contact.places import places, runs
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.rows import ContactRows, contact_rows
from ttus_opt.contact.scene_warnings import (
    cut_off,
    warn_contact,
    warn_cut_off,
    warn_misplaced,
    warn_size,
)
from ttus_opt.core.arguments import expect
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.compiled import Stopwatch
from ttus_opt.core.errors import InputError
from ttus_opt.core.html_card import card, sections_svg
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.grid import Sector
from ttus_opt.voxmap.sampling import check_sampling, least_length
from ttus_opt.voxmap.voxmap import Voxmap

LOG = logging.getLogger(__name__)

#: Largest boundary value: far above any stiffness, far below overflow [N or N/cm²]
LARGEST_BOUNDARY = 1e9

#: Missing data of a trajectory without wrenches, in a message
FORCES = "forces (columns fx, fy, fz)"


@dataclass(frozen=True, eq=False)
class Scene:
    """Matrices and measurements of one fit.

    Attributes:
        voxmap: Grid and surface.
        shell: The probe.
        trajectory: Poses and wrenches, T frames.
        sampling: ``trilinear``, ``voxel-mean`` or ``contact-size``.
        laplace: L, the parts of b, and solves with L.
        rows: N and W of the trajectory.
        inner: p_in on the inner layer [N or N/cm²].
        outer: p_out; the outer layer has -p_out [N or N/cm²].
        b: Right side of L p = b, shape (V,) [N or N/cm²].
        parameters: Parameters identified in the assembly, by name (``boundary_scale``).
        seconds: Duration of the assembly, without compiling [s].
        standard_errors: Standard errors of the parameters, by name.
        not_identified: Reason for each parameter that the data do not determine, whose
            neutral value is used, by name.
        compile_seconds: Duration of compiling in the assembly [s].
    """

    voxmap: Voxmap
    shell: PointShell = field(repr=False)
    trajectory: Trajectory = field(repr=False)
    sampling: str
    laplace: LaplaceSystem = field(repr=False)
    rows: ContactRows = field(repr=False)
    inner: float
    outer: float
    b: Array = field(repr=False)
    parameters: Mapping[str, float] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    not_identified: Mapping[str, str] = field(default_factory=dict)
    compile_seconds: float = field(default=0.0, compare=False)

    @classmethod
    def assemble(
        cls,
        voxmap: Voxmap,
        shell: PointShell,
        trajectory: Trajectory,
        *,
        inner: float | Literal["fit"] | None = None,
        outer: float = 1.0,
        sampling: str = "trilinear",
    ) -> Scene:
        """Assemble L, b, N, f, W and τ.

        Args:
            voxmap: Grid and surface.
            shell: The probe.
            trajectory: Poses, and wrenches where they were measured.
            inner: p_in, or "fit": the scale for which the Laplace field alone matches
                the measured forces best in least squares; 1 where its standard error
                exceeds half of it (a `TtusWarning`). None is "fit" where forces were
                measured in contact, otherwise 1; forces that push into the patient are
                then a warning instead of an error.
            outer: p_out; where p_in is fitted the ratio p_out / p_in.
            sampling: ``trilinear``, ``voxel-mean`` or ``contact-size``. The paper has
                ``voxel-mean`` and p_in = p_out = 1: `ttus_opt.core.paper.SCENE`.

        Returns:
            The scene. A `TtusWarning` reports poses off the grid or without contact.

        Raises:
            InputError: Not a trajectory, unknown sampling, boundary values that are not
                finite, or "fit" without a measured force in contact.
        """
        watch = Stopwatch()
        expect(voxmap, Voxmap, "the voxmap")
        expect(shell, PointShell, "the probe")
        if not isinstance(trajectory, Trajectory):
            raise InputError(
                f"a scene takes one trajectory, got {type(trajectory).__name__}: join "
                "several with Trajectory.concatenate"
            )
        check_sampling(sampling)
        if isinstance(inner, str) and inner != "fit":
            raise InputError(f'inner must be a number or "fit", got {inner!r}')
        for name, value in (("inner", inner), ("outer", outer)):
            _check_boundary(name, value)
        warn_misplaced(voxmap)
        warn_size(voxmap, shell)
        laplace = LaplaceSystem.assemble(voxmap)
        poses = trajectory.rotation, trajectory.position
        rows = contact_rows(voxmap, shell, *poses, sampling=sampling)
        warn_contact(rows, voxmap.grid.r_inner)
        warn_cut_off(cut_off(voxmap, shell, *poses))
        asked, ratio = inner is not None, outer
        if inner is None:
            inner = "fit" if rows.N.nnz and trajectory.has_wrench else 1.0
        values = (1.0, 1.0) if isinstance(inner, str) else (float(inner), float(outer))
        b = laplace.right_side(*values)
        scene = cls(voxmap, shell, trajectory, sampling, laplace, rows, *values, b)
        if isinstance(inner, str):
            scene = scene._with_fitted_boundary(ratio, asked)
        scene = replace(scene, seconds=watch.seconds, compile_seconds=watch.compile)
        LOG.info("%r in %.2f s, %d values in N", scene, watch.seconds, rows.N.nnz)
        return scene

    def __repr__(self) -> str:
        return f"Scene({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        surface, grid = self.voxmap.surface, self.voxmap.grid
        outline = surface.points()[:, len(surface.z) // 2, :2]
        touching = self.touching
        places = self.trajectory.position[touching, :2]
        thinned = places[:: max(1, len(places) // 100)]
        picture = sections_svg([outline], (grid.r_inner, grid.r_outer), thinned)
        return card("Scene", self._facts(), picture)

    def _facts(self) -> dict[str, str]:
        """A short description, by name."""
        touching = int(self.touching.sum())
        measured = "measured" if self.trajectory.has_wrench else "no"
        kind = "forces" if self.measures_force_only else "wrenches"
        return {
            "grid": self.voxmap.grid.sizes,
            "poses": f"{len(self.trajectory)} poses, {touching} in contact",
            "wrenches": f"{measured} {kind}",
            "probe": f"{len(self.shell)} shell points",
            "sampling": self.sampling,
            "boundary": f"p_in {self.inner:.4g}, p_out {self.outer:.4g}, "
            f"{self.voxmap.boundary}",
        }

    def with_boundary(self, inner: float, outer: float) -> Scene:
        """The same scene with other boundary values; nothing is assembled again."""
        return replace(
            self,
            inner=inner,
            outer=outer,
            b=self.laplace.right_side(inner, outer),
            parameters={},
            standard_errors={},
            not_identified={},
        )

    def _with_fitted_boundary(self, ratio: float, asked: bool) -> Scene:
        """The same with the boundary values that match the measured forces best.

        Args:
            ratio: p_out / p_in.
            asked: Whether forces that push into the patient are an error.
        """
        place = np.where(self.touching, self.places, -1)
        known = identified_scale(self.laplace, self.N, place, self.f, ratio, asked)
        inner = known.parameters[BOUNDARY_SCALE]
        return replace(self.with_boundary(inner, inner * ratio), **known._asdict())

    def resampled(self, sampling: str) -> Scene:
        """The same contacts in another sampling; a fitted scale is fitted again.

        Rows of ``trilinear`` and ``contact-size`` differ by a factor per pose only.

        Raises:
            InputError: An unknown sampling.
        """
        check_sampling(sampling)
        scene = replace(self, sampling=sampling)
        known: dict[str, DragRows] = {}
        if "voxel-mean" in (sampling, self.sampling):
            rows = scene.rows_along(self.trajectory)
        else:
            factor = self._sizes(sampling) / self._sizes(self.sampling)
            rows = self.rows.scaled(factor)
            if "point_drag" in vars(self):
                known["point_drag"] = self.point_drag.scaled(factor)
        scene = replace(scene, rows=rows)._refitted(self)
        vars(scene).update(known)
        return scene

    def measuring(self, trajectory: Trajectory) -> Scene:
        """The same poses with other wrenches; a fitted scale is fitted again."""
        return replace(self, trajectory=trajectory)._refitted(self)

    def raised(self, height: float) -> Scene:
        """The same poses on a patient whose skin is higher [m]; assembled again.

        Raises:
            GeometryError: That skin does not lie within the grid.
        """
        scene = Scene.assemble(
            self.voxmap.raised(height),
            self.shell,
            self.trajectory,
            inner=self.inner,
            outer=self.outer,
            sampling=self.sampling,
        )
        return scene._refitted(self)

    def _refitted(self, like: Scene) -> Scene:
        """With a boundary scale that is fitted, if that of another scene was."""
        if BOUNDARY_SCALE not in like.parameters:
            return self
        return self._with_fitted_boundary(like.outer / like.inner, False)

    def _sizes(self, sampling: str) -> Array:
        """Factors on trilinear rows, shape (T,) [–]."""
        least = least_length(sampling)
        if not least:
            return np.ones(len(self.trajectory))
        return patch_factors(self.patches.spread, least)

    def rows_along(self, trajectory: Trajectory) -> ContactRows:
        """N and W of other poses of the same probe on the same patient."""
        poses = trajectory.rotation, trajectory.position
        return contact_rows(self.voxmap, self.shell, *poses, sampling=self.sampling)

    @property
    def touching(self) -> Mask:
        """Frames in contact, shape (T,)."""
        return self.rows.touching

    @property
    def presses(self) -> IntArray:
        """Number of every frame's press, shape (T,).

        A press is a run of frames in contact, or in the air, within one recording.
        """
        return runs(self.touching, self.trajectory.segment)

    @cached_property
    def places(self) -> IntArray:
        """Number of every frame's place, shape (T,) (`ttus_opt.contact.places`)."""
        return places(self.presses, self.trajectory.position)

    @property
    def patches(self) -> Patches:
        """Contact patches of the poses."""
        return self.rows.patches

    @cached_property
    def point_drag(self) -> DragRows:
        """Rows of drag of every point, at the usual deadband, shape (3T, V)."""
        where = self.voxmap, self.shell, self.trajectory
        return point_drag_rows(*where, sampling=self.sampling)

    @property
    def n_voxels(self) -> int:
        """Number of voxels V [–]."""
        return self.voxmap.grid.n_voxels

    @property
    def L(self) -> sp.csr_array:
        """Laplace operator, (V, V) [–]."""
        return self.laplace.L

    @property
    def N(self) -> sp.csr_array:
        """Force rows, (3T, V)."""
        return self.rows.N

    @property
    def W(self) -> sp.csr_array:
        """Torque rows, (3T, V) [m]."""
        return self.rows.W

    @property
    def f(self) -> Array:
        """Measured forces, frame by frame, shape (3T,) [N].

        Raises:
            InputError: The trajectory carries no wrench.
        """
        return _measured(self.trajectory.force, FORCES)

    @property
    def tau(self) -> Array:
        """Measured torques, frame by frame, shape (3T,) [N·m].

        Raises:
            InputError: The trajectory carries no torque.
        """
        return _measured(self.trajectory.torque, "torques (columns tx, ty, tz)")

    @property
    def measures_force_only(self) -> bool:
        """Whether forces were measured without torques: there are no torque rows."""
        return self.trajectory.has_wrench and not self.trajectory.has_torque

    @property
    def torque_length(self) -> float:
        """Default length ℓ that makes torque rows comparable with force rows [m]."""
        return self.shell.rms_radius


@dataclass(frozen=True)
class ScenePlan:
    """How a scene is built from a scan or a surface.

    Attributes:
        shape: Voxel counts (n_r, n_theta, n_z) [–].
        r_inner: Radius of the inner layer [m].
        r_outer: Radius of the outer layer; None for 20 mm beyond the surface [m].
        inner: p_in, "fit" or None, as for `Scene.assemble`.
        outer: p_out; where p_in is fitted the ratio p_out / p_in.
        sampling: ``trilinear``, ``voxel-mean`` or ``contact-size``.
        boundary: ``subvoxel`` or ``staircase``, as for `Voxmap.from_surface`.
        sector: Angles between which the grid lies [rad]; None for the full turn.
    """

    shape: Sequence[int] = (48, 120, 60)
    r_inner: float = 0.03
    r_outer: float | None = None
    inner: float | Literal["fit"] | None = None
    outer: float = 1.0
    sampling: str = "trilinear"
    boundary: str = "subvoxel"
    sector: Sector | None = None

    def build(
        self,
        patient: Surface | Array,
        shell: PointShell,
        recordings: Trajectory | Sequence[Trajectory],
        *,
        axis: Axis | None = None,
    ) -> Scene:
        """Build surface, voxmap and scene.

        Args:
            patient: The surface, or a scan of it, shape (n, 3) [m].
            shell: The probe.
            recordings: One or several.
            axis: The patient frame in a scan; estimated when not given.

        Raises:
            InputError: Invalid input; see the steps.
            GeometryError: The scan shows no body, or the surface does not fit the grid.
        """
        if not isinstance(patient, Surface):
            frame = Axis.from_cloud(patient) if axis is None else axis
            patient = extract_surface(patient, axis=frame)
        if not isinstance(recordings, Trajectory):
            recordings = Trajectory.concatenate(recordings)
        voxmap = Voxmap.from_surface(
            patient,
            shape=self.shape,
            r_inner=self.r_inner,
            r_outer=self.r_outer,
            boundary=self.boundary,
            sector=self.sector,
        )
        return Scene.assemble(
            voxmap,
            shell,
            recordings,
            inner=self.inner,
            outer=self.outer,
            sampling=self.sampling,
        )


def _check_boundary(name: str, value: float | str | None) -> None:
    """Validate a boundary value that is a number; `InputError` where it is invalid."""
    if isinstance(value, str) or value is None:
        return
    if not np.isfinite(value) or abs(value) > LARGEST_BOUNDARY:
        raise InputError(
            f"boundary values must be finite and at most {LARGEST_BOUNDARY:g}, got "
            f"{name} {value}"
        )


def _measured(values: Array | None, what: str) -> Array:
    if values is None:
        raise InputError(
            f"the trajectory has no measured {what}: add them, or fit laplace_only"
        )
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
