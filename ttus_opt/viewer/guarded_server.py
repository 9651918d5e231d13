"""A server of pages for this machine alone, behind a link that nobody can guess.

viser serves every network interface and offers to share the page through a server of
its own. Here it listens on 127.0.0.1; every request, the page's socket too, must name a
random token as the first part of its path; and the page may ask nothing of any other
host, which the browser enforces (Content-Security-Policy).
"""

from __future__ import annotations

import contextlib
import hmac
import secrets
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import InputError
from ttus_opt.core.optional import load

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

Check = Callable[["ServerConnection", "Request"], "Response | None"]

#: Where a page is looked for first
PORT = 8050

#: Title of the page
TITLE = "ttus-opt"

#: Only this machine
HOST = "127.0.0.1"

#: The page is one file that unpacks itself, draws in a worker and decodes with
#: WebAssembly; it speaks to the server that it came from, and to nobody else
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'unsafe-inline' 'unsafe-eval' blob:",
        "style-src 'unsafe-inline'",
        "img-src data: blob:",
        "font-src data:",
        "worker-src blob: data:",
        f"connect-src 'self' ws://{HOST}:* data: blob:",
        "base-uri 'none'",
        "form-action 'none'",
    )
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}

REFUSAL = "this page opens with the link that ttus-opt view printed\n"


def guarded_server(port: int) -> tuple[viser.ViserServer, str]:
    """Start a server.

    Args:
        port: Where to listen; the next free one if it is taken, 0 for any.

    Returns:
        The server and the link to its page.

    Raises:
        MissingPackageError: viser is not installed.
        InputError: A port that is none, or a viser that cannot be guarded.
    """
    if not 0 <= port <= 65_535:
        raise InputError(f"port must be 0 to 65535, got {port}")
    viser = load("viser", "viewer")
    sockets: Any = load("websockets.asyncio.server", "viewer")
    token, guarded = secrets.token_urlsafe(16), []
    serve = sockets.serve

    def guarded_serve(handler: Any, *args: Any, **options: Any) -> Any:
        if handler.__module__.startswith("viser."):
            options["process_request"] = _checked(options["process_request"], token)
            guarded.append(handler)
        return serve(handler, *args, **options)

    with quiet():
        sockets.serve = guarded_serve
        try:
            server = viser.ViserServer(HOST, port, label=TITLE, verbose=False)
        finally:
            sockets.serve = serve
        if not guarded:
            server.stop()
            raise InputError(
                f"viser {viser.__version__} cannot be guarded by a token: install the "
                'version that pip install "ttus-opt[viewer]" takes'
            )
    return server, f"http://{HOST}:{server.get_port()}/{token}"


def _checked(answer: Check, token: str) -> Check:
    """Answer requests that name the token, as if it were not there; refuse others."""

    def check(connection: ServerConnection, request: Request) -> Response | None:
        first, _, rest = request.path.partition("?")[0].lstrip("/").partition("/")
        if not hmac.compare_digest(first.encode(), token.encode()):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        request.path = f"/{rest}"
        response = answer(connection, request)
        if response is not None:
            for name, value in HEADERS.items():
                response.headers[name] = value
        return response

    return check


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep viser's banner off the terminal; the command says what there is to say."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
