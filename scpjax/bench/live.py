"""A live plot in the browser: one page on this machine alone, fed by the samples as they come."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from types import TracebackType
from urllib.parse import parse_qs, urlparse

_KEPT = 20000


class Live:
    """Serves the page at ``url`` until it is closed; a context manager. ``names``: ``time_s`` and the columns."""

    def __init__(self, names: Sequence[str], port: int = 0):
        self.names = tuple(names)
        self._rows: deque[list[float | None]] = deque(maxlen=_KEPT)
        self._count = 0
        self._lock = threading.Lock()
        self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, name="scpjax-live", daemon=True)
        self._thread.start()

    def add(self, time: float, values: Sequence[float]) -> None:
        """One sample; a NaN is a gap."""
        with self._lock:
            self._rows.append([time, *(None if v != v else float(v) for v in values)])
            self._count += 1

    def since(self, count: int) -> dict[str, object]:
        """Rows after the first ``count``."""
        with self._lock:
            new = max(0, min(self._count - count, len(self._rows)))
            rows = list(self._rows)[len(self._rows) - new :]
            return {"names": self.names, "rows": rows, "next": self._count}

    def close(self) -> None:
        """End the page."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(2.0)

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        live = self
        page = (resources.files("scpjax") / "bench" / "live.html").read_bytes()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                asked = urlparse(self.path)
                if asked.path == "/data":
                    since = parse_qs(asked.query).get("since", ["0"])[0]
                    body = json.dumps(live.since(int(since) if since.isdigit() else 0)).encode()
                    kind = "application/json"
                else:
                    body, kind = page, "text/html; charset=utf-8"
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                """The terminal is for the progress."""

        return Handler
