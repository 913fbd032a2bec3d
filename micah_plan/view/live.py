"""A page served to the browsers of this machine, and made again whenever its file has changed.

MeshCat's own server listens on all interfaces and takes no address, so the self-contained page is served instead.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from threading import Lock

from micah_plan.errors import InputError, MicahError

LOOPBACK = "127.0.0.1"


class PageServer(ThreadingTCPServer):
    """Serves one page at ``/``, on the loopback address only.

    Not an `http.server.HTTPServer`: that asks the name service for the machine's name.

    Args:
        page: makes the HTML; called at every request, one at a time. A `MicahError` becomes its line of text.
        port: 0 takes any that is free.

    Raises:
        InputError: if the port cannot be used.
    """

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 1024  # a page that many windows request at once; the default of 5 drops connections

    def __init__(self, page: Callable[[], str], port: int = 0) -> None:
        self._page = page
        self._lock = Lock()
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            problem = f"port {port} of {LOOPBACK} cannot be used: {error.strerror}"
            raise InputError(problem, remedy="choose another --port; 0 takes a free one") from None

    @property
    def port(self) -> int:
        """Port of the server."""
        return int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address of the page on this machine."""
        return f"http://{LOOPBACK}:{self.port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore browsers that close the connection early."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def answer(self, path: str, host: str) -> tuple[int, str, str]:
        """Status, media type and body of a request.

        A web site may resolve its own name to the loopback address to read the served pages. Its requests still carry
        that name as their host, and are refused.
        """
        if host not in (f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"):
            return 403, "text/plain", "served to this machine only\n"
        if path.partition("?")[0] != "/":
            return 404, "text/plain", "the page is at /\n"
        try:
            with self._lock:
                return 200, "text/html", self._page()
        except MicahError as error:
            return 500, "text/plain", f"error: {error}\n"


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 30.0  # browsers open connections in advance and leave them
    server_version = "micah_plan"
    sys_version = ""

    def do_GET(self) -> None:
        status, kind, text = self.server.answer(self.path, self.headers.get("Host", ""))
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Suppress log messages: the terminal shows the address only."""


def remade_on_change(file: Path, make: Callable[[], str]) -> Callable[[], str]:
    """The page of a file, created on the first request and again after each change of the file.

    Raises:
        InputError: when called, if the file is gone, or whatever `make` raises.
    """
    latest: tuple[int, int] | None = None
    page = ""

    def current() -> str:
        nonlocal latest, page
        try:
            state = file.stat()
        except OSError as error:
            raise InputError(
                f"cannot be read: {error.strerror}", source=file, remedy="check the path, or make the file again"
            ) from None
        stamp = state.st_mtime_ns, state.st_size
        if stamp != latest:
            page = make()
            latest = stamp
        return page

    return current
