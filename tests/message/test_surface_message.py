"""Surfaces as messages: sizes, bound, changes, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, TtusError, refuses, torso
from tests.message.patients import dented, uneven
from tests.message.sealing import body, sealed
from ttus_opt import example
from ttus_opt.message import decode, encode
from ttus_opt.message.envelope import SURFACE, SURFACE_DELTA
from ttus_opt.message.surface_message import Window

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


def check(sent, received, bound):
    assert np.abs(received.radius - sent.radius).max() <= bound * (1 + 1e-9)
    np.testing.assert_array_equal(received.observed, sent.observed)
    np.testing.assert_allclose(received.theta, sent.theta, atol=1e-15)
    np.testing.assert_allclose(received.z, sent.z, atol=1e-15)
    np.testing.assert_allclose(received.axis.rotation, sent.axis.rotation, atol=1e-14)
    np.testing.assert_array_equal(received.axis.origin, sent.axis.origin)
    for part in filter(np.any, (sent.observed, ~sent.observed)):
        np.testing.assert_allclose(
            received.radius_std[part], np.median(sent.radius_std[part]), rtol=1e-6
        )


@pytest.mark.parametrize("bound", [1e-5, 0.25e-3, 2e-3])
def test_there_and_back(bound):
    check(uneven(), decode(encode(uneven(), max_error=bound)), bound)


@pytest.mark.parametrize("shape", [(4, 2), (5, 3), (7, 40), (64, 33)])
def test_any_counts(shape):
    sent = torso(*shape)
    received = decode(encode(sent))
    assert np.abs(received.radius - sent.radius).max() <= 0.25e-3
    assert received.observed.all()


def test_a_smaller_bound_takes_more_bytes():
    lengths = [len(encode(uneven(), max_error=e)) for e in (1e-3, 1e-4, 1e-5)]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scan", "unit", "most"),
    [
        (example.path("scan.ply"), "m", 2000),
        ("torso/ct_skin_mm.ply", "mm", 2300),
        ("torso/realsense_male_m.pcd", "m", 3200),
    ],
)
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_sizes_of_real_surfaces(shared, scan, unit, most):
    cloud = tt.read_cloud(shared / scan, unit=unit)
    surface = tt.extract_surface(
        cloud, axis=tt.Axis.from_cloud(cloud), n_theta=180, n_z=60
    )
    message = encode(surface, max_error=0.25e-3)
    assert len(message) <= most
    check(surface, decode(message), 0.25e-3)


def test_a_change_is_short_and_exact():
    first, second = uneven(180, 60), dented(uneven(180, 60))
    whole = encode(first)
    change = encode(second, base=whole)
    assert len(change) < len(whole) / 4
    received = decode(change, base=whole)
    assert np.abs(received.radius - second.radius).max() <= 0.25e-3 * (1 + 1e-9)
    np.testing.assert_array_equal(received.observed, second.observed)


def test_changes_follow_one_another():
    surfaces = [uneven(), dented(uneven()), dented(uneven(), -0.003)]
    messages = [encode(surfaces[0])]
    for surface in surfaces[1:]:
        messages.append(encode(surface, base=messages))
    received = decode(messages[-1], base=messages[:-1])
    assert np.abs(received.radius - surfaces[-1].radius).max() <= 0.25e-3 * (1 + 1e-9)
    refuses(InputError, "builds on message", decode, messages[2], base=messages[0])


def test_no_change_is_a_change_too():
    whole = encode(uneven())
    received = decode(encode(uneven(), base=whole), base=whole)
    check(uneven(), received, 0.25e-3)


def test_a_change_everywhere_at_a_smaller_bound():
    whole = encode(uneven(), max_error=1e-3)
    received = decode(encode(uneven(), base=whole, max_error=1e-5), base=whole)
    assert np.abs(received.radius - uneven().radius).max() <= 1e-5 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("marked", "window"),
    [
        ([], (0, 1, 0, 1)),
        ([(3, 2)], (3, 1, 2, 1)),
        ([(9, 0), (0, 4), (1, 2)], (9, 3, 0, 5)),
        ([(2, 1), (5, 1)], (2, 4, 1, 1)),
        ([(j, 0) for j in range(10)], (0, 10, 0, 1)),
    ],
)
def test_the_window_is_the_smallest_on_the_circle(marked, window):
    changed = np.zeros((10, 5), bool)
    for node in marked:
        changed[node] = True
    found = Window.around(changed)
    assert found == window
    assert changed[found.indices(changed.shape)].sum() == len(marked)


def test_another_grid_or_frame_is_told():
    whole = encode(uneven())
    for other in (uneven(44), replace(uneven(), axis=tt.Axis.identity())):
        refuses(InputError, "another grid or patient frame", encode, other, base=whole)


@pytest.mark.parametrize("bound", [0.0, -1.0, np.nan, np.inf, 1e-12])
def test_bounds_that_make_no_sense(bound):
    refuses(InputError, "max_error", encode, uneven(), max_error=bound)


def test_messages_in_the_wrong_places():
    whole = encode(uneven())
    change = encode(dented(uneven()), base=whole)
    refuses(InputError, "give that as base", decode, change)
    refuses(InputError, "no base", decode, whole, base=whole)
    refuses(InputError, "surface's message first", decode, change, base=change)
    refuses(InputError, "in their order", decode, change, base=[whole, whole])
    refuses(InputError, "base is empty", decode, change, base=[])


@pytest.mark.parametrize(
    ("at", "value"),
    [
        (0, b"\xff\xff\xff\xff"),  # counts
        (0, b"\x00\x00\x00\x00"),
        (0, b"\xff\x7f\x1f\x00"),
        (4, np.float64(np.nan).tobytes()),  # first angle
        (12, np.float64(1e300).tobytes()),  # lowest height
        (20, np.float64(-5.0).tobytes()),  # highest height
        (52, bytes(32)),  # rotation
        (84, np.float32(np.nan).tobytes()),  # standard deviation
        (92, np.float64(np.nan).tobytes()),  # bound
        (92, np.float64(1e-300).tobytes()),
        (92, np.float64(0.9).tobytes()),
    ],
)
def test_hostile_headers(at, value):
    content = body(encode(uneven()))
    bent = content[:at] + value + content[at + len(value) :]
    refuses(TtusError, "", decode, sealed(bent, SURFACE))


@pytest.mark.parametrize(
    "window", [(40, 1, 0, 1), (0, 41, 0, 1), (0, 0, 0, 1), (0, 1, 14, 2), (0, 1, 0, 0)]
)
def test_windows_beyond_the_surface(window):
    whole = encode(uneven())
    content = body(encode(dented(uneven()), base=whole))
    bent = content[:4] + np.array(window, "<u2").tobytes() + content[12:]
    with pytest.raises(InputError, match="beyond 40 x 15"):
        decode(sealed(bent, SURFACE_DELTA), base=whole)
