"""The shelf of formulations: what every file there says and takes."""

import ast
import importlib
import inspect
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import formulations
from tests.kit import InputError, refuses, small_scene
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.formulation import available, load

SCENE = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)
FITTED = Scene.assemble(SCENE.voxmap, SCENE.shell, SCENE.trajectory, inner="fit")
NAMES = [info.name for info in available()]
EXPECTED = {
    "anisotropic": ("anisotropic", "force", "torque"),
    "coulomb_drag": (
        "laplace",
        "drag_smoothness",
        "force",
        "torque",
        "drag_sign",
        "drag_limit",
        "mean_friction",
    ),
    "coulomb_global": ("laplace", "force", "torque"),
    "depth_map": ("depth_map", "force", "torque"),
    "depth_map_coulomb": ("depth_map", "force", "torque"),
    "depth_map_residual": ("laplace_residual", "force", "torque"),
    "eq10": ("laplace", "force", "torque"),
    "eq10_hard_boundary": ("laplace", "force", "torque", "boundary"),
    "eq10_monotone": ("laplace", "force", "torque", "monotone"),
    "eq10_sign": ("laplace", "force", "torque", "sign"),
    "eq10_sign_monotone": ("laplace", "force", "torque", "sign", "monotone"),
    "free_surface": ("laplace_free_surface", "force", "torque", "nonnegative"),
    "laplace_only": ("laplace",),
    "robust": ("laplace", "robust_force", "torque"),
    "screened": ("screened", "force", "torque"),
    "sparse_sources": ("sparse_sources", "force", "torque", "boundary"),
    "tikhonov": ("laplace", "tikhonov", "force", "torque"),
    "total_variation": ("total_variation", "force", "torque", "boundary"),
    "viscous_drag": ("laplace", "force", "torque", "viscous_sign"),
    "volume_weighted": ("volume_weighted", "force", "torque", "boundary"),
}


def members(name, **options):
    declared = load(name, SCENE, **options)
    return (
        *(term.name for term in declared.terms),
        *(constraint.name for constraint in declared.constraints),
    )


def test_the_shelf_has_these_at_least():
    assert set(EXPECTED) <= set(NAMES)


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_a_formulation_is_made_of(name):
    assert members(name) == EXPECTED[name]


def test_the_shelf_of_the_manual_has_them_all():
    page = Path(__file__).parents[2] / "docs" / "method" / "formulations.md"
    shelf = page.read_text(encoding="utf-8").split("### 8.3")[1].split("\n### ")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", shelf, re.M)) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_file_states_the_mathematics_and_its_source(name):
    module = importlib.import_module(f"formulations.{name}")
    doc = inspect.getdoc(module)
    assert doc is not None
    assert "min_" in doc, "the docstring states the problem: min_p ‖L p - b‖² + …"
    assert "Source" in doc or name == "laplace_only", "the docstring names its source"
    assert inspect.getdoc(module.build)


@pytest.mark.parametrize("name", NAMES)
def test_a_file_is_short_and_knows_no_solver(name):
    path = Path(formulations.__path__[0]) / f"{name}.py"
    text = path.read_text()
    assert len(text.splitlines()) < 70
    imported = [
        node.module or ""
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
    ]
    assert not [m for m in imported if "solvers" in m or ".fit" in m]


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"laplace_only"}))
def test_weights_reach_the_measured_rows(name):
    declared = load(
        name, SCENE, force_weight=0.25, torque_weight=0.125, torque_length=0.02
    )
    weights = {term.name: term.weight for term in declared.terms}
    force = "robust_force" if name == "robust" else "force"
    assert (weights[force], weights["torque"]) == (0.25, 0.125)
    torque = next(term for term in declared.terms if term.name == "torque")
    assert torque.length == 0.02
    assert "0.25" in str(declared)


@pytest.mark.parametrize("name", NAMES)
def test_a_boundary_scale_is_listed_where_boundary_values_count(name):
    """Targets and limits of twice the boundary values tell whether they do."""
    scene = replace(SCENE, parameters={"boundary_scale": 2.0})
    declared = load(name, scene)
    double = load(name, scene.with_boundary(2.0 * scene.inner, 2.0 * scene.outer))
    one, two = declared.compile(), double.compile()
    vectors = [
        *zip((t.target for t in one.terms), (t.target for t in two.terms), strict=True),
        *zip(
            (c.lower for c in one.constraints),
            (c.lower for c in two.constraints),
            strict=True,
        ),
    ]
    counts = not all(np.array_equal(a, b) for a, b in vectors)
    values = one.split(np.zeros(one.n_variables))
    assert ("boundary_scale" in declared.parameters(values)) == counts
    assert counts == (not name.startswith("depth_map"))


@pytest.mark.parametrize(
    ("name", "own"), [("total_variation", "variation"), ("sparse_sources", "sparsity")]
)
def test_torques_alone_have_a_prior(name, own):
    """Without one a field of 28,746 N/cm² was an optimum, after 20 s."""
    alone = load(name, SCENE, force_weight=0.0, torque_weight=0.25)
    assert alone.terms[0].weight == 0.75
    assert load(name, SCENE, force_weight=0.5).terms[0].weight == 1.5
    refuses(InputError, f"{own} must not be 0", load, name, SCENE, **{own: 0.0})
    nothing = fit(SCENE, name, force_weight=0.0, torque_weight=0.0)
    laplace_field = SCENE.laplace.solve(SCENE.b)
    np.testing.assert_allclose(nothing.field.values.ravel(), laplace_field, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_a_formulation_goes_to_another_process(name):
    """With its searches, those within them too, and what was changed of it."""
    last = load(name, FITTED).terms[-1].name
    declared = load(name, FITTED).with_weights(**{last: 0.5})
    twins = pickle.loads(pickle.dumps(declared)), declared
    while declared.search is not None:
        twins = tuple(one.search.build(0.7) for one in twins)
        declared = twins[1]
    assert str(twins[0]) == str(declared)
    np.testing.assert_array_equal(*(t.terms[-1].assembled.target for t in twins))
