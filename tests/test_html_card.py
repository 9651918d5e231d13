"""What a notebook shows: the facts, escaped, and a picture that decodes."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.html_card import card, sections_svg, signed_map
from ttus_opt.voxmap.field import PotentialField

SCENE = small_scene("trilinear")
FIELD = PotentialField(
    SCENE.voxmap,
    SCENE.voxmap.grid.unflatten(SCENE.b),
    "trilinear",
    {"boundary_scale": 2.0, "friction_coefficient": 0.25},
    standard_errors={"friction_coefficient": 0.013},
)


@pytest.mark.parametrize(
    ("shown", "facts"),
    [
        (SCENE.voxmap.surface, ["90 θ × 31 z", "R 8.3 to 12.0 cm", "100 % observed"]),
        (SCENE, ["9×20×10 = 1,800 voxels", "12 poses, ", "300 shell", "p_in 2, "]),
        (FIELD, ["p -1.5 to 2 N/cm²", "boundary_scale 2", "coefficient 0.25 ± 0.013"]),
    ],
)
def test_facts_stand_in_both_forms(shown: object, facts: list[str]) -> None:
    html = shown._repr_html_()  # type: ignore[attr-defined]
    for fact in facts:
        assert fact in repr(shown)
        assert fact in html
    assert type(shown).__name__ in html
    assert len(repr(shown)) < 200
    assert len(html) < 20_000
    ElementTree.fromstring(html)  # well formed


def test_short_forms_of_probe_and_trajectory() -> None:
    assert repr(SCENE.shell).startswith("PointShell(300 points, ")
    assert repr(SCENE.trajectory) == "Trajectory(12 frames, with wrenches)"


def test_a_card_escapes_what_it_shows() -> None:
    html = card("a<b", {"x&y": '"z"'}, "")
    assert "a&lt;b" in html and "x&amp;y" in html and "&quot;z&quot;" in html


def test_a_map_is_red_above_zero_and_blue_below() -> None:
    from matplotlib.image import imread

    html = signed_map(np.array([[2.0, 0.0, -1.0], [0.0, 1.0, -2.0]]))
    found = re.search(r"base64,([^\"]+)", html)
    assert found is not None
    pixels = imread(io.BytesIO(base64.b64decode(found[1])), format="png")
    assert pixels.shape == (2, 3, 3)
    np.testing.assert_allclose(pixels[0, 0], [1, 0, 0])
    np.testing.assert_allclose(pixels[0, 1], [1, 1, 1])
    np.testing.assert_allclose(pixels[0, 2], [0.5, 0.5, 1], atol=0.01)
    np.testing.assert_allclose(pixels[1, 2], [0, 0, 1])


def test_sections_hold_every_outline_circle_and_dot() -> None:
    square = 0.1 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]])
    svg = ElementTree.fromstring(sections_svg([square, 0.5 * square], [0.2], square))
    assert len(svg.findall("polygon")) == 2
    assert len(svg.findall("circle")) == 1 + 4
    low, _, width, _ = map(float, svg.attrib["viewBox"].split())
    assert low < -0.2 and low + width > 0.2
    assert svg.findall("polygon")[0].attrib["points"].startswith("0.100,-0.100")


def test_a_card_loads_no_plotting_package() -> None:
    program = (
        "import sys, tests.test_html_card as t; t.FIELD._repr_html_()\n"
        "print('matplotlib' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
