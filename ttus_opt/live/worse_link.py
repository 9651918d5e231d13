"""Any link made worse: what a side sends is delayed, lost and doubled on its way.

Where both sides use one, both directions are worse, each by its own `Impairment`.
Packets leave when their side next sends, so that its period is added to the delay.
"""

from __future__ import annotations

from ttus_opt.live.impairment import ImpairedLink, Impairment
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.real_time import Link


class WorseLink:
    """A link through which one side sends worse.

    Attributes:
        link: The link itself.
        way: What is on its way to it; its impairment may be replaced at any time.
    """

    def __init__(self, link: Link, impairment: Impairment) -> None:
        self.link, self.way = link, ImpairedLink(impairment)

    @property
    def overhead(self) -> int:
        """Of the link."""
        return self.link.overhead

    def send(self, now: float, packets: tuple[Outgoing, ...]) -> None:
        """Put packets on their way, and pass on those that are due."""
        self.way.send(now, packets)
        self.link.send(now, tuple(self.way.due(now)))

    def receive(self, now: float) -> list[bytes]:
        """What has arrived."""
        return self.link.receive(now)
