"""A renderer whose patient may change as a whole: field, surface and grid.

`Renderer.update` replaces a field over one surface. Here two renderers are blended, one
for the present surface and one for the new, by the law of `ttus_opt.haptic.blend`:
the same limit of the force rate, and an energy tank of its own with the same reserve,
with ΔU the difference of the energies that each stores. Meanwhile a frame takes as long
as two. A change that arrives during a swap waits until it is complete; of several, the
last one counts.

A wrench that a limit has scaled down enters the energy balance as it is felt.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.haptic.blend import (
    PROGRESS,
    SEEN,
    BlendLaw,
    BlendState,
    advance,
    follow,
    opened_ledger,
    refill,
    settled_ledger,
)
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.renderer import Renderer, Wrench
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField

_NO_DRAG = np.zeros(6)


class PatientRenderer:
    """Renders a patient that is updated, surface and all.

    One thread renders and updates.

    Attributes:
        shell: The probe.
        blend_law: How updates are blended in.
    """

    def __init__(
        self, field: PotentialField, shell: PointShell, blend: BlendLaw | None = None
    ) -> None:
        """A renderer of one field.

        Args:
            field: The fitted field.
            shell: The probe's point shell.
            blend: How updates are blended in.
        """
        self.shell, self.blend_law = shell, blend or BlendLaw()
        self._now, self._field = self._made(field), field
        self._old: Renderer | None = None
        self._next: PotentialField | None = None
        self._ledger = settled_ledger(self.blend_law.reserve)
        self._limits = self.blend_law.kernel_limits(shell.rms_radius)

    @property
    def blend(self) -> BlendState:
        """State of the present swap: of surfaces where there is one, else of fields."""
        return BlendState.of(self._ledger) if self._old else self._now.blend

    def present(self) -> tuple[Array, FrameData]:
        """The newest field and surface as `Renderer.present` gives them."""
        return self._now.present()

    def update(self, field: PotentialField) -> None:
        """Replace the field, over this or another surface."""
        another = self._field.differs_in(field) in ("grid", "surface")
        if self._next is None and not another:
            self._now.update(field)
            self._field = field
        elif self._old is not None:
            self._next = field
        else:
            self._open(field)

    def render(self, rotation: Array, position: Array, *, time: float) -> Wrench:
        """Force and torque of a pose (3, 3), (3,) [m] at a time [s]."""
        felt = self._now.render(rotation, position, time=time)
        motion = follow(self._ledger, rotation, position, self.shell.reference)
        old = self._old
        if old is None:
            refill(self._ledger, self._limits, felt.contact_points == 0)
            return felt
        before = old.render(rotation, position, time=time)
        wrenches = [np.concatenate([w.force, w.torque]) for w in (before, felt)]
        contact = max(felt.contact_points, before.contact_points)
        refill(self._ledger, self._limits, contact == 0)
        advance(
            *(self._ledger, self._limits, contact, motion),
            *(*wrenches, _NO_DRAG, _NO_DRAG),
        )
        share = float(self._ledger[PROGRESS])
        mixed = (1.0 - share) * wrenches[0] + share * wrenches[1]
        if share == 1.0:
            self._old, waiting, self._next = None, self._next, None
            if waiting is not None:
                self.update(waiting)
        limited = felt.limited_by or before.limited_by
        return replace(felt, force=mixed[:3], torque=mixed[3:], limited_by=limited)

    def _made(self, field: PotentialField) -> Renderer:
        return Renderer(field, self.shell, blend=self.blend_law)

    def _open(self, field: PotentialField) -> None:
        """Begin a swap to another surface."""
        new, old = self._made(field), self._now
        new.take_motion(old)
        self._now, self._field = new, field
        if self._ledger[SEEN] == 0.0:
            return  # before the first frame: nothing to blend
        (values, data), (target, over) = old.present(), new.present()
        self._ledger = opened_ledger(self._ledger, values, target, data, over)
        self._old = old
