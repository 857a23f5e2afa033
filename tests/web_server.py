"""A web server for ranges of files, which fails as it is told to."""

import re
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Self
from urllib.parse import unquote


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a client that hung up before the answer; tests read what it says."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class WebServer:
    """Serves a folder on a port of its own while its block runs.

    Parameters
    ----------
    folder : Path
        Served.
    answer : callable, optional
        Gets each handler and the bytes of a GET; True if it has answered itself.
    ranges : bool
        Whether parts of files are sent.
    down : bool
        Whether every request is refused as by a server under maintenance.
    """

    def __init__(
        self,
        folder: Path,
        answer: Callable[[Any, bytes], bool] = lambda handler, data: False,
        *,
        ranges: bool = True,
        down: bool = False,
    ) -> None:
        self.sent = 0

        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_HEAD(self) -> None:
                if (data := self.content()) is not None:
                    self.head(200, len(data))

            def do_GET(self) -> None:
                if (data := self.content()) is None:
                    return
                asked = re.match(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
                if asked is None or not ranges:
                    self.head(200, len(data))
                else:
                    start, end = int(asked[1]), min(int(asked[2]) + 1, len(data))
                    whole, data = len(data), data[start:end]
                    if answer(self, data):
                        return
                    self.head(206, len(data), f"bytes {start}-{end - 1}/{whole}")
                server.sent += len(data)
                self.wfile.write(data)

            def content(self) -> bytes | None:
                if down:
                    self.send_error(503)
                    return None
                file = folder / unquote(self.path).lstrip("/")
                if file.is_file():
                    return file.read_bytes()
                self.send_error(404)
                return None

            def head(self, status: int, length: int, part: str = "") -> None:
                self.send_response(status)
                self.send_header("Content-Length", str(length))
                if ranges:
                    self.send_header("Accept-Ranges", "bytes")
                if part:
                    self.send_header("Content-Range", part)
                self.end_headers()

            def log_message(self, *_: Any) -> None: ...

        self._server = _Server(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> Self:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
