"""The firmware's tables are those of the package, and it builds without a warning."""

import re
import subprocess
from pathlib import Path

import pytest

from rig.simulation.firmware import missing
from scpjax.bench import messages as m
from scpjax.bench.parameters import NAMES, BoardConfig, table

FIRMWARE = Path(__file__).resolve().parents[2] / "rig" / "firmware"


def test_parameters_are_those_of_the_package():
    config = BoardConfig()
    rows = re.findall(r"X\((\w+), (.+?), (.+?), (.+?), (FREE|LOWER|RAISE)\)", (FIRMWARE / "parameters.h").read_text())
    assert [r[0] for r in rows] == list(NAMES)
    defaults = dict(re.findall(r"#define (\w+) (-?[\d.e]+)f", (FIRMWARE / "config.h").read_text()))

    def value(text: str) -> float:
        text = text.replace("SUPPLY_V* SUPPLY_V", str(float(defaults["SUPPLY_V"]) ** 2))
        return float(defaults.get(text, text.removesuffix("f")))

    parameters, start = table(config)
    for (_, begin, low, high, may), p, now in zip(rows, parameters, start, strict=True):
        assert value(begin) == pytest.approx(now, rel=1e-6)
        assert (value(low), value(high)) == pytest.approx((p.low, p.high))
        assert may.lower() == p.may


def test_the_configuration_is_that_of_the_package():
    text = (FIRMWARE / "config.h").read_text()
    found = {k: float(v) for k, v in re.findall(r"#define (\w+) (-?[\d.e]+)f", text)}
    config = BoardConfig()
    assert found == {name.upper(): pytest.approx(getattr(config, name)) for name in config.__dataclass_fields__}
    assert all(f"#ifndef {name}" in text for name in found)


def test_faults_refusals_and_version_have_the_same_numbers():
    safety = re.search(r"enum Fault : uint8_t \{(.*?)\};", (FIRMWARE / "safety.h").read_text(), re.DOTALL)
    protocol = (FIRMWARE / "protocol.h").read_text()
    status = re.search(r"enum Status : uint8_t \{(.*?)\};", protocol, re.DOTALL)
    assert safety
    assert status
    faults = re.findall(r"^\s*([A-Z_]+)", safety[1], re.MULTILINE)
    assert [getattr(m, "NO_FAULT" if f == "NONE" else f) for f in faults] == list(range(10))
    assert [getattr(m, s) for s in re.findall(r"[A-Z_]+", status[1])] == list(range(7))
    assert f"VERSION = {m.PROTOCOL};" in protocol


def test_it_builds_without_a_warning(tmp_path):
    if missing():
        pytest.skip(f"skipped: not installed: {missing()} (rig/simulation/install.sh)")
    call = ["make", "-C", str(FIRMWARE), f"BUILD={tmp_path}"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr.lower()
    sizes = re.search(r"^\s*(\d+)\s+(\d+)\s+(\d+)", done.stdout, re.MULTILINE)
    assert sizes
    text, data, bss = map(int, sizes.groups())
    assert text + data < 30_720  # an old Nano's bootloader leaves that much
    assert data + bss < 1_648  # 400 bytes of stack
