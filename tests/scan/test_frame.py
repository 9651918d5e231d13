"""The patient frame: rigid, written and read back, and the plane it stands on."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from tests.scan.test_frame_estimate import bed, body, no_bed, rotation
from ttus_opt.scan import frame
from ttus_opt.scan.supporting_plane import SupportingPlane


def test_there_and_back():
    rng = np.random.default_rng(0)
    axis = tt.Axis(rng.standard_normal(3), rotation(rng))
    points = rng.standard_normal((20, 3))
    np.testing.assert_allclose(axis.to_scan(axis.to_patient(points)), points)
    np.testing.assert_allclose(axis.to_patient(axis.origin[None]), 0, atol=1e-15)
    np.testing.assert_allclose(
        axis.to_scan(np.array([[0, 0, 1.0]]))[0], axis.origin + axis.rotation[:, 2]
    )


@pytest.mark.parametrize(
    "matrix",
    [
        2 * np.eye(3),
        np.diag([1.0, 1, 1.0001]),
        np.diag([1.0, 1, -1]),
        np.full((3, 3), np.nan),
    ],
)
def test_no_rotation_is_refused(matrix):
    refuses(InputError, "not a rotation", tt.Axis, np.zeros(3), matrix)


def test_wrong_shapes_are_refused():
    refuses(InputError, r"origin \(3,\)", tt.Axis, np.zeros(2), np.eye(3))


@pytest.mark.slow
def test_the_supporting_plane_is_found_once(monkeypatch):
    """It stays in the frame: extraction looks for none, and leaves the bed out."""
    rng = np.random.default_rng(0)
    cloud = np.concatenate([body(rng, upper=False, n=8000), bed(rng, 6000)])
    axis, given = tt.Axis.from_cloud(cloud), tt.Axis.identity()
    plane = axis.support
    assert isinstance(plane, SupportingPlane)
    assert plane.normal[1] > 0.999
    expected = tt.extract_surface(cloud, axis=axis, support=plane, n_theta=36, n_z=8)
    looks = []

    def looked(cloud):
        looks.append(cloud)
        return plane

    monkeypatch.setattr(frame, "find_supporting_plane", looked)
    found = tt.extract_surface(cloud, axis=axis, n_theta=36, n_z=8)
    np.testing.assert_array_equal(found.radius, expected.radius)
    assert not looks
    assert given.support == "unknown"
    assert given.supporting_plane(cloud) is plane  # a frame that was given looks
    assert len(looks) == 1
    no_bed(monkeypatch)
    assert tt.Axis.from_cloud(body(rng, upper=False, n=8000)).support is None


def test_it_is_written_with_its_origin_and_direction():
    turned = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    shown = repr(tt.Axis(np.array([0.012, -0.3, 1.0]), turned))
    assert "(1.2, -30.0, 100.0) cm" in shown
    assert "z along (1.00, 0.00, 0.00)" in shown
