"""A recording: what went in and what came out of one actuator, on one time axis, in SI."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import numpy as np

from scpjax.errors import RecordingError
from scpjax.recordings.validate import check_shapes, check_stems, check_values, fill, uniform
from scpjax.units import Unit, parse_column

Hold = Literal["zero_order", "linear", "band_limited"]
"""How an input runs between its samples."""

MODELS = ("te", "tm", "plant", "aaa")


@dataclass(frozen=True)
class Channel:
    """One column: its name in the file (``displacement_mm``), its stem (``displacement``) and its unit."""

    column: str
    stem: str
    unit: Unit

    @classmethod
    def parse(cls, column: str, *, allow_unknown: bool = True) -> Channel:
        """The channel of a column name; ``RecordingError`` where its unit is missing or wrong."""
        return cls(column, *parse_column(column, allow_unknown=allow_unknown))


@dataclass(frozen=True)
class Metadata:
    """What is known of a recording beside its samples; SI.

    ``known`` holds the values of ``[actuator]`` by their names there (``resistance_ohm``); ``quasi_static``
    says that no time was recorded and that the time axis only counts samples; ``unread`` names the columns of the file
    that are neither drive nor response.
    """

    title: str = ""
    source: str = ""
    name: str = ""
    path: str = ""
    model: str | None = None
    known: tuple[tuple[str, float], ...] = ()
    ambient_K: float | None = None
    pulley_radius_m: float | None = None
    pulley_mass_kg: float | None = None
    supply_V: float | None = None
    quasi_static: bool = False
    unread: tuple[str, ...] = ()
    provenance: str = ""

    def get_known(self, key: str, default: float | None = None) -> float | None:
        """The value of ``key`` in ``[actuator]``, or ``default``."""
        return dict(self.known).get(key, default)


class Recording(eqx.Module):
    """Inputs and outputs of one actuator on one time axis, everything in SI.

    ``time`` (n,) s; ``inputs`` (n, u) and ``outputs`` (n, y) in the SI unit of their channel; ``weights``
    (n, y) are 0 where an output is missing (the value there is interpolated and means nothing), else 1. A
    NaN in ``outputs`` becomes weight 0. Raises ``RecordingError`` for fewer than 8 samples, a time that
    does not grow, unequal lengths, a value that is not finite, or no input or output (with
    ``require_outputs=False`` a recording may be all input).
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    weights: np.ndarray
    input_channels: tuple[Channel, ...] = eqx.field(static=True)
    output_channels: tuple[Channel, ...] = eqx.field(static=True)
    hold: Hold = eqx.field(static=True)
    metadata: Metadata = eqx.field(static=True)

    def __init__(
        self,
        time: Any,
        inputs: Any,
        outputs: Any,
        weights: Any = None,
        *,
        input_channels: Sequence[Channel],
        output_channels: Sequence[Channel],
        hold: Hold = "zero_order",
        metadata: Metadata | None = None,
        require_outputs: bool = True,
    ):
        self.metadata = Metadata() if metadata is None else metadata
        self.input_channels, self.output_channels = tuple(input_channels), tuple(output_channels)
        self.hold = hold
        self.time = np.array(time, dtype=np.float64)
        self.inputs = np.array(inputs, dtype=np.float64)
        values = np.array(outputs, dtype=np.float64)
        given = np.ones(values.shape) if weights is None else np.array(weights, dtype=np.float64)
        where = place(self.metadata)
        if hold not in get_args(Hold):
            raise RecordingError(f"unknown hold '{hold}'", where=where, mend=f"use one of {get_args(Hold)}")
        ins, outs = ([c.column for c in group] for group in (self.input_channels, self.output_channels))
        check_stems([c.stem for c in (*self.input_channels, *self.output_channels)], where)
        numbers = (len(ins), len(outs))
        check_shapes(self.time, self.inputs, values, given, numbers, where, require_outputs=require_outputs)
        check_values(self.time, self.inputs, values, given, ins, where)
        self.weights = np.where(np.isnan(values), 0.0, given)
        self.outputs = fill(self.time, values, self.weights)

    @classmethod
    def from_arrays(
        cls,
        time: Any,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        *,
        hold: Hold = "zero_order",
        metadata: Metadata | None = None,
        require_outputs: bool = True,
    ) -> Recording:
        """From arrays (n,) keyed by column name with unit suffix, values in that unit; ``time`` in s.

        A NaN in an output is a missing sample.
        """
        channels = (
            tuple(Channel.parse(name) for name in inputs),
            tuple(Channel.parse(name) for name in outputs),
        )
        stacks = []
        for group, columns in zip(channels, (inputs, outputs), strict=True):
            values = [np.asarray(columns[c.column], dtype=np.float64) for c in group]
            for channel, value in zip(group, values, strict=True):
                if value.shape != np.shape(time):
                    raise RecordingError(
                        f"{value.shape} values against a time of {np.shape(time)}",
                        where=f"{place(metadata)}: column {channel.column}",
                        mend="give one value per time",
                    )
            si = [c.unit.to_si(v) for c, v in zip(group, values, strict=True)]
            stacks.append(np.stack(si, axis=-1) if si else np.zeros((np.size(time), 0)))
        return cls(
            time,
            *stacks,
            input_channels=channels[0],
            output_channels=channels[1],
            hold=hold,
            metadata=metadata,
            require_outputs=require_outputs,
        )

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.time.shape[0]

    @property
    def duration(self) -> float:
        """Last less first time, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def period(self) -> float:
        """Sample period, s: of a uniform recording the mean, else the median step."""
        return self.duration / (self.n - 1) if self.is_uniform else float(np.median(np.diff(self.time)))

    @property
    def is_uniform(self) -> bool:
        """Whether every time lies within 1e-3 of a period of an even grid (CSV rounding does that much)."""
        return uniform(self.time)

    @property
    def dtype(self) -> np.dtype:
        """The type of the leaves."""
        return self.time.dtype

    def input(self, stem: str) -> np.ndarray:
        """The input (n,) of this stem (``voltage``) or column name, SI."""
        return self.inputs[..., _index(self.input_channels, stem, "input", self)]

    def output(self, stem: str) -> np.ndarray:
        """The output (n,) of this stem (``displacement``) or column name, SI."""
        return self.outputs[..., _index(self.output_channels, stem, "output", self)]

    def weight(self, stem: str) -> np.ndarray:
        """The weights (n,) of the output of this stem or column name."""
        return self.weights[..., _index(self.output_channels, stem, "output", self)]

    def slice(self, start_s: float | None = None, stop_s: float | None = None) -> Recording:
        """The samples with ``start_s <= time < stop_s`` (None: first, last); times are kept."""
        keep = np.ones(self.n, dtype=bool)
        keep &= True if start_s is None else self.time >= start_s
        keep &= True if stop_s is None else self.time < stop_s
        return self._with(
            time=self.time[keep],
            inputs=self.inputs[keep],
            outputs=self.outputs[keep],
            weights=self.weights[keep],
        )

    def select_outputs(self, *stems: str) -> Recording:
        """Only these outputs (stems or column names), in this order."""
        index = [_index(self.output_channels, stem, "output", self) for stem in stems]
        return self._with(
            outputs=self.outputs[:, index],
            weights=self.weights[:, index],
            output_channels=tuple(self.output_channels[i] for i in index),
        )

    def with_weights(self, weights: Any) -> Recording:
        """With these weights (n, y), at least 0; missing samples should keep weight 0."""
        return self._with(weights=np.broadcast_to(weights, self.outputs.shape))

    def with_inputs(self, inputs: Any) -> Recording:
        """With these inputs (n, u), SI."""
        return self._with(inputs=inputs)

    def with_outputs(self, outputs: Any) -> Recording:
        """With these outputs (n, y), SI; a NaN gets weight 0."""
        return self._with(outputs=outputs)

    def with_samples(self, time: Any, inputs: Any, outputs: Any, weights: Any) -> Recording:
        """With these samples on another time axis; channels, hold and metadata stay."""
        return self._with(time=time, inputs=inputs, outputs=outputs, weights=weights)

    def with_metadata(self, metadata: Metadata) -> Recording:
        """With this metadata (``dataclasses.replace(recording.metadata, ...)``)."""
        return self._with(metadata=metadata)

    def _with(self, **changes: Any) -> Recording:
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        merged = {**fields, **changes}
        return Recording(**merged, require_outputs=len(self.output_channels) > 0)

    def __repr__(self) -> str:
        ins = ", ".join(c.column for c in self.input_channels)
        outs = ", ".join(c.column for c in self.output_channels)
        name = f"{self.metadata.name!r}, " if self.metadata.name else ""
        if not isinstance(self.time, np.ndarray):
            return f"Recording({name}{ins} -> {outs})"
        return f"Recording({name}{ins} -> {outs}, n={self.n}, {self.duration:.6g} s, {self.hold})"


def place(metadata: Metadata | None) -> str:
    """How errors name a recording: its file, else its name."""
    return (metadata.path or metadata.name if metadata else "") or "recording"


def check_informative(recording: Recording, outputs: Collection[str] | None = None) -> None:
    """``RecordingError`` where nothing can be learned: a constant drive, an output missing or constant, of all or of
    those with these stems.
    """
    where = place(recording.metadata)
    drives = ", ".join(c.column for c in recording.input_channels)
    if np.ptp(recording.inputs, axis=0).max() <= 1e-9 * max(1e-6, np.abs(recording.inputs).max()):
        raise RecordingError(
            f"drive {drives} never changes: nothing can be learned",
            where=where,
            mend="use a step or multilevel excitation",
        )
    for i, channel in enumerate(recording.output_channels):
        if outputs is not None and channel.stem not in outputs:
            continue
        seen = recording.outputs[recording.weights[:, i] > 0, i]
        problem = "has no values" if seen.size == 0 else "never changes" if np.ptp(seen) == 0 else ""
        if problem:
            raise RecordingError(
                f"output {channel.column} {problem}: nothing can be learned from it",
                where=where,
                mend="check the sensor, or leave the column out with [roles] response",
            )


def _index(channels: tuple[Channel, ...], stem: str, kind: str, recording: Recording) -> int:
    for i, channel in enumerate(channels):
        if stem in (channel.stem, channel.column):
            return i
    raise RecordingError(
        f"no {kind} '{stem}'",
        where=place(recording.metadata),
        mend=f"the {kind}s here are {', '.join(c.stem for c in channels)}",
    )
