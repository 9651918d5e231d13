"""What a notebook shows: the facts, escaped, and a picture that decodes."""

import base64
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import python, small_scene
from ttus_opt.core.html_card import card, sections_svg, signed_map
from ttus_opt.fitting.checks.sanity import check_recordings
from ttus_opt.solvers.registry import solvers

SCENE = small_scene("trilinear")
FIELD = tt.PotentialField(
    SCENE.voxmap,
    SCENE.voxmap.grid.unflatten(SCENE.b),
    "trilinear",
    {"boundary_scale": 2.0, "friction_coefficient": 0.25},
    standard_errors={"friction_coefficient": 0.013},
)


def pixels_of(html):
    from matplotlib.image import imread  # not with this module: a card loads none

    found = re.search(r"base64,([^\"]+)", html)
    return np.asarray(imread(io.BytesIO(base64.b64decode(found[1])), format="png"))


@pytest.mark.parametrize(
    ("shown", "facts"),
    [
        (SCENE.voxmap.surface, ["90 θ × 31 z", "R 8.3 to 12.0 cm", "100 % observed"]),
        (SCENE, ["9×20×10 = 1,800 voxels", "12 poses, ", "300 shell", "p_in 2, "]),
        (SCENE.shell, ["300 points", "40 × 30 × 30 mm", " cm²"]),
        (SCENE.trajectory, ["12 frames", "0.55 s", "with wrenches"]),
        (
            replace(SCENE.trajectory, force=None, torque=None),
            ["12 frames", "without wrenches"],
        ),
        (FIELD, ["p -1.5 to 2 N/cm²", "boundary_scale 2", "coefficient 0.25 ± 0.013"]),
    ],
)
def test_facts_stand_in_both_forms(shown, facts):
    html = shown._repr_html_()
    for fact in facts:
        assert fact in repr(shown)
        assert fact in html
    assert type(shown).__name__ in html
    assert len(repr(shown)) < 200
    assert len(html) < 20_000
    ElementTree.fromstring(html)  # well formed


def test_short_forms_of_probe_and_trajectory():
    shell = "PointShell(300 points, 40 × 30 × 30 mm, "
    assert repr(SCENE.shell).startswith(shell)
    assert repr(SCENE.trajectory) == "Trajectory(12 frames, 0.55 s, with wrenches)"
    extent = "9×20×10 = 1,800 voxels, r 3.0 to 14.0 cm, z 0.0 to 20.0 cm"
    assert repr(SCENE.voxmap) == f"Voxmap({extent})"
    assert repr(SCENE.voxmap.grid) == f"CylindricalGrid({extent})"


def test_a_trajectory_s_curve_is_its_force():
    html = SCENE.trajectory._repr_html_()
    force = np.linalg.norm(SCENE.trajectory.force, axis=1)
    assert f"at most {force.max():.3g} N" in html
    found = re.search(r'points="([^"]+)"', html)
    drawn = np.array([p.split(",") for p in found[1].split()], dtype=float)
    assert len(drawn) == len(force)
    assert (160.0 - drawn[:, 1]) / 152.0 == pytest.approx(force / force.max(), abs=1e-3)
    assert drawn[[0, -1], 0] == pytest.approx([0.0, 160.0])


@pytest.mark.slow
def test_everything_public_is_one_short_line():
    solution = tt.fit(SCENE, "eq10_sign", solver="structured")
    field = solution.field
    evaluated = tt.evaluate(field, SCENE.shell, SCENE.trajectory)
    shown = [
        SCENE,
        SCENE.voxmap.surface.axis,
        SCENE.laplace,
        SCENE.rows,
        SCENE.shell,
        tt.load_formulation("eq10_sign", SCENE),
        tt.load_formulation("total_variation", SCENE),
        solution,
        solution.program,
        field,
        tt.Renderer(field, SCENE.shell),
        tt.RecursiveFit(SCENE),
        tt.Fitter(tt.load_formulation("eq10", SCENE), solver="structured"),
        evaluated,
        evaluated.errors,
        check_recordings(SCENE, field),
        *solvers().values(),
    ]
    for each in shown:
        line = repr(each)
        assert "\n" not in line and len(line) < 250, line
        assert " object at 0x" not in line and "array(" not in line, line
    assert "1 laplace + 0.01 force + 0.01 torque subject to sign" in repr(shown[5])


@pytest.mark.parametrize(
    ("wave", "high", "low"),
    [
        (np.sin, (1 / 8, 1 / 2), (7 / 8, 1 / 2)),
        (np.cos, (1 / 2, 7 / 8), (1 / 2, 1 / 8)),
    ],
)
def test_the_card_of_a_field_is_its_section(wave, high, low):
    """x to the right and y upwards, red where the field is positive."""
    grid = SCENE.voxmap.grid
    values = wave(grid.theta)[None, :, None] * np.ones(grid.shape)
    html = tt.PotentialField(SCENE.voxmap, values, "trilinear")._repr_html_()
    red, _, blue = np.moveaxis(pixels_of(html), -1, 0)
    n = len(red)
    for (row, column), sign in ((high, 1.0), (low, -1.0)):
        place = int(row * n), int(column * n)
        assert sign * (red - blue)[place] > 0.5
    assert red[0, 0] == blue[0, 0] == 1.0  # beyond the grid


def test_a_card_escapes_what_it_shows():
    html = card("a<b", {"x&y": '"z"'}, "")
    assert "a&lt;b" in html and "x&amp;y" in html and "&quot;z&quot;" in html


def test_a_map_is_red_above_zero_and_blue_below():
    html = signed_map(np.array([[2.0, 0.0, -1.0], [0.0, 1.0, -2.0]]))
    pixels = pixels_of(html)
    assert pixels.shape == (2, 3, 3)
    np.testing.assert_allclose(pixels[0, 0], [1, 0, 0])
    np.testing.assert_allclose(pixels[0, 1], [1, 1, 1])
    np.testing.assert_allclose(pixels[0, 2], [0.5, 0.5, 1], atol=0.01)
    np.testing.assert_allclose(pixels[1, 2], [0, 0, 1])


def test_sections_hold_every_outline_circle_and_dot():
    square = 0.1 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]])
    svg = ElementTree.fromstring(sections_svg([square, 0.5 * square], [0.2], square))
    assert len(svg.findall("polygon")) == 2
    assert len(svg.findall("circle")) == 1 + 4
    low, _, width, _ = map(float, svg.attrib["viewBox"].split())
    assert low < -0.2 and low + width > 0.2
    assert svg.findall("polygon")[0].attrib["points"].startswith("0.100,-0.100")


@pytest.mark.slow
def test_a_card_loads_no_plotting_package():
    program = (
        "import sys, tests.core.test_html_card as t; t.FIELD._repr_html_()\n"
        "print('matplotlib' in sys.modules)"
    )
    assert python("-c", program).stdout.strip() == "False"
