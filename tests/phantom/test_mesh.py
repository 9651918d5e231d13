import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.phantom.block import box_mesh
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.torso import graded, ring_mesh


def volume(mesh):
    from skfem import Basis, ElementHex1

    return float(Basis(mesh, ElementHex1(), intorder=3).dx.sum())


#: Beside the fine part: none, or more than the rounding of its ends
_MARGIN = st.just(0.0) | st.floats(1e-6, 5)


@settings(max_examples=60, deadline=None)
@given(
    low=st.floats(-10, 0),
    left=_MARGIN,
    width=st.floats(0.5, 5),
    right=_MARGIN,
    step=st.floats(0.05, 0.5),
    growth=st.floats(1.05, 2.0),
)
def test_graded_nodes_span_the_interval_and_grow_smoothly(
    low, left, width, right, step, growth
):
    fine = (low + left, low + left + width)
    nodes = graded(low, fine[1] + right, fine, step, growth)
    steps = np.diff(nodes)
    assert nodes[0] == low and nodes[-1] == fine[1] + right
    assert (steps > 0.0).all()
    inside = (nodes[:-1] >= fine[0] - 1e-9) & (nodes[1:] <= fine[1] + 1e-9)
    assert np.ptp(steps[inside]) < 1e-9
    assert steps[inside].mean() <= 1.6 * step


def test_ring_is_closed_and_has_the_volume_of_a_pipe():
    def pipe(f, theta, z):
        r = 1.0 + f
        return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)

    theta = np.linspace(0.3, 0.3 + 2 * np.pi, 65)
    mesh = ring_mesh(np.linspace(0, 1, 4), theta, np.linspace(0, 2, 3), pipe)
    assert mesh.p.shape == (3, 4 * 64 * 3)
    # A regular 64-gon instead of the circle.
    polygon = 32 * np.sin(2 * np.pi / 64)
    assert volume(mesh) == pytest.approx((4 - 1) * polygon * 2.0, rel=1e-9)
    # Faces on the outside only: inner, outer and two ends, none at the seam.
    assert len(mesh.boundary_facets()) == 2 * 64 * 2 + 2 * 64 * 3


def test_box_has_its_volume():
    mesh = box_mesh(np.array([0.0, 1, 3]), np.array([0.0, 2]), np.array([0.0, 1, 2]))
    assert volume(mesh) == pytest.approx(12.0)


def test_refuses_bad_gradings_and_open_rings():
    refuses(InputError, "cannot grade", graded, 0.0, 1.0, (0.5, 2.0), 0.1)
    refuses(InputError, "cannot grade", graded, 0.0, 1.0, (0.2, 0.5), 0.0)
    with pytest.raises(InputError, match="full turn"):
        ring_mesh(np.arange(3.0), np.linspace(0, 6, 9), np.arange(3.0), None)
