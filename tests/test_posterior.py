from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ttus_opt.functionals import Combination
from ttus_opt.posterior import Posterior

Array = NDArray[np.float64]
HEIGHT = 6


class Dense:
    """The same by explicit rows: y = C x + noise, x ~ Normal(0, G)."""

    def __init__(self, G: Array) -> None:
        self.G = G
        self.rows: list[tuple[Array, Array]] = []

    def condition(self) -> tuple[Array, Array, float]:
        """Covariance, mean and least objective, by the gain form."""
        if not self.rows:
            return self.G, np.zeros(len(self.G)), 0.0
        C = np.concatenate([c for c, _ in self.rows])
        d = np.concatenate([d for _, d in self.rows])
        H = np.eye(len(C)) + C @ self.G @ C.T
        gain = np.linalg.solve(H, C @ self.G).T
        return self.G - gain @ C @ self.G, gain @ d, float(d @ np.linalg.solve(H, d))


def prior(rng: np.random.Generator, k: int, rank: int | None = None) -> Array:
    root = rng.normal(size=(k, k if rank is None else rank))
    G: Array = root @ root.T / k
    return G


def rows(rng: np.random.Generator, k: int, weight: float = 1.0) -> Combination:
    slots = np.sort(rng.choice(k, 5, replace=False)).astype(np.int64)
    return Combination(slots, np.sqrt(weight) * rng.normal(size=(5, HEIGHT)))


def full(C: Combination, k: int) -> Array:
    out = np.zeros((HEIGHT, k))
    out[:, C.slots] = C.values.T
    return out


def started(G: Array) -> Posterior:
    posterior = Posterior()
    posterior.extend(np.zeros((len(G), 0)), G)
    return posterior


def agree(posterior: Posterior, dense: Dense, tolerance: float = 1e-9) -> None:
    S, m, misfit = dense.condition()
    assert np.abs(posterior.covariance - S).max() <= tolerance * np.abs(S).max()
    assert np.abs(posterior.mean - m).max() <= tolerance * max(np.abs(m).max(), 1e-3)
    assert posterior.misfit == pytest.approx(misfit, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("rank", [20, 9])
@pytest.mark.parametrize("weight", [1e-2, 1e2])
def test_blocks_come_and_go(rank: int, weight: float) -> None:
    rng = np.random.default_rng(rank)
    dense = Dense(prior(rng, 20, rank))
    posterior = started(dense.G)
    given = []
    for _ in range(12):
        C, d = rows(rng, 20, weight), rng.normal(size=HEIGHT)
        seen = posterior.outlook(C)
        S, m, _ = dense.condition()
        c = full(C, 20)
        assert np.allclose(seen.schur, np.eye(HEIGHT) + c @ S @ c.T, rtol=1e-8)
        assert np.allclose(seen.mean, c @ m, atol=1e-8 * (1.0 + np.abs(c @ m).max()))
        posterior.append(C, seen, d)
        dense.rows.append((c, d))
        given.append((C, d))
        agree(posterior, dense, 1e-8)
    for at in (0, 5, 9, 3):
        posterior.remove(*given.pop(at))
        dense.rows.pop(at)
        agree(posterior, dense, 1e-7)
    posterior.fade(0.3)
    dense.rows = [(np.sqrt(0.3) * c, np.sqrt(0.3) * d) for c, d in dense.rows]
    agree(posterior, dense, 1e-8)
    posterior.clear()
    assert np.array_equal(posterior.covariance, dense.G)
    assert not posterior.mean.any()
    assert posterior.misfit == 0.0


def test_functionals_come_late_and_go() -> None:
    rng = np.random.default_rng(3)
    # more than there is room for at first
    k, early = 90, 40
    G = prior(rng, k)
    posterior, dense = started(G[:early, :early]), Dense(G)
    for _ in range(6):
        C, d = rows(rng, early), rng.normal(size=HEIGHT)
        posterior.append(C, posterior.outlook(C), d)
        dense.rows.append((full(C, k), d))
    posterior.extend(G[early:, :early], G[early:, early:])
    agree(posterior, dense)
    # those that came late can be measured, and those that nothing measures can go
    C, d = rows(rng, k), rng.normal(size=HEIGHT)
    posterior.append(C, posterior.outlook(C), d)
    dense.rows.append((full(C, k), d))
    agree(posterior, dense)
    used = np.any(np.concatenate([c for c, _ in dense.rows]) != 0.0, axis=0)
    order = list(range(k))
    gone = np.flatnonzero(~used)[::-3]
    for slot in gone:
        order[slot] = order[-1]
        order.pop()
    posterior.drop(gone)
    dense.G = G[np.ix_(order, order)]
    dense.rows = [(c[:, order], d) for c, d in dense.rows]
    agree(posterior, dense)
    posterior.refresh()
    agree(posterior, dense)


def test_sources_and_their_correction() -> None:
    rng = np.random.default_rng(4)
    G = prior(rng, 15)
    posterior = started(G)
    for _ in range(5):
        C = rows(rng, 15)
        posterior.append(C, posterior.outlook(C), rng.normal(size=HEIGHT))
    u = posterior.sources
    assert np.allclose(G @ u, posterior.mean, atol=1e-10)
    assert np.abs(posterior.step(u, G @ u)).max() < 1e-10
    # from anywhere, one step leads to it
    start = rng.normal(size=15)
    assert np.allclose(start + posterior.step(start, G @ start), u, atol=1e-8)
    assert posterior.energy(start) == pytest.approx(np.sqrt(start @ G @ start))


def test_the_same_rows_with_other_functionals_change_nothing_else() -> None:
    rng = np.random.default_rng(5)
    G = prior(rng, 10)
    # functional 10 is the sum of the first two
    T = np.vstack([np.eye(10), np.eye(10)[0] + np.eye(10)[1]])
    posterior = started(T @ G @ T.T)
    values = rng.normal(size=(1, HEIGHT))
    d = rng.normal(size=HEIGHT)
    one = Combination(np.array([10]), values)
    two = Combination(np.array([0, 1]), np.repeat(values, 2, axis=0))
    posterior.append(one, posterior.outlook(one), d)
    S, m = posterior.covariance, posterior.mean
    posterior.account(one, d, -1.0)
    posterior.account(two, d, 1.0)
    posterior.refresh()
    assert np.allclose(posterior.covariance, S, atol=1e-12)
    assert np.allclose(posterior.mean, m, atol=1e-12)


def test_rounding_does_not_add_up() -> None:
    rng = np.random.default_rng(6)
    posterior = started(prior(rng, 30))
    held = []
    for count in range(1000):
        C, d = rows(rng, 30, 0.1), rng.normal(size=HEIGHT)
        posterior.append(C, posterior.outlook(C), d)
        held.append((C, d))
        if count % 2:
            posterior.remove(*held.pop(int(rng.integers(len(held)))))
    assert len(held) == 500
    S, m = posterior.covariance, posterior.mean
    assert np.array_equal(S, S.T)
    posterior.refresh()
    fresh = posterior.covariance
    assert np.abs(S - fresh).max() < 1e-8 * np.abs(fresh).max()
    assert np.abs(m - posterior.mean).max() < 1e-8 * np.abs(m).max()
