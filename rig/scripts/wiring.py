"""Draw the wiring diagram of the bench, after appendix A.2-A.3 of the thesis: python rig/scripts/wiring.py

Writes rig/wiring.svg (and, with --png FILE, a picture to look at).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

INK, POWER, SIGNAL, SOFT = "#2b3036", "#d55e00", "#0072b2", "#eef0f3"


class Sheet:
    """A sheet with a few symbols; coordinates are in tenths of an inch."""

    def __init__(self, width: float, height: float):
        self.figure = Figure(figsize=(width / 10, height / 10))
        FigureCanvasAgg(self.figure)
        self.axes: Axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set_xlim(0, width)
        self.axes.set_ylim(0, height)
        self.axes.axis("off")

    def wire(self, *points: tuple[float, float], colour: str = INK, width: float = 1.1) -> None:
        """A line through points."""
        x, y = zip(*points, strict=True)
        self.axes.plot(x, y, color=colour, lw=width, solid_capstyle="round", solid_joinstyle="round", zorder=2)

    def text(self, x: float, y: float, words: str, size: float = 7.5, side: str = "left", colour: str = INK) -> None:
        """Words beside a point."""
        self.axes.text(x, y, words, fontsize=size, ha=side, va="center", color=colour, zorder=5)

    def dot(self, x: float, y: float, colour: str = INK) -> None:
        """Where wires join."""
        self.axes.add_patch(Circle((x, y), 0.28, color=colour, zorder=4))

    def box(self, x: float, y: float, w: float, h: float, words: str, size: float = 7.5) -> None:
        """A part as a box with words in it."""
        self.axes.add_patch(Rectangle((x, y), w, h, fc=SOFT, ec=INK, lw=1.1, zorder=3))
        self.text(x + w / 2, y + h / 2, words, size, "center")

    def resistor(self, x: float, y: float, length: float, upright: bool = False, colour: str = INK) -> None:
        """A zigzag that begins at a point and goes right, or down."""
        s = np.array([0, 0.2, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.8, 1.0]) * length
        z = np.array([0, 0, 1, -1, 1, -1, 1, -1, 0, 0]) * 0.7
        points = zip(x + z, y - s, strict=True) if upright else zip(x + s, y + z, strict=True)
        self.wire(*points, colour=colour)

    def ground(self, x: float, y: float) -> None:
        """Ground below a point."""
        for k, w in enumerate((1.3, 0.85, 0.4)):
            self.wire((x - w, y - 0.45 * k), (x + w, y - 0.45 * k))

    def transistor(self, x: float, y: float, words: str) -> None:
        """An N-channel MOSFET: gate at (x, y), drain above and source below at x + 3."""
        self.wire((x, y), (x + 1.4, y))
        self.wire((x + 1.4, y - 1.5), (x + 1.4, y + 1.5), width=1.6)
        for k in (-1.1, 0.0, 1.1):
            self.wire((x + 1.9, y + k - 0.45), (x + 1.9, y + k + 0.45), width=1.8)
        self.wire((x + 1.9, y + 1.1), (x + 3, y + 1.1), (x + 3, y + 2.4))
        self.wire((x + 1.9, y - 1.1), (x + 3, y - 1.1), (x + 3, y - 2.6))
        self.wire((x + 1.9, y), (x + 3, y), (x + 3, y - 1.1))
        self.text(x + 3.6, y - 0.6, words, 7)

    def diode(self, x: float, low: float, high: float) -> None:
        """A diode from ``low`` (anode) up to ``high``."""
        m = (low + high) / 2
        self.wire((x, low), (x, m - 0.8))
        self.axes.fill([x - 0.9, x + 0.9, x], [m - 0.8, m - 0.8, m + 0.7], color=INK, zorder=3)
        self.wire((x - 0.9, m + 0.7), (x + 0.9, m + 0.7))
        self.wire((x, m + 0.7), (x, high))


def pins(sheet: Sheet) -> dict[str, float]:
    """The Arduino on the left; height of each pin."""
    order = ["3", "9", "5", "6", "A4", "A5", "A3", "A0", "A1", "A2", "7", "8", "2", "4", "5V", "GND"]
    heights = [68, 52, 63, 47, 59.8, 43.8, 37, 31, 27.5, 24, 18.5, 15.5, 10.5, 8, 4.6, 2.2]
    at = dict(zip(order, heights, strict=True))
    sheet.box(3, 1, 13, 72, "")
    sheet.text(9, 71.2, "Arduino Uno / Nano", 8.5, "center")
    sheet.text(9, 69.6, "ATmega328P", 7, "center")
    for name, y in at.items():
        sheet.text(15.4, y, name, 8, "right", SIGNAL)
        sheet.wire((16, y), (18, y), colour=SIGNAL)
    return at


def channel(sheet: Sheet, name: str, gate: float, sense: float, reading: float) -> None:
    """One actuator: MOSFET, heater, diode, the sink of the sensing current and its amplifier."""
    bus = gate + 4.6
    drain = gate + 2.4 - 0.6
    sheet.wire((18, gate), (20, gate), colour=SIGNAL)
    sheet.resistor(20, gate, 5)
    sheet.text(22.5, gate + 1.5, "220 Ω", 7, "center")
    sheet.wire((25, gate), (29, gate))
    sheet.dot(27, gate)
    sheet.resistor(27, gate, 3, upright=True)
    sheet.ground(27, gate - 3)
    sheet.text(26, gate - 1.7, "10 kΩ", 7, "right")
    sheet.transistor(29, gate, "IRL7833")
    sheet.ground(32, gate - 2.6)
    node = gate + 1.9
    sheet.wire((32, drain), (32, node), (52, node), colour=POWER, width=1.6)
    sheet.dot(41, node, POWER)
    sheet.wire((41, node), (41, bus - 0.2), colour=POWER, width=1.6)
    sheet.diode(41, node, bus + 1)
    sheet.text(42.2, node + 1.9, "10 A diode", 7)
    sheet.wire((52, node), (53, node), colour=POWER, width=1.6)
    sheet.resistor(53, node, 9, colour=POWER)
    sheet.text(57.5, node + 1.8, f"heater wire, {name}", 7.5, "center", POWER)
    sheet.wire((62, node), (66, node), (66, bus + 1), colour=POWER, width=1.6)
    sheet.wire((41, bus + 1), (74, bus + 1), colour=POWER, width=1.6)
    sheet.dot(66, bus + 1, POWER)
    sheet.wire((18, sense), (36, sense), colour=SIGNAL)
    sheet.box(36, sense - 1.4, 11, 2.8, "125 mA sink\nwhile high", 6.5)
    sheet.wire((47, sense), (50, sense), (50, node))
    sheet.dot(50, node)
    sheet.wire((18, reading), (53, reading), colour=SIGNAL)
    sheet.box(53, reading - 1.4, 9, 2.8, "INA180A1\n× 20", 6.5)
    sheet.wire((55, reading + 1.4), (55, node))
    sheet.wire((60, reading + 1.4), (60, node - 1.0), (64, node - 1.0), (64, node))
    sheet.dot(55, node)
    sheet.dot(64, node)


def supply(sheet: Sheet, reading: float) -> None:
    """Battery, fuse, shunt and its amplifier."""
    top, x = 73.6, 74
    for y in (73.6, 57.6):
        sheet.dot(x, y, POWER)
    sheet.wire((x, top), (x, 38), colour=POWER, width=1.6)
    sheet.resistor(x, 38, 5, upright=True, colour=POWER)
    sheet.text(x + 1.4, 35.5, "20 mΩ, 3 W", 7)
    sheet.wire((x, 33), (x, 30.5), colour=POWER, width=1.6)
    sheet.box(x - 2, 27.7, 4, 2.8, "10 A\nfuse", 6.5)
    sheet.wire((x, 27.7), (x, 25.5), colour=POWER, width=1.6)
    for k, w in enumerate((2.2, 1.1, 2.2, 1.1)):
        sheet.wire((x - w, 25.5 - 0.8 * k), (x + w, 25.5 - 0.8 * k), colour=POWER, width=1.6)
    sheet.text(x + 3, 24.6, "Li-ion 3.7 V\n≥ 10 A", 7)
    sheet.wire((x, 23.1), (x, 20.6))
    sheet.ground(x, 20.6)
    sheet.wire((18, reading), (24, reading), colour=SIGNAL)
    sheet.resistor(24, reading, 5)
    sheet.text(26.5, reading + 1.4, "1 kΩ", 7, "center")
    sheet.wire((22, reading), (22, reading - 1.4))
    sheet.dot(22, reading)
    for k in (0.0, 0.6):
        sheet.wire((20.9, reading - 1.4 - k), (23.1, reading - 1.4 - k), width=1.5)
    sheet.wire((22, reading - 2.0), (22, reading - 2.8))
    sheet.ground(22, reading - 2.8)
    sheet.text(23.6, reading - 1.8, "10 µF", 7)
    sheet.wire((29, reading), (58, reading), colour=SIGNAL)
    sheet.box(58, reading - 1.4, 9, 2.8, "INA180A1\n× 20", 6.5)
    sheet.wire((67, reading + 0.7), (70, reading + 0.7), (70, reading + 1.3), (x, reading + 1.3))
    sheet.wire((67, reading - 0.7), (71, reading - 0.7), (71, 32.2), (x, 32.2))
    sheet.dot(x, reading + 1.3)
    sheet.dot(x, 32.2)


def sensors(sheet: Sheet, at: dict[str, float]) -> None:
    """Thermistors, potentiometer, sonar, encoder."""
    for name, words in (("A0", "agonist"), ("A1", "antagonist")):
        sheet.wire((18, at[name]), (39, at[name]), colour=SIGNAL)
        sheet.box(39, at[name] - 1.2, 30, 2.4, f"5 V – NTC 100 kΩ, B 3950 ({words}) – tap – 10 kΩ – GND", 6.8)
    y = at["A2"]
    sheet.wire((18, y), (39, y), colour=SIGNAL)
    sheet.box(39, y - 1.2, 30, 2.4, "5 V – potentiometer 10 kΩ on the pulley – GND", 6.8)
    for name in ("7", "8"):
        sheet.wire((18, at[name]), (39, at[name]), colour=SIGNAL)
    sheet.text(37.5, at["7"] + 0.9, "trigger", 7, "right")
    sheet.text(37.5, at["8"] + 0.9, "echo", 7, "right")
    sheet.box(39, at["8"] - 1.2, 30, at["7"] - at["8"] + 2.4, "HC-SR04 (5 V, GND), or none", 6.8)
    for name, words in (("2", "A"), ("4", "B")):
        sheet.wire((18, at[name]), (39, at[name]), colour=SIGNAL)
        sheet.text(37.5, at[name] + 0.9, words, 7, "right")
    sheet.box(39, at["4"] - 1.2, 30, at["2"] - at["4"] + 2.4, "quadrature encoder (5 V, GND), or none", 6.8)
    sheet.wire((18, at["5V"]), (22, at["5V"]), colour=SIGNAL)
    sheet.text(22.6, at["5V"], "sensors and amplifiers; the board itself is fed by USB", 7)
    sheet.wire((18, at["GND"]), (20.5, at["GND"]))
    sheet.ground(20.5, at["GND"])
    sheet.text(22.6, at["GND"], "one ground: battery, sources of both MOSFETs, sensors, board", 7)


def draw() -> Sheet:
    """The whole diagram."""
    sheet = Sheet(88, 77)
    at = pins(sheet)
    channel(sheet, "agonist", at["3"], at["5"], at["A4"])
    channel(sheet, "antagonist", at["9"], at["6"], at["A5"])
    supply(sheet, at["A3"])
    sensors(sheet, at)
    sheet.text(44, 75.8, "scpjax bench: power in orange, signals in blue", 8.5, "center")
    return sheet


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--png", type=Path, help="also write a picture")
    arguments = parser.parse_args()
    mpl.rcParams["svg.hashsalt"] = "scpjax"
    sheet = draw()
    out = Path(__file__).resolve().parents[1] / "wiring.svg"
    sheet.figure.savefig(out, metadata={"Date": None})
    if arguments.png:
        sheet.figure.savefig(arguments.png, dpi=130)


if __name__ == "__main__":
    main()
