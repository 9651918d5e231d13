"""Errors near and far from the places a field was fitted to, light and deep.

The depth of a contact is the largest of the shell's points, R(θ, z) − r. Its place is
the foot on the surface, along the radius, of the points' mean weighted by area and
depth. A field file has the fitted places in cells of a few millimetres, and the deepest
contact.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from ttus_opt.contact.standing import skin_points
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import Errors, Evaluation
from ttus_opt.scan.surface import Surface

#: Limits of the bins: distance from a fitted place [m], depth over the deepest one [–]
DISTANCES = 0.0, 0.02, 0.05, 0.1, math.inf
DEPTHS = 0.0, 0.5, 1.0, math.inf

#: Smallest side of a cell [m], and most cells of a file, for which the side is doubled
CELL, MOST_CELLS = 0.004, 1000

#: Frames whose shell points are in memory at once [–]
CHUNK = 256


@dataclass(frozen=True)
class Contacts:
    """Contact of every frame.

    Attributes:
        place: On the surface, patient frame, shape (T, 3) [m].
        depth: Shape (T,) [m]; 0 without contact.
    """

    place: Array = field(repr=False)
    depth: Array = field(repr=False)

    @classmethod
    def of(cls, surface: Surface, shell: PointShell, poses: Trajectory) -> Contacts:
        """Contacts along a trajectory."""
        place, depth = np.zeros((len(poses), 3)), np.zeros(len(poses))
        for start in range(0, len(poses), CHUNK):
            some = slice(start, start + CHUNK)
            points = shell.points @ poses.rotation[some].transpose(0, 2, 1)
            points += poses.position[some, None]
            deep, z = np.maximum(surface.depth_of(points), 0.0), points[..., 2]
            deep[(z < surface.z[0]) | (z > surface.z[-1])] = 0.0  # no skin is known
            depth[some] = deep.max(axis=1)
            share = shell.areas * deep
            share /= np.maximum(share.sum(axis=1, keepdims=True), np.finfo(float).tiny)
            x, y, z = np.einsum("tm,tmi->it", share, points)
            place[some] = skin_points(surface, np.arctan2(y, x), z)
        return cls(place, depth)


@dataclass(frozen=True)
class FittedContacts:
    """What a field was fitted to, as its file has it.

    Attributes:
        cell: Side of the cells [m].
        cells: Cells with a fitted place, in multiples of the side, shape (n, 3) [–].
        deepest: Largest depth [m].
    """

    cell: float
    cells: Array = field(repr=False)
    deepest: float

    @classmethod
    def of(cls, contacts: Contacts) -> FittedContacts | None:
        """Cells of the contacts' places; None without contact."""
        places = contacts.place[contacts.depth > 0.0]
        if not len(places):
            return None
        cell = CELL
        while len(cells := np.unique(np.rint(places / cell), axis=0)) > MOST_CELLS:
            cell *= 2.0
        return cls(cell, cells, float(contacts.depth.max()))

    @property
    def text(self) -> str:
        """For the provenance of a field."""
        cells = self.cells.astype(int).tolist()
        facts = {"cell_m": self.cell, "deepest_m": self.deepest, "cells": cells}
        return json.dumps(facts, separators=(",", ":"))

    @classmethod
    def from_text(cls, text: str) -> FittedContacts:
        """What `text` has written.

        Raises:
            FileError: It is damaged.
        """
        try:
            facts = json.loads(text)
            cells = np.array(facts["cells"], dtype=float).reshape(-1, 3)
            map_ = cls(float(facts["cell_m"]), cells, float(facts["deepest_m"]))
        except (ValueError, TypeError, KeyError) as error:
            raise _damaged() from error
        sizes = map_.cell, map_.deepest
        if not (len(cells) and np.isfinite(cells).all() and min(sizes) > 0.0):
            raise _damaged()
        return map_

    def distance(self, places: Array) -> Array:
        """To the nearest fitted cell's centre, shape (T,) [m]."""
        return np.asarray(KDTree(self.cells * self.cell).query(places)[0])


def _damaged() -> FileError:
    return FileError("the field file's contacts are damaged: fit the field again")


@dataclass(frozen=True)
class Bin:
    """Errors of the frames in contact between two limits.

    Attributes:
        low: Lower limit [m or –].
        high: Upper limit, which is included [m or –].
        frames: Number of frames.
        errors: Their errors; None without frames.
    """

    low: float
    high: float
    frames: int
    errors: Errors | None

    def as_dict(self) -> dict[str, Any]:
        """For JSON; the last bin's upper limit is null."""
        errors = None if self.errors is None else self.errors.as_dict()
        high = self.high if math.isfinite(self.high) else None
        return {"from": self.low, "to": high, "frames": self.frames, "errors": errors}


def bins(value: Array, limits: tuple[float, ...], judged: Evaluation) -> list[Bin]:
    """Errors by a value per frame, shape (T,); NaN leaves a frame out."""
    number = np.digitize(value, limits[1:-1], right=True)
    number[np.isnan(value)] = -1
    out = []
    for i, (low, high) in enumerate(itertools.pairwise(limits)):
        some = number == i
        errors = judged.over(some).errors if some.any() else None
        out.append(Bin(low, high, int(some.sum()), errors))
    return out


def by_distance_and_depth(
    fitted: FittedContacts, contacts: Contacts, judged: Evaluation
) -> tuple[list[Bin], list[Bin]]:
    """Errors by the distance from fitted places [m], and by depth over the deepest [–].

    Args:
        fitted: What the field was fitted to.
        contacts: Contacts of the judged frames.
        judged: These frames.
    """
    touching = contacts.depth > 0.0
    distance = np.where(touching, fitted.distance(contacts.place), np.nan)
    relative = np.where(touching, contacts.depth / fitted.deepest, np.nan)
    return bins(distance, DISTANCES, judged), bins(relative, DEPTHS, judged)
