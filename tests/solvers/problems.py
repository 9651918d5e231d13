"""Small programs with known primal and dual answers, for every solver."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.members import ProgramBounds, ProgramConstraint, ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Absolute, Groups, Huber, Linear, Squares

INF = np.inf
SQUARES = Squares()


def term(M, t, weight=1.0, penalty=SQUARES, name="fit"):
    """A term over all variables."""
    rows = sp.csr_array(np.asarray(M, dtype=float))
    target = np.asarray(t, dtype=float)
    return ProgramTerm(name, weight, rows, target, penalty)


def rows(name, A, lower, upper):
    """Rows between limits."""
    return ProgramConstraint(
        name,
        sp.csr_array(np.asarray(A, dtype=float)),
        np.asarray(lower, dtype=float),
        np.asarray(upper, dtype=float),
    )


def bounds(name, lower, upper):
    """Bounds on all variables."""
    return ProgramBounds(
        name, np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    )


def program(terms, constraints=(), limits=()):
    """A program over one variable p, of no scene."""
    terms = tuple(terms)
    n = terms[0].matrix.shape[1]
    return Program(
        {"p": slice(0, n)}, terms, tuple(constraints), tuple(limits), cast(Any, None)
    )


@dataclass(frozen=True)
class Reference:
    """A program and its one answer.

    Attributes:
        name: For the test's id.
        program: What is solved.
        x: Its minimiser.
        rows: Multipliers by constraint name.
        bounds: Multipliers of the box.
        terms: Multipliers of penalties that bend, by term name.
        weak: Limit and multiplier are both zero somewhere: a residual of ε leaves
            x and the multiplier open to √ε.
    """

    name: str
    program: Program
    x: Any
    rows: Mapping[str, Any] = field(default_factory=dict)
    bounds: Any = None
    terms: Mapping[str, Any] = field(default_factory=dict)
    weak: bool = False


def references():
    """All reference problems; every answer can be checked by hand."""
    eye2, eye3, eye4 = np.eye(2), np.eye(3), np.eye(4)
    two = [[1.0, 1.0]]
    return [
        # normal equations 5 x = 6 and 2 y = 1
        Reference(
            "least_squares",
            program([term([[1, 0], [2, 0], [0, 1], [0, 1]], [2, 2, 0, 1])]),
            [1.2, 0.5],
        ),
        # weights 1 and 3 on targets 0 and 4: the mean lies at 3
        Reference(
            "two_weights",
            program([term(eye2, [0, 0]), term(eye2, [4, 4], 3.0, name="other")]),
            [3, 3],
        ),
        # gradient 2 (x - c) is (2, 0, -2): lower limits pull up, upper ones down
        Reference(
            "box",
            program([term(eye3, [-1, 0.5, 2])], (), [bounds("box", [0] * 3, [1] * 3)]),
            [0, 0.5, 1],
            bounds=[-2, 0, 2],
        ),
        # the target lies on the limit: active with multiplier zero
        Reference(
            "weakly_active",
            program([term(eye2, [0, 3])], (), [bounds("box", [0, 0], [INF, INF])]),
            [0, 3],
            bounds=[0, 0],
            weak=True,
        ),
        Reference(
            "equality",
            program([term(eye4, [0] * 4)], [rows("sum", [[1] * 4], [1], [1])]),
            [0.25] * 4,
            {"sum": [-0.5]},
        ),
        Reference(
            "upper_row",
            program([term(eye2, [2, 2])], [rows("cap", two, [-INF], [2])]),
            [1, 1],
            {"cap": [2]},
        ),
        Reference(
            "lower_row",
            program([term(eye2, [2, 2])], [rows("least", two, [6], [INF])]),
            [3, 3],
            {"least": [-2]},
        ),
        # a range whose lower side holds, an equality and an idle row in one block
        Reference(
            "mixed_rows",
            program(
                [term(eye3, [0, 0, 5])],
                [
                    rows(
                        "mixed",
                        [[1, 1, 0], [0, 0, 1], [1, 0, 0]],
                        [2, 3, -9],
                        [4, 3, 9],
                    )
                ],
            ),
            [1, 1, 3],
            {"mixed": [-2, 4, 0]},
        ),
        # rows by two names and a box together: x = (1, 2, 0)
        Reference(
            "names",
            program(
                [term(eye3, [0, 0, -1])],
                [
                    rows("first", [[1, 0, 0]], [1], [1]),
                    rows("second", [[0, 1, 0]], [2], [INF]),
                ],
                [bounds("box", [-INF, -INF, 0], [INF, 3, INF])],
            ),
            [1, 2, 0],
            {"first": [-2], "second": [-4]},
            [0, 0, -2],
        ),
        # ‖x‖² + 3 Σ x
        Reference(
            "linear_term",
            program(
                [term(eye2, [0, 0]), term(eye2, [0, 0], 3.0, Linear(), name="slope")],
                (),
                [bounds("box", [-1, -INF], [INF, INF])],
            ),
            [-1, -1.5],
            bounds=[-1, 0],
        ),
    ]


def bending_references():
    """Reference problems with penalties that are no sum of squares."""
    eye1, eye2 = np.eye(1), np.eye(2)
    return [
        # ‖x‖² + 2 |x - 3|: 2 x + 2 g = 0 with g = -1
        Reference(
            "absolute",
            program([term(eye1, [0]), term(eye1, [3], 2.0, Absolute(), name="bent")]),
            [1],
            terms={"bent": [-1]},
        ),
        # ‖x‖² + 10 |x - 3| sticks at 3 with g = -0.6
        Reference(
            "absolute_kink",
            program([term(eye1, [0]), term(eye1, [3], 10.0, Absolute(), name="bent")]),
            [3],
            terms={"bent": [-0.6]},
        ),
        # ‖x‖² + huber(x - 9; 2): slope -4 until x = 2
        Reference(
            "huber",
            program([term(eye1, [0]), term(eye1, [9], 1.0, Huber(2.0), name="bent")]),
            [2],
            terms={"bent": [-4]},
        ),
        # ‖x - (3, 4)‖² + 2 ‖x‖: shrinks the length from 5 to 4
        Reference(
            "groups",
            program([term(eye2, [3, 4]), term(eye2, [0, 0], 2.0, Groups(2), "bent")]),
            [2.4, 3.2],
            terms={"bent": [0.6, 0.8]},
        ),
    ]


#: Rows of the capped least squares
M = np.random.default_rng(0).normal(size=(12, 4))


def capped(target, cap=0.5, weight=1.0, times=1.0):
    """Least squares below a cap on a multiple of each unknown."""
    own = np.zeros(12) + np.asarray(target)
    fit = [term(M, own), term(np.eye(4), np.ones(4), weight, name="ridge")]
    return program(fit, [rows("cap", times * np.eye(4), [-INF] * 4, [cap] * 4)])


def minimum(target, cap=0.5, weight=1.0, times=1.0):
    """The same by projected coordinate descent."""
    H = M.T @ M + weight * np.eye(4)
    g = M.T @ (np.zeros(12) + np.asarray(target)) + weight
    x = np.zeros(4)
    for _ in range(500):
        for i in range(4):
            x[i] = min(x[i] + (g[i] - H[i] @ x) / H[i, i], cap / times)
    return x
