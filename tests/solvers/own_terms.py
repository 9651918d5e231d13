"""Terms over all voxels as a user writes them, without tags; those of the benchmark."""

from dataclasses import dataclass

import numpy as np

from benchmarks.own_terms.along_z import AlongZ
from benchmarks.own_terms.depth_weighted import DepthWeighted
from benchmarks.own_terms.skin_graph import SkinGraph
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.departures import difference_rows


@dataclass(frozen=True)
class Differences(Term):
    """Differences between neighbours in r, θ and z."""

    name = "differences"

    def rows(self):
        rows = difference_rows(self.scene.voxmap.grid)
        return AffineRows({"p": rows}, np.zeros(rows.shape[0]))


OWN = (DepthWeighted, AlongZ, SkinGraph)
