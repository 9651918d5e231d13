"""Minimisers by dense algebra and by direct factorisation; no code of a solver."""

import itertools

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve


def stacked(program):
    """M, sparse, and t: the objective, of squares alone, is ‖M x − t‖²."""
    root = [np.sqrt(term.weight) for term in program.terms]
    pairs = list(zip(root, program.terms, strict=True))
    M = sp.csc_array(sp.vstack([w * term.matrix for w, term in pairs]))
    return M, np.concatenate([w * term.target for w, term in pairs])


def least_squares(M, t):
    """The minimiser of ‖M x − t‖², from the augmented system."""
    m, n = M.shape
    augmented = sp.block_array([[sp.eye_array(m), M], [M.T, None]], format="csc")
    return np.asarray(spsolve(augmented, np.concatenate([t, np.zeros(n)]))[m:])


def minimiser(program):
    """The minimiser of squares, given boundary values eliminated, shape (n,)."""
    M, t = stacked(program)
    x, free = np.zeros(M.shape[1]), np.ones(M.shape[1], dtype=bool)
    if program.dirichlet is not None:
        free = program.laplace.free
        x[~free] = program.dirichlet.lower
    x[free] = least_squares(M[:, free], t - M @ x)
    return x


def enumerated(M, t, A, b):
    """The minimiser of ‖M x − t‖² over A x ≤ b, from all active sets.

    The first set whose point holds all limits, with multipliers of the right sign, is
    the answer: the problem is strictly convex. None if no set will do.
    """
    inverse = np.linalg.inv(M.T @ M)
    best = inverse @ (M.T @ t)
    gap, K = A @ best - b, A @ inverse @ A.T
    for count in range(min(A.shape) + 1):
        for picked in itertools.combinations(range(len(b)), count):
            own = list(picked)
            try:
                mu = np.linalg.solve(K[np.ix_(own, own)], gap[own])
            except np.linalg.LinAlgError:
                continue
            left = gap - K[:, own] @ mu
            if (mu >= -1e-9).all() and (left <= 1e-9).all():
                return np.asarray(best - inverse @ A[own].T @ mu)
    return None
