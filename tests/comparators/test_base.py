"""What the base class checks and fits, against least squares."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.comparators.contacts import made as on_torso
from tests.comparators.recordings import facing, recordings
from tests.kit import InputError, ellipsoid, refuses, torso
from ttus_opt.comparators.base import LEAST_FORCE, OneStiffness, positive_scale
from ttus_opt.probe.trajectory import Trajectory


class Straight(OneStiffness):
    """A unit force away from the axis wherever the probe is."""

    name = "straight"

    def _unit_wrench(self, R, at):
        out = at * [1.0, 1.0, 0.0]
        return np.concatenate([out / np.linalg.norm(out), np.zeros(3)]), 1


def test_the_scale_is_that_of_least_squares():
    rng = np.random.default_rng(0)
    shape = rng.normal(size=(20, 3))
    force = 3.0 * shape + rng.normal(size=(20, 3))
    expected, *_ = np.linalg.lstsq(shape.reshape(-1, 1), force.ravel(), rcond=None)
    assert positive_scale(shape, force, "it") == pytest.approx(expected[0])


def test_a_scale_that_would_pull_or_says_nothing_is_refused():
    shape = np.eye(3)
    with pytest.raises(InputError, match="it: the measured forces pull"):
        positive_scale(shape, -shape, "it")
    with pytest.raises(InputError, match="it: the measured forces pull"):
        positive_scale(shape, np.roll(shape, 1, axis=0), "it")
    refuses(InputError, "in no frame", positive_scale, 0.0 * shape, shape, "it")


def test_one_stiffness_is_the_mean_force_along_the_shape():
    made = on_torso(Straight)
    press, _ = recordings()
    assert repr(made) == "<straight: not fitted>"
    assert repr(made.fit(press)) == "<straight: fitted>"
    out = press.position * [1.0, 1.0, 0.0]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    mean = float(np.einsum("ti,ti->t", out, press.force).mean())
    assert made.parameters() == {"stiffness [N/m³]": pytest.approx(mean)}
    R, at = facing(torso(), 1.0, 0.1, 0.003)
    found = made.render(R, at)
    np.testing.assert_allclose(np.linalg.norm(found.force), mean)
    np.testing.assert_array_equal(found.torque, np.zeros(3))


def test_forces_too_small_to_be_contact_are_told():
    made = on_torso(Straight)
    press, _ = recordings()
    largest = float(np.linalg.norm(press.force, axis=1).max())
    for share, enough in ((0.99, False), (1.01, True)):
        faint = replace(press, force=press.force * (share * LEAST_FORCE / largest))
        if enough:
            assert made.fit(faint).fitted
        else:
            refuses(InputError, r"no force is above 0\.1 N", made.fit, faint)


@pytest.mark.parametrize(
    ("cloud", "words"),
    [
        (np.zeros((9, 3)), r"at least 10 points .*\(9, 3\)"),
        (np.zeros((20, 2)), r"at least 10 points .*\(20, 2\)"),
        (np.full((20, 3), np.nan), "NaN or infinite"),
    ],
)
def test_a_cloud_that_is_none_is_told(cloud, words):
    refuses(InputError, words, on_torso, Straight, cloud=cloud)


def test_without_a_cloud_the_surface_s_own_points_are_it():
    made = on_torso(Straight)
    np.testing.assert_array_equal(made.cloud, torso().points().reshape(-1, 3))


@pytest.mark.parametrize("turned", [True, False])
def test_contact_is_judged_with_the_probe_as_it_is_turned(turned):
    """A probe of 30 × 10 × 10 mm points 25 mm inwards, or aside and touches nothing."""
    shell, surface = ellipsoid(300, (0.03, 0.01, 0.01)), torso()
    theta = 1.0
    out = np.array([np.cos(theta), np.sin(theta), 0.0])
    at = (float(surface.radius_at(theta, 0.1)) + 0.025) * out + [0.0, 0.0, 0.1]
    angle = theta if turned else -theta
    R = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    own = Trajectory(
        np.arange(3.0), np.tile(at, (3, 1)), np.tile(R, (3, 1, 1)), np.tile(out, (3, 1))
    )
    made = Straight(surface=surface, shell=shell)
    if turned:
        made._require_contact(own, np.tile(out, (3, 1)))
    else:
        with pytest.raises(InputError, match="touches the surface in no frame"):
            made._require_contact(own, np.tile(out, (3, 1)))
