"""One thread renders, others update and warm up: what they share and what not."""

import threading

import numpy as np
import pytest

import ttus_opt as tt
from tests.haptic.test_renderer import random_field
from tests.kit import (
    DRAG,
    TWIST,
    InputError,
    deepest_pose,
    pressing,
    refuses,
    scaled,
)
from ttus_opt.haptic.field_swap import swapped


def test_updates_from_another_thread_never_jump_nor_stop_the_frames(scene):
    """A standing probe feels a slow change, and in the air the last field holds."""
    field = random_field(scene)
    law = tt.BlendLaw(force_rate=5.0, reserve=1.0)
    renderer = tt.Renderer(field, scene.shell, blend=law)
    fields = [scaled(field, s) for s in np.random.default_rng(5).uniform(0.2, 3.0, 25)]
    pose = deepest_pose(scene)
    before = renderer.render(*pose).force
    failures: list[BaseException] = []

    def feed():
        try:
            for new in fields:
                renderer.update(new)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=feed)
    thread.start()
    frames = 0
    while thread.is_alive() or frames < 200:
        after = renderer.render(*pose).force
        assert np.linalg.norm(after - before) <= 5e-3 * (1 + 1e-9)
        before = after
        frames += 1
    thread.join()
    assert not failures
    renderer.render(np.eye(3), np.array([0.0, 0.0, 7.0]))
    assert renderer.blend.progress == 1.0
    np.testing.assert_array_equal(
        renderer.render(*pose).force,
        tt.Renderer(fields[-1], scene.shell).render(*pose).force,
    )


def scratch_of(renderer):
    """Copies of all that a frame writes and the next call might read."""
    data, buffers = renderer._data, renderer._buffers
    names = ("place", "near", "node", "touched", "depth", "voxel", "share", "hits")
    arrays = {name: getattr(data, name) for name in names} | buffers._asdict()
    arrays["ledger"] = renderer._fields.pair.ledger
    return {name: array.copy() for name, array in arrays.items()}


@pytest.mark.parametrize("call", ["warm_up", "update"])
def test_other_threads_calls_leave_a_frames_scratch_alone(scene, call):
    """A frame may be half done when another thread updates or compiles."""
    field = pressing(scene, DRAG)
    renderer = tt.Renderer(field, scene.shell, blend=tt.BlendLaw(force_rate=1e-9))
    pose = deepest_pose(scene)
    renderer.render(*pose, TWIST)
    renderer.update(scaled(field, 2.0, {}))
    renderer.render(*pose, TWIST)
    before, data = scratch_of(renderer), renderer._data
    if call == "warm_up":
        renderer.warm_up()
    else:  # amid a swap, so that two drags are mixed at the last pose
        renderer.update(field)
    after = scratch_of(renderer)
    assert renderer._data is data
    for name, array in before.items():
        if name != "ledger" or call == "warm_up":
            np.testing.assert_array_equal(after[name], array, err_msg=name)


def test_frames_give_way_to_an_update(scene):
    """While an update wants the turn, frames render and do not take it."""
    field, pose = pressing(scene), deepest_pose(scene)
    renderer = tt.Renderer(field, scene.shell)
    renderer.render(*pose)
    renderer.update(scaled(field, 0.5))
    renderer._waiting = True
    before = renderer._fields.pair.ledger.copy()
    force = renderer.render(*pose).force
    np.testing.assert_array_equal(renderer._fields.pair.ledger, before)
    renderer._waiting = False
    assert np.linalg.norm(renderer.render(*pose).force) < np.linalg.norm(force)
    assert renderer.blend.progress > 0.0


def test_updates_come_one_after_the_other(scene, monkeypatch):
    """A second update still waiting keeps its claim when the first one ends."""
    field = pressing(scene)
    renderer, claims = tt.Renderer(field, scene.shell), []
    threads = [threading.Thread(target=renderer.update, args=(field,)) for _ in "ab"]

    def watched(*arguments):
        if not claims:
            claims.append(renderer._waiting)
            threads[1].start()
            threads[1].join(0.2)  # it waits, for the turn or for its place
        else:
            threads[0].join(5.0)
            claims.append(renderer._waiting)
        return swapped(*arguments)

    monkeypatch.setattr("ttus_opt.haptic.renderer.swapped", watched)
    threads[0].start()
    threads[0].join(10.0)
    threads[1].join(10.0)
    assert claims == [True, True]


@pytest.mark.parametrize("call", ["render", "render_into"])
def test_two_threads_that_render_at_once_are_told(scene, call):
    """A second frame comes while the first is under way; afterwards all is well."""
    renderer, pose = tt.Renderer(pressing(scene), scene.shell), deepest_pose(scene)
    within, told = renderer._set_motion, []

    def frame():
        more = (np.empty(6),) if call == "render_into" else ()
        return getattr(renderer, call)(*pose, *more)

    def meanwhile(*arguments):
        renderer._set_motion = within

        def other():
            refuses(InputError, "give each thread its own Renderer", frame)
            told.append(True)

        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        return within(*arguments)

    renderer._set_motion = meanwhile
    frame()
    assert told == [True]
    refuses(InputError, "NaN", renderer.render, np.full((3, 3), np.nan), pose[1])
    frame()  # a frame that was refused gives its turn back
