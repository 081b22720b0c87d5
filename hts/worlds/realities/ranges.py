"""What of a twin is drawn, and over what: read from the fields of its parameter classes and of its instruments'.

A field made by `hts.contracts.parameter` says its range. It is drawn

    over `drawn`, or its whole range; log-uniform if that begins above 0 and spans a factor of ten, else uniform
    only if its structural `switch` is on, one coin for all fields of that name; else it stays at its default, off
    not at all if it says why (`fixed`)

and a field without a range, or an instrument whose settings class is not known, stays at its default.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from hts.plugin_settings import settings_model
from hts.worlds.twin.parameters import DynamicsParameters, SensorParameters
from hts.worlds.twin.structure import SessionParameters

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from hts.plugins import Registry

BODY: Mapping[str, type[BaseModel]] = {
    "dynamics": DynamicsParameters,
    "sensors": SensorParameters,
    "sessions": SessionParameters,
}
LOGARITHMIC = 10.0  # high / low from which a positive range is drawn log-uniformly


@dataclass(frozen=True)
class Drawn:
    """One parameter that is drawn: its dotted key under the world's settings, and how."""

    key: str
    low: float
    high: float
    unit: str
    source: str
    default: Any
    switch: str | None
    whole: bool
    boolean: bool
    counts: tuple[int, int] | None
    ascending: bool

    @property
    def logarithmic(self) -> bool:
        return self.low > 0 and self.high >= LOGARITHMIC * self.low and not self.whole

    @property
    def group(self) -> str:
        """The section of its key: parameters of one have as many values each, where they have several."""
        return self.key.rpartition(".")[0]

    def at(self, share: float) -> float:
        """The value below which this share of the range lies, as it is drawn over."""
        low, high = self.low, self.high
        return low * (high / low) ** share if self.logarithmic else low + (high - low) * share

    def quartiles(self) -> tuple[float, float, float]:
        """Of the range."""
        return self.at(0.25), self.at(0.5), self.at(0.75)


def drawn_parameters(registry: Registry) -> list[Drawn]:
    """Everything that a reality draws, in the order of the classes; instruments in the order of their names."""
    found = [one for name, model in BODY.items() for one in _of(model, f"{name}.")]
    for name in sorted(registry.instruments):
        instrument = settings_model(registry, "instruments", name)
        if instrument is not None:
            found += _of(instrument, f"instruments.{name}.")
    return found


def switches(parameters: list[Drawn]) -> list[str]:
    """Names of the structural switches, each once."""
    return list(dict.fromkeys(one.switch for one in parameters if one.switch is not None))


def instruments_in(parameters: list[Drawn]) -> list[str]:
    """Names of the instruments that are drawn: of every installed plugin, and each changes what is kept."""
    sections = [one.key.split(".") for one in parameters]
    return list(dict.fromkeys(section[1] for section in sections if section[0] == "instruments"))


def ranges_sha256(parameters: list[Drawn]) -> str:
    """Of all that decides a draw: another hash, other realities from the same seed."""
    rows = [(p.key, p.low, p.high, p.switch, p.whole, p.boolean, p.counts, p.ascending) for p in parameters]
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def table(parameters: list[Drawn]) -> str:
    """All of it as a table in markdown."""
    lines = ["| parameter | unit | default | drawn over | how | switch | source |", "|---|---|---|---|---|---|---|"]
    for one in parameters:
        how = "log-uniform" if one.logarithmic else "whole numbers" if one.whole else "uniform"
        over = "on" if one.boolean else f"{one.low:g} to {one.high:g}"
        if one.counts:
            how += f", {one.counts[0]} to {one.counts[1]} of them"
        default = ", ".join(f"{v:g}" for v in one.default) if isinstance(one.default, tuple) else f"{one.default:g}"
        cells = (f"`{one.key}`", one.unit, default, over, "" if one.boolean else how, one.switch or "", one.source)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _of(model: type[BaseModel], prefix: str) -> Iterator[Drawn]:
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from _of(inner, f"{prefix}{name}.")
        elif (one := _field(f"{prefix}{name}", field)) is not None:
            yield one


def _field(key: str, field: FieldInfo) -> Drawn | None:
    extra = field.json_schema_extra
    if not isinstance(extra, dict) or "fixed" in extra or not ({"range", "switch"} & set(extra)):
        return None
    values: dict[str, Any] = dict(extra)
    low, high = values.get("drawn") or values.get("range") or (0.0, 1.0)
    counts = values.get("counts")
    return Drawn(
        key=key,
        low=float(low),
        high=float(high),
        unit=str(values.get("unit", "")),
        source=str(values.get("source", "")),
        default=field.default,
        switch=values.get("switch"),
        whole=field.annotation is int,
        boolean=field.annotation is bool,
        counts=(int(counts[0]), int(counts[1])) if counts else None,
        ascending=bool(values.get("ascending", False)),
    )
