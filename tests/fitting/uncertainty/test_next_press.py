"""Greedy choice against conditioning, and suggestions on a torso with three presses."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.uncertainty.test_field_uncertainty import KEPT_SHARE, three_presses
from tests.kit import InputError, refuses
from ttus_opt.fitting.uncertainty.next_press import greedy, next_press, normal_forces
from ttus_opt.fitting.uncertainty.wrench_uncertainty import rendered, wrench_rows


def conditioned(C, noise, chosen):
    """Covariance of all, given measurements of some."""
    among = C[np.ix_(chosen, chosen)] + np.diag(noise[chosen])
    return np.asarray(C - C[:, chosen] @ np.linalg.solve(among, C[chosen]))


def test_it_takes_what_explains_most_of_what_is_left():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(12, 5)) * rng.uniform(0.3, 2.0, (12, 1))
    C, noise = root @ root.T, rng.uniform(0.1, 1.0, 12)
    noise[3] = np.inf  # cannot be measured
    region = np.arange(12) < 7
    chosen, shares, std = greedy(C, noise, region, 4)
    taken = []
    before = C
    for one, share in zip(chosen.tolist(), shares.tolist(), strict=True):
        left = [
            np.diag(conditioned(C, noise, [*taken, k]))[region].sum()
            if k != 3 and k not in taken
            else np.inf
            for k in range(12)
        ]
        assert one == int(np.argmin(left))
        was = np.diag(before)[region].sum()
        assert share == pytest.approx((was - min(left)) / np.diag(C)[region].sum())
        taken.append(one)
        before = conditioned(C, noise, taken)
    np.testing.assert_allclose(std, np.sqrt(np.diag(before)), rtol=1e-9)


def test_a_place_is_suggested_once_however_noisy():
    covariance = np.diag([4.0, 1.0, 0.5])
    chosen, _, _ = greedy(covariance, np.full(3, 100.0), np.ones(3, dtype=bool), 3)
    assert chosen.tolist() == [0, 1, 2]


@functools.cache
def stated():
    return tt.uncertainty(tt.fit(three_presses(), "depth_map"), three_presses())


@functools.cache
def suggested():
    return next_press(stated(), 3, spacing=0.04, depth=0.006)


pytestmark = pytest.mark.filterwarnings(KEPT_SHARE)


def test_presses_are_where_least_is_known():
    found, scene = suggested(), three_presses()
    held = scene.trajectory.select(scene.rows.contact_points > 0).position
    away = np.linalg.norm(held - found.poses.position[0], axis=1)
    assert away.min() > 0.04
    assert found.before[found.node[0]] > 0.8 * found.before.max()
    assert (found.after <= found.before + 1e-9).all()
    before, after = found.region_std
    assert after**2 / before**2 == pytest.approx(1.0 - found.reduction.sum())
    *_, noise = normal_forces(stated(), found.poses)
    # what was measured is known so well
    assert (found.after[found.node] ** 2 <= noise).all()
    assert len(found.as_dict()["presses"]) == 3


def test_stated_deviations_are_those_of_the_uncertainty():
    found = suggested()
    rows, sized, noise = normal_forces(stated(), found.poses)
    assert not sized.any()  # of trilinear sampling
    own = np.sqrt(stated().covariance(rows)[:, 0, 0])
    np.testing.assert_allclose(own, found.before[found.node], rtol=1e-6)
    force = rows @ stated().potential.values.ravel()
    np.testing.assert_allclose(force, found.force[found.node], rtol=1e-9)
    given = stated().potential, stated().scene.shell, found.poses
    wrench = rendered(stated().potential, wrench_rows(*given))
    along = stated().noise.covariance(wrench)[:, :3, :3]
    assert (noise <= np.einsum("tii->t", along)).all() and (noise > 0.0).all()


def test_the_region_decides():
    box = (-math.inf, math.inf, -math.inf, math.inf, 0.05, 0.11)
    low = next_press(stated(), 2, box=box, sector=(2.5, 4.5), spacing=0.04, depth=0.006)
    inside = (low.z >= 0.05) & (low.z <= 0.11) & (low.theta >= 2.5) & (low.theta <= 4.5)
    np.testing.assert_array_equal(low.in_region, inside)
    assert low.in_region[low.node[0]]
    elsewhere = suggested().node[0]
    assert not low.in_region[elsewhere] or low.node[0] != elsewhere


def test_poses_are_written_as_a_trajectory(tmp_path):
    suggested().save(tmp_path / "next.csv")
    read = tt.read_trajectory(tmp_path / "next.csv")
    np.testing.assert_array_equal(read.position, suggested().poses.position)
    figure = tt.plots.next_press_picture(suggested(), three_presses().trajectory)
    tt.plots.save_picture(figure, tmp_path / "next.png")
    assert (tmp_path / "next.png").stat().st_size > 10_000


def test_each_place_is_a_cell_of_its_own_size():
    """Also beside skin that was not seen."""
    found = suggested()
    kept = (found.theta < 2.0) | (found.theta > 5.5)
    some = replace(
        found,
        **{n: getattr(found, n)[kept] for n in ("theta", "z", "before", "after")},
        in_region=found.in_region[kept],
        node=np.zeros(1, dtype=int),
    )
    cells = tt.plots.next_press_picture(some).axes[0].collections[0]
    corners = cells.get_coordinates()
    widths = np.diff(corners[0, :, 0])
    np.testing.assert_allclose(widths, widths[0])
    middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2.0
    drawn = np.asarray(cells.get_array().filled(np.nan)).reshape(middle.shape[:2])
    for theta, z, value in zip(some.theta, some.z, some.before, strict=True):
        place = np.degrees(theta), 100.0 * z
        at = np.linalg.norm(middle - place, axis=2).argmin()
        assert drawn.flat[at] == value
    assert np.isnan(drawn).any()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"count": 0}, "count must be 1 to"),
        ({"count": 10_000}, "count must be 1 to"),
        ({"depth": -0.01}, "depth must be positive"),
        ({"spacing": 0.0}, "spacing must be positive"),
        ({"sector": (0.0, 7.0)}, "less than a full turn"),
        ({"box": (5.0, 6.0, 5.0, 6.0, 5.0, 6.0)}, "no point lies in the box"),
        ({"sector": (0.3, 0.5), "spacing": 0.09}, "no place of the region"),
    ],
)
def test_what_gives_no_place_is_refused(given, told):
    with pytest.raises(InputError, match=told):
        next_press(stated(), **{"spacing": 0.04, "depth": 0.006} | given)


def test_a_field_without_force_has_no_next_press():
    given = stated()
    potential = replace(given.potential, values=0.0 * given.potential.values)
    none = replace(given, potential=potential)
    refuses(InputError, "no force where the skin", next_press, none, spacing=0.04)
