"""What a simulated patient's tissue answers: finite elements, or a field.

The example's torso is linear elasticity (`ttus_opt.phantom`): a contact at a pose takes
less than a millisecond and no mesh, as its compliance is bundled, made on a mesh twice
as coarse as that of the example's recordings. Below any other skin and probe it is a
field of this package's own kind, so that a model can learn all of it.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ttus_opt import example
from ttus_opt.contact.friction import FRICTION
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError
from ttus_opt.fitting.recursion.recursive_depth_map import usual_sampling
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.press import CoulombDrag, Motion, press
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms.depth_profile import DepthProfile, voxel_depths
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

#: Law of the torso's mean force below the example's probe, as a fit of its recordings
#: gives it: what a prior's error is counted from
TORSO_LAW = DepthProfile((1.2,), (6.0,))

#: Of tissue below any skin: voxels, finer than those of a live model; how much its
#: stiffness varies about the law [–], in waves of this length [m]
FINE, VARIES, WAVE = (48, 120, 60), 0.3, 0.08


@cache
def bundled_patch() -> SkinPatch:
    """The bundled torso's skin and compliance."""
    with np.load(example.path("skin.npz")) as stored:
        lower, n = stored["compliance"], len(stored["points"])
        compliance = np.zeros((n, n))
        compliance[np.tril_indices(n)] = lower
        compliance += np.tril(compliance, -1).T
        return SkinPatch(stored["points"], stored["normals"], stored["rim"], compliance)


class ElasticTorso:
    """The example's torso and ellipsoid, by finite elements."""

    def __init__(self, friction: float = 0.0) -> None:
        """A torso whose skin has a Coulomb coefficient ``friction`` [–]."""
        self._patch, self._drag = bundled_patch(), CoulombDrag(friction)
        self._probe = EllipsoidProbe((0.030, 0.0125, 0.018))

    def wrench(self, rotation: Array, position: Array, velocity: Array) -> Array:
        """Force, then torque of the patient at rest without noise, (6,) [N, N·m].

        None beside the patch, or too deep for linear elasticity.

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            position: Its origin, patient frame, shape (3,) [m].
            velocity: Of that origin, shape (3,) [m/s].
        """
        try:
            contact = press(
                *(self._patch, self._probe, rotation, position),
                motion=Motion(velocity, np.zeros(3)),
                drag=self._drag,
            )
        except GeometryError:
            return np.zeros(6)
        return np.concatenate([contact.force, contact.torque])


class FieldTissue:
    """Tissue whose forces are those of a field."""

    def __init__(self, field: PotentialField, shell: PointShell) -> None:
        self._renderer = Renderer(field, shell)

    @classmethod
    def below(
        cls, surface: Surface, shell: PointShell, friction: float = 0.0
    ) -> FieldTissue:
        """Tissue below any skin: `TORSO_LAW`, by `VARIES` stiffer here, softer there.

        Args:
            surface: The skin.
            shell: The probe.
            friction: Coulomb coefficient [–].
        """
        inner = min(0.03, 0.5 * float(surface.radius.min()))
        voxmap = Voxmap.from_surface(surface, shape=FINE, r_inner=inner)
        theta, z = np.meshgrid(voxmap.grid.theta, voxmap.grid.z, indexing="ij")
        turns = np.round(2.0 * np.pi * surface.radius.mean() / WAVE)
        waves = np.sin(turns * theta) * np.sin(2.0 * np.pi / WAVE * z)
        values = voxmap.grid.unflatten(TORSO_LAW(voxel_depths(voxmap)))
        stated = {FRICTION: friction} if friction > 0.0 else {}
        share = 1.0 + VARIES * waves
        field = PotentialField(
            voxmap, share * values, usual_sampling(shell), stated, {}
        )
        return cls(field, shell)

    def wrench(self, rotation: Array, position: Array, velocity: Array) -> Array:
        """As `ElasticTorso.wrench`."""
        twist = np.concatenate([velocity, np.zeros(3)])
        felt = self._renderer.render(rotation, position, twist)
        return np.concatenate([felt.force, felt.torque])


#: What a probe that touches the patient at rest feels
Tissue = ElasticTorso | FieldTissue
