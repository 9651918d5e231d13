"""Benchmark cases: reference cases of increasing size, or a user's scene.

The reference cases S, M, L and XL are built from the bundled example: its true surface,
and its recordings of presses and sweeps, thinned evenly. A case is plain data that can
be sent to another process.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from ttus_opt import example
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.arguments import chosen, expect_one_of
from ttus_opt.core.errors import InputError
from ttus_opt.core.io import existing_file
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.sampling import check_sampling
from ttus_opt.voxmap.voxmap import Boundary

#: Voxels in r, θ, z and number of poses
REFERENCE = {
    "S": ((24, 72, 30), 200),
    "M": ((48, 120, 60), 400),
    "L": ((100, 180, 60), 400),
    "XL": ((200, 360, 150), 400),
}

#: The example's recordings that they have
RECORDED = ("press_fit", "sweep_fit")

#: Cases not in "all": XL takes gigabytes, and only `structured` solves it
ON_REQUEST = ("XL",)

#: Value on the inner layer, and minus that on the outer one: scaled to the example's
#: forces in trilinear sampling [N/cm²]
EXAMPLE_BOUNDARY = 17.0

#: Grid and poses of the small warm-up case: large enough for an intermediate multigrid
#: level, so that it compiles everything that a case will call
SMALL_SHAPE, SMALL_POSES = (12, 32, 16), 6

#: Relative change of the measured values between two solves of the same structure
CHANGE = 0.05


#: Ways to perturb a recording
PERTURBATIONS = ("noise", "reversed")
#: Standard deviation per axis of the noise added, force [N] and torque [N·m]
FORCE_NOISE, TORQUE_NOISE = 2.0, 0.03
#: Fraction of the frames whose wrench is reversed [–]
REVERSED_PART = 0.2
#: Seed of noise and choice of frames, the same for every solver
SEED = 0


@dataclass(frozen=True, kw_only=True)
class CaseSpec(ScenePlan):
    """A plan of a scene, with the files and numbers that it is built from.

    Attributes:
        name: Name in the tables.
        surface: Surface file.
        probe: Primitive or mesh file.
        trajectories: Recordings with wrenches.
        n_poses: Number of frames, evenly spread; None for all.
        n_points: Points of the probe's shell.
        probe_unit: Unit of a mesh file.
        perturbation: Perturbation of the measured wrenches, one of
            `PERTURBATIONS`; "" for none.
    """

    name: str
    surface: str
    probe: str
    trajectories: tuple[str, ...]
    n_poses: int | None = None
    n_points: int = 1500
    probe_unit: str = "mm"
    perturbation: str = ""

    @property
    def n_voxels(self) -> int:
        """Number of voxels V [–]."""
        return int(np.prod(self.shape))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> CaseSpec:
        """Inverse of `dataclasses.asdict`, through JSON."""
        lists = {key: tuple(values[key]) for key in ("trajectories", "shape")}
        return cls(**{**values, **lists})

    def scene(self) -> Scene:
        """Read the files and assemble the scene.

        Raises:
            InputError: An invalid file or number.
        """
        shell = PointShell.from_spec(
            self.probe, n_points=self.n_points, unit=self.probe_unit
        )
        recording = perturbed(self._thinned(), self.perturbation)
        return self.build(Surface.load(self.surface), shell, recording)

    def small(self) -> CaseSpec:
        """The same with few voxels, for warm-up and validation."""
        shape = tuple(map(min, self.shape, SMALL_SHAPE))
        return replace(self, shape=shape, n_poses=SMALL_POSES, n_points=300)

    def perturbed(self, how: str) -> CaseSpec:
        """The same with perturbed wrenches, and a name that says so.

        Raises:
            InputError: Not in `PERTURBATIONS`, nor "".
        """
        chosen([how] * bool(how), PERTURBATIONS, "perturbation", every="")
        return self._with("perturbation", how or self.perturbation)

    def _with(self, name: str, value: str, **others: Any) -> CaseSpec:
        """The same with another value, in its name, and others that follow."""
        if value == getattr(self, name):
            return self
        changed: Any = {**others, name: value}
        return replace(self, name=f"{self.name}-{value}", **changed)

    def bounded(self, boundary: str) -> CaseSpec:
        """The same with another boundary, and a name that says so.

        Raises:
            InputError: An unknown boundary.
        """
        expect_one_of(boundary, get_args(Boundary), "boundary")
        return self._with("boundary", boundary)

    def sampled(self, sampling: str) -> CaseSpec:
        """The same with another sampling, and a name that says so.

        The value on the inner layer is then fitted, because the unit of the potential
        depends on the sampling.

        Raises:
            InputError: An unknown sampling.
        """
        check_sampling(sampling)
        return self._with("sampling", sampling, inner="fit", outer=1.0)

    def _thinned(self) -> Trajectory:
        whole = Trajectory.concatenate([read_trajectory(p) for p in self.trajectories])
        if self.n_poses is None or self.n_poses >= len(whole):
            return whole
        picked = np.linspace(0, len(whole) - 1, self.n_poses).round().astype(np.int64)
        return whole.select(picked)


def reference_cases(names: str = "all") -> list[CaseSpec]:
    """Reference cases by name, smallest first.

    Args:
        names: "S", "M", "L" or "XL", several separated by commas, or "all", which
            leaves out `ON_REQUEST`.

    Raises:
        InputError: An unknown case.
    """
    asked = [name.strip() for name in names.split(",")]
    if "all" in asked:
        asked += [name for name in REFERENCE if name not in ON_REQUEST]
    unknown = [name for name in asked if name not in (*REFERENCE, "all")]
    if unknown:
        raise InputError(
            f"unknown case {unknown[0]!r}: choose {', '.join(REFERENCE)} or all, or "
            "give a scene of your own with --surface, --probe and --trajectory"
        )
    return [
        CaseSpec(
            shape,
            inner=EXAMPLE_BOUNDARY,
            outer=EXAMPLE_BOUNDARY,
            name=case,
            surface=str(example.path("surface.nc")),
            probe=example.PROBE,
            trajectories=tuple(str(example.path(f"{name}.csv")) for name in RECORDED),
            n_poses=poses,
        )
        for case, (shape, poses) in REFERENCE.items()
        if case in asked
    ]


def with_new_values(scene: Scene, seed: int) -> Scene:
    """The scene with the same matrices, forces and torques changed by `CHANGE`."""
    rng = np.random.default_rng(seed)
    trajectory = scene.trajectory
    changed = {
        name: values * (1.0 + CHANGE * rng.standard_normal(values.shape))
        for name in ("force", "torque")
        if (values := getattr(trajectory, name)) is not None
    }
    return replace(scene, trajectory=replace(trajectory, **changed))


def existing(case: CaseSpec) -> CaseSpec:
    """The case with absolute paths.

    Raises:
        FileError: A file is missing or empty.
    """

    def absolute(path: str, what: str) -> str:
        return str(existing_file(path, what).resolve())

    return replace(
        case,
        surface=absolute(case.surface, "surface"),
        probe=case.probe if ":" in case.probe else absolute(case.probe, "probe"),
        trajectories=tuple(absolute(path, "trajectory") for path in case.trajectories),
    )


def perturbed(trajectory: Trajectory, how: str) -> Trajectory:
    """A recording with perturbed wrenches, the same at every call.

    The example's recordings are consistent with sign and monotonicity: no bound is
    active, and solvers have no constraints to handle. Perturbed values make tens to
    hundreds of limits active, at weights high enough for the field to follow them.

    Args:
        trajectory: A trajectory with wrenches.
        how: ``noise`` adds Gaussian noise to every force and torque, ``reversed``
            changes the sign in a fifth of the frames; "" does nothing.

    Raises:
        InputError: An unknown perturbation, or no wrenches.
    """
    if not chosen([how] * bool(how), PERTURBATIONS, "perturbation", every=""):
        return trajectory
    force, torque = trajectory.force, trajectory.torque
    if force is None or torque is None:
        raise InputError(
            f"perturbation {how!r} changes measured wrenches, but the trajectory has "
            "none: add columns fx, fy, fz, tx, ty, tz"
        )
    rng = np.random.default_rng(SEED)
    if how == "noise":
        return replace(
            trajectory,
            force=force + rng.normal(0.0, FORCE_NOISE, force.shape),
            torque=torque + rng.normal(0.0, TORQUE_NOISE, torque.shape),
        )
    count = max(1, round(REVERSED_PART * len(trajectory)))
    sign = np.ones((len(trajectory), 1))
    sign[rng.choice(len(trajectory), count, replace=False)] = -1.0
    return replace(trajectory, force=sign * force, torque=sign * torque)
