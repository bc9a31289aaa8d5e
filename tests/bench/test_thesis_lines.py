"""The tab-separated lines of the thesis's own sketches."""

import os
import threading

import numpy as np
import pytest

from scpjax.bench import legacy
from scpjax.bench.device import PortDevice
from scpjax.cli import main
from scpjax.recordings.files import read_recording


def thesis_lines(n=60):
    rows = [f"{55 * i}\t{120 if i > 5 else 0}\t{40.0 + (0.02 * max(0, i - 5)):.2f}\r\n" for i in range(n)]
    rows[20] = f"{55 * 20}\t120\t52.10\r\n"
    return "".join(rows)


def test_the_thesis_lines_become_a_recording():
    text = "13\t7\n" + thesis_lines() + "garbage\n\t\t\n55\t999\t1\n"
    found = legacy.recording(text.encode().split(b"\n"), value="distance")
    assert found.n == 60
    assert found.output("displacement")[-1] == pytest.approx(0.2 * 54 * 1e-3, rel=1e-6)
    assert found.weight("displacement")[20] == 0
    assert np.sum(found.weight("displacement") == 0) == 1
    nearer = legacy.recording(text.encode().split(b"\n"), value="distance", nearer=True)
    assert nearer.output("displacement")[-1] < 0


def test_a_real_jump_is_believed_after_three_readings():
    rows = [f"{50 * i}\t0\t{40.0 if i < 10 else 45.0}".encode() for i in range(20)]
    assert legacy.recording(rows, value="distance").output("displacement")[-1] == pytest.approx(0.05)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
def test_the_thesis_lines_end_on_silence():
    master, slave = os.openpty()
    device = PortDevice(os.ttyname(slave), baud=legacy.BAUD)
    device.open()
    writer = threading.Thread(target=os.write, args=(master, thesis_lines().encode()))
    writer.start()
    rows = list(legacy.lines(device, silence=0.4, most=20.0))
    writer.join()
    device.close()
    os.close(slave)
    os.close(master)
    assert len(legacy.parse(rows)) >= 59


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
def test_what_had_come_of_the_thesis_lines_is_on_disk_when_it_is_stopped(tmp_path, monkeypatch):
    """Every byte in NAME.raw, and the recording of the lines until then, with the supply of the bench."""
    master, slave = os.openpty()
    lines = thesis_lines().encode()
    (tmp_path / "bench.toml").write_text("supply_V = 5.0\n")
    read = legacy.lines

    writer = threading.Thread(target=os.write, args=(master, lines))

    def stopped(*args, **options):
        writer.start()  # the port is open now
        for k, line in enumerate(read(*args, **options)):
            if k == 40:
                raise KeyboardInterrupt
            yield line

    monkeypatch.setattr(legacy, "lines", stopped)
    out = tmp_path / "new" / "lines.csv"
    call = ["rig", "record", "--port", os.ttyname(slave), "--bench", str(tmp_path / "bench.toml")]
    assert main([*call, "--legacy", "distance", "--out", str(out), "--quiet"]) == 130
    writer.join()
    os.close(slave)
    os.close(master)
    found = read_recording(out)
    assert 30 < found.n <= 40
    assert found.metadata.supply_V == 5.0
    raw = out.with_suffix(".raw").read_bytes()
    assert len(raw) >= 500
    assert lines.replace(b"\r", b"").startswith(raw.replace(b"\r", b"")[:400])
