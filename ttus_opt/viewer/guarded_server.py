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
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from ttus_opt.core.errors import InputError
from ttus_opt.core.optional import load
from ttus_opt.viewer.looks import dress, small

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

Check = Callable[["ServerConnection", "Request"], "Response | None"]

#: What a browser calls itself, in whatever answers its connection
BROWSER: ContextVar[str] = ContextVar("browser", default="")

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

#: How long a message is shown [s]
SHOWN = 8.0

#: Time that pages have to show what they are told at the end [s]
GOODBYE = 0.3

REFUSAL = "this page opens with the link that ttus-opt view printed\n"


@dataclass(frozen=True)
class Served:
    """Pages that are open to whoever has their link.

    Attributes:
        server: Of the pages.
        url: The link.
        patients: What `patient_nodes.patients_on` drew.
    """

    server: viser.ViserServer
    url: str
    patients: list[Any] = field(default_factory=list)

    def announce(self, line: str) -> Any:
        """Write a line into the panel, until ``remove()`` of what is returned."""
        return self.server.gui.add_html(small(line))

    def tell(self, line: str, seconds: float | None = SHOWN) -> None:
        """Show a line on every page for some time [s], None until it is closed."""
        for client in self.server.get_clients().values():
            client.add_notification(
                "ttus-opt", line, auto_close_seconds=seconds, color="orange"
            )
            client.flush()

    def end(self, line: str) -> None:
        """Serve no more; open pages keep what they show, and say why."""
        if self.server.get_clients():
            self.tell(line, None)
            time.sleep(GOODBYE)
        with quiet():
            self.server.stop()


def guarded_server(port: int) -> Served:
    """Start a server of pages that are empty as yet.

    Args:
        port: Where to listen; the next free one if it is taken, 0 for any.

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
    url = f"http://{HOST}:{server.get_port()}/{token}"
    dress(server)
    return Served(server, url)


def _checked(answer: Check, token: str) -> Check:
    """Answer requests that name the token, as if it were not there; refuse others."""

    def check(connection: ServerConnection, request: Request) -> Response | None:
        first, _, rest = request.path.partition("?")[0].lstrip("/").partition("/")
        if not hmac.compare_digest(first.encode(), token.encode()):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
        request.path = f"/{rest}"
        BROWSER.set(request.headers.get("User-Agent", ""))
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
