"""The paper's choices: its numbers, and that what takes them takes them."""

import pytest

import ttus_opt as tt
from tests.kit import ellipsoid, small_scene
from ttus_opt import paper


def test_they_are_what_the_paper_says():
    assert paper.SCENE == {"inner": 1.0, "outer": 1.0, "sampling": "voxel-mean"}
    assert paper.WEIGHTS == {"force_weight": 1e-4, "torque_weight": 1e-4}


def test_scene_and_formulation_take_them():
    told = small_scene()
    scene = tt.Scene.assemble(told.voxmap, ellipsoid(), told.trajectory, **paper.SCENE)
    assert (scene.sampling, scene.inner, scene.outer) == ("voxel-mean", 1.0, 1.0)
    declared = tt.load_formulation("eq10", scene, **paper.WEIGHTS)
    weights = {term.name: term.weight for term in declared.compile().terms}
    assert weights["force"] == weights["torque"] == 1e-4


def test_nobody_changes_them_for_others():
    with pytest.raises(TypeError):
        paper.SCENE["inner"] = 2.0
