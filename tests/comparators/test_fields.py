"""A field as a comparator renders what the package's fit and renderer do."""

import numpy as np

import ttus_opt as tt
from tests.comparators.contacts import made as on_torso
from tests.comparators.recordings import COARSE, recordings
from tests.kit import ellipsoid, torso
from ttus_opt.comparators.fields import Eq10, LaplaceOnly
from ttus_opt.contact.scene import ScenePlan


def test_it_is_the_fit_and_the_renderer():
    press, slide = recordings()
    made = on_torso(Eq10, **COARSE).fit(press)
    assert made.parameters()["boundary_scale"] > 0.0
    plan = ScenePlan(shape=COARSE["shape"], r_inner=0.03, inner="fit")
    scene = plan.build(torso(), ellipsoid(), press)
    solution = tt.fit(scene, "eq10", force_weight=1.0, torque_weight=1.0)
    renderer = tt.Renderer(solution.field, ellipsoid())
    for t in range(0, len(slide), 7):
        pose = slide.rotation[t], slide.position[t]
        found, expected = made.render(*pose), renderer.render(*pose)
        np.testing.assert_allclose(found.force, expected.force, atol=1e-9)
        np.testing.assert_allclose(found.torque, expected.torque, atol=1e-10)


def test_laplace_alone_is_as_large_as_fits_the_forces_best():
    """Wrenches are linear in the boundary value: no other is nearer."""
    press, _ = recordings()
    made = on_torso(LaplaceOnly, **COARSE).fit(press)
    found = made.wrenches(press)[:, :3]
    touching = np.abs(found).any(axis=1)
    f, g = press.force[touching], found[touching]
    best = float((f * g).sum() / (g * g).sum())
    assert abs(best - 1.0) < 0.05


def test_before_a_fit_nothing_is_known():
    assert on_torso(LaplaceOnly).parameters() == {}
