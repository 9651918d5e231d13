"""The contour filter's association and Markov model, against dense algebra."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_discrete_lyapunov

from tests.kit import InputError, refuses
from ttus_opt.scan import contour_filter
from ttus_opt.scan.candidates import Candidates
from ttus_opt.scan.contour_filter import (
    Contour,
    ContourModel,
    associate,
    follow,
    without_end_cliffs,
)


def test_association_does_not_pull_inwards():
    """D as printed pulls by 2hσ²/(h² + σ²), 2 mm here; D per surface does not."""
    rng = np.random.default_rng(0)
    sigma, h, truth = 0.003, 0.008, 0.15
    r = truth + sigma * rng.standard_normal((20_000, 12))
    D = (1 - (r - (truth - h)) / (2 * h)) ** 2
    printed = np.average(r, weights=D) - truth
    expected = -2 * h * sigma**2 / (h**2 + sigma**2)
    assert printed == pytest.approx(expected, abs=5e-5)
    variance = np.full(len(r), 0.01**2)
    m = associate(np.sort(r, axis=1), np.full(len(r), truth), variance, sigma)
    assert m.seen.all()
    assert abs(m.y.mean() - truth) < 2e-5


def test_association_prefers_the_near_surface():
    """Skin and bed equally far from the prediction: D decides for the skin."""
    r = np.array([[0.149, 0.150, 0.151, 0.189, 0.190, 0.191, np.inf]])
    m = associate(r, np.array([0.17]), np.array([0.02**2]), 0.003)
    assert m.y[0] < 0.152
    one = associate(r[:, 3:], np.array([0.17]), np.array([0.02**2]), 0.003)
    assert one.y[0] == pytest.approx(0.19, abs=5e-4)  # alone, it is what there is


@pytest.mark.parametrize("of_each", [False, True])
def test_two_surfaces_by_hand(of_each):
    """Weight and variance of a near and a far point, as the module defines them."""
    sigma, P, d = 0.003, 0.01**2, 0.17
    near, far = -0.02, 0.004
    room = 4.0 * sigma / 2.0  # half a gap beyond the farthest
    D = (1.0 - (far - near) / (far - near + room)) ** 2
    S = P + sigma**2
    a, b = np.exp(-(near**2) / (2 * S)), np.exp(-(far**2) / (2 * S)) * D
    a, b = a / (a + b), b / (a + b)
    noise = np.full((1, 2), sigma) if of_each else sigma
    m = associate(np.array([[d + near, d + far]]), np.array([d]), np.array([P]), noise)
    assert m.y[0] - d == pytest.approx(a * near + b * far, rel=1e-9)
    # which of both is not known, beyond twice what noise explains
    between = a * b * (far - near) ** 2
    assert between > 4.0 * sigma**2
    expected = (a**2 + b**2) * sigma**2 + between - 2.0 * sigma**2
    assert m.variance[0] == pytest.approx(expected, rel=1e-9)


def test_association_of_coinciding_and_of_no_candidates():
    r = np.array([[0.15, 0.15, 0.15], [np.inf] * 3, [0.5, np.inf, np.inf]])
    m = associate(r, np.full(3, 0.15), np.full(3, 1e-5), 0.003)
    assert m.seen.tolist() == [True, False, False]  # D is 0/0 in print; beyond gate
    assert m.y[0] == pytest.approx(0.15)
    assert np.isfinite(m.y).all() and np.isfinite(m.variance).all()


def test_one_noise_for_all_is_the_same_noise_of_each():
    rng = np.random.default_rng(4)
    r = np.sort(0.15 + 0.003 * rng.standard_normal((50, 8)), axis=1)
    r[25:, 4:] += 0.02  # two surfaces within the gate
    predicted, variance = np.full(50, 0.155), np.full(50, 0.01**2)
    one = associate(r, predicted, variance, 0.003)
    each = associate(r, predicted, variance, np.full(r.shape, 0.003))
    np.testing.assert_allclose(each.y, one.y, rtol=1e-12)
    np.testing.assert_allclose(each.variance, one.variance, rtol=1e-9)


def test_association_weighs_by_prediction_and_noise_together():
    """S = P + σ²: by hand for two points of one surface, and at the gate's edge."""
    sigma, P, d = 0.003, 0.001**2, 0.15
    v = np.array([-0.002, 0.006])
    m = associate((d + v)[None], np.array([d]), np.array([P]), sigma)
    beta = np.exp(-(v**2) / (2 * (P + sigma**2)))
    beta /= beta.sum()
    assert m.y[0] - d == pytest.approx(beta @ v, rel=1e-9)
    # the candidates that belong: 4 √(P + σ²), far beyond 4 √P
    edge = 4 * np.sqrt(P + sigma**2)
    for off, belongs in ((0.999 * edge, True), (1.001 * edge, False)):
        m = associate(np.array([[d + off]]), np.array([d]), np.array([P]), sigma)
        assert m.seen[0] == belongs


def test_more_candidates_measure_better():
    one = np.full((1, 8), np.inf)
    one[0, 0] = 0.15
    many = np.full((1, 8), 0.15)
    args = (np.array([0.15]), np.array([1e-4]), 0.003)
    single, all_eight = associate(one, *args), associate(many, *args)
    assert single.variance[0] == pytest.approx(0.003**2)
    assert all_eight.variance[0] == pytest.approx(0.003**2 / 8)


def discretised(model, step):
    """F and Q of the continuous model, from its equations alone.

    (d, g)' = A (d, g) + (0, s √(2/ℓ)) w with unit white noise w has F = exp(A Δθ), and
    Q grows from zero by Q' = A Q + Q Aᵀ + C: linear, solved by one exponential more.
    """
    A = np.array([[0.0, 1.0], [0.0, -1.0 / model.slope_angle]])
    C = np.diag([0.0, 2.0 * model.slope_std**2 / model.slope_angle])
    growth = np.zeros((5, 5))
    growth[:4, :4] = np.kron(A, np.eye(2)) + np.kron(np.eye(2), A)
    growth[:4, 4] = C.reshape(-1)
    return expm(A * step), expm(growth * step)[:4, 4].reshape(2, 2)


@pytest.mark.parametrize("n_theta", [9, 36, 180, 1440])
@pytest.mark.parametrize("slope_angle", [0.02, 0.35, 30.0])
def test_a_step_is_the_continuous_process(n_theta, slope_angle):
    model = ContourModel(slope_std=0.07, slope_angle=slope_angle)
    step = 2 * np.pi / n_theta
    F, Q = model.transition(step)
    expected_F, expected_Q = discretised(model, step)
    np.testing.assert_allclose(F, expected_F, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Q, expected_Q, rtol=1e-5)


@pytest.mark.parametrize("n_theta", [9, 36, 180])
def test_the_slope_has_its_deviation_at_any_number_of_spokes(n_theta):
    """Lyapunov's equation of the slope's step, and the steps of one turn at once.

    A first-order Q gave 2.0, 1.26 and 1.05 times as much.
    """
    model = ContourModel(slope_std=0.1)
    F, Q = model.transition(2 * np.pi / n_theta)
    variance = solve_discrete_lyapunov(F[1:, 1:], Q[1:, 1:])
    assert np.sqrt(variance[0, 0]) == pytest.approx(0.1, rel=1e-9)
    # a turn in n steps and in one: what a process of its own time has
    whole_F, whole_Q = model.transition(2 * np.pi)
    P, power = np.zeros((2, 2)), np.eye(2)
    for _ in range(n_theta):
        P, power = F @ P @ F.T + Q, F @ power
    np.testing.assert_allclose(power, whole_F, atol=1e-12)
    np.testing.assert_allclose(P, whole_Q, rtol=1e-9)


def test_small_steps_keep_their_digits():
    """A slope that hardly forgets is a walk: nothing of Q cancels away."""
    step, model = 0.01, ContourModel(slope_std=0.1, slope_angle=1e7)
    _, Q = model.transition(step)
    walk = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    np.testing.assert_allclose(Q, 0.1**2 * 2 / 1e7 * walk, rtol=1e-8)
    model = ContourModel(slope_std=1.0, slope_angle=1.0)
    for x in (0.0999999, 0.1000001):  # where the series and the sum meet
        exact = 2.0 * quad(lambda t: (1.0 - np.exp(-t)) ** 2, 0.0, x)[0]
        assert model.transition(x)[1][0, 0] == pytest.approx(exact, rel=1e-10)


def dense_contour(y, noise, model, jump=None):
    """Mean and variance of d at every spoke of one slice, by dense least squares.

    Four laps of the model's own discretisation, so that the middle one knows both
    neighbours; nothing of the filter.

    Args:
        y: Measured radius per spoke, shape (n,) [m].
        noise: Its variance, shape (n,) [m²]; infinite where there is none.
        model: The model.
        jump: Variance of a jump from each spoke to the next, shape (n,) [m²].
    """
    n, laps = len(y), 4
    F, Q = discretised(model, 2 * np.pi / n)
    jump = np.zeros(n) if jump is None else jump
    total = laps * n
    A, b = [], []
    for k in range(total):
        row = np.zeros((1, 2 * total))
        row[0, 2 * k] = 1 / np.sqrt(noise[k % n])
        A.append(row)
        b.append([y[k % n] / np.sqrt(noise[k % n])])
        if k:
            more = np.diag([jump[(k - 1) % n], 0.0])
            half = np.linalg.inv(np.linalg.cholesky(Q + more))
            row = np.zeros((2, 2 * total))
            row[:, 2 * k : 2 * k + 2] = half
            row[:, 2 * k - 2 : 2 * k] = -half @ F
            A.append(row)
            b.append([0.0, 0.0])
    A_, b_ = np.concatenate(A), np.concatenate(b)
    P = np.linalg.inv(A_.T @ A_)
    middle = slice(2 * n, 4 * n, 2)
    return (P @ A_.T @ b_)[middle], np.diag(P)[middle]


@pytest.mark.parametrize("n", [9, 24])
def test_filter_matches_a_dense_gaussian_smoother(n):
    """One candidate per spoke: the posterior mean of the same Markov model."""
    rng = np.random.default_rng(3)
    model = ContourModel(depth_noise=0.004, slope_std=0.08)
    theta = np.arange(n) * 2 * np.pi / n
    r = 0.15 + 0.01 * np.cos(2 * theta) + 0.002 * rng.standard_normal(n)
    found = follow(Candidates(r[:, None, None], np.ones((n, 1), int)), model)
    mean, variance = dense_contour(r, np.full(n, model.depth_noise**2), model)
    np.testing.assert_allclose(found.radius[:, 0], mean, atol=1e-5)
    np.testing.assert_allclose(found.variance[:, 0], variance, rtol=1e-3)
    assert found.observed.all()


def test_candidates_are_weighed_twice_around_the_smoothed_contour(monkeypatch):
    """The second round is the dense smoother of what the first round weighs."""
    n, rng = 24, np.random.default_rng(0)
    theta = np.arange(n) * 2 * np.pi / n
    truth = 0.15 + 0.02 * np.cos(theta) + 0.01 * np.cos(3 * theta)
    r = np.sort(truth[:, None] + 0.004 * rng.standard_normal((n, 12)), axis=1)
    given, model = Candidates(r[:, None], np.full((n, 1), 12)), ContourModel()
    found = follow(given, model)
    monkeypatch.setattr(contour_filter, "_N_REWEIGHT", 1)
    once = follow(given, model)
    m = associate(r, once.radius[:, 0], once.variance[:, 0], model.depth_noise)
    mean, variance = dense_contour(m.y, m.variance, model)
    np.testing.assert_allclose(found.radius[:, 0], mean, atol=2e-6)
    np.testing.assert_allclose(found.variance[:, 0], variance, rtol=1e-3)
    assert np.abs(once.radius[:, 0] - mean).max() > 1e-4  # one round is not two


def test_a_contour_jumps_after_the_spoke_that_it_missed(monkeypatch):
    """The dense smoother of a step up at spoke 8 and down at spoke 20."""
    n, model = 36, ContourModel(depth_noise=0.001, slope_std=0.02)
    r = 0.12 + 1e-4 * np.random.default_rng(0).standard_normal(n)
    r[8:20] += 0.04
    given = Candidates(r[:, None, None], np.ones((n, 1), int))
    found = follow(given, model)
    monkeypatch.setattr(contour_filter, "_N_REWEIGHT", 1)
    once = follow(given, model)
    m = associate(r[:, None], once.radius[:, 0], once.variance[:, 0], model.depth_noise)
    jump = np.zeros(n)
    jump[[8, 20]] = 0.015**2
    noise = np.where(m.seen, m.variance, np.inf)
    mean, variance = dense_contour(m.y, noise, model, jump)
    np.testing.assert_allclose(found.radius[:, 0], mean, atol=1e-5)
    np.testing.assert_allclose(found.variance[:, 0], variance, rtol=1e-3)
    assert abs(found.radius[10, 0] - 0.16) < 1e-3 > abs(found.radius[22, 0] - 0.12)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"slope_std": 0.0}, "slope_std must be positive"),
        ({"slope_angle": np.inf}, "slope_angle must be positive"),
        ({"spoke_distance": 4.0}, "spoke_distance must be between"),
        ({"slice_distance": 0.0}, "slice_distance must be between"),
    ],
)
def test_an_unusable_model(given, words):
    refuses(InputError, words, ContourModel, **given)


def test_cliffs_at_the_ends_are_not_seen():
    """From the cliff to the end of its spoke's row; one amid the body stays."""
    radius = np.full((8, 60), 0.15)
    radius[2, -2:] = 0.10  # a cap
    radius[5, 30:] = 0.12  # the body's own step
    radius[6, 0] = 0.13
    radius[7, -12:] = 0.15 - 0.0074 * np.arange(12)  # a shoulder within 1.5
    seen = np.ones(radius.shape, dtype=bool)
    found = without_end_cliffs(Contour(radius, radius, seen), 0.005)
    expected = seen.copy()
    expected[2, -3:] = expected[6, :2] = False
    np.testing.assert_array_equal(found.observed, expected)
    body = np.full((8, 200), 0.15)
    body[3, :15] = 0.12  # 7.5 cm from the end: the body's own
    found = without_end_cliffs(Contour(body, body, np.ones_like(body, bool)), 0.005)
    assert found.observed.all()
