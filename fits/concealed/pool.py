"""Worker processes that are asked one case at a time, and are replaced when they hang, die or grow old."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO, Any

from fits.concealed.worker import ANSWER

ROOT = Path(__file__).resolve().parents[2]
COMMAND = ("-m", "fits.concealed.worker")
OLD = 40  # cases after which a worker is replaced, so that its memory does not grow for ever


class Worker:
    """One process. ``limit``: seconds that one case may take."""

    def __init__(self, *, limit: float, log: Path):
        self.limit, self.log = limit, log
        self.process: subprocess.Popen[str] | None = None
        self.lines: queue.Queue[str | None] = queue.Queue()
        self.done = 0

    def ask(self, job: dict[str, Any]) -> dict[str, Any]:
        """The answer to one job; ``{"error": ...}`` where none comes."""
        if self.process is None or self.process.poll() is not None or self.done >= OLD:
            self.close()
            self._open()
        assert self.process is not None
        assert self.process.stdin is not None
        self.done += 1
        try:
            self.process.stdin.write(json.dumps(job) + "\n")
            self.process.stdin.flush()
            while True:
                line = self.lines.get(timeout=self.limit)
                if line is None:
                    self.close()
                    return {"error": f"the process died; see {self.log}"}
                if line.startswith(ANSWER):
                    return json.loads(line.removeprefix(ANSWER))
        except queue.Empty:
            self.close()
            return {"error": f"no answer within {self.limit:.0f} s"}
        except OSError as error:
            self.close()
            return {"error": f"the process is gone ({error}); see {self.log}"}

    def _open(self) -> None:
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("a", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                [sys.executable, *COMMAND],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=ROOT,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # the baselines' matrices are small
            )
        self.lines, self.done = queue.Queue(), 0
        assert self.process.stdout is not None
        threading.Thread(target=_pass_on, args=(self.process.stdout, self.lines), daemon=True).start()

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for stream in (self.process.stdin, self.process.stdout):
                if stream is not None:
                    with contextlib.suppress(BrokenPipeError):  # what it did not read
                        stream.close()
            self.process = None


def _pass_on(stream: IO[str], lines: queue.Queue[str | None]) -> None:
    try:
        for line in stream:
            lines.put(line)
    except ValueError:  # closed while reading
        pass
    lines.put(None)
