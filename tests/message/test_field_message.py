"""Fields as messages: the bound holds, both sides solve the same equation."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import (
    InputError,
    TtusError,
    ellipsoid,
    presses,
    refuses,
    small_scene,
    torso,
)
from tests.message.patients import SECTOR, fitted, over_a_sector, sent, sent_sector
from tests.message.sealing import body, sealed
from ttus_opt import example
from ttus_opt.laplace.multigrid.solver import Multigrid
from ttus_opt.message import decode, encode, field_message
from ttus_opt.message.envelope import FIELD, LONGEST
from ttus_opt.message.field_message import sampled

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


@pytest.mark.parametrize(
    "sampling", ["trilinear", "voxel-mean", "contact-size:0.01834"]
)
def test_there_and_back(sampling):
    field = fitted(sampling)
    surface, message = sent(sampling)
    received = decode(message, base=surface)
    read = sampled(received.voxmap)
    assert np.abs(received.values - field.values)[read].max() <= 0.01 * (1 + 1e-6)
    assert received.voxmap.grid == field.voxmap.grid
    assert received.sampling == sampling
    assert received.parameters == {"boundary_scale": 2.0}


def test_a_surface_that_is_rounded_after_the_fit():
    """The bound holds where contact reads; regions are those of what is decoded."""
    field = fitted()
    coarse = encode(field.voxmap.surface, max_error=4e-3)
    received = decode(encode(field, base=coarse), base=coarse)
    own = received.voxmap
    assert (own.region != field.voxmap.region).any()  # or nothing is tested
    laid = tt.Voxmap.from_surface(
        own.surface, shape=own.grid.shape, r_inner=0.03, r_outer=own.grid.r_outer
    )
    np.testing.assert_array_equal(own.region, laid.region)
    read = sampled(own)
    error = np.abs(received.values - field.values)
    assert 0.005 < error[read].max() <= 0.01 * (1 + 1e-6)
    assert error[~read].max() > 0.01
    fine = decode(encode(field, base=coarse, max_error=1e-4), base=coarse)
    assert np.abs(fine.values - field.values)[read].max() <= 1e-4 * (1 + 1e-3)


@pytest.mark.parametrize("boundary", ["subvoxel", "staircase"])
@pytest.mark.parametrize("sampling", ["trilinear", "voxel-mean"])
def test_what_contact_reads_is_where_the_bound_holds(sampling, boundary):
    surface, shell = torso(), ellipsoid()
    voxmap = tt.Voxmap.from_surface(
        surface, shape=(9, 20, 10), r_inner=0.03, boundary=boundary
    )
    poses = presses(surface, 40, np.random.default_rng(3))
    scene = tt.Scene.assemble(voxmap, shell, poses, inner=1.0, sampling=sampling)
    touched = np.unique(scene.N.indices)
    assert sampled(voxmap).reshape(-1)[touched].all()


def test_a_bound_of_ones_own():
    surface, message = sent()
    fine = encode(fitted(), base=surface, max_error=1e-5)
    received = decode(fine, base=surface)
    read = sampled(received.voxmap)
    error = np.abs(received.values - fitted().values)[read]
    assert error.max() <= 1e-5 * (1 + 1e-3)
    assert len(fine) > len(message)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [None, 1e-2])
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_size_and_force_of_case_M(weight):
    """A field of 345,600 voxels takes 3 kB, and 0.02 N at 0.25 mm and 0.005 N/cm²."""
    cloud = tt.read_cloud(example.path("scan.ply"), unit="m")
    frame = tt.Surface.load(example.path("surface.nc")).axis  # of the recordings
    base = encode(tt.extract_surface(cloud, axis=frame))
    surface = decode(base)  # what both sides have
    assert isinstance(surface, tt.Surface)
    shell = tt.PointShell.ellipsoid((0.030, 0.0125, 0.018))
    recordings = [
        tt.read_trajectory(example.path(f"{name}_fit.csv"))
        for name in ("press", "sweep")
    ]
    scene = tt.Scene.assemble(
        tt.Voxmap.from_surface(surface, shape=(48, 120, 60), r_inner=0.03),
        shell,
        tt.Trajectory.concatenate(recordings),
        inner="fit",
        sampling="trilinear",
    )
    if weight is None:  # by marginal likelihood, as usual
        field = tt.fit(scene, "eq10", weights="auto").field
    else:
        field = tt.fit(scene, "eq10", force_weight=weight, torque_weight=weight).field
    message = encode(field, base=base)
    assert len(message) <= (3000 if weight is None else 1200)
    received = decode(message, base=base)
    assert np.abs(received.values - field.values).max() <= 0.005 * (1 + 1e-6)
    before, after = tt.Renderer(field, shell), tt.Renderer(received, shell)
    test = tt.read_trajectory(example.path("press_test.csv"))
    wrenches = [
        (before.render(*pose), after.render(*pose))
        for pose in zip(test.rotation, test.position, strict=True)
    ]
    effect = [
        np.linalg.norm(b.force - a.force) for b, a in wrenches if b.contact_points
    ]
    print(f"{len(message)} bytes, {np.mean(effect):.3f} N, {np.max(effect):.3f} N")
    assert np.mean(effect) < 0.02
    assert len(effect) > 100


def test_messages_in_the_wrong_places():
    surface, message = sent()
    refuses(InputError, "its surface", encode, fitted())
    refuses(InputError, "give that as base", decode, message)
    other = encode(fitted().voxmap.surface, max_error=1e-3)
    refuses(InputError, "builds on message", decode, message, base=other)
    refuses(InputError, "surface's message first", decode, message, base=message)
    refuses(InputError, "in their order", decode, message, base=[surface, message])


def test_a_surface_of_other_heights_is_told():
    surface = fitted().voxmap.surface
    longer = encode(replace(surface, z=surface.z * 1.1))
    with pytest.raises(InputError, match="encode the surface that the field"):
        encode(fitted(), base=longer)


def test_a_field_over_a_sector_there_and_back():
    field, (surface, message) = over_a_sector(), sent_sector()
    received = decode(message, base=surface)
    own = received.voxmap
    assert own.grid == field.voxmap.grid and own.grid.sector == SECTOR
    error = np.abs(received.values - field.values)[sampled(own)].max()
    assert 0.0 < error <= 0.01 * (1 + 1e-6)

    poses = small_scene("trilinear").trajectory  # some beside the sector
    before, after = tt.Renderer(field, ellipsoid()), tt.Renderer(received, ellipsoid())
    forces = [
        (before.render(*pose).force, after.render(*pose).force)
        for pose in zip(poses.rotation, poses.position, strict=True)
    ]
    b, a = np.moveaxis(np.array(forces), 1, 0)
    np.testing.assert_allclose(a, b, atol=0.05)
    met = np.linalg.norm(b, axis=1) > 0.5
    assert met.any() and not met.all()


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (52, b"\x02", "its sector"),
        (53, np.float64(np.nan).tobytes(), "two angles"),
        (53, np.float64(2.7).tobytes(), "to a larger one"),
        (61, np.float64(60.0).tobytes(), "two angles"),
    ],
)
def test_hostile_sectors(at, value, words):
    surface, message = sent_sector()
    refuses(TtusError, words, decode, bent(at, value, message), base=surface)


@pytest.mark.parametrize("bound", [0.0, -1.0, np.nan, np.inf])
def test_bounds_that_make_no_sense(bound):
    refuses(InputError, "max_error", encode, fitted(), base=sent()[0], max_error=bound)


def test_large_fields_are_refused_unless_asked_for():
    surface, message = sent()
    with pytest.raises(InputError, match=r"1,800 voxels, at most 1,000"):
        decode(message, base=surface, max_voxels=1000)


def test_fields_beyond_any_link_are_not_encoded(monkeypatch):
    monkeypatch.setattr(field_message, "MOST_SENT", 1000)
    with pytest.raises(InputError, match=r"at most 1,000 voxels, got 1,800"):
        encode(fitted(), base=sent()[0])


@pytest.mark.slow
def test_a_field_of_case_M_is_decoded_in_64_MiB_and_a_larger_one_on_request(
    monkeypatch,
):
    """Its time is that of one solve, counted in V-cycles; its memory is traced."""
    surface = torso()
    base = encode(surface)
    voxmap = tt.Voxmap.from_surface(surface, shape=(48, 120, 60), r_inner=0.03)
    rough = np.random.default_rng(0).normal(0.0, 0.05, voxmap.grid.shape)
    message = encode(tt.PotentialField(voxmap, rough, "trilinear"), base=base)
    solve, cycles = Multigrid.solve, []

    def counted(self, *given, **named):
        found = solve(self, *given, **named)
        cycles.append(found.iterations)
        return found

    monkeypatch.setattr(Multigrid, "solve", counted)
    tracemalloc.start()
    try:
        decode(message, base=base)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()
    assert len(cycles) == 1 and cycles[0] <= 12
    larger = tt.Voxmap.from_surface(surface, shape=(56, 120, 60), r_inner=0.03)
    flat = tt.PotentialField(larger, np.zeros(larger.grid.shape), "trilinear")
    with pytest.raises(InputError, match=r"403,200 voxels, at most 400,000 are"):
        decode(encode(flat, base=base), base=base)


def bent(at, value, message=None):
    content = body(message or sent()[1])
    return sealed(content[:at] + value + content[at + len(value) :], FIELD)


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (4, b"\xff\xff\xff\xff\xff\xff", "281,462,092,005,375 voxels"),
        (4, b"\x00\x00\x00\x00\x00\x00", "damaged|at least"),
        (10, np.float64(np.nan).tobytes(), "not finite"),
        (10, np.float64(0.2).tobytes(), "r_outer|surface"),
        (18, np.float64(1e300).tobytes(), "half a radial step"),
        (26, b"\x09", "unknown sampling"),
        (27, b"\x09", "unknown boundary"),
        (28, np.float64(np.nan).tobytes(), "boundary values"),
        (36, np.float64(1e300).tobytes(), "boundary values"),
        (44, np.float64(np.nan).tobytes(), "max_error"),
    ],
)
def test_hostile_headers(at, value, words):
    refuses(TtusError, words, decode, bent(at, value), base=sent()[0])


@pytest.mark.parametrize(
    "text", [b"", b"[", b"[" * 60_000, b"[1, 2]", b'[{"a": "b"}, {}]', b"[{}]"]
)
def test_hostile_parameters(text, monkeypatch):
    field, base = fitted(), sent()[0]  # kept for other tests, so before the patch
    monkeypatch.setattr("json.dumps", lambda _: text.decode())
    message = encode(field, base=base)
    refuses(InputError, "parameters", decode, message, base=base)


def test_the_longest_message_holds_any_surface():
    # 32 bits a node at most, and the mask
    assert LONGEST > 2**20 * 4.2
