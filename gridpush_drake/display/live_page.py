"""A live page of Meshcat, with caption, legend and close-up beside the scene as in a recording.

Drake's server gives out its own page only. So a small server in front of it, on a port of its own,
gives out that page with an overlay, and passes everything else on: the page's other files, and the
connection over which the scene comes. A browser, or whoever forwards a port, needs this one port.

What is being done travels over Meshcat's own connection, as a property of a path in the scene
(`overlay.CAPTION_PATH`). So a page that is opened late, or opened anew, has it too.
"""

import contextlib
import socket
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import urlopen

from pydrake.geometry import Meshcat

from gridpush_drake.display.overlay import (
    CAPTION_PATH,
    Overlay,
    Phase,
    add_overlay,
    encode_phases,
)
from gridpush_drake.display.server import (
    MAX_PORT,
    StartMeshcatServer,
    check_port,
    explain_port,
)
from gridpush_drake.errors import StationError

FIRST_PORT = 7000
"""The first port that is tried where none is asked for."""

PAGE_PATHS = ("/", "/index.html", "/meshcat.html")
"""Under which Meshcat gives out its page."""

SERVER_TIMEOUT = 10.0
"""Longest time that Meshcat's own server may take to answer, s."""

CHUNK_SIZE = 65536
"""Bytes passed on at a time."""


class LivePage:
    """Meshcat with an overlay, served on one port.

    Attributes:
        meshcat: the scene.
        overlay: what stands beside it; may be replaced before the page is opened.
        url: of the page.
    """

    def __init__(self, port: int | None = None, host: str = "localhost") -> None:
        """Starts both servers.

        Args:
            port: of the page; the first free one from FIRST_PORT on where None, any free one where
                0.
            host: to listen on, as in `StartMeshcatServer`.

        Raises:
            StationError: the port is out of range or in use, or the host is not this machine's.
        """
        check_port(port)
        self.overlay = Overlay()
        self._server = _listen(self, port, host)
        self.meshcat: Meshcat = StartMeshcatServer(0, host)
        self.meshcat_port = int(self.meshcat.port())
        name = "localhost" if host == "*" else host
        self.url = f"http://{name}:{self._server.server_address[1]}"
        Thread(target=self._server.serve_forever, name="live page", daemon=True).start()

    def show_phases(self, phases: Sequence[Phase]) -> None:
        """Shows what is being done: the last of the phases now.

        Only the thread that made the page may call it.
        """
        self.meshcat.SetProperty(f"/drake/{CAPTION_PATH}", "userData", encode_phases(phases))

    def read_page(self) -> str:
        """Meshcat's own page with the overlay in it."""
        page = self.fetch("/")[1].decode("utf-8")
        return add_overlay(page, self.overlay)

    def fetch(self, path: str) -> tuple[str, bytes]:
        """Asks Meshcat's own server for a file.

        Returns:
            Its kind, and what is in it.

        Raises:
            OSError: the server has no such file.
        """
        with urlopen(
            f"http://localhost:{self.meshcat_port}{path}", timeout=SERVER_TIMEOUT
        ) as answer:
            return answer.headers.get("Content-Type", "text/html"), answer.read()


def _listen(page: LivePage, port: int | None, host: str) -> ThreadingHTTPServer:
    """A server on the port asked for, or on the first free one."""
    handler = type("Handler", (_Handler,), {"page": page})
    address = "" if host == "*" else host
    ports = range(FIRST_PORT, MAX_PORT + 1) if port is None else (port,)
    for one in ports:
        try:
            return _Server((address, one), handler)
        except OSError:
            continue
    raise StationError(explain_port(port, host))


class _Server(ThreadingHTTPServer):
    """A server that ends with its process."""

    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Says nothing: a browser that goes away in the middle is no fault."""


class _Handler(BaseHTTPRequestHandler):
    """Answers one browser."""

    page: LivePage

    def do_GET(self) -> None:
        """Gives out the page, or passes on what is asked for."""
        if self.headers.get("Upgrade", "").lower() == "websocket":
            self._pass_on()
            return
        try:
            if urlsplit(self.path).path in PAGE_PATHS:
                kind = "text/html; charset=utf-8"
                content = self.page.read_page().encode()
            else:
                kind, content = self.page.fetch(self.path)
        except (URLError, OSError):
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # its name is given
        """Keeps quiet about requests."""

    def _pass_on(self) -> None:
        """Connects the browser with Meshcat's own server, both ways, until one of them goes."""
        self.close_connection = True
        head = "".join(f"{name}: {value}\r\n" for name, value in self.headers.items())
        meshcat = socket.create_connection(("localhost", self.page.meshcat_port), SERVER_TIMEOUT)
        with meshcat:
            meshcat.settimeout(None)
            meshcat.sendall(f"GET {self.path} HTTP/1.1\r\n{head}\r\n".encode("latin-1"))
            back = Thread(target=_pour, args=(meshcat, self.connection), daemon=True)
            back.start()
            _pour(self.connection, meshcat)
            back.join()


def _pour(source: socket.socket, sink: socket.socket) -> None:
    """Passes on what comes from one end to the other, until either is closed; then closes both."""
    with contextlib.suppress(OSError):
        while chunk := source.recv(CHUNK_SIZE):
            sink.sendall(chunk)
    for end in (source, sink):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
