"""What a term's rows are assembled to, and what copies with another weight keep."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene

SCENE = small_scene(shape=(5, 8, 6), n_poses=5)
V = SCENE.n_voxels


@dataclass(frozen=True)
class Own(tt.Term):
    """Counts how often its rows are made."""

    made: list[int] = field(default_factory=list, repr=False)
    group: int = 0
    name = "own"

    @property
    def penalty(self):
        return tt.terms.Groups(self.group) if self.group else tt.terms.Squares()

    def rows(self):
        self.made.append(1)
        return tt.AffineRows({"p": sp.coo_array(np.eye(6, V))}, np.arange(6))


def test_before_they_are_made_nothing_is_kept():
    term = Own(SCENE)
    other = term.with_weight(3.0)
    assert not term.made
    np.testing.assert_array_equal(other.assembled.target, np.arange(6.0))


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf"), -1e-300])
def test_a_weight_that_is_none_is_refused(weight):
    refuses(InputError, "own weight must not be negative", Own, SCENE, weight)
    with pytest.raises(InputError, match="own weight must not be negative"):
        Own(SCENE).with_weight(weight)


def test_groups_take_all_rows():
    assert len(Own(SCENE, group=3).assembled.target) == 6
    refuses(InputError, "4 rows, got 6", lambda: Own(SCENE, group=4).assembled)


def test_what_most_terms_have_none_of():
    term, values = Own(SCENE), {"p": np.zeros(V)}
    assert term.formula == "Σ r², r = M x − t"
    assert not term.requires and not term.parameters(values)
    assert not term.fitted(values) and not term.not_identifiable()
    assert term.with_neutral(["friction"]) is term
