"""Members and their declared rows."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.rows import replaced, stacked


@dataclass(frozen=True)
class Square:
    side: float
    name: str = ""

    @cached_property
    def area(self):
        return [self.side**2]

    @cached_property
    def title(self):
        return f"a {self.name}"


def test_only_what_is_named_is_handed_on():
    first = Square(2.0, "tile")
    area, title = first.area, first.title
    other = replaced(first, "area", name="stone")
    assert other.area is area
    assert (other.title, title) == ("a stone", "a tile")
    assert first.name == "tile"


def test_what_was_not_computed_is_computed_when_asked_for():
    other = replaced(Square(2.0), "area", side=3.0)
    assert "area" not in vars(other)
    assert other.area == [9.0]


SCENE = small_scene(shape=(5, 8, 6), n_poses=5)
V = SCENE.n_voxels
ROWS = sp.csr_array(np.eye(3, V))


@dataclass(frozen=True)
class Own(tt.Term):
    """Whatever a user returns."""

    given: Any = field(default=None, repr=False)
    name = "own"

    def rows(self):
        return self.given


@dataclass(frozen=True)
class Limits(Constraint):
    """Whatever a user returns."""

    given: Any = field(default=None, repr=False)
    name = "mine"

    def rows(self):
        return self.given


@pytest.mark.parametrize(
    "matrix",
    [
        sp.coo_array(ROWS),
        sp.csc_matrix(ROWS),
        sp.csr_matrix(ROWS),
        sp.lil_array(ROWS),
        ROWS.astype(np.float32),
        ROWS.astype(int),
    ],
    ids=lambda M: f"{type(M).__name__}-{M.dtype}",
)
def test_every_sparse_format_is_taken(matrix):
    term = Own(SCENE, given=tt.AffineRows({"p": matrix}, [1, 2, 3]))
    rows = term.assembled
    assert isinstance(rows.blocks["p"], sp.csr_array)
    assert (rows.blocks["p"].dtype, rows.target.dtype) == (np.float64, np.float64)
    np.testing.assert_array_equal(rows.blocks["p"].toarray(), np.eye(3, V))
    np.testing.assert_array_equal(rows.target, [1.0, 2.0, 3.0])


def target(value):
    return tt.AffineRows({"p": ROWS}, value)


def matrix(value):
    return tt.AffineRows({"p": value}, np.zeros(3))


HOSTILE = {
    "nothing": (None, "must return AffineRows, got NoneType"),
    "a matrix alone": (ROWS, "must return AffineRows, got csr_array"),
    "dense": (matrix(np.eye(3, V)), r"must be sparse, got an array of float64"),
    "no matrix": (matrix(None), "must be sparse, got None"),
    "complex matrix": (matrix(1j * ROWS), "must be real and 2-D"),
    "too few rows": (matrix(ROWS[:2]), "2 rows over p, but 3 entries"),
    "infinite row": (matrix(ROWS * np.inf), r"rows over p hold (nan|inf)"),
    "no variables": (tt.AffineRows({}, np.zeros(3)), "by variable, such as"),
    "blocks a matrix": (tt.AffineRows(ROWS, np.zeros(3)), "by variable, such as"),
    "no target": (target(None), "target must be a vector of real numbers.*None"),
    "one number": (target(0.0), "target must be a vector .*got a float"),
    "a column": (target(np.zeros((3, 1))), r"vector .*shape \(3, 1\)"),
    "words": (target(["a", "b", "c"]), "vector of real numbers.*got a list"),
    "ragged": (target([[1.0], [2.0, 3.0], 4.0]), "vector of real numbers"),
    "complex": (target(np.zeros(3) * 1j), "vector of real numbers.*complex"),
    "too long": (target(np.zeros(4)), "3 rows over p, but 4 entries"),
    "nan": (target([0.0, np.nan, 0.0]), r"target holds nan \(row 1, 1 in all\)"),
    "another size": (matrix(ROWS[:, :5]), "own gives variable 'p' 5 entries"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_makes_no_sense_is_told_in_one_sentence(what):
    given, told = HOSTILE[what]
    call = (load("eq10", SCENE) + Own(SCENE, given=given)).compile
    message = refuses(InputError, told, call)
    if what != "another size":
        assert "term own (" in message
        assert f"{Path(__file__).name}, line " in message


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (None, "must return LinearRows, ConeRows or Bounds, got NoneType"),
        (Bounds("p", np.zeros(V), np.zeros(V - 1)), "lower limits and .* upper ones"),
        (Bounds("p", np.zeros(V), None), "upper limit must be a vector"),
        (
            LinearRows({"p": ROWS}, np.zeros(3), np.full(3, -np.inf)),
            "no value satisfies",
        ),
        (LinearRows({"p": ROWS}, np.zeros(2), np.ones(2)), "3 rows over p, but 2"),
        (LinearRows({"p": np.eye(3, V)}, np.zeros(3), np.ones(3)), "must be sparse"),
        (LinearRows({"p": ROWS}, [0, 0, np.nan], np.ones(3)), "lower limit holds nan"),
    ],
)
def test_limits_are_checked_alike(given, told):
    with pytest.raises(InputError, match=f"constraint mine.*{told}"):
        load("eq10", SCENE).with_constraints(Limits(SCENE, given)).compile()


def test_an_exception_in_rows_is_told_with_its_own_line(tmp_path):
    """Not with thirty lines of where this package was at that moment."""
    own = tmp_path / "broken_rows.py"
    own.write_text(
        "import ttus_opt as tt\n"
        "class Broken(tt.Term):\n"
        "    name = 'broken'\n"
        "    def rows(self):\n"
        "        return helper(self.scene)\n"
        "def helper(scene):\n"
        "    return scene.L @ [1, 2]\n"
        "def build(scene):\n"
        "    return tt.Formulation([Broken(scene)])\n"
    )
    with pytest.raises(
        InputError, match=r"^rows\(\) of term broken raised ValueError.*, line 7\)$"
    ):
        tt.fit(SCENE, own)


def test_a_class_without_a_name_is_told():
    class Nameless(tt.Term):
        def rows(self):
            return target(np.zeros(3))

    with pytest.raises(InputError, match="Nameless has no name: add name"):
        load("eq10", SCENE) + Nameless(SCENE)


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "names", [["a"], ["b"], ["c"], ["a", "c"], ["b", "c"], ["c", "a"], ["a", "b", "c"]]
)
def test_blocks_lie_where_their_variables_do(names):
    sizes = {"a": 3, "b": 4, "c": 2}
    dense = {name: RNG.normal(size=(5, sizes[name])) for name in names}
    for block in dense.values():
        block[RNG.random(block.shape) < 0.4] = 0.0
    blocks = {name: sp.csr_array(block) for name, block in dense.items()}
    nothing = {name: np.zeros((5, size)) for name, size in sizes.items()}
    expected = np.hstack([(nothing | dense)[name] for name in sizes])
    found = stacked(blocks, sizes, 5)
    np.testing.assert_array_equal(found.toarray(), expected)
    assert found.nnz == np.count_nonzero(expected)
    for name, block in dense.items():  # which others may still use
        np.testing.assert_array_equal(blocks[name].toarray(), block)
    assert stacked({}, sizes, 5).shape == (5, 9)
