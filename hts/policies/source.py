"""What the files of another library say of a policy: its contract, what it observes, its activation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hts.errors import PolicyError
from hts.policies.contract import Contract
from hts.policies.terms import ABSOLUTE, NOT_MEASURED

VECTORS = {"angular_velocity", "projected_gravity", "command"}
OWN_NAMES = VECTORS | {"joint_position_offset", "joint_velocity", "last_action", ABSOLUTE}


@dataclass(frozen=True)
class Source:
    """What was found beside a policy. observation: parts as in a Layout, sizes left out, () if nothing says;
    activation: between its layers, "" if nothing says."""

    contract: Contract = field(default_factory=Contract)
    observation: tuple[Mapping[str, Any], ...] = ()
    activation: str = ""

    def over(self, other: Source) -> Source:
        """This one, and where it says nothing the other."""
        return Source(
            self.contract.over(other.contract),
            self.observation or other.observation,
            self.activation or other.activation,
        )

    def check_activation(self, path: Path) -> None:
        """Raises PolicyError for another activation than ELU."""
        if self.activation and self.activation.lower() != "elu":
            raise PolicyError(
                f"{path}: its activation is {self.activation}, hts computes ELU. Train it with activation: elu."
            )


def sized(parts: tuple[Mapping[str, Any], ...], joints: int) -> tuple[Mapping[str, Any], ...]:
    """With the sizes that the names mean for so many joints, where a part has none."""
    made = []
    for part in parts:
        name = str(part["name"])
        size = 3 if name in VECTORS or NOT_MEASURED.get(name, "").endswith("velocity") else joints
        made.append({"size": size, **part})
    return tuple(made)
