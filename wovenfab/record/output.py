"""What a run writes into its results directory besides the history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.figures import StandardTest
from wovenfab.sheet.probes import Gauge, Line, Probe, Yarn

#: Groups of fields, in the order in which they are stored.
FIELDS = "displacement", "relative_displacement", "curvature", "shear_angle", "stretch"


@dataclass(frozen=True)
class Output:
    """What is written besides the history.

    Attributes:
        fields: Groups of fields for ParaView; those that the effects do not know are left out.
        every: Fields are written every so many planned steps, at reversals and at the end.
        probes: Places by name. Gauges are columns of the history, lines and yarns are written to
            ``lines.csv``.
        checkpoint: Wall time (s, a float) or number of steps (an int) between checkpoints; one
            more is written at the end. False for none.
        texts: Contents of further files by name, such as ``case.yaml``; written at the start.
        identity: Plain values that checkpoints keep, by which a run is recognised.
        specimen: What cycles are evaluated as, besides force and energy.
        tests: The standard tests whose figures are written.
    """

    fields: tuple[str, ...] = FIELDS
    every: int = 10
    probes: Mapping[str, Probe] = field(default_factory=dict)
    checkpoint: float | int | bool = 300.0
    texts: Mapping[str, str] = field(default_factory=dict)
    identity: Mapping[str, Any] = field(default_factory=dict)
    specimen: BiasExtension | None = None
    tests: tuple[StandardTest, ...] = ()

    @property
    def lines(self) -> dict[str, Line | Yarn]:
        """The probes that are written wherever fields are stored."""
        return {n: p for n, p in self.probes.items() if isinstance(p, Line | Yarn)}

    @property
    def gauges(self) -> dict[str, Gauge]:
        """The probes that are written on every step."""
        return {n: p for n, p in self.probes.items() if not isinstance(p, Line | Yarn)}
