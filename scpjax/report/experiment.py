"""The next experiment on the page: its drive, what each hypothesis expects, and what would still set them apart."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from scpjax.diagnose.proposal import NextExperiment
from scpjax.report import page, plot
from scpjax.report.numbers import column, number
from scpjax.report.pieces import title
from scpjax.report.plot import BASE, DRIVE, EXTENDED, FAINT, new_figure, style

_COLOURS = (EXTENDED, BASE, "#009e73", "#cc79a7")
_DRIVES = (DRIVE, "#c08bb0")


def figure(e: NextExperiment) -> Figure:
    """Drive; then for each column what every hypothesis expects, and what the best imitation is still off."""
    columns = list(e.predicted[e.separates[0]])
    ratios = [1.1] + [2.2, 1.3] * len(columns)
    out = new_figure(8.6, 0.78 * sum(ratios) + 0.75)
    axes = out.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios, "hspace": 0.2})
    tall = out.get_figheight()
    out.subplots_adjust(
        left=0.11, right=0.985, top=1 - (0.36 if len(e.separates) < 3 else 0.56) / tall, bottom=0.48 / tall
    )
    for k, name in enumerate(e.drive_columns):
        axes[0].step(e.time, e.drive[:, k], where="post", color=_DRIVES[k % 2], lw=1.1, label=name)
    words, unit = column(e.drive_columns[0])
    axes[0].set_ylabel(f"{words.split()[0]}\n({unit})")
    if len(e.drive_columns) > 1:
        plot.legend_above(axes[0])
    for i, name in enumerate(columns):
        words, unit = column(name)
        above, below = axes[2 * i + 1], axes[2 * i + 2]
        for k, label in enumerate(e.separates):
            dash = "-" if k == 0 else (0, (4, 1.6))
            above.plot(*plot.envelope(e.time, e.predicted[label][name]), color=_COLOURS[k % 4], lw=1.2, ls=dash)
        above.set_ylabel(f"{words}\n({unit})")
        below.axhspan(-2 * e.noise[name], 2 * e.noise[name], color="#cfd6de", lw=0, alpha=0.7)
        below.axhline(0, color=FAINT, lw=0.8)
        for (_, fitted), off in e.left.items():
            colour = _COLOURS[e.separates.index(fitted) % 4]
            below.plot(e.left_time, off[name], color=colour, lw=0.9)
        below.set_ylabel(f"Off, fitted\n({unit})")
        below.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))
    for axis in axes:
        style(axis)
        axis.set_xlim(0, e.time[-1])
    axes[-1].set_xlabel("Time (s)")
    from matplotlib.lines import Line2D

    keys = [Line2D([], [], color=_COLOURS[k % 4], lw=1.6) for k in range(len(e.separates))]
    names = [name_of(label) for label in e.separates]
    out.legend(
        keys, names, loc="upper right", bbox_to_anchor=(0.99, 1.0), ncols=min(len(names), 2), frameon=False, fontsize=8
    )
    out.align_ylabels(axes)
    return out


def name_of(label: str) -> str:
    """A hypothesis in words."""
    plain = {"base model": "Nothing missing", "closure": "What was learned"}
    name, _, law = label.partition(" (")
    words = plain.get(label) or " and ".join(title(part) for part in name.split(" + "))
    return f"{words} ({law}" if law else words


def section(e: NextExperiment | None, png: bytes | None) -> str:
    """The section of the page; nothing where nothing is proposed."""
    if e is None or png is None:
        return ""
    rows = [(name_of(true), name_of(fitted), number(bits, 3)) for (true, fitted), bits in sorted(e.pair_bits.items())]
    hot = {k: number(v - 273.15, 3) for k, v in e.hottest.items()}
    heat = f"Hottest part expected: {' or '.join(dict.fromkeys(hot.values()))} °C. " if hot else ""
    compare = (
        f"{heat}The best standard excitation within the same limits ({e.standard}) would bring "
        f"{number(e.standard_bits, 3)} bits, the present drive once more {number(e.repeat_bits, 3)}."
    )
    caption = (
        "The drive to play; what each hypothesis expects; and what it would still be off, fitted anew to all "
        "recordings, if the other is true, with ± 2 noise (shaded)."
    )
    note = (
        "Bits: expected growth of the log-likelihood ratio (base 2) of the true hypothesis to the other. "
        "10 bits are odds of a thousand to one."
    )
    return page.section(
        "The next experiment",
        page.text(e.says),
        page.figure(png, caption),
        page.table(("If this is true", "and this is fitted", "Expected bits"), rows, (2,)),
        page.text(compare),
        page.text(note, "small soft"),
    )


def drawn(e: NextExperiment | None) -> bytes | None:
    """The figure as a PNG file, where there is one."""
    return None if e is None else plot.png(figure(e))
