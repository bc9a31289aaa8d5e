"""200 samples a second at real time through a pseudo-terminal from the firmware in a process of its own."""

import json
import subprocess
import sys
import time
from pathlib import Path

import boards
import pytest

from rig.simulation.firmware import missing
from scpjax.bench.device import PortDevice
from scpjax.bench.rig import Rig, RigOptions
from scpjax.recordings.files import read_recording

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 600.0 if boards.FULL_SIZE else 4.0


@pytest.fixture(params=boards.KINDS)
def port(request):
    """The name of a port behind which a board runs in another process."""
    if request.param == "firmware" and missing():
        pytest.skip(f"skipped: not installed: {missing()} (rig/simulation/install.sh)")
    if request.param == "emulator" and boards.FULL_SIZE:
        pytest.skip("skipped: ten minutes of the firmware are enough")
    call = [sys.executable, "-m", "rig.simulation.run", *(["--emulator"] if request.param == "emulator" else [])]
    server = subprocess.Popen(call, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    yield server.stdout.readline().strip()
    server.terminate()
    server.wait(10)
    server.stdout.close()


def test_two_hundred_samples_a_second_and_none_lost(port, tmp_path):
    with Rig(PortDevice(port), options=RigOptions(every=1)) as rig:
        rig.wait(0.5)
        rig.record(tmp_path / "a.csv")
        began, used = time.monotonic(), time.process_time()
        rig.wait(SECONDS)
        share = (time.process_time() - used) / (time.monotonic() - began)
        rig.end_recording()
        q = rig.quality
        assert (q.lost, q.damaged, q.stale) == (0, 0, 0)
    recording = read_recording(tmp_path / "a.csv")
    assert recording.n == pytest.approx(200 * SECONDS, rel=0.1)  # a busy machine may run the board a little slow
    assert recording.is_uniform
    report = {"seconds": SECONDS, "recorded": recording.n, "host share of a core": round(share, 4), **q.to_json()}
    (tmp_path / "report.json").write_text(json.dumps(report))
    print(json.dumps(report))
    assert share < 0.10
