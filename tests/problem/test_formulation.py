"""Formulations by name, path and object, and what is refused."""

import traceback

import numpy as np
import pytest

from tests.kit import InputError, refuses, small_scene
from ttus_opt.core.plugins import formulation_module
from ttus_opt.problem.formulation import Formulation, available, load
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm

SCENE = small_scene(shape=(6, 10, 6), n_poses=5)
EQ10 = Formulation([LaplaceTerm(SCENE), ForceTerm(SCENE, 0.1)], name="mine")


def test_by_name_by_path_and_as_it_is(tmp_path):
    by_name = load("eq10", SCENE, force_weight=0.5)
    assert by_name.name == "eq10"
    assert by_name.terms[1].weight == 0.5
    assert load(by_name, SCENE) is by_name
    own = tmp_path / "own.py"
    own.write_text(
        "from ttus_opt.problem.formulation import Formulation\n"
        "from ttus_opt.problem.terms.laplace import LaplaceTerm\n"
        "def build(scene, weight=2.0):\n"
        "    return Formulation([LaplaceTerm(scene, weight)])\n"
    )
    by_path = load(own, SCENE, weight=3.0)
    assert (by_path.name, by_path.terms[0].weight) == ("own", 3.0)
    np.testing.assert_array_equal(by_path.compile().terms[0].target, SCENE.b)


def test_unknown_names_and_options_say_what_there_is(tmp_path):
    with pytest.raises(InputError, match="unknown formulation 'eq01', did you mean eq"):
        load("eq01", SCENE)
    refuses(
        InputError, r"there are .*anisotropic.*A file of your own", load, "xyzzy", SCENE
    )
    refuses(InputError, r"no option 'lam'.*force_weight", load, "eq10", SCENE, lam=1.0)
    refuses(InputError, "not found", load, tmp_path / "none.py", SCENE)
    with pytest.raises(InputError, match="cannot be given to a finished formulation"):
        load(EQ10, SCENE, force_weight=1.0)


@pytest.mark.parametrize("word", ["nan", "much", ""])
def test_a_word_where_a_number_belongs(word):
    """As `--option` hands on whatever is no JSON."""
    with pytest.raises(InputError, match=rf"largest_friction .* number .*'{word}'"):
        load("coulomb_drag", SCENE, largest_friction=word)


def test_a_users_file_that_raises_is_told_in_one_sentence(tmp_path):
    """With its own line; the cause begins in the user's file, not in the package."""
    own = tmp_path / "broken.py"
    own.write_text("def build(scene):\n    return scene.nonsense\n")
    expected = (
        rf"build\(\) of formulation broken raised AttributeError: .*nonsense.*{own}"
    )
    with pytest.raises(InputError, match=rf"{expected}, line 2\)") as caught:
        load(own, SCENE)
    assert "\n" not in str(caught.value)
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
            "from ttus_opt.problem.terms.base import Term\n"
            "class T(Term):\n"
            "    name = 'own'\n"
            "def build(scene):\n"
            "    return T(scene)\n",
            "TypeError: .*abstract .*rows.*line 5",
        ),
    ],
)
def test_a_users_file_that_cannot_be_used(tmp_path, text, told):
    own = tmp_path / "own.py"
    own.write_text(text)
    refuses(InputError, told, load, own, SCENE)


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
def test_options_are_checked_by_their_kind(name, option, value, told):
    refuses(InputError, told, load, name, SCENE, **{option: value})
    assert load("eq10", SCENE, torque_length=None).terms


def test_the_package_is_not_blamed_on_a_user(monkeypatch):
    """An error of a formulation of our own is no InputError."""
    module = formulation_module("eq10")

    monkeypatch.setattr(module, "LaplaceTerm", len)
    refuses(TypeError, "len", load, "eq10", SCENE)


def test_a_users_file_may_take_any_keyword(tmp_path):
    own = tmp_path / "loose.py"
    own.write_text(
        "from formulations.eq10 import build as eq10\n"
        "def build(scene, **options):\n"
        "    return eq10(scene, **options)\n"
    )
    assert load(own, SCENE, force_weight=0.25).terms[1].weight == 0.25


def test_every_formulation_says_what_it_is():
    shelf = {info.name: info for info in available()}
    assert {"eq10", "laplace_only", "coulomb_global", "free_surface"} <= set(shelf)
    for info in shelf.values():
        assert info.summary.endswith("."), info.name
        assert len(info.summary) <= 88
    assert shelf["eq10"].options["force_weight"] == 1e-2
