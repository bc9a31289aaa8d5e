"""A live plot in the browser: one page on this machine alone, fed by the samples as they come."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from urllib.parse import parse_qs, urlparse

_KEPT = 20000

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>scpjax rig</title>
<style>body{font:14px system-ui,sans-serif;margin:1rem;color:#2b3036}canvas{width:100%;height:30vh;display:block}
h1{font-size:1rem}p{margin:.2rem 0}</style></head><body><h1>scpjax rig: live</h1><p id="state">waiting</p><div id="plots"></div>
<script>
const span=60, colours=["#6b7785","#d55e00","#0072b2","#009e73","#cc79a7"];
let names=null, rows=[], next=0;
function draw(c,k){const g=c.getContext("2d"),w=c.width=c.clientWidth*devicePixelRatio,h=c.height=c.clientHeight*devicePixelRatio;
 const end=rows.length?rows[rows.length-1][0]:0, seen=rows.filter(r=>r[0]>=end-span&&r[k]!==null);
 if(seen.length<2)return; let lo=Math.min(...seen.map(r=>r[k])),hi=Math.max(...seen.map(r=>r[k])); if(hi-lo<1e-9){lo-=1;hi+=1}
 const f=12*devicePixelRatio, x=t=>70+(w-80)*(t-end+span)/span, y=v=>h-1.5*f-(h-3*f)*(v-lo)/(hi-lo);
 g.font=f+"px system-ui"; g.fillStyle="#2b3036"; g.fillText(names[k],70,f); g.fillText(hi.toPrecision(4),2,y(hi)+f/2);
 g.fillText(lo.toPrecision(4),2,y(lo)); g.fillText((end-span).toFixed(0)+" s",70,h-2); g.fillText(end.toFixed(1)+" s",w-6*f,h-2);
 g.strokeStyle=colours[(k-1)%5]; g.lineWidth=1.5*devicePixelRatio; g.beginPath();
 seen.forEach((r,i)=>i?g.lineTo(x(r[0]),y(r[k])):g.moveTo(x(r[0]),y(r[k]))); g.stroke()}
async function poll(){try{const a=await (await fetch("data?since="+next)).json(); next=a.next; names=a.names;
 rows=rows.concat(a.rows).slice(-20000); const p=document.getElementById("plots");
 while(p.children.length<names.length-1)p.appendChild(document.createElement("canvas"));
 [...p.children].forEach((c,i)=>draw(c,i+1)); document.getElementById("state").textContent=rows.length+" samples"}
 catch(e){document.getElementById("state").textContent="the recording has ended"} setTimeout(poll,250)}
poll();
</script></body></html>
"""


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

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                asked = urlparse(self.path)
                if asked.path == "/data":
                    since = parse_qs(asked.query).get("since", ["0"])[0]
                    body = json.dumps(live.since(int(since) if since.isdigit() else 0)).encode()
                    kind = "application/json"
                else:
                    body, kind = _PAGE.encode(), "text/html; charset=utf-8"
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                """The terminal is for the progress."""

        return Handler
