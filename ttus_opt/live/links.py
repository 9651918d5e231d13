"""The links by name: what a user asks for is what a side opens."""

from __future__ import annotations

from ttus_opt.core.errors import InputError
from ttus_opt.live.socket_link import SocketLink
from ttus_opt.live.webrtc_link import WebRTCLink

LINKS: dict[str, type[SocketLink | WebRTCLink]] = {
    "udp": SocketLink,
    "webrtc": WebRTCLink,
}


def open_link(
    name: str, key: bytes, host: str, port: int, *, calls: bool
) -> SocketLink | WebRTCLink:
    """One side of a link.

    Args:
        name: One of `LINKS`, on both sides.
        key: The session's key.
        host: Address of the follower to call, or own address to wait at.
        port: Its port; 0 for any free one when waiting.
        calls: Whether this is the operator, who calls.

    Raises:
        InputError: An unknown name, or an address that cannot be used.
        MissingPackageError: The link's package is not installed.
    """
    if name not in LINKS:
        raise InputError(f"a link is {' or '.join(LINKS)}, got {name}")
    return LINKS[name](key, host, port, calls=calls)
