"""Long recordings of quick, directly driven actuators as segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scpjax.fit.ambient import told_ambient
from scpjax.fit.data import columns
from scpjax.fit.start import best_linear
from scpjax.physics.structure import Structure
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import recorded_effort

_LONG, _SEGMENT, _SEGMENTS, _EDGE = 16384, 2048, 3, 16


def cut_long(recordings: Sequence[Recording], s: Structure) -> tuple[tuple[Recording, ...], tuple[str, ...]]:
    """Long recordings of quick, directly driven actuators (or systems of the user's own) as segments that run abreast.

    Each segment begins with a lead, from rest and without weight, in which its unknown start dies away; a few samples
    at its end, where a band-limited hold cannot know what follows, have no weight either. Of very long recordings
    evenly spread segments are taken. Slow (thermal) recordings stay whole, and short ones where none is long; beside a
    long one they give up at most half of theirs to the lead.
    """
    if s.thermal or max(r.n for r in recordings) <= _LONG or not all(r.is_uniform for r in recordings):
        return tuple(recordings), ()
    out, used = [], 0
    for r in recordings:
        poles = best_linear(
            np.asarray(recorded_effort(s, r))[:6000, 0],
            r.output(columns(s, r)[0][1])[:6000],
            r.period,
            2,
            held=r.hold == "zero_order",
        )
        slowest = min((float(np.min(np.abs(np.real(m.poles)))) for m in poles[:1]), default=1e-9)
        lead = int(np.clip(16.0 / slowest / r.period, 64, _SEGMENT))
        edge = min(_EDGE, r.n // 8)
        lead = min(lead, (r.n - edge) // 2)
        starts = np.arange(0, max(r.n - lead - _SEGMENT - _EDGE, 1), _SEGMENT)
        if len(starts) > _SEGMENTS:
            starts = starts[np.linspace(0, len(starts) - 1, _SEGMENTS).round().astype(int)]
        for a in starts:
            b = min(a + lead + _SEGMENT + _EDGE, r.n)
            part = r.slice(r.time[a], r.time[b] if b < r.n else None)
            weights = np.array(part.weights)
            weights[:lead] = 0.0
            weights[part.n - edge :] = 0.0
            name = f"{r.metadata.name} {r.time[a]:.4g}-{part.time[-1]:.4g} s"
            told = replace(r.metadata, name=name, ambient_K=told_ambient(r, s))  # of all of it, not of the segment
            out.append(part.with_weights(weights).with_metadata(told))
            used += part.n - lead - edge
    total = sum(r.n for r in recordings)
    return tuple(out), (f"long recordings were cut into {len(out)} segments; {used} of {total} samples were used",)
