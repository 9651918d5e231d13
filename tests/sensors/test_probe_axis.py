"""The patient frame from a probe held above the sternum."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import GeometryError, InputError, refuses
from ttus_opt.sensors.probe_axis import axis_from_probe

#: Probe to a scan whose axes are right, front, head: x to the left, y to the feet
HELD = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])


def scan(rng):
    """Half an ellipsoid, 0.22 m deep, on a bed."""
    u = rng.normal(size=(12_000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    u[:, 1] = np.abs(u[:, 1])
    body = u * [0.17, 0.22, 0.35]
    bed = np.stack(
        [rng.uniform(-0.4, 0.4, 8000), np.zeros(8000), rng.uniform(-0.5, 0.5, 8000)], 1
    )
    return np.concatenate([body, bed]) + 0.001 * rng.standard_normal((20_000, 3))


def probe(n=5, rotation=HELD, at=None):
    rng = np.random.default_rng(1)
    shake = Rotation.from_rotvec(0.004 * rng.standard_normal((n, 3))).as_matrix()
    position = np.array([0.0, 0.24, 0.05]) if at is None else at
    return tt.Trajectory(
        np.arange(float(n)),
        position + 0.0005 * rng.standard_normal((n, 3)),
        shake @ rotation,
    )


def test_axes_and_origin_as_stated():
    cloud = scan(np.random.default_rng(0))
    axis = axis_from_probe(probe(), cloud)
    np.testing.assert_allclose(axis.rotation, np.eye(3), atol=0.01)
    skin = 0.22 * np.sqrt(1 - (0.05 / 0.35) ** 2)
    np.testing.assert_allclose(axis.origin, [0, skin / 2, 0.05], atol=0.004)
    deep = axis_from_probe(probe(), cloud, depth=0.08)
    np.testing.assert_allclose(deep.origin, [0, skin - 0.08, 0.05], atol=0.004)
    assert axis.supporting_plane(cloud) is not None


@pytest.mark.parametrize(
    ("held", "columns"),
    [
        (("z", "-y"), HELD),
        (("-z", "x"), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])),
        (("y", "z"), np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])),
    ],
)
def test_other_ways_of_holding(held, columns):
    assert np.linalg.det(columns) == pytest.approx(1.0)
    axis = axis_from_probe(
        probe(rotation=columns), scan(np.random.default_rng(0)), held=held
    )
    np.testing.assert_allclose(axis.rotation, np.eye(3), atol=0.01)


@pytest.mark.parametrize("seed", [0, 1])
def test_turned_and_shifted_with_the_scan(seed):
    """However scan and probe lie in their frame, the patient frame is the same."""
    rng = np.random.default_rng(seed)
    cloud = scan(np.random.default_rng(0))
    R, t = Rotation.random(rng=rng).as_matrix(), rng.uniform(-1, 1, 3)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = R, t
    still = axis_from_probe(probe(), cloud)
    turned = axis_from_probe(probe().transformed(motion), cloud @ R.T + t)
    np.testing.assert_allclose(turned.rotation, R @ still.rotation, atol=1e-6)
    # the plane of the bed is found by trials
    np.testing.assert_allclose(turned.origin, R @ still.origin + t, atol=2e-3)


@pytest.mark.slow
def test_refusals():
    cloud = scan(np.random.default_rng(0))
    for held in (("z", "z"), ("z", "-z")):
        refuses(InputError, "same axis", axis_from_probe, probe(), cloud, held=held)
    with pytest.raises(InputError, match="each one of"):
        axis_from_probe(probe(), cloud, held=("down", "x"))
    for depth in (0.0, 80.0, float("nan")):
        refuses(InputError, "give metres", axis_from_probe, probe(), cloud, depth=depth)
    with pytest.raises(GeometryError, match="no skin"):
        axis_from_probe(probe(at=np.array([2.0, 0, 0])), cloud)
    with pytest.raises(GeometryError, match="180° off"):
        axis_from_probe(probe(), cloud, held=("-z", "-y"))
    still = probe()
    walked = tt.Trajectory(
        still.time, still.position + 0.02 * still.time[:, None], still.rotation
    )
    refuses(InputError, "held still", axis_from_probe, walked, cloud)
    with pytest.raises(InputError, match="give the origin's depth"):
        axis_from_probe(probe(), cloud[:12_000])
    side = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    beside = probe(rotation=side, at=np.array([0.25, 0.1, 0.0]))
    refuses(GeometryError, "another axis meant", axis_from_probe, beside, cloud)
