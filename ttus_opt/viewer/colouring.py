"""What the skin can be coloured by: a number at every node, with name and unit.

- *Stiffness*: force of a light reference press at every node, as the renderer gives it.
- *Uncertainty*: standard deviation of a press's force over that force, from the map
  that ``ttus-opt fit --uncertainty`` stores with a field, or from the fit itself.
- *Seen*: whether the scan saw the skin, or it was filled in.
- *Next press*: standard deviation of a press's force before further presses, and the
  places where these would tell most (`ttus_opt.fitting.uncertainty.next_press`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ttus_opt.contact.standing import standing
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.viewer.skin import SPACING, SkinMesh
from ttus_opt.voxmap.field import PotentialField

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty

#: Depth of the reference press: a light one, about 1 to 3 N on soft tissue [m]
LIGHT = 0.005

#: Share of the nodes that the colour scale covers: a few outliers do not darken the
#: rest [–]
COVERED = 0.98

#: Places over whose numbers a node's is interpolated, the nearest most [–]
NEAR = 4


@dataclass(frozen=True)
class Colouring:
    """A number at every node of the skin.

    Attributes:
        title: What the numbers are.
        unit: Of the numbers; "" for classes.
        values: One a node, NaN where there is none, shape (n,).
        classes: Names of the values 0, 1, … where they are classes.
        marks: Numbered places to show, patient frame, shape (k, 3) [m].
    """

    title: str
    unit: str
    values: Array = field(repr=False)
    classes: tuple[str, ...] = ()
    marks: Array = field(default_factory=lambda: np.zeros((0, 3)), repr=False)

    @property
    def span(self) -> tuple[float, float]:
        """Numbers at the two ends of the colour scale."""
        known = self.values[np.isfinite(self.values)]
        if self.classes:
            return 0.0, float(len(self.classes) - 1)
        if not len(known):
            return 0.0, 1.0
        low, high = np.quantile(known, [1.0 - COVERED, COVERED])
        return float(low), float(high)


def stiffness(
    field: PotentialField,
    renderer: Renderer,
    shell: PointShell,
    hold: Array,
    skin: SkinMesh,
) -> Colouring:
    """Force of a light reference press at every node; none where the model ends.

    Args:
        field: What is rendered.
        renderer: Its own, which no other thread uses.
        shell: The probe.
        hold: Its orientation relative to the skin, shape (3, 3) [–].
        skin: The nodes.
    """
    surface, rest = field.voxmap.surface, np.zeros(6)
    poses = standing(surface, shell, hold, skin.theta, skin.z, LIGHT)
    force = np.full(len(skin.theta), np.nan)
    for i, (rotation, position) in enumerate(zip(*poses, strict=True)):
        wrench = renderer.render(rotation, position, rest)
        if wrench.contact_points > 0 and wrench.limited_by != "end":
            force[i] = float(np.linalg.norm(wrench.force))
    title = f"force of a press {1e3 * LIGHT:g} mm deep"
    return Colouring(title, "N", force)


def uncertainty(
    field: PotentialField, skin: SkinMesh, stated: Uncertainty | None = None
) -> Colouring:
    """Relative standard deviation of a press's force at every node.

    Args:
        field: What is shown.
        skin: The nodes.
        stated: Uncertainty of the field's fit, where the field holds no map.

    Raises:
        InputError: Neither a map nor a fit's uncertainty.
    """
    known = field.uncertainty
    if known is None and stated is not None:
        from ttus_opt.fitting.uncertainty.skin_uncertainty import uncertainty_map

        known = uncertainty_map(stated.sampled(), field)
    if known is None:
        raise InputError(
            "this field holds no uncertainty: fit with ttus-opt fit --uncertainty"
        )
    values = [known.at(*point) for point in skin.vertices.tolist()]
    title = "standard deviation of a press, of its force"
    return Colouring(title, "%", 100.0 * np.array(values))


def seen(field: PotentialField, skin: SkinMesh) -> Colouring:
    """Which skin the scan saw, and which was filled in."""
    found = field.voxmap.surface.seen_at(skin.theta, skin.z)
    classes = "filled in", "seen by the scan"
    return Colouring("skin", "", found.astype(np.float64), classes)


def next_presses(stated: Uncertainty, skin: SkinMesh) -> Colouring:
    """Standard deviation of a press, and the places where to press next."""
    from ttus_opt.fitting.uncertainty.next_press import next_press

    found = next_press(stated)
    query = cKDTree(found.points).query(skin.vertices, k=NEAR)
    far, near = np.asarray(query[0]), np.asarray(query[1])
    weight = 1.0 / np.maximum(far, 1e-9) ** 2
    mean = (weight * found.before[near]).sum(axis=1) / weight.sum(axis=1)
    values = np.where(far[:, 0] < 3.0 * SPACING, mean, np.nan)
    title = f"standard deviation of a press {1e3 * found.depth:.1f} mm deep"
    marks = found.points[found.node]
    return Colouring(title, "N", values, marks=marks)
