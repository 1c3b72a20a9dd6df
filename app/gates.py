"""Gates for `elbowroom run --check`: figures of metrics.json that must lie within bounds, written in TOML."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrc import toml_file
from hrc.errors import HrcError, unknown

BOUNDS = ("min", "max", "equals")


class GateError(HrcError):
    """A file of gates is missing or malformed, or names a figure that there is not."""


@dataclass(frozen=True)
class Gate:
    """A figure by its dotted name in metrics.json, and what it must be: one bound, or `min` and `max`."""

    figure: str
    bounds: Mapping[str, Any]

    def holds(self, value: Any) -> bool:
        """Whether the figure is as it must be. A figure without a single tick to judge, null, is not."""
        if "equals" in self.bounds:
            return value == self.bounds["equals"]
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        return self.bounds.get("min", value) <= value <= self.bounds.get("max", value)

    def __str__(self) -> str:
        return ", ".join(f"{bound} {value}" for bound, value in self.bounds.items())


@dataclass(frozen=True)
class Verdict:
    """What came of a gate."""

    gate: Gate
    value: Any
    holds: bool


def names() -> list[str]:
    """The gates that come with the project."""
    return toml_file.names("gates")


def load(name_or_path: str | Path) -> tuple[Gate, ...]:
    """Gates by name, or by the path of their file. Raises GateError.

    A gate is `"ee_error.relax.max_m" = {max = 0.003}`, quoted or not, or a table; a plain value is `equals`.
    """
    path = toml_file.find(name_or_path, "gates", "file of gates", GateError)
    gates = tuple(_gates(path.name, toml_file.read(path, "gates", GateError), ""))
    if not gates:
        raise GateError(f"{path.name} has no gate in it, so it would let everything pass")
    return gates


def _gates(file: str, table: Mapping[str, Any], prefix: str) -> Iterator[Gate]:
    for key, value in table.items():
        name = prefix + key
        if not isinstance(value, dict):
            yield Gate(name, {"equals": value})
        elif not value or set(value) & set(BOUNDS):
            yield _gate(file, name, value)
        else:
            yield from _gates(file, value, f"{name}.")


def _gate(file: str, name: str, bounds: Mapping[str, Any]) -> Gate:
    if not bounds:
        raise GateError(f"{file}: {name} has no bound; bounds are {', '.join(BOUNDS)}")
    for bound, value in bounds.items():
        if bound not in BOUNDS:
            raise GateError(f"{file}: {name}: {unknown('bound', bound, BOUNDS)}")
        if bound != "equals" and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise GateError(f"{file}: {name}: {bound} must be a number, not {value!r}")
    if "equals" in bounds and len(bounds) > 1:
        raise GateError(f"{file}: {name}: equals stands alone")
    if bounds.get("min", float("-inf")) > bounds.get("max", float("inf")):
        raise GateError(f"{file}: {name}: min must not be above max")
    return Gate(name, bounds)


def judge(gates: Sequence[Gate], figures: Mapping[str, Any]) -> list[Verdict]:
    """Each gate with its figure. Raises GateError for a figure that there is not."""
    known = dict(flat(figures))
    verdicts = []
    for gate in gates:
        if gate.figure not in known:
            raise GateError(unknown("figure", gate.figure, known))
        value = known[gate.figure]
        verdicts.append(Verdict(gate, value, gate.holds(value)))
    return verdicts


def flat(figures: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Each figure by its dotted name, as `force.links_4_to_7.median_error_N`."""
    for key, value in figures.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def table(verdicts: Sequence[Verdict]) -> str:
    """The gates that do not hold, one a line: figure, value, what it must be."""
    lines = [(verdict.gate.figure, _shown(verdict.value), f"must be: {verdict.gate}")
             for verdict in verdicts if not verdict.holds]
    widths = [max(len(line[i]) for line in lines) for i in range(2)] if lines else [0, 0]
    return "\n".join(f"{figure:<{widths[0]}}  {value:>{widths[1]}}  {must}" for figure, value, must in lines)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing to judge"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
