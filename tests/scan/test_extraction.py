"""The contour filter against known radii: cylinders, a CT torso, a real scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.spatial import cKDTree

from tests.conftest import SHARED
from tests.scan import camera
from ttus_opt.arrays import Array
from ttus_opt.errors import GeometryError, InputError
from ttus_opt.scan import contour_filter
from ttus_opt.scan.candidates import Candidates, collect, drop_strays, usable_range
from ttus_opt.scan.cloud import read_cloud
from ttus_opt.scan.contour_filter import ContourModel, associate, follow
from ttus_opt.scan.extraction import extract_surface
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.supporting_plane import find_supporting_plane
from ttus_opt.scan.surface import Surface

DATA = SHARED / "torso"


def cylinder(
    rng: np.random.Generator, radius: float = 0.15, noise: float = 0.003
) -> Array:
    theta = rng.uniform(0, 2 * np.pi, 60_000)
    r = radius + noise * rng.standard_normal(theta.size)
    z = rng.uniform(-0.2, 0.2, theta.size)
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)


# ---------------------------------------------------------------- association


def test_association_does_not_pull_inwards() -> None:
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


def test_association_prefers_the_near_surface() -> None:
    """Skin and bed equally far from the prediction: D decides for the skin."""
    r = np.array([[0.149, 0.150, 0.151, 0.189, 0.190, 0.191, np.inf]])
    m = associate(r, np.array([0.17]), np.array([0.02**2]), 0.003)
    assert m.y[0] < 0.152
    one = associate(r[:, 3:], np.array([0.17]), np.array([0.02**2]), 0.003)
    assert one.y[0] == pytest.approx(0.19, abs=5e-4)  # alone, it is what there is


def test_association_of_coinciding_and_of_no_candidates() -> None:
    r = np.array([[0.15, 0.15, 0.15], [np.inf] * 3, [0.5, np.inf, np.inf]])
    m = associate(r, np.full(3, 0.15), np.full(3, 1e-5), 0.003)
    assert m.seen.tolist() == [True, False, False]  # D is 0/0 in print; beyond gate
    assert m.y[0] == pytest.approx(0.15)
    assert np.isfinite(m.y).all() and np.isfinite(m.variance).all()


def test_association_weighs_by_prediction_and_noise_together() -> None:
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


def test_more_candidates_measure_better() -> None:
    one = np.full((1, 8), np.inf)
    one[0, 0] = 0.15
    many = np.full((1, 8), 0.15)
    args = (np.array([0.15]), np.array([1e-4]), 0.003)
    single, all_eight = associate(one, *args), associate(many, *args)
    assert single.variance[0] == pytest.approx(0.003**2)
    assert all_eight.variance[0] == pytest.approx(0.003**2 / 8)


# --------------------------------------------------------------- contour filter


def discretised(model: ContourModel, step: float) -> tuple[Array, Array]:
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
def test_a_step_is_the_continuous_process(n_theta: int, slope_angle: float) -> None:
    model = ContourModel(slope_std=0.07, slope_angle=slope_angle)
    step = 2 * np.pi / n_theta
    F, Q = model.transition(step)
    expected_F, expected_Q = discretised(model, step)
    np.testing.assert_allclose(F, expected_F, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Q, expected_Q, rtol=1e-5)


@pytest.mark.parametrize("n_theta", [9, 36, 180])
def test_the_slope_has_its_deviation_at_any_number_of_spokes(n_theta: int) -> None:
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


def test_small_steps_keep_their_digits() -> None:
    """A slope that hardly forgets is a walk: nothing of Q cancels away."""
    step, model = 0.01, ContourModel(slope_std=0.1, slope_angle=1e7)
    _, Q = model.transition(step)
    walk = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    np.testing.assert_allclose(Q, 0.1**2 * 2 / 1e7 * walk, rtol=1e-8)
    model = ContourModel(slope_std=1.0, slope_angle=1.0)
    for x in (0.0999999, 0.1000001):  # where the series and the sum meet
        exact = 2.0 * quad(lambda t: (1.0 - np.exp(-t)) ** 2, 0.0, x)[0]
        assert model.transition(x)[1][0, 0] == pytest.approx(exact, rel=1e-10)


def dense_contour(y: Array, noise: Array, model: ContourModel) -> tuple[Array, Array]:
    """Mean and variance of d at every spoke of one slice, by dense least squares.

    Four laps of the model's own discretisation, so that the middle one knows both
    neighbours; nothing of the filter.

    Args:
        y: Measured radius per spoke, shape (n,) [m].
        noise: Its variance, shape (n,) [m²]; infinite where there is none.
        model: The model.
    """
    n, laps = len(y), 4
    F, Q = discretised(model, 2 * np.pi / n)
    half = np.linalg.inv(np.linalg.cholesky(Q))
    total = laps * n
    A, b = [], []
    for k in range(total):
        row = np.zeros((1, 2 * total))
        row[0, 2 * k] = 1 / np.sqrt(noise[k % n])
        A.append(row)
        b.append([y[k % n] / np.sqrt(noise[k % n])])
        if k:
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
def test_filter_matches_a_dense_gaussian_smoother(n: int) -> None:
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


def test_candidates_are_weighed_twice_around_the_smoothed_contour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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


def test_noisy_cylinder_is_unbiased_and_its_deviation_honest() -> None:
    errors, scores = [], []
    for seed in range(3):
        cloud = cylinder(np.random.default_rng(seed))
        s = extract_surface(cloud, axis=Axis.identity(), support=None)
        assert s.observed.mean() > 0.999
        error = (s.radius - 0.15)[s.observed]
        errors.append(error)
        scores.append(error / s.radius_std[s.observed])
    # A strip of constant width subtends less angle further out: the points of a
    # cloud even in angle are by σ²/R nearer in it, 0.06 mm here. Nothing else.
    assert np.concatenate(errors).mean() == pytest.approx(-(0.003**2) / 0.15, abs=3e-5)
    assert np.std(np.concatenate(errors)) < 1e-3
    assert 0.4 < np.sqrt(np.mean(np.concatenate(scores) ** 2)) < 1.3


def test_bed_left_in_is_rejected_by_the_weights() -> None:
    """A bed 4 cm behind half of the skin, not taken out as a plane."""
    rng = np.random.default_rng(0)
    cloud = cylinder(rng)
    bed = np.stack(
        [
            np.full(40_000, -0.19),
            rng.uniform(-0.15, 0.15, 40_000),
            rng.uniform(-0.2, 0.2, 40_000),
        ],
        axis=1,
    )
    s = extract_surface(
        np.concatenate([cloud, bed]), axis=Axis.identity(), support=None
    )
    error = s.radius - 0.15
    assert np.abs(error).max() < 0.006
    assert abs(error.mean()) < 1e-4


def test_step_is_followed() -> None:
    """A shoulder: the radius jumps by 6 cm within a spoke and back."""
    theta = np.random.default_rng(0).uniform(0, 2 * np.pi, 80_000)
    z = np.random.default_rng(1).uniform(-0.2, 0.2, theta.size)
    r = np.where((theta > 1.0) & (theta < 2.5), 0.18, 0.12)
    cloud = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)
    s = extract_surface(cloud, axis=Axis.identity(), support=None)
    plateau = s.radius[(s.theta > 1.2) & (s.theta < 2.3)]
    np.testing.assert_allclose(plateau, 0.18, atol=0.002)
    low = s.radius[(s.theta > 2.8) | (s.theta < 0.7)]
    np.testing.assert_allclose(low, 0.12, atol=0.002)


def test_unseen_part_is_marked_filled_and_less_certain() -> None:
    cloud = cylinder(np.random.default_rng(0), noise=0.001)
    seen = cloud[cloud[:, 0] > -0.05]
    s = extract_surface(seen, axis=Axis.identity(), support=None)
    share = 1 - np.arccos(0.05 / 0.15) / np.pi
    assert s.observed.mean() == pytest.approx(share, abs=0.02)
    np.testing.assert_allclose(s.radius, 0.15, atol=0.005)
    back = s.radius_std[len(s.theta) // 2]
    assert (back > 5 * s.radius_std[0]).all()


@pytest.mark.parametrize(("n_theta", "n_z"), [(9, 2), (36, 20), (181, 40), (90, 150)])
def test_any_resolution(n_theta: int, n_z: int) -> None:
    cloud = cylinder(np.random.default_rng(0))
    s = extract_surface(
        cloud, axis=Axis.identity(), support=None, n_theta=n_theta, n_z=n_z
    )
    assert s.radius.shape == (n_theta, n_z)
    assert abs(s.radius[s.observed].mean() - 0.15) < 3e-4


def test_given_heights_and_frame() -> None:
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    axis = Axis(np.array([1.0, 2, 3]), turn)
    cloud = axis.to_scan(cylinder(np.random.default_rng(0)))
    s = extract_surface(cloud, axis=axis, z_range=(-0.1, 0.05), support=None)
    assert (s.z[0], s.z[-1]) == (-0.1, 0.05)
    assert np.abs(s.radius - 0.15).max() < 0.004


@pytest.mark.parametrize(
    ("slices", "option", "reach"),
    [
        (0.020, None, 0.006),  # not further than 6 mm
        (0.009, None, 0.0045),  # half the distance of the slices
        (0.004, None, 0.003),  # not nearer than 3 mm
        (0.020, 0.002, 0.002),  # as it is asked for
    ],
)
def test_points_belong_to_a_slice_up_to_a_distance(
    slices: float, option: float | None, reach: float
) -> None:
    """Rings beside slices, some just near enough, some just too far."""
    n_z, theta = 12, np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    ring = 0.15 * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    heights = slices * np.arange(n_z)
    beside = [*(heights[::4] + 0.95 * reach), *(heights[2::4] - 1.05 * reach)]
    points = np.concatenate([ring + np.array([0.0, 0.0, z]) for z in beside])
    surface = extract_surface(
        points,
        axis=Axis.identity(),
        support=None,
        n_theta=36,
        n_z=n_z,
        z_range=(0.0, heights[-1]),
        slice_distance=option,
    )
    expected = [np.abs(points[:, 2] - z).min() <= reach for z in heights]
    assert surface.observed.all(axis=0).tolist() == expected
    assert surface.observed.any(axis=0).tolist() == expected
    assert expected[0] and not expected[2]


# -------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_theta": 0}, "n_theta must be a whole number >= 8, got 0"),
        ({"n_z": 1}, "n_z must be"),
        ({"n_theta": 90.5}, "n_theta must be a whole number"),
        ({"spoke_distance": 4.0}, "spoke_distance must be between"),
        ({"slice_distance": 0.0}, "slice_distance must be between"),
        ({"z_range": (0.2, 0.1)}, "z_range must be"),
        ({"z_range": (5.0, 6.0)}, "no point has a height"),
    ],
)
def test_unusable_options(options: dict[str, object], message: str) -> None:
    cloud = cylinder(np.random.default_rng(0))
    with pytest.raises(InputError, match=message):
        extract_surface(cloud, axis=Axis.identity(), support=None, **options)


def test_unusable_clouds() -> None:
    cloud = cylinder(np.random.default_rng(0))
    axis = Axis.identity()
    with pytest.raises(InputError, match="drop_nan"):
        extract_surface(np.where(cloud > 0.14, np.nan, cloud), axis=axis)
    with pytest.raises(InputError, match="unit='mm'"):
        extract_surface(1000 * cloud, axis=axis)
    with pytest.raises(InputError, match="transposed"):
        extract_surface(cloud.T, axis=axis)
    with pytest.raises(InputError, match="100 or more"):
        extract_surface(cloud[:50], axis=axis)
    with pytest.raises(GeometryError, match="never meets the axis"):
        extract_surface(cloud + np.array([2.0, 0, 0]), axis=axis)
    with pytest.raises(GeometryError, match="quarter turn around the axis"):
        extract_surface(cloud + np.array([0.4, 0, 0]), axis=axis, support=None)
    with pytest.raises(GeometryError, match="does the axis run inside"):
        beside = cloud[cloud[:, 0] < -0.12] + [-0.3, 0, 0]
        extract_surface(beside, axis=axis, support=None, z_range=(-0.1, 0.1))
    with pytest.raises(InputError, match="slope_std must be positive"):
        ContourModel(slope_std=0.0)


# ---------------------------------------------------------------------- spokes


def test_candidates_are_the_points_near_the_spoke() -> None:
    """Against brute force over every pair of point and spoke."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.2, 0.2, (400, 3))
    theta = np.arange(12) * (2 * np.pi / 12)
    z = np.linspace(-0.1, 0.1, 5)
    found = collect(points, theta, z, spoke_distance=0.02, slice_distance=0.03)
    r = np.hypot(points[:, 0], points[:, 1])
    for j, t in enumerate(theta):
        along = points[:, :2] @ [np.cos(t), np.sin(t)]
        across = points[:, :2] @ [-np.sin(t), np.cos(t)]
        for k, height in enumerate(z):
            near = (np.abs(across) <= 0.02) & (along > 0) & (r > 0.02)
            near &= np.abs(points[:, 2] - height) <= 0.03
            expected = np.sort(r[near])
            assert found.count[j, k] == near.sum()
            kept = found.radius[j, k][np.isfinite(found.radius[j, k])]
            np.testing.assert_allclose(kept, expected)


def test_thinning_keeps_the_distribution() -> None:
    r = np.linspace(0.1, 0.2, 1000)
    points = np.stack([r, 0 * r, 0 * r], axis=1)
    z = np.array([0.0, 0.1])
    theta = np.arange(8) * np.pi / 4
    found = collect(points, theta, z, spoke_distance=0.004, slice_distance=0.01)
    kept = found.radius[0, 0]
    assert found.count[0, 0] == 1000 and np.isfinite(kept).all()
    assert kept.mean() == pytest.approx(0.15, abs=0.002)


def test_cut_ends_are_left_out() -> None:
    rng = np.random.default_rng(0)
    r = 0.15 * np.sqrt(rng.random(20_000))
    theta = rng.uniform(0, 2 * np.pi, r.size)
    cap = np.stack([r * np.cos(theta), r * np.sin(theta), np.full(r.size, 0.2)], 1)
    found = usable_range(np.concatenate([cylinder(rng, noise=0.001), cap]))
    assert -0.2 <= found.z_min < -0.185
    assert 0.185 < found.z_max < 0.2


def test_strays_are_dropped_and_surfaces_kept() -> None:
    rng = np.random.default_rng(0)
    cloud = cylinder(rng)
    strays = rng.uniform(0.3, 0.6, (30, 3))
    kept = drop_strays(np.concatenate([cloud, strays]))
    assert (np.hypot(kept[:, 0], kept[:, 1]) < 0.2).all()
    assert len(kept) > 0.999 * len(cloud)


# --------------------------------------------------------- CT torso as the truth


@dataclass(frozen=True)
class Simulated:
    vertices: Array
    faces: NDArray[np.int64]
    cloud: Array


@cache
def ct_scan() -> Simulated:
    """The CT skin on a bed, seen from the front and both flanks, two holes."""
    path = DATA / "ct_skin_mm.ply"
    if not path.exists():
        pytest.skip("ct_skin_mm.ply is not beside the checkout")
    import trimesh

    mesh = trimesh.load(path, process=False)
    vertices = np.asarray(mesh.vertices, float) * 1e-3
    faces = np.asarray(mesh.faces)
    if mesh.volume < 0:
        faces = faces[:, ::-1]
    rng = np.random.default_rng(1)
    points, normals = camera.sample_mesh(vertices, faces, 600_000, rng)
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    side = (points[:, 2] > low + 0.002) & (points[:, 2] < high - 0.002)
    points, normals = points[side], normals[side]
    for centre in ([0.05, 0.30, 0.33], [-0.17, 0.12, 0.20]):
        middle = points[np.argmin(((points - centre) ** 2).sum(1))]
        outside = ((points - middle) ** 2).sum(1) > 0.03**2
        points, normals = points[outside], normals[outside]
    bed, up = camera.bed_plane(
        np.array([0, vertices[:, 1].min(), 0.26]), (0.9, 0.7), 600_000, rng
    )
    points, normals = np.concatenate([points, bed]), np.concatenate([normals, up])
    seen = [
        camera.see(points, normals, camera.View(direction, 0.003), rng)
        for direction in ((0, -1, 0), (-1, -0.45, 0), (1, -0.45, 0))
    ]
    cloud = rng.permutation(np.concatenate(seen))[:100_000]
    return Simulated(vertices, faces, cloud)


def true_radius(scan: Simulated, surface: Surface) -> Array:
    """True r(θ, z); NaN where the section meets the mesh's cut ends."""
    vertices = surface.axis.to_patient(scan.vertices)
    truth = camera.radius_by_section(vertices, scan.faces, surface.theta, surface.z)
    nodes = np.stack(
        [
            truth * np.cos(surface.theta)[:, None],
            truth * np.sin(surface.theta)[:, None],
            np.broadcast_to(surface.z, truth.shape),
        ],
        axis=-1,
    )
    height = surface.axis.to_scan(nodes.reshape(-1, 3))[:, 2].reshape(truth.shape)
    low, high = scan.vertices[:, 2].min(), scan.vertices[:, 2].max()
    return np.where((height > low + 0.003) & (height < high - 0.003), truth, np.nan)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["known", "estimated"])
def test_ct_torso_seen_by_cameras(frame: str) -> None:
    scan = ct_scan()
    assert len(scan.cloud) == 100_000
    axis = Axis.from_cloud(scan.cloud)
    if frame == "known":
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        axis = Axis(np.array([0, 0.15, 0.26]), turn)
    surface = extract_surface(scan.cloud, axis=axis)
    error = surface.radius - true_radius(scan, surface)
    inside = np.isfinite(error)
    assert inside.mean() > 0.97
    observed = np.abs(error[surface.observed & inside])
    assert observed.mean() < 0.0010  # asked for: 2 mm
    assert np.percentile(observed, 95) < 0.0025  # asked for: 5 mm
    assert abs(error[surface.observed & inside].mean()) < 0.0002
    filled = np.abs(error[~surface.observed & inside])
    assert filled.mean() < 0.010
    assert 0.2 < len(filled) / inside.sum() < 0.45
    # The two holes are in the unseen part; so is everything behind the flanks.
    score = error[inside] / surface.radius_std[inside]
    assert np.sqrt(np.mean(score**2)) < 1.5


def test_camera_sees_one_side_only() -> None:
    """The test's own camera: nothing from the far side, noise along the ray."""
    rng = np.random.default_rng(0)
    theta = rng.uniform(0, 2 * np.pi, 200_000)
    normals = np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    points = 0.15 * normals + np.outer(rng.uniform(-0.2, 0.2, theta.size), [0, 0, 1])
    seen = camera.see(points, normals, camera.View((0, -1, 0), 0.003), rng)
    assert seen[:, 1].min() > 0.0
    depth = seen[:, 1] - np.sqrt(0.15**2 - seen[:, 0] ** 2)
    assert depth.std() == pytest.approx(0.003, rel=0.02)


# ---------------------------------------------------------------- the real scan


@cache
def real_scan() -> tuple[Array, Surface]:
    path = DATA / "realsense_male_m.pcd"
    if not path.exists():
        pytest.skip("realsense_male_m.pcd is not beside the checkout")
    cloud = read_cloud(path, unit="m")
    return cloud, extract_surface(cloud, axis=Axis.from_cloud(cloud))


def test_real_scan_is_followed() -> None:
    cloud, s = real_scan()
    plane = find_supporting_plane(cloud)
    assert plane is not None
    body = s.axis.to_patient(cloud[plane.above(cloud)])
    body = body[(body[:, 2] >= s.z[0]) & (body[:, 2] <= s.z[-1])]
    assert np.ptp(s.z) > 0.4 and len(body) > 30_000
    theta, z = np.meshgrid(
        np.linspace(0, 2 * np.pi, 1080, endpoint=False),
        np.linspace(s.z[0], s.z[-1], 360),
        indexing="ij",
    )
    r = s.radius_at(theta, z)
    dense = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
    j = np.rint(theta / s.theta[1]).astype(int) % len(s.theta)
    k = np.rint((z - s.z[0]) / (s.z[1] - s.z[0])).astype(int)
    distance, _ = cKDTree(dense[s.observed[j, k]]).query(body)
    assert np.median(distance) < 0.0015  # asked for: 3 mm
    assert np.percentile(distance, 95) < 0.005  # asked for: 8 mm
    back, _ = cKDTree(body).query(s.points()[s.observed])
    assert np.median(back) < 0.002  # points are about 3 mm apart
    assert np.percentile(back, 95) < 0.005
    per_section = s.observed.sum(axis=0) / len(s.theta) * 36
    assert 12 < np.median(per_section) < 26  # 16-25 of 36 by eye


def test_real_table_is_never_skin() -> None:
    cloud, s = real_scan()
    plane = find_supporting_plane(cloud)
    assert plane is not None
    nodes = s.points()
    height = plane.height(s.axis.to_scan(nodes.reshape(-1, 3))).reshape(s.radius.shape)
    assert height[s.observed].min() > 0.008
    assert height.min() > -1e-6  # the filled back does not pass through it either
    # The table reaches 15 cm out of the body's side; no low node leaves the body.
    lateral = np.abs(nodes[..., 1])
    for k in range(len(s.z)):
        low = s.observed[:, k] & (height[:, k] < 0.03)
        high = s.observed[:, k] & (height[:, k] > 0.08)
        if low.any():
            assert lateral[low, k].max() < lateral[high, k].max()
    table = cloud[~plane.above(cloud)]
    table = table[np.abs(s.axis.to_patient(table)[:, 1]) > 0.13]  # clear of the seam
    assert len(table) > 4000
    gap, _ = cKDTree(table).query(s.axis.to_scan(nodes[s.observed]))
    assert gap.min() > 0.008


def test_real_surface_is_smooth_and_closed() -> None:
    _, s = real_scan()
    assert np.isfinite(s.radius).all() and (s.radius_std > 0).all()
    r = np.concatenate([s.radius[-1:], s.radius, s.radius[:1]])
    bend = np.abs(r[2:] - 2 * r[1:-1] + r[:-2])
    assert np.percentile(bend, 99) < 0.004
    assert bend[[0, -1]].mean() < 2 * bend.mean()  # no seam where the lap closes


def test_same_scan_same_surface() -> None:
    cloud, s = real_scan()
    again = extract_surface(cloud, axis=Axis.from_cloud(cloud))
    np.testing.assert_array_equal(again.radius, s.radius)
