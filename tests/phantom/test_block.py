"""The physics against Hertz's contact of a sphere with a half-space."""

import functools

import numpy as np
import pytest

from tests.phantom.block import hertz_force, soft_block
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.elasticity import skin_compliance
from ttus_opt.phantom.press import press
from ttus_opt.phantom.probe import EllipsoidProbe

RADIUS, YOUNG, POISSON = 0.05, 15e3, 0.45
SPHERE = EllipsoidProbe((RADIUS,) * 3)


@functools.cache
def block_patch(pitch):
    return skin_compliance(soft_block(0.12, pitch, 0.012, YOUNG, POISSON))


def pressed(pitch, depth, shift=(0.0, 0.0)):
    position = np.array([shift[0] * pitch, shift[1] * pitch, RADIUS - depth])
    return press(block_patch(pitch), SPHERE, np.eye(3), position)


def hertz_error(pitch, depth=8e-4):
    """Relative error of the force, mean over where the nodes lie to the sphere."""
    shifts = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.25, 0.25)]
    forces = np.array([pressed(pitch, depth, s).force[2] for s in shifts])
    return forces / hertz_force(depth, RADIUS, YOUNG, POISSON) - 1.0


@pytest.mark.slow
def test_force_converges_to_hertz_with_refinement():
    # Contact radius 6.3 mm: 1.6, 2.1 and 2.6 nodes per radius.
    errors = [hertz_error(pitch) for pitch in (4e-3, 3e-3, 2.4e-3)]
    means = [abs(e.mean()) for e in errors]
    assert means[0] > means[1] > means[2]
    assert means[2] < 0.025
    assert np.abs(errors[2]).max() < 0.03
    order = np.log(means[0] / means[2]) / np.log(4.0 / 2.4)
    assert order > 1.5


@pytest.mark.slow
def test_force_is_normal_and_the_torque_of_a_centred_sphere_vanishes():
    contact = pressed(4e-3, 8e-4)
    assert np.abs(contact.force[:2]).max() < 1e-9 * contact.force[2]
    assert np.abs(contact.torque).max() < 1e-9 * contact.force[2]


def test_refuses_a_patch_wider_than_the_block():
    with pytest.raises(InputError, match="cannot hold a patch"):
        soft_block(0.02, 1e-3, 0.02, YOUNG, POISSON)
