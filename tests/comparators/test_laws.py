"""What holds for every comparator, tested by its being in the folder."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.comparators.recordings import facing, fitted, options, recordings
from tests.kit import InputError, ellipsoid, refuses, torso
from ttus_opt.comparators import available, create, kind

# a recording this short, on so coarse a grid, does not bear weights of its own
pytestmark = pytest.mark.filterwarnings(
    "ignore:weights were not chosen:ttus_opt.core.errors.TtusWarning"
)

NAMES = list(available())
#: Their fits or frames take long
LONG = {"depth_map", "depth_map_coulomb", "eq10", "proxy_six_dof", "tuned"}


#: Two that stand for the others where a law needs fits of its own
QUICK = {"kelvin_voigt", "signed_distance"}


def those(names, quick=None):
    """Parametrised over comparators, slow where they are or are not quick."""

    def slow(name):
        return name in LONG if quick is None else name not in quick

    return pytest.mark.parametrize(
        "name",
        [pytest.param(n, marks=pytest.mark.slow if slow(n) else ()) for n in names],
    )


every = those(NAMES)


def wrench(name, R, at, twist=None):
    found = fitted(name).render(R, at, twist)
    return np.concatenate([found.force, found.torque])


@every
def test_nothing_pushes_in_the_air(name):
    height = 0.04 if name == "ellipsoid_torso" else 0.001  # its skin is another one
    R, at = facing(torso(), 1.3, 0.1, -height)
    assert not wrench(name, R, at).any()
    assert not wrench(name, R, 3.0 * at, np.full(6, 0.1)).any()


@every
def test_touch_pushes_outwards_and_more_the_deeper(name):
    outward = facing(torso(), 1.3, 0.1, 0.0)[1] * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward)
    out = []
    for depth in np.linspace(0.001, 0.008, 15):
        R, at = facing(torso(), 1.3, 0.1, float(depth))
        out.append(float(wrench(name, R, at)[:3] @ outward))
    assert min(out) >= 0.0
    assert out[-1] > 2.0 * out[4] > 0.0


@every
def test_a_straight_press_never_pulls_in_nor_out(name):
    outward = facing(torso(), 1.3, 0.1, 0.0)[1] * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward)
    for depth in (1e-5, 0.0005, 0.002, 0.006):
        for speed in (-0.2, 0.2):
            R, at = facing(torso(), 1.3, 0.1, depth)
            twist = np.concatenate([speed * outward, np.zeros(3)])
            assert wrench(name, R, at, twist)[:3] @ outward >= 0.0


@those(name for name in NAMES if kind(name).continuous)
def test_force_is_continuous_in_the_pose(name):
    jumps = []
    for n in (20, 160):
        path = [_along(share) for share in np.linspace(0.0, 1.0, n)]
        steps = np.diff([wrench(name, *pose) for pose in path], axis=0)
        jumps.append(np.abs(steps[:, :3]).max())
    # 8 times shorter steps: 8 times smaller where it is smooth, the same at a jump
    assert jumps[1] < 0.35 * jumps[0]


def _along(share):
    """From the air into the patient, then sliding and turning."""
    down, slide = min(2.0 * share, 1.0), max(2.0 * share - 1.0, 0.0)
    R, at = facing(
        torso(), 1.3 + 0.3 * slide, 0.09 + 0.02 * slide, 0.008 * down - 0.001
    )
    turn = Rotation.from_rotvec([0.1 * slide, 0.2 * slide, 0.1]).as_matrix()
    return R @ turn, at


@every
def test_deep_poses_give_finite_wrenches(name):
    R, at = facing(torso(), 1.3, 0.1, 0.0)
    for share in (0.8, 0.5, 0.1, 0.0):
        there = np.array([share * at[0], share * at[1], at[2]])
        assert np.isfinite(wrench(name, R, there)).all()


@those((name for name in NAMES if kind(name).turns), QUICK)
def test_turning_the_scene_turns_the_wrench(name):
    surface, quarter = torso(), Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    n = len(surface.theta)
    if n % 4:
        surface = torso(4 * (n // 4))
    turned = tt.Surface.from_radius(
        np.roll(surface.radius, len(surface.theta) // 4, 0), surface.z
    )
    motion = np.eye(4)
    motion[:3, :3] = quarter.as_matrix()
    both = []
    for skin, move in ((surface, np.eye(4)), (turned, motion)):
        made = create(name, surface=skin, shell=ellipsoid(), **options(name))
        made.fit([part.transformed(move) for part in recordings()])
        both.append(made.wrenches(recordings()[1].transformed(move)))
    back = np.hstack([quarter.inv().apply(part) for part in np.hsplit(both[1], 2)])
    size = np.abs(both[0][:, :3]).max()
    # a quarter turn moves the nodes between which a depth map's evidence interpolates,
    # which forces without noise resolve
    near = 1e-2 if name.startswith("depth_map") else 1e-3
    np.testing.assert_allclose(back[:, :3], both[0][:, :3], atol=near * size)


@every
def test_along_a_recording_each_frame_is_rendered(name):
    slide = recordings()[1].select(slice(5, 12))
    twist = slide.twist()
    one_by_one = [
        wrench(name, *pose)
        for pose in zip(slide.rotation, slide.position, twist, strict=True)
    ]
    np.testing.assert_allclose(fitted(name).wrenches(slide), one_by_one, rtol=1e-12)


@those(NAMES, QUICK)
def test_a_second_fit_forgets_the_first(name):
    press, slide = recordings()
    made = create(name, surface=torso(), shell=ellipsoid(), **options(name))
    assert made.fit(slide).fit([press, slide]) is made
    np.testing.assert_allclose(
        made.wrenches(slide), fitted(name).wrenches(slide), rtol=1e-6, atol=1e-9
    )


@every
def test_bad_input_is_told_in_one_line(name):
    made = create(name, surface=torso(), shell=ellipsoid(), **options(name))
    R, at = facing(torso(), 1.3, 0.1, 0.004)
    press, _ = recordings()
    bare = tt.Trajectory(press.time, press.position, press.rotation)
    still = replace(press, force=0.0 * press.force)
    away = replace(press, position=press.position + np.array([0.0, 2.0, 0.0]))
    for given in ([], bare, still, away, replace(press, force=-press.force)):
        refuses(InputError, "", made.fit, given)
    refuses(InputError, "not fitted yet", made.render, R, at)
    refuses(InputError, "not fitted yet", made.wrenches, press)
    for pose in ((R, at * np.nan), (R * np.nan, at), (2.0 * R, at), (R, at[:2])):
        with pytest.raises(InputError, match=r"NaN|finite|orthonormal|\(3,\)"):
            fitted(name).render(*pose)
    with pytest.raises(InputError, match="twist"):
        fitted(name).render(R, at, np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0]))


def test_unknown_names_and_options_are_told():
    with pytest.raises(InputError, match="unknown comparator 'laplase'"):
        create("laplase", surface=torso(), shell=ellipsoid())
    with pytest.raises(InputError, match="has no option edges: it has edge"):
        create("voxmap_point_shell", surface=torso(), shell=ellipsoid(), edges=0.1)
    with pytest.raises(InputError, match="at least 10 points"):
        create("proxy_cloud", surface=torso(), shell=ellipsoid(), cloud=np.zeros(3))


@pytest.mark.parametrize("name", available())
def test_a_comparator_made_by_its_class_takes_no_unknown_keyword(name):
    with pytest.raises(TypeError, match="unexpected keyword argument 'edges'"):
        kind(name)(surface=torso(), shell=ellipsoid(), edges=0.1)


def test_each_says_in_one_line_what_it_is():
    for name, summary in available().items():
        assert summary, name
        assert "\n" not in summary
        assert len(summary) < 80, name
