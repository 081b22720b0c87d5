"""logs/held.json: commands at which a policy walked the asked speed, found by trimming, for later visits.

{"SESSION ROLE POLICY_HASH SPEED": [command m/s, whether a limit held it back]}
"""

from __future__ import annotations

import json
from pathlib import Path

from hts_go1_runtime.bundle import Hold
from hts_go1_runtime.errors import RuntimeFault

FILE = "held.json"

Held = dict[str, tuple[float, bool]]


def read_held(logs: Path, hold: Hold | None) -> Held:
    """What was found before; {} if nothing was, or if no speed is held. Raises RuntimeFault for a file in which
    anything is what no trimming can have found: a robot would be commanded it."""
    path = logs / FILE
    if hold is None:
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RuntimeFault(f"{path}: cannot be read ({error.strerror}). {_AWAY}") from error
    except (ValueError, RecursionError) as error:
        raise RuntimeFault(f"{path}: no JSON ({' '.join(str(error).split())[:120]}). {_AWAY}") from error
    if not isinstance(found, dict):
        raise RuntimeFault(f"{path}: holds {str(found)[:60]}, expected names with commands. {_AWAY}")
    return {key: _command(value, hold, f"{path}: '{key[:120]}'") for key, value in found.items()}


def written(held: Held) -> str:
    """Content of the file."""
    return json.dumps(held, indent=1) + "\n"


def _command(value: object, hold: Hold, where: str) -> tuple[float, bool]:
    low, high = hold.commands
    match value:
        case [int() | float() as command, bool() as at_limit] if (
            not isinstance(command, bool) and low <= command <= high
        ):
            return float(command), at_limit
    raise RuntimeFault(
        f"{where} is {str(value)[:60]}, expected a command from {low:g} to {high:g} m/s and true or false. {_AWAY}"
    )


_AWAY = "Move it away, and record the head-to-heads anew."
