"""What the dual reads of a program: its minimiser is that of dense least squares."""

from tests.kit import small_scene
from ttus_opt.problem import formulation

SCENE = small_scene("trilinear", shape=(5, 8, 5), n_poses=4)


def compiled(name):
    return formulation.load(name, SCENE, force_weight=3.0, torque_weight=2.0).compile()


def test_priors_that_are_none():
    assert compiled("total_variation").laplace_prior is None
    plain, weighted = compiled("eq10"), compiled("volume_weighted")
    prior, scaled = plain.laplace_prior, weighted.laplace_prior
    assert prior.laplace_rows.scale is None and plain.dirichlet is None
    scale, values = scaled.laplace_rows.scale, weighted.dirichlet.lower
    assert scale is not None and (scale > 0.0).all()
    assert values is not None and len(values) == int((~SCENE.laplace.free).sum())
