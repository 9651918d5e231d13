"""Only who knows the link sees the page or speaks to it."""

import contextlib
import socket
import threading
from http.client import HTTPConnection
from urllib.parse import urlsplit

import pytest

from tests.kit import InputError, refuses
from ttus_opt.viewer import guarded_server as guard

viser = pytest.importorskip("viser", reason="needs ttus-opt[viewer]")
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402


@pytest.fixture(scope="module")
def link():
    served = guard.guarded_server(0)
    yield served.url
    served.end("")


def get(link, path):
    connection = HTTPConnection(urlsplit(link).netloc, timeout=10)
    with contextlib.closing(connection):
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def test_the_link_opens_the_page(link):
    status, headers, page = get(link, urlsplit(link).path)
    assert status == 200
    assert b"<html" in page
    assert "connect-src 'self'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("path", ["/", "/index.html", "/wrong", "/?token", "/%2e%2e/"])
def test_another_request_is_refused(link, path):
    status, _, page = get(link, path)
    assert status == 403
    assert b"<html" not in page
    token = urlsplit(link).path
    assert get(link, token[:-1])[0] == 403
    assert get(link, f"{token}x")[0] == 403
    assert get(link, f"{token}/../secret")[0] == 404


def test_a_socket_without_the_token_is_refused(link):
    place = urlsplit(link)
    protocol = [f"viser-v{viser.__version__}"]
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://{place.netloc}", subprotocols=protocol, open_timeout=10)
    url = f"ws://{place.netloc}{place.path}"
    with connect(url, subprotocols=protocol, open_timeout=10) as known:
        assert len(known.recv(timeout=10)) > 0


def test_only_this_machine_is_listened_to(link):
    assert urlsplit(link).hostname == "127.0.0.1"
    port = urlsplit(link).port
    other = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    with contextlib.closing(other):
        other.bind(("127.0.0.2", port))  # free: the server has 127.0.0.1 alone


def test_a_port_in_use_gives_the_next_and_links_differ(link):
    port = urlsplit(link).port
    served = guard.guarded_server(port)
    assert urlsplit(served.url).port != port
    assert urlsplit(served.url).path != urlsplit(link).path
    served.end("")


def test_a_viser_that_cannot_be_guarded_is_not_started(monkeypatch):
    import websockets.asyncio.server as sockets

    own = sockets.serve

    class Elsewhere(viser.ViserServer):
        """Serves without the function that is guarded."""

        def __init__(self, *args, **options):
            sockets.serve = own
            super().__init__(*args, **options)

    monkeypatch.setattr(viser, "ViserServer", Elsewhere)
    threads = threading.active_count()
    refuses(InputError, "cannot be guarded", guard.guarded_server, 0)
    assert threading.active_count() <= threads + 1
    assert sockets.serve is own


def test_a_port_that_is_none_is_refused():
    refuses(InputError, "0 to 65535", guard.guarded_server, 70_000)
