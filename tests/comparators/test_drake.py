"""Pressure field contact against drake's hydroelastic contact, where installed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.comparators.walls import RADIUS, wall
from ttus_opt.comparators.pressure_field import PressureField
from ttus_opt.probe.point_shell import PointShell

pytest.importorskip("pydrake", reason="drake is not installed: pip install drake")

SEMI_AXES = (0.030, 0.0125, 0.018)

#: Young's modulus over thickness of the compliant half-space [N/m³]
STIFFNESS = 2.0e6


def drake_wrench(turn, height):
    """Wrench on a rigid ellipsoid over the half-space z < 0, about its centre."""
    from pydrake.geometry import (
        AddCompliantHydroelasticPropertiesForHalfSpace,
        AddContactMaterial,
        AddRigidHydroelasticProperties,
        Ellipsoid,
        HalfSpace,
        ProximityProperties,
    )
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import (
        AddMultibodyPlantSceneGraph,
        ContactModel,
        CoulombFriction,
    )
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    plant.set_contact_model(ContactModel.kHydroelastic)
    plant.SetUseSampledOutputPorts(False)
    tissue, probe = ProximityProperties(), ProximityProperties()
    AddCompliantHydroelasticPropertiesForHalfSpace(0.1, 0.1 * STIFFNESS, tissue)
    AddRigidHydroelasticProperties(0.001, probe)
    for material in (tissue, probe):
        AddContactMaterial(
            dissipation=0.0, friction=CoulombFriction(), properties=material
        )
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "tissue", tissue
    )
    body = plant.AddRigidBody("probe", SpatialInertia.SolidSphereWithMass(1.0, 0.02))
    plant.RegisterCollisionGeometry(
        body, RigidTransform(), Ellipsoid(*SEMI_AXES), "probe", probe
    )
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    pose = RigidTransform(RotationMatrix(turn), [0.0, 0.0, height])
    plant.SetFreeBodyPose(own, body, pose)
    results = plant.get_contact_results_output_port().Eval(own)
    info = results.hydroelastic_contact_info(0)
    found, point = info.F_Ac_W(), info.contact_surface().centroid()
    force, torque = found.translational(), found.rotational()
    # of A on the other one, whichever A is: the probe is pushed up
    sign = np.sign(force[2])
    return sign * np.concatenate(
        [force, torque + np.cross(np.array(point) - [0.0, 0.0, height], force)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [[0.0, 0.0, 0.0], [0.3, 0.2, 0.1], [-0.5, 0.4, 0.0]])
def test_an_ellipsoid_is_pushed_as_in_drake(tilt):
    turn, depth = Rotation.from_rotvec(tilt).as_matrix(), 0.006
    lowest = float(np.linalg.norm(np.array(SEMI_AXES) * turn[2]))
    expected = drake_wrench(turn, lowest - depth)
    # drake's z is our x, the direction out of the wall
    to_wall = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shell = PointShell.ellipsoid(SEMI_AXES, n_points=3000)
    at = np.array([RADIUS + lowest - depth, 0.0, 0.0])
    unit, _ = PressureField(surface=wall(), shell=shell)._unit_wrench(
        to_wall @ turn, at
    )
    found = STIFFNESS * unit.reshape(2, 3) @ to_wall
    size = np.linalg.norm(expected[:3])
    np.testing.assert_allclose(found[0], expected[:3], atol=0.02 * size)
    np.testing.assert_allclose(found[1], expected[3:], atol=0.02 * 0.018 * size)
