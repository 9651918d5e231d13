"""Formulations: declaring, combining, loading and what is refused."""

from __future__ import annotations

import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.constraints.boundary import HardBoundary
from ttus_opt.constraints.sign import Sign
from ttus_opt.errors import InputError
from ttus_opt.formulation_files import formulation_module
from ttus_opt.problem.formulation import Formulation, Search, available, load
from ttus_opt.terms.force import ForceTerm
from ttus_opt.terms.laplace import LaplaceTerm
from ttus_opt.terms.sparse_sources import SparseSourcesTerm
from ttus_opt.terms.torque import TorqueTerm

SCENE = small_scene(shape=(6, 10, 6), n_poses=5)


def eq10(weight: float = 0.1) -> Formulation:
    return Formulation([LaplaceTerm(SCENE), ForceTerm(SCENE, weight)], name="mine")


def test_repr_is_the_mathematics_with_sizes_and_weights() -> None:
    text = repr(eq10().with_constraints(Sign(SCENE), HardBoundary(SCENE)))
    fixed = int(SCENE.voxmap.dirichlet.sum())
    assert text.splitlines() == [
        "mine: minimise over p in R^360",
        "  + 1 · ‖L p − b‖²    [laplace: 360 rows]",
        "  + 0.1 · ‖N p − f‖²    [force: 15 rows]",
        "  subject to p ≥ 0 inside, p ≤ 0 outside    [sign: "
        f"{int((SCENE.voxmap.region != 0).sum())} bounds]",
        "  subject to p = b on inner, outer and surface layer and both ends    "
        f"[boundary: {fixed} rows]",
    ]


def test_repr_of_a_search_and_of_more_variables() -> None:
    text = repr(load("coulomb_global", SCENE))
    assert "searching friction_coefficient in [0, 1]" in text
    assert "p in R^360, q in R^360" in repr(load("coulomb_drag", SCENE))


def test_plus_adds_a_term_and_leaves_the_first_alone() -> None:
    first = eq10()
    both = first + TorqueTerm(SCENE, 0.2) + SparseSourcesTerm(SCENE, 0.3)
    assert [t.name for t in both.terms] == [
        "laplace",
        "force",
        "torque",
        "sparse_sources",
    ]
    assert len(first.terms) == 2
    assert both.name == "mine"


def test_weights_change_without_reassembly() -> None:
    first = eq10()
    program = first.compile()
    second = first.with_weights(force=5.0)
    again = second.compile()
    assert [t.weight for t in second.terms] == [1.0, 5.0]
    for old, new in zip(program.terms, again.terms, strict=True):
        assert new.matrix is old.matrix
        assert new.target is old.target
    with pytest.raises(InputError, match="no term 'forse', there are laplace, force"):
        first.with_weights(forse=1.0)
    with pytest.raises(InputError, match="force weight must be finite and not"):
        first.with_weights(force=-1.0)


def test_a_variants_rows_are_assembled_once() -> None:
    first = load("screened", SCENE, screening=20.0)
    first.compile()
    heavier = first.with_weights(screened=3.0)
    assert heavier.terms[0].assembled is first.terms[0].assembled


def test_combining_reaches_into_a_search() -> None:
    declared = (
        load("coulomb_global", SCENE).with_weights(force=7.0) + SparseSourcesTerm(SCENE)
    ).with_constraints(Sign(SCENE))
    assert declared.search is not None
    built = declared.search.build(0.4)
    assert [t.name for t in built.terms][-1] == "sparse_sources"
    assert built.terms[1].weight == 7.0
    assert built.constraints[0].name == "sign"


def test_combining_reaches_into_the_search_after_a_search() -> None:
    fitted = replace(SCENE, parameters={"boundary_scale": 2.0})
    declared = load("coulomb_global", fitted).with_weights(force=7.0)
    declared = declared.with_constraints(Sign(fitted))
    assert declared.search is not None
    found = declared.search.build(0.4)
    assert found.search is not None
    assert found.search.parameter == "boundary_scale"
    built = found.search.build(1.5)
    assert built.search is None
    assert built.parameters({})["boundary_scale"] == 3.0
    assert built.parameters({})["friction_coefficient"] == 0.4
    assert built.terms[1].weight == 7.0
    assert built.constraints[0].name == "sign"
    # without forces nothing tells the scale, and a given one stays
    for unknown in (
        load("coulomb_global", fitted, force_weight=0.0),
        load("coulomb_global", SCENE),
    ):
        assert unknown.search is not None
        assert unknown.search.build(0.4).search is None


@pytest.mark.parametrize("limits", [(0.0, 0.0), (1.0, 0.0), (0.0, float("inf"))])
def test_a_search_needs_a_range(limits: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="needs a range low < high"):
        Search("mu", *limits, lambda value: eq10())


def test_what_cannot_be_a_formulation() -> None:
    with pytest.raises(InputError, match="at least one term"):
        Formulation([])
    with pytest.raises(InputError, match="force appears twice"):
        eq10() + ForceTerm(SCENE)
    with pytest.raises(InputError, match="sign appears twice"):
        eq10().with_constraints(Sign(SCENE), Sign(SCENE))
    other = replace(SCENE)
    with pytest.raises(InputError, match="the same scene"):
        eq10() + TorqueTerm(other)


def test_by_name_by_path_and_as_it_is(tmp_path: Path) -> None:
    by_name = load("eq10", SCENE, force_weight=0.5)
    assert by_name.name == "eq10"
    assert by_name.terms[1].weight == 0.5
    assert load(by_name, SCENE) is by_name
    own = tmp_path / "own.py"
    own.write_text(
        "from ttus_opt.problem.formulation import Formulation\n"
        "from ttus_opt.terms.laplace import LaplaceTerm\n"
        "def build(scene, weight=2.0):\n"
        "    return Formulation([LaplaceTerm(scene, weight)])\n"
    )
    by_path = load(own, SCENE, weight=3.0)
    assert (by_path.name, by_path.terms[0].weight) == ("own", 3.0)
    np.testing.assert_array_equal(by_path.compile().terms[0].target, SCENE.b)


def test_unknown_names_and_options_say_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown formulation 'eq01', did you mean eq"):
        load("eq01", SCENE)
    with pytest.raises(InputError, match=r"there are anisotropic.*A file of your own"):
        load("xyzzy", SCENE)
    with pytest.raises(InputError, match=r"no option 'lam'.*force_weight"):
        load("eq10", SCENE, lam=1.0)
    with pytest.raises(InputError, match="not found"):
        load(tmp_path / "none.py", SCENE)
    with pytest.raises(InputError, match="cannot be given to a finished formulation"):
        load(eq10(), SCENE, force_weight=1.0)


@pytest.mark.parametrize("word", ["nan", "much", ""])
def test_a_word_where_a_number_belongs(word: str) -> None:
    """As `--option` hands on whatever is no JSON."""
    with pytest.raises(InputError, match=rf"largest_friction .* number .*'{word}'"):
        load("coulomb_drag", SCENE, largest_friction=word)


def test_a_users_file_that_raises_is_told_in_one_sentence(tmp_path: Path) -> None:
    """With its own line; the cause begins in the user's file, not in the package."""
    own = tmp_path / "broken.py"
    own.write_text("def build(scene):\n    return scene.nonsense\n")
    expected = (
        rf"build\(\) of formulation broken raised AttributeError: .*nonsense.*{own}"
    )
    with pytest.raises(InputError, match=rf"{expected}, line 2\)") as caught:
        load(own, SCENE)
    assert "\n" not in str(caught.value)
    assert caught.value.__cause__ is not None
    frames = traceback.extract_tb(caught.value.__cause__.__traceback__)
    assert [f.filename for f in frames] == [str(own)]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def build(scene:\n", "SyntaxError.*line 1"),
        ("import sys\nsys.exit(3)\n", "SystemExit: 3 .*line 2"),
        ("import nowhere_to_be_found\n", "ModuleNotFoundError.*line 1"),
        ("x = 1\n", r"no function build\(scene"),
        ("def build(scene):\n    return 3\n", "returned int, expected a Formulation"),
        (
            "from ttus_opt.terms.base import Term\n"
            "class T(Term):\n"
            "    name = 'own'\n"
            "def build(scene):\n"
            "    return T(scene)\n",
            "TypeError: .*abstract .*rows.*line 5",
        ),
    ],
)
def test_a_users_file_that_cannot_be_used(tmp_path: Path, text: str, told: str) -> None:
    own = tmp_path / "own.py"
    own.write_text(text)
    with pytest.raises(InputError, match=told):
        load(own, SCENE)


@pytest.mark.parametrize(
    ("name", "option", "value", "told"),
    [
        ("eq10", "torque_length", "abc", "takes a number, got 'abc'"),
        ("total_variation", "variation", float("nan"), "takes a number, got nan"),
        ("total_variation", "isotropic", 3, "takes true or false, got 3"),
        ("viscous_drag", "sectors", 1.5, "takes a whole number such as 1, got 1.5"),
        ("tikhonov", "reference", 2, "takes a word such as laplace, got 2"),
        ("eq10", "force_weight", [1.0], r"takes a number such as 0.01, got \[1.0\]"),
        ("eq10", "force_weight", True, "takes a number such as 0.01, got True"),
    ],
)
def test_options_are_checked_by_their_kind(
    name: str, option: str, value: object, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        load(name, SCENE, **{option: value})
    assert load("eq10", SCENE, torque_length=None).terms


def test_the_package_is_not_blamed_on_a_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of a formulation of our own is no InputError."""
    module = formulation_module("eq10")

    monkeypatch.setattr(module, "LaplaceTerm", len)
    with pytest.raises(TypeError, match="len"):
        load("eq10", SCENE)


def test_members_are_left_out_by_name() -> None:
    both = eq10().with_constraints(Sign(SCENE))
    left = both.without("force", "sign")
    assert [term.name for term in left.terms] == ["laplace"]
    assert not left.constraints
    with pytest.raises(InputError, match=r"no term or constraint 'sing'.*mean sign"):
        both.without("sing")


def test_a_users_file_may_take_any_keyword(tmp_path: Path) -> None:
    own = tmp_path / "loose.py"
    own.write_text(
        "from formulations.eq10 import build as eq10\n"
        "def build(scene, **options):\n"
        "    return eq10(scene, **options)\n"
    )
    assert load(own, SCENE, force_weight=0.25).terms[1].weight == 0.25


def test_every_formulation_says_what_it_is() -> None:
    shelf = {info.name: info for info in available()}
    assert {"eq10", "laplace_only", "coulomb_global", "free_surface"} <= set(shelf)
    for info in shelf.values():
        assert info.summary.endswith("."), info.name
        assert len(info.summary) <= 88
    assert shelf["eq10"].options["force_weight"] == 1e-2
