import itertools
import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, deepest_pose, python, refuses, scaled, small_scene
from ttus_opt.contact.rows import contact_rows
from ttus_opt.haptic.wrench import render_frame


def random_field(scene):
    values = np.random.default_rng(1).normal(size=scene.voxmap.grid.shape)
    return tt.PotentialField(scene.voxmap, values, scene.sampling)


def test_render_is_the_row_of_the_fit(scene):
    """render(pose) == (N(pose) p, W(pose) p), eq. (6.5) of docs/method/contact.md."""
    field = random_field(scene)
    renderer = tt.Renderer(field, scene.shell)
    force = (scene.N @ field.values.reshape(-1)).reshape(-1, 3)
    torque = (scene.W @ field.values.reshape(-1)).reshape(-1, 3)
    touched = 0
    poses = zip(scene.trajectory.rotation, scene.trajectory.position, strict=True)
    for t, pose in enumerate(poses):
        wrench = renderer.render(*pose)
        assert wrench.in_grid
        assert wrench.contact_points == scene.rows.contact_points[t]
        touched += wrench.contact_points > 0
        np.testing.assert_allclose(wrench.force, force[t], rtol=0, atol=1e-12)
        np.testing.assert_allclose(wrench.torque, torque[t], rtol=0, atol=1e-13)
    assert touched > 5


@pytest.mark.parametrize("kind", ["f4", ">f8"])
def test_shells_and_surfaces_of_other_numbers_render_alike(kind):
    """A frame reads addresses: single precision was read as double, and gave 0 N."""
    scene = small_scene("trilinear")
    pose = deepest_pose(scene)
    shell = replace(scene.shell, points=scene.shell.points.astype(kind))
    surface = scene.voxmap.surface
    surface = replace(surface, radius=surface.radius.astype(kind))
    voxmap = replace(scene.voxmap, surface=surface)
    field = replace(random_field(scene), voxmap=voxmap)
    expected = tt.Renderer(random_field(scene), scene.shell).render(*pose).force
    found = tt.Renderer(field, shell).render(*pose).force
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def least_memory(frame):
    """Bytes that 250 frames leave and at most hold: the least of three rounds.

    Python's count is of the whole process. A progress bar's thread of an earlier test,
    or the collection of its garbage, may fall into one round; what a frame allocates is
    in each.
    """
    rounds = []
    tracemalloc.start()
    try:
        for _ in range(4):  # the first fills the interpreter's lists of spare objects
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            for _ in range(250):
                frame()
            now, peak = tracemalloc.get_traced_memory()
            rounds.append((now - before, peak - before))
    finally:
        tracemalloc.stop()
    kept, peaks = zip(*rounds[1:], strict=True)
    return min(kept), min(peaks)


def test_nothing_is_compiled_or_allocated_in_a_frame(scene):
    """Whatever layout a pose has; also while a swap of fields is under way."""
    field = random_field(scene)
    renderer = tt.Renderer(field, scene.shell, blend=tt.BlendLaw(force_rate=1e-9))
    known = list(render_frame.signatures)
    out = np.zeros(6)
    R, at = (array.copy() for array in deepest_pose(scene))
    frozen = R.copy()
    frozen.setflags(write=False)
    straight = renderer.render(R, at).force
    for rotation in (np.asfortranarray(R), frozen, R.tolist(), np.stack([R, R], 2)):
        pose = rotation[..., 0] if np.ndim(rotation) == 3 else rotation
        np.testing.assert_array_equal(renderer.render(pose, at).force, straight)
    twist, clock = np.array([0.02, 0.01, 0.03, 0.5, 0.1, -0.2]), itertools.count()
    frames = {
        "settled": lambda: renderer.render_into(R, at, out),
        "swapping": lambda: renderer.render_into(R, at, out),
        "dragging": lambda: renderer.render_into(R, at, out, twist),
        "estimating": lambda: renderer.render_into(R, at, out, time=1e-3 * next(clock)),
    }
    after = {"settled": {}}
    for stage, frame in frames.items():
        kept, peak = least_memory(frame)
        assert kept < 200, stage  # less than a byte per frame
        assert peak < 2100, stage  # numba's fingerprint of one call's arguments
        drag = after.get(stage, {"friction_coefficient": 0.3})
        values = 2 * field.values if stage == "settled" else field.values
        renderer.update(tt.PotentialField(field.voxmap, values, field.sampling, drag))
    assert renderer.blend.progress < 1.0
    assert list(render_frame.signatures) == known


def test_a_frame_leaves_no_trace_in_the_next_nor_changes_the_last(scene):
    renderer = tt.Renderer(random_field(scene), scene.shell)
    poses = list(zip(scene.trajectory.rotation, scene.trajectory.position, strict=True))
    kept = [renderer.render(*pose) for pose in poses]
    first = [wrench.force.copy() for wrench in kept]
    again = [renderer.render(*pose).force for pose in reversed(poses)]
    np.testing.assert_array_equal(first, again[::-1])
    np.testing.assert_array_equal(first, [wrench.force for wrench in kept])


def test_outside_the_grid_is_zero_and_says_so(scene):
    renderer = tt.Renderer(random_field(scene), scene.shell)
    far = np.array([0.0, 0.0, 7.0])
    assert renderer.render_into(np.eye(3), far, np.empty(6)) == -1
    wrench = renderer.render(np.eye(3), far)
    assert not wrench.in_grid
    assert wrench.contact_points == 0
    assert not wrench.force.any()
    assert not wrench.torque.any()


@pytest.mark.parametrize(
    ("rotation", "position", "word"),
    [
        (np.eye(4), np.zeros(3), r"\(3, 3\)"),
        (np.eye(3), np.zeros(2), r"\(3,\)"),
        (np.eye(3) * 1.1, np.zeros(3), "orthonormal"),
        (np.full((3, 3), np.nan), np.zeros(3), "NaN"),
        (np.eye(3), np.array([0.0, np.nan, 0.0]), "NaN"),
        (np.eye(3), np.array([0.0, np.inf, 0.0]), "NaN or infinite"),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "reflection .determinant −1."),
        (-np.eye(3), np.zeros(3), "reflection"),
    ],
)
def test_unusable_poses(scene, rotation, position, word):
    renderer = tt.Renderer(random_field(scene), scene.shell)
    refuses(InputError, word, renderer.render, rotation, position)


def test_a_field_loaded_from_file_renders_the_same(tmp_path):
    scene = small_scene("trilinear")
    field = random_field(scene)
    field.save(f"{tmp_path}/field.nc")
    loaded = tt.PotentialField.load(f"{tmp_path}/field.nc")
    R, at = scene.trajectory.rotation[3], scene.trajectory.position[3]
    np.testing.assert_array_equal(
        tt.Renderer(loaded, scene.shell).render(R, at).force,
        tt.Renderer(field, scene.shell).render(R, at).force,
    )
    rows = contact_rows(loaded.voxmap, scene.shell, R[None], at[None])
    assert rows.contact_points[0] == scene.rows.contact_points[3]


def test_the_callers_field_is_not_the_renderers(scene):
    """Changing an array after it was handed over changes no force."""
    values = np.random.default_rng(2).normal(size=scene.voxmap.grid.shape)
    field = tt.PotentialField(scene.voxmap, values, scene.sampling)
    renderer = tt.Renderer(field, scene.shell)
    pose = deepest_pose(scene)
    before = renderer.render(*pose).force
    values *= 2.0
    np.testing.assert_array_equal(renderer.render(*pose).force, before)


def test_an_update_before_the_first_frame_is_simply_taken(scene):
    field = random_field(scene)
    renderer = tt.Renderer(field, scene.shell)
    new, pose = scaled(field, 3), deepest_pose(scene)
    renderer.update(new)
    assert renderer.blend.progress == 1.0
    np.testing.assert_array_equal(
        renderer.render(*pose).force, tt.Renderer(new, scene.shell).render(*pose).force
    )


def test_an_update_must_fit():
    scene = small_scene("trilinear")
    field = random_field(scene)
    told, other = "cannot change the field's sampling", "voxel-mean"
    renderer = tt.Renderer(field, scene.shell)
    refuses(InputError, told, renderer.update, replace(field, sampling=other))


def test_out_must_hold_a_wrench(scene):
    renderer = tt.Renderer(random_field(scene), scene.shell)
    with pytest.raises(InputError, match=r"\(6,\), got float64 \(3,\)"):
        renderer.render_into(np.eye(3), np.zeros(3), np.zeros(3))


@pytest.mark.slow
def test_a_pickled_renderer_gives_the_same_in_another_process(tmp_path):
    """The newest field, settled, with its limits: as a renderer built of it."""
    scene = small_scene("trilinear")
    field = random_field(scene)
    renderer = tt.Renderer(field, scene.shell, force_limit=0.5)
    renderer.render(scene.trajectory.rotation[0], scene.trajectory.position[0])
    newest = scaled(field, 2.0)
    renderer.update(newest)  # a blend that is still under way
    poses = scene.trajectory.rotation, scene.trajectory.position
    (tmp_path / "sent").write_bytes(pickle.dumps((renderer, *poses)))
    code = (
        "import pickle, sys, numpy as np\n"
        "renderer, turns, places = pickle.load(open(sys.argv[1] + '/sent', 'rb'))\n"
        "felt = [renderer.render(R, x) for R, x in zip(turns, places)]\n"
        "wrenches = [[*w.force, *w.torque] for w in felt]\n"
        "np.save(sys.argv[1] + '/felt.npy', wrenches)\n"
    )
    python("-c", code, tmp_path)
    there = np.load(tmp_path / "felt.npy")
    own = tt.Renderer(newest, scene.shell, force_limit=0.5)
    here = [own.render(R, x) for R, x in zip(*poses, strict=True)]
    assert (there == [[*w.force, *w.torque] for w in here]).all()
    assert np.linalg.norm(there[:, :3], axis=1).max() == pytest.approx(0.5)
