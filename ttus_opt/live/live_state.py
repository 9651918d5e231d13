"""What a page or a report shows of a session at one moment."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ttus_opt.live.messages import Sample


@dataclass(frozen=True)
class LiveState:
    """The operator's side at one moment, ready to be shown.

    Attributes:
        time: Operator's clock [s].
        state: NORMAL, HOLD or STOP.
        cause: Why it is not NORMAL; empty in NORMAL.
        round_trip: Of the link [s]; NaN before the first reply.
        loss: Share of packets lost in the last seconds [–].
        model_age: Time since the follower measured what changed the model last [s];
            infinite before.
        folded: Samples that the model has learned from [–].
        blended: Share of the last update that the hand feels already [–].
        position: Hand, patient frame [m].
        force: Felt force on the hand, patient axes [N].
        torque: Felt torque [N·m].
        force_std: Standard deviation of the model's force there [N]; NaN without one.
        measured: The last sample; None before the first.
        felt_there: Force that the hand's model gives at that sample's pose [N], to
            compare with the measured one whatever the delay; None before the first.
        packets_per_second: Datagrams sent, on average [1/s].
        bits_per_second: With headers, on average [bit/s].
        limited_by: Limit that acts on the felt wrench, empty for none.
    """

    time: float
    state: str
    cause: str
    round_trip: float
    loss: float
    model_age: float
    folded: int
    blended: float
    position: tuple[float, float, float]
    force: tuple[float, float, float]
    torque: tuple[float, float, float]
    force_std: float
    measured: Sample | None
    felt_there: tuple[float, float, float] | None
    packets_per_second: float
    bits_per_second: float
    limited_by: str

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, without rotations."""
        content = asdict(self)
        sample = self.measured
        if sample is not None:
            content["measured"] = {
                "time": sample.time,
                "position": sample.position.tolist(),
                "wrench": sample.wrench.tolist(),
            }
        return content
