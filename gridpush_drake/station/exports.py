"""Ports of a Diagram's parts, exported under a common prefix."""

from collections.abc import Sequence

from pydrake.systems.framework import DiagramBuilder, System


def ExportOutputs(builder: DiagramBuilder, system: System, prefix: str, ports: Sequence[str]) -> None:
    """Exports output ports of a system, each as `prefix.port`."""
    for port in ports:
        builder.ExportOutput(system.GetOutputPort(port), f"{prefix}.{port}")
