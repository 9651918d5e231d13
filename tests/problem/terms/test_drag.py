"""Drag models: rows against forces computed pose by pose, coefficients against numpy.

Five poses are in the air, ten at rest, the others slide along the skin.
"""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene
from ttus_opt.contact import friction
from ttus_opt.contact.friction import Sliding, coulomb_rows
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.haptic.field_wrench import wrenches_by_rows
from ttus_opt.problem.terms.drag import CoulombField, GlobalCoulomb, Viscous
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm

MU, DEADBAND = 0.3, 0.02
SECTORS, BANDS = 10, 4
N = SECTORS * BANDS


@functools.cache
def scene():
    whole = dragged_scene("contact", shape=(8, 16, 8), n=30)
    position, rotation = (
        getattr(whole.trajectory, name).copy() for name in ("position", "rotation")
    )
    position[:5, :2] *= 1.3
    position[20:], rotation[20:] = position[20], rotation[20]
    parts = np.searchsorted([5, 20], np.arange(30), side="right")
    trajectory = replace(
        whole.trajectory, position=position, rotation=rotation, segment=parts
    )
    return tt.Scene.assemble(
        whole.voxmap, whole.shell, trajectory, inner=3.0, sampling="trilinear"
    )


AIR, REST = np.arange(30) < 5, np.arange(30) >= 20


def field():
    return np.asarray(scene().laplace.solve(scene().b))


def wrench(model, values):
    """Force and torque that its rows make of values, a vector per pose, (T, 3) each."""
    both = (scene().N, model.rows.force), (scene().W, model.rows.torque)
    every = (model.beside(*rows) for rows in both)
    return [
        sum(M @ values[k] for k, M in rows.items()).reshape(-1, 3) for rows in every
    ]


def contact():
    """Force and torque without drag, shape (T, 3) each."""
    p = field()
    return (scene().N @ p).reshape(-1, 3), (scene().W @ p).reshape(-1, 3)


def told(model, values, drag):
    """Rows of force and torque have this drag in them, and act at the arm's end."""
    force, torque = contact()
    turning = np.cross(model.sliding.arm, drag)
    for found, expected in zip(
        wrench(model, values), (force + drag, torque + turning), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def by_coulomb(model, mu):
    """−μ v/max(|v|, v₀) (n̂·f), pose by pose, shape (T, 3) [N]."""
    drag = []
    poses = zip(model.sliding.velocity, model.sliding.normal, contact()[0], strict=True)
    for velocity, normal, force in poses:
        speed = max(math.hypot(*velocity), model.deadband)
        drag.append(-mu * (normal @ force) * velocity / speed)
    return np.array(drag)


@pytest.mark.parametrize("acts_at", ["contact", "reference"])
def test_a_given_coefficient_takes_its_share_of_the_normal_force(acts_at):
    model = GlobalCoulomb(scene(), acts_at, DEADBAND, MU)
    drag = by_coulomb(model, MU)
    assert np.linalg.norm(drag, axis=1).max() > 0.1
    told(model, {"p": field()}, drag)
    model.rows  # noqa: B018  (what another coefficient keeps)
    other = model.with_coefficient(0.1)
    told(other, {"p": field()}, by_coulomb(model, 0.1))
    assert other.rows is model.rows and other.sliding is model.sliding


def test_a_field_of_drag_does_the_same_where_it_is_a_share_of_the_potential():
    model, p = CoulombField(scene(), deadband=DEADBAND), field()
    told(model, {"p": p, "q": MU * p}, by_coulomb(model, MU))
    without = model.with_neutral(["friction_coefficient"])
    assert set(without.beside(scene().N, without.rows.force)) == {"p"}
    told(without, {"p": p}, np.zeros((30, 3)))
    assert model.with_neutral(["viscous_coefficient"]) is model


def by_patch(where):
    return Viscous(where, sectors=SECTORS, bands=BANDS)


def test_viscous_drag_is_the_patchs_coefficient_times_the_velocity():
    model = by_patch(scene())
    c = np.random.default_rng(0).uniform(5.0, 50.0, N)
    assert len(set(model.region[model.moving])) > 2
    drag = -c[model.region][:, None] * model.sliding.velocity
    told(model, {"p": field(), "c": c}, drag)
    first = int(model.region[model.moving][0])
    fewer = model.with_neutral([f"viscous_coefficient_{first}"])
    assert fewer.excluded == {first}
    drag[model.region == first] = 0.0
    told(fewer, {"p": field(), "c": c}, drag)


def test_what_is_identified_renders_as_the_rows_say():
    """The parameters alone, on a field, drag as the model does."""
    p = field()
    for model in (
        GlobalCoulomb(scene(), "reference", DEADBAND, MU),
        GlobalCoulomb(scene(), "points", DEADBAND, MU),
        Viscous(scene(), "contact", DEADBAND),
        Viscous(scene(), "reference", DEADBAND, SECTORS, BANDS),
    ):
        n = getattr(model, "sectors", 0) * getattr(model, "bands", 0)
        values = {"p": p, "c": np.linspace(5.0, 50.0, n)}
        potential = tt.PotentialField(
            scene().voxmap,
            scene().voxmap.grid.unflatten(p),
            "trilinear",
            model.parameters(values),
        )
        felt = wrenches_by_rows(
            scene().rows, potential, scene().shell, scene().trajectory
        )
        force, torque = wrench(model, values)
        np.testing.assert_allclose(felt.force, force, atol=1e-9)
        np.testing.assert_allclose(felt.torque, torque, atol=1e-9)


def test_poses_in_the_air_and_at_rest_do_not_slide():
    model = GlobalCoulomb(scene())
    np.testing.assert_array_equal(model.touching, ~AIR)
    assert not model.moving[AIR | REST].any()
    assert model.moving[6:19].all()


def some_drag_field(rng):
    p = field()
    return {"p": p, "q": p * rng.uniform(0.1, 0.5, len(p))}


def test_the_one_coefficient_of_a_drag_field_is_its_regression():
    model = CoulombField(scene())
    values = some_drag_field(np.random.default_rng(1))
    full, dragged = (model.rows.force @ values[k] for k in ("p", "q"))
    expected = np.linalg.lstsq(full[:, None], dragged)[0][0]
    assert model.identified(values) == {"friction_coefficient": pytest.approx(expected)}
    backwards = values | {"q": -values["q"]}
    assert model.identified(backwards) == {"friction_coefficient": 0.0}
    nothing = {"p": np.zeros_like(values["p"]), "q": values["q"]}
    assert model.identified(nothing) == {"friction_coefficient": 0.0}
    assert not model.fitted(nothing)["friction_coefficient"].gradient
    excluded = replace(model, excluded=True)
    assert excluded.identified(values) == {"friction_coefficient": 0.0}
    assert not excluded.fitted(values)


def slopes_agree(model, name, one, values):
    """A parameter's derivative against central differences along random directions."""
    rng = np.random.default_rng(2)
    assert one.gradient
    for variable, gradient in one.gradient.items():
        along = rng.normal(size=len(gradient)) * np.abs(values[variable]).mean()
        there, back = (
            model.identified({**values, variable: values[variable] + sign * along})
            for sign in (1e-5, -1e-5)
        )
        expected = (there[name] - back[name]) / 2e-5
        assert gradient @ along == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_drag_fields_coefficient_has_its_derivatives():
    model = CoulombField(scene(), largest=0.7)
    values = some_drag_field(np.random.default_rng(3))
    (found,) = model.fitted(values).items()
    slopes_agree(model, *found, values)
    assert (found[1].span, found[1].upper) == (1.0, 0.7)


def test_patches_and_their_mean_have_their_derivatives():
    model = by_patch(scene())
    values = {"p": field(), "c": np.linspace(5.0, 50.0, N)}
    found = model.fitted(values)
    slid = sorted({*model.region[model.moving].tolist()})
    names = [f"viscous_coefficient_{i}" for i in slid]
    assert list(found) == [*names, "viscous_coefficient"]
    for name, one in found.items():
        slopes_agree(model, name, one, values)
    fewer = replace(model, excluded=frozenset(slid[:1]))
    mean = fewer.fitted(values)["viscous_coefficient"]
    slopes_agree(fewer, "viscous_coefficient", mean, values)
    assert found["viscous_coefficient"].span == math.inf
    # drag as large as contact, at the speed of sliding
    here = model.moving & (model.region == slid[0])
    force, speed = (
        math.sqrt(np.mean(np.sum(v[here] ** 2, axis=1)))
        for v in (contact()[0], model.sliding.velocity)
    )
    assert found[names[0]].span == pytest.approx(force / max(speed, model.deadband))


def test_a_patch_never_touched_has_the_mean_of_all_frames_in_contact():
    model = by_patch(scene())
    c = np.linspace(5.0, 50.0, N)
    touched = model.region[~AIR]
    found = model.identified({"c": c})
    mean = float(np.mean([c[i] for i in touched]))
    assert found["viscous_coefficient"] == pytest.approx(mean)
    for i in range(N):
        expected = c[i] if i in touched else mean
        assert found[f"viscous_coefficient_{i}"] == pytest.approx(expected)
    assert (found["viscous_sectors"], found["viscous_bands"]) == (SECTORS, BANDS)
    backwards = Viscous(scene()).identified({"c": np.array([-3.0])})
    assert backwards == {"viscous_coefficient": 0.0}
    left_out = Viscous(scene(), excluded=frozenset({0}))
    assert left_out.identified({"c": np.array([3.0])}) == {"viscous_coefficient": 0.0}
    assert not left_out.fitted({"p": field()})


def only(poses):
    """The scene's poses of a mask alone."""
    whole = scene()
    return tt.Scene.assemble(
        whole.voxmap,
        whole.shell,
        whole.trajectory.select(np.flatnonzero(poses)),
        inner=3.0,
        sampling="trilinear",
    )


@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_what_no_pose_determines_is_said():
    for poses, why in ((AIR, "no contact"), (REST, "no sliding")):
        bare = only(poses)
        mu, c = {"friction_coefficient": why}, {"viscous_coefficient": why}
        assert GlobalCoulomb(bare).not_identifiable() == mu
        assert CoulombField(bare).not_identifiable() == mu | {
            "mean_friction_coefficient": why
        }
        assert Viscous(bare).not_identifiable() == c
        assert not Viscous(bare).fitted({"p": field()})
    for model in (GlobalCoulomb(scene()), CoulombField(scene()), Viscous(scene())):
        assert not model.not_identifiable()
    left_out = "the drag field is left out"
    assert CoulombField(scene(), excluded=True).not_identifiable() == {
        "friction_coefficient": left_out,
        "mean_friction_coefficient": left_out,
    }


def test_patches_say_each_for_itself_what_is_known():
    model = by_patch(scene())
    resting = by_patch(only(REST))
    touched, slid = (set(model.region[m].tolist()) for m in (~AIR, model.moving))
    told = model.not_identifiable()
    assert set(told) == {f"viscous_coefficient_{i}" for i in {*range(N)} - slid}
    never = [i for i in range(N) if i not in touched]
    for i in never:
        name = f"viscous_coefficient_{i}"
        assert told[name] == "never touched, as the mean of the others"
    told = resting.not_identifiable()
    (own,) = {*resting.region.tolist()}
    assert told[f"viscous_coefficient_{own}"] == "no sliding"
    assert told["viscous_coefficient"] == "no sliding"
    # one that was never touched stays, with the mean
    name = f"viscous_coefficient_{never[0]}"
    assert model.with_neutral([name]) is model
    all_left_out = replace(model, excluded=frozenset(range(N))).not_identifiable()
    assert all_left_out["viscous_coefficient"] == "none of its regions is identified"


@pytest.mark.parametrize("coefficient", [-0.1, math.nan, math.inf])
def test_a_coefficient_that_is_none_is_refused(coefficient):
    with pytest.raises(InputError, match="must not be negative"):
        GlobalCoulomb(scene(), coefficient=coefficient)


def test_a_straight_press_slides_along_its_flanks():
    """A symmetric probe pressed straight in: its patch slides nowhere."""
    one = tt.PointShell.sphere(0.02, n_points=60)
    signs = np.array([[1, b, c] for b in (1, -1) for c in (1, -1)])
    points, normals = (
        (signs[:, None] * values).reshape(-1, 3) for values in (one.points, one.normals)
    )
    shell = tt.PointShell(points, normals, np.tile(one.areas / 4, 4), np.zeros(3))
    surface = tt.Surface.from_radius(np.full((24, 9), 0.1), np.linspace(-0.06, 0.06, 9))
    voxmap = tt.Voxmap.from_surface(surface, shape=(10, 24, 13))
    x = 0.13 - 0.025 * np.sin(np.linspace(0.0, np.pi, 30))
    position = np.stack([x, 0 * x, 0 * x], axis=1)
    rotation = np.tile(np.eye(3), (30, 1, 1))
    zero = np.zeros((30, 3))
    straight = tt.Trajectory(0.05 * np.arange(30), position, rotation, zero, zero)
    scene = tt.Scene.assemble(voxmap, shell, straight, inner=3.0)
    touching = GlobalCoulomb(scene, "points").touching
    assert 5 < touching.sum() < 25
    for place in ("contact", "reference"):
        model = GlobalCoulomb(scene, place)
        assert np.abs(model.sliding.velocity).max() < 1e-12
        assert not model.moving.any()
    everywhere = GlobalCoulomb(scene, "points")
    np.testing.assert_array_equal(everywhere.moving, touching)
    assert everywhere.not_identifiable() == {}
    still = replace(straight, position=np.tile(position[15], (30, 1)))
    resting = GlobalCoulomb(
        tt.Scene.assemble(voxmap, shell, still, inner=3.0), "points"
    )
    assert resting.touching.all()
    assert not resting.moving.any()
    assert resting.not_identifiable() == {"friction_coefficient": "no sliding"}


def test_the_residual_is_contact_and_drag_less_what_was_measured():
    """Drag acts at the contact: its moment is arm × drag; torque is over a length."""
    model, length = GlobalCoulomb(scene(), "contact", DEADBAND, MU), 0.05
    (force, torque), drag = contact(), by_coulomb(model, MU)
    rows = ForceTerm(scene(), 2.0, drag=model).assembled
    found = rows.blocks["p"] @ field() - rows.target
    expected = force + drag - scene().f.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)
    rows = TorqueTerm(scene(), length=length, drag=model).assembled
    found = length * (rows.blocks["p"] @ field() - rows.target)
    expected = torque + np.cross(model.sliding.arm, drag) - scene().tau.reshape(-1, 3)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=1e-12)


def test_what_its_drag_knows_is_its_own():
    model = CoulombField(scene(), deadband=DEADBAND)
    term, values = ForceTerm(scene(), drag=model), {"p": field(), "q": MU * field()}
    assert term.parameters(values) == model.parameters(values)
    assert term.fitted(values).keys() == model.fitted(values).keys()
    assert term.not_identifiable() == model.not_identifiable()


@pytest.mark.parametrize("kind", [ForceTerm, TorqueTerm])
def test_without_drag_its_rows_are_those_of_the_scene(kind):
    own = {} if kind is ForceTerm else {"length": 1.0}
    drag = CoulombField(scene(), deadband=DEADBAND)
    term = kind(scene(), 2.0, drag=drag, **own)
    neutral = term.with_neutral(["friction_coefficient"])
    assert set(neutral.assembled.blocks) == {"p"} and neutral.weight == 2.0
    expected = scene().W if own else scene().N
    assert abs(neutral.assembled.blocks["p"] - expected).max() < 1e-12
    assert term.with_neutral(["another"]) is term


@pytest.mark.parametrize("deadband", [friction.DEADBAND, 0.01])
def test_rows_are_made_where_drag_acts(deadband):
    own = scene()
    where = own.voxmap, own.shell, own.trajectory
    for acts_at in ("contact", "reference", "points"):
        found = GlobalCoulomb(own, acts_at, deadband).rows
        expected = (
            point_drag_rows(*where, deadband=deadband)
            if acts_at == "points"
            else coulomb_rows(Sliding.of(*where, acts_at), own.rows, deadband=deadband)
        )
        for name in ("force", "torque"):
            difference = getattr(found, name) - getattr(expected, name)
            assert abs(difference).max() == 0.0
