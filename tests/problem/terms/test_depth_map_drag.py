"""Where drag acts, of contacts whose Laplace field says something else."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene
from ttus_opt import example
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.problem.terms import depth_map_drag
from ttus_opt.problem.terms.depth_map_drag import estimate_dragged
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.problem.terms.drag_estimate import alike_drag

MU = 0.3


def of_depth(acts_at):
    """Forces and torques of p = 60 d² with drag, which no Laplace field explains."""
    scene = dragged_scene(acts_at)
    p = 6e3 * np.maximum(voxel_depths(scene.voxmap), 0.0) ** 2
    drag = tt.terms.GlobalCoulomb(scene, acts_at, coefficient=MU).rows
    rng = np.random.default_rng(0)
    force = (scene.N - MU * drag.force) @ p
    force += rng.normal(0.0, 0.01, len(force))
    torque = (scene.W - MU * drag.torque) @ p
    measured = replace(
        scene.trajectory, force=force.reshape(-1, 3), torque=torque.reshape(-1, 3)
    )
    return Scene.assemble(scene.voxmap, scene.shell, measured, sampling=scene.sampling)


@pytest.mark.parametrize("acts_at", ["contact", "reference", "points"])
def test_evidence_finds_where_drag_acts(acts_at, monkeypatch):
    """Among all, whatever the Laplace field says of them."""
    scene = of_depth(acts_at)
    monkeypatch.setattr(
        depth_map_drag, "alike_drag", lambda *where: alike_drag(*where, alike=np.inf)
    )
    drag, found = estimate_dragged(scene)
    assert drag.acts_at == acts_at
    rows = scene.N - drag.friction_coefficient * drag.drag.rows.force
    assert found.log_evidence == estimate_depth_map(scene, rows).log_evidence


def test_what_the_laplace_field_tells_apart_is_not_asked_again():
    scene = dragged_scene("contact")  # of a Laplace field, without noise
    (only,) = alike_drag(scene)
    assert only.acts_at == "contact"
    every = alike_drag(scene, alike=np.inf)
    assert every[0].misfit == min(one.misfit for one in every) and len(every) > 1
    assert estimate_dragged(scene, "reference")[0].acts_at == "reference"
    with pytest.raises(InputError, match="acts_at must be one of auto"):
        estimate_dragged(scene, "handle")


def test_given_values_are_held():
    _, found = estimate_dragged(dragged_scene("contact"), depth_length=0.02)
    assert found.depth_length == 0.02


@pytest.mark.slow
def test_the_example_drags_where_its_sweep_does():
    """Drag of the whole patch; a Laplace field takes it for that of every point."""
    surface = tt.Surface.load(example.path("surface.nc"))
    plan = ScenePlan((16, 48, 20), sampling="contact-size")
    names = "press_fit.csv", "sweep_drag_fit.csv"
    recordings = [tt.read_trajectory(example.path(name)) for name in names]
    shell = tt.PointShell.from_spec(example.PROBE)
    scene = plan.build(surface, shell, recordings)
    assert [one.acts_at for one in alike_drag(scene)] == ["points", "contact"]
    assert estimate_dragged(scene)[0].acts_at == "contact"
