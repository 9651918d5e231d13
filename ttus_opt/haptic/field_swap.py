"""The fields that a renderer holds: the present one, the new one, and their drag.

They are replaced together (`swapped`), so that a frame never sees half of an update.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ttus_opt.contact.friction import FRICTION, VISCOUS
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.blend import PROGRESS, SEEN, opened_ledger
from ttus_opt.haptic.drag import PRESLIDING, DragLaw
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.tables import table_of
from ttus_opt.haptic.wrench import FieldPair, mixed, mixed_drag
from ttus_opt.voxmap.field import PotentialField


class RenderedField(NamedTuple):
    """A field in the form that frames read.

    Attributes:
        values: A copy of its values, flat, shape (V,).
        drag: `DragLaw.numbers`.
        coefficients: Names of its drag coefficients; empty without drag.
    """

    values: Array
    drag: Array
    coefficients: str

    @classmethod
    def of(cls, field: PotentialField) -> RenderedField:
        """Copy a field.

        Raises:
            InputError: Unusable drag parameters.
        """
        values = np.array(field.values, dtype=np.float64, order="C").reshape(-1)
        law = DragLaw.of(field.parameters, field.voxmap.grid)
        names = [n for n in (FRICTION, VISCOUS) if law.active and n in field.parameters]
        return cls(values, law.numbers, ", ".join(names))


@dataclass(frozen=True, slots=True)
class RenderedFields:
    """The fields of a frame and the names of their drag coefficients."""

    pair: FieldPair
    table: IntArray  # addresses of the pair's arrays
    current_drag: str
    target_drag: str

    @classmethod
    def of(
        cls, current: RenderedField, target: RenderedField, ledger: Array
    ) -> RenderedFields:
        """Two fields, or the same twice, and the ledger of the swap between them."""
        pair = FieldPair(
            current.values, target.values, current.drag, target.drag, ledger
        )
        return cls(pair, table_of(pair), current.coefficients, target.coefficients)

    @property
    def drag(self) -> str:
        """Names of the present drag coefficients; empty without drag."""
        if self.target_drag:
            return self.target_drag
        return "" if self.pair.ledger[PROGRESS] == 1.0 else self.current_drag

    @property
    def held_by_poses(self) -> bool:
        """Whether all drag is friction with presliding, which needs no twist."""
        return bool(self.pair.target_drag[PRESLIDING]) and VISCOUS not in self.drag


def swapped(
    fields: RenderedFields, new: RenderedField, data: FrameData, weights: Array
) -> RenderedFields:
    """The fields after an update: a swap that starts from the present mixture.

    Args:
        fields: The present fields; no frame may write their ledger meanwhile.
        new: The new field.
        data: Probe and surface, with its own scratch arrays.
        weights: `drag.patch_weights` in block order, shape (M, 7).
    """
    now = fields.pair
    if now.ledger[SEEN] == 0.0:
        return RenderedFields.of(new, new, now.ledger)
    share = float(now.ledger[PROGRESS])
    values, drag = now.target, now.target_drag
    if share < 1.0:
        values = mixed(now.current, now.target, share)
        drag = mixed_drag(now.ledger, now, values, data, weights)
    old = RenderedField(values, drag, fields.drag)
    return RenderedFields.of(
        old, new, opened_ledger(now.ledger, values, new.values, data)
    )


def require_alike(old: PotentialField, new: PotentialField) -> None:
    """Check that two fields have the same grid, surface and sampling.

    Raises:
        InputError: One of them differs.
    """
    if name := old.differs_in(new):
        raise InputError(
            f"an update cannot change the field's {name}: make a new Renderer"
        )
