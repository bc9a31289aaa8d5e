"""The live page."""

import json
import urllib.request

from scpjax.bench.device import EmulatedDevice
from scpjax.bench.live import Live
from scpjax.bench.rig import Rig
from scpjax.bench.simulated import simulated
from scpjax.bench.world import Noise

QUIET = Noise(volts=0.0)


def emulated(made, **options):
    return EmulatedDevice(made.world, config=made.config, **options)


def test_the_live_page_serves_what_comes():
    made = simulated("muscle")
    names = ("time_s", *made.wiring.drives, *made.wiring.responses)
    with Live(names) as live, Rig(emulated(made), made.wiring) as rig:
        rig.listener = lambda time, sample: live.add(time, rig.wiring.row(sample))
        rig.set_voltage(2.0)
        rig.wait(1.0)
        page = urllib.request.urlopen(live.url, timeout=5).read()
        data = json.loads(urllib.request.urlopen(f"{live.url}data?since=0", timeout=5).read())
        later = json.loads(urllib.request.urlopen(f"{live.url}data?since={data['next']}", timeout=5).read())
    assert b"canvas" in page
    assert data["names"] == list(names)
    assert len(data["rows"]) == data["next"] > 15
    assert len(data["rows"][-1]) == len(names)
    assert later["rows"] == []
