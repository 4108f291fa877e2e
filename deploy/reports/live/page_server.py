"""Server of the live view's page, for browsers on this machine: read-only, with a token.

It listens at 127.0.0.1. A foreign page in the same browser gets nothing: it does not know the
token, may not read answers (no CORS), and cannot use its own host name (the header Host is
checked).
"""

from __future__ import annotations

import hmac
import json
import secrets
import threading
from functools import cache, partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any
from urllib.parse import parse_qs, urlsplit

from plotly.offline import get_plotlyjs

from deploy.reports.live.frames import Frames

HOST = "127.0.0.1"
_LONGEST_WAIT_S = 10.0
"""Limit for a request, and for a browser to receive data."""
_KEEP_ALIVE_S = 2.0
_MOST_CONNECTIONS = 24
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self';"
    " style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; base-uri 'none';"
    " form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/view.js": ("view.js", "text/javascript; charset=utf-8"),
    "/view.css": ("view.css", "text/css; charset=utf-8"),
}
_PLOTLY, _EVENTS = "/plotly.js", "/events"


class PageServer(ThreadingHTTPServer):
    """Server of the page and its data.

    Args:
        frames: the frames to show.
        documents: JSON documents by path, such as ``/figures.json``.
        port: where to listen; 0 for any.

    Attributes:
        url: address of the page, with the token.

    Raises:
        OSError: the port is taken.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 16

    def __init__(self, frames: Frames, documents: dict[str, Any], port: int = 0) -> None:
        super().__init__((HOST, port), _Handler)
        self.frames = frames
        self.documents = {path: json.dumps(value) for path, value in documents.items()}
        self.token = secrets.token_urlsafe(24)
        self.url = f"http://{HOST}:{self.server_port}/?token={self.token}"
        self.hosts = (f"{HOST}:{self.server_port}", f"localhost:{self.server_port}")
        self.is_watched = threading.Event()
        self._free = threading.BoundedSemaphore(_MOST_CONNECTIONS)

    def start(self) -> None:
        """Start serving in a thread."""
        threading.Thread(target=partial(self.serve_forever, 0.1), daemon=True).start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Accept a connection, unless there are too many already."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve one connection to its end."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors that a client causes on its connection."""


class _Handler(BaseHTTPRequestHandler):
    """Handler of one request. Methods other than GET are refused."""

    server: PageServer
    timeout = _LONGEST_WAIT_S
    server_version, sys_version = "funnel-hil", ""

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        refusal = self._refusal(parse_qs(parts.query))
        if refusal is not None:
            self._send(refusal, "text/plain", refusal.phrase.encode())
        elif parts.path in _FILES:
            name, kind = _FILES[parts.path]
            text = _page_file(name).replace("{{ token }}", self.server.token)
            self._send(HTTPStatus.OK, kind, text.encode())
        elif parts.path in self.server.documents:
            document = self.server.documents[parts.path]
            self._send(HTTPStatus.OK, "application/json", document.encode())
        elif parts.path == _PLOTLY:
            self._send(HTTPStatus.OK, "text/javascript; charset=utf-8", _plotly_js())
        elif parts.path == _EVENTS:
            self._stream()
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"Not Found")

    def _refuse_method(self) -> None:
        status = HTTPStatus.METHOD_NOT_ALLOWED
        self._send(status, "text/plain", status.phrase.encode())

    do_HEAD = do_POST = do_PUT = do_DELETE = do_OPTIONS = do_PATCH = _refuse_method  # noqa: N815

    def _refusal(self, query: dict[str, list[str]]) -> HTTPStatus | None:
        """Return why a request is refused; None if it is served."""
        if self.headers.get_all("Host", []) not in [[host] for host in self.server.hosts]:
            return HTTPStatus.MISDIRECTED_REQUEST
        given = query.get("token", [""])[-1]
        if not hmac.compare_digest(given.encode(errors="replace"), self.server.token.encode()):
            return HTTPStatus.FORBIDDEN
        return None

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self._begin(status, kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _begin(self, status: HTTPStatus, kind: str) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind}.items():
            self.send_header(name, value)

    def _stream(self) -> None:
        """Send server-sent events: all kept frames, then each new one, then the end."""
        self._begin(HTTPStatus.OK, "text/event-stream")
        self.end_headers()
        self.server.is_watched.set()
        number, is_over = 0, False
        while not is_over:
            is_over = self.server.frames.is_over  # first, so that no frame is missed
            number, fresh = self.server.frames.after(number, _KEEP_ALIVE_S)
            self._write_event("frames", json.dumps(fresh, allow_nan=False))
        self._write_event("over", "true")

    def _write_event(self, name: str, data: str) -> None:
        self.wfile.write(f"event: {name}\ndata: {data}\n\n".encode())

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (http.server's name)
        """Log nothing: requests contain the token."""


@cache
def _page_file(name: str) -> str:
    return resources.files("deploy.reports.live").joinpath("page", name).read_text(encoding="utf-8")


@cache
def _plotly_js() -> bytes:
    return str(get_plotlyjs()).encode()
