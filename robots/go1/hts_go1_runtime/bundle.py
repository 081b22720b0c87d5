"""A deploy bundle as the runtime takes it: nothing is run before all of it has been checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hts_go1_runtime import machine
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.frozen import REAL, SEEN
from hts_go1_runtime.gated import check_gate, check_whose
from hts_go1_runtime.policy import PARTS, Policy
from hts_go1_runtime.reach import Reach, reach_of
from hts_go1_runtime.rows import FASTEST, LONGEST_ROW, Row, row_of
from hts_go1_runtime.trained import check_trained

SCHEMA, VERSION = "hts deploy bundle", 1
CHECKSUMS = "SHA256SUMS"
TARGET = "default_pose + action_scale * action"
ROBOT = "go1"
LARGEST_FILE = 64 * 2**20  # bytes
LONGEST_FROZEN = 600.0  # s
FIRST_RUNS = {"speed_scale": (0.0, 1.0), "torque_scale": (0.1, 1.0), "seconds": (0.0, 600.0)}
"""From, to; hts refuses the same in `gate.first_run`, and 0 of the first and the last."""


@dataclass(frozen=True)
class Hold:
    """How the speed is held: limits of the command, m/s, and seconds of trimming."""

    commands: tuple[float, float]
    seconds: float


@dataclass(frozen=True)
class FrozenSeconds:
    """For how long a sensor may repeat itself, s, 0: for ever. seen: what policies observe; real: what only the robot
    gives."""

    seen: float = SEEN
    real: float = REAL


@dataclass(frozen=True)
class Bundle:
    """A bundle that was checked. policies: file -> policy, ready to run; reach: what the joints may be told."""

    folder: Path
    manifest: Mapping[str, Any]
    policies: Mapping[str, Policy]
    rows: Sequence[Row]
    hold: Hold | None
    rate_hz: float
    reach: Reach
    frozen: FrozenSeconds

    @property
    def fastest(self) -> float | None:
        """m/s, the end of trimming, None where no speed is held."""
        return None if self.hold is None else self.hold.commands[1]

    @property
    def other_robot(self) -> str:
        """Name of the robot that it was made for, "" where that is this one. One of these joints and limits may be a
        Go1 with something more, so it is told and not refused."""
        name = str(self.manifest["robot"].get("name", ROBOT))
        return "" if name == ROBOT else name

    @property
    def logs(self) -> Path:
        return self.folder / "logs"


def load_bundle(folder: Path) -> Bundle:
    """Checksums, manifest against graphs, gains and limits against the robot's own. Raises RuntimeFault."""
    sums = _checksums(folder)
    manifest = _manifest(folder / "manifest.json", sums)
    where = str(folder / "manifest.json")
    try:
        reach = _reach(manifest["robot"], where)
        rate = _rate(manifest["control"], where)
        policies = {}
        for entry in manifest["policies"]:
            _check_entry(entry, rate, reach, f"{where}: policy {entry['file']}")
            check_gate(entry["gate"], f"{where}: policy {entry['file']}")
            check_trained(entry.get("trained"), f"{where}: policy {entry['file']}")
            content = _read(folder, str(entry["file"]), sums)
            policies[str(entry["file"])] = policy = Policy(entry, content, str(folder / entry["file"]))
            check_whose(entry["gate"], _checked_card(policy), f"{where}: policy {entry['file']}")
        rows = [row_of(row, policies, where) for row in manifest["rows"]]
        hold, frozen = _hold(manifest["hold"], where), _frozen(manifest.get("frozen"), where)
        _check_visit(manifest, where)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise RuntimeFault(f"{where}: not a whole manifest ({what[:160]}). Make the bundle again.") from error
    if len({row.log for row in rows}) != len(rows) or not rows:
        raise RuntimeFault(f"{where}: rows {[row.log for row in rows][:8]}, expected names, each once.")
    if hold is None and any(row.trim for row in rows):
        raise RuntimeFault(f"{where}: a row is to be trimmed, but nothing says how (`hold`). Make the bundle again.")
    return Bundle(folder, manifest, policies, rows, hold, rate, reach, frozen)


def _checksums(folder: Path) -> dict[str, str]:
    """file -> SHA-256, after every file was compared with its own."""
    path = folder / CHECKSUMS
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RuntimeFault(
            f"{path}: cannot be read ({error}). Name the folder of a deploy bundle, copied whole."
        ) from error
    sums = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    for name in sums:
        _read(folder, name, sums)
    return sums


def _read(folder: Path, name: str, sums: Mapping[str, str]) -> bytes:
    """A file of the bundle, whose checksum is right."""
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RuntimeFault(f"{folder / CHECKSUMS}: names '{name}', which is not in the bundle. Do not run it.")
    try:
        if path.exists() and not path.is_file():
            raise RuntimeFault(f"{path}: no file. Copy the bundle again.")
        if path.stat().st_size > LARGEST_FILE:
            raise RuntimeFault(f"{path}: larger than {LARGEST_FILE:,} bytes. Do not run it.")
        content = path.read_bytes()
    except OSError as error:
        raise RuntimeFault(f"{path}: cannot be read ({error.strerror}). Copy the bundle again.") from error
    found = hashlib.sha256(content).hexdigest()
    if found != sums.get(name):
        expected = f"{sums[name][:12]}…" if name in sums else "none"
        raise RuntimeFault(
            f"{path}: its SHA-256 is {found[:12]}…, {CHECKSUMS} says {expected}. It was changed or damaged: copy the "
            "bundle again."
        )
    return content


def _manifest(path: Path, sums: Mapping[str, str]) -> Mapping[str, Any]:
    try:
        found = json.loads(_read(path.parent, path.name, sums))
    except (ValueError, RecursionError) as error:
        raise RuntimeFault(f"{path}: no JSON ({error}). Make the bundle again.") from error
    schema = (found.get("schema"), found.get("schema_version")) if isinstance(found, dict) else (None, None)
    if schema != (SCHEMA, VERSION):
        raise RuntimeFault(
            f"{path}: schema {schema}, this runtime reads {(SCHEMA, VERSION)}. Update the older of the two."
        )
    return found


def _reach(robot: Mapping[str, Any], where: str) -> Reach:
    """The manifest's robot is this one; what its joints may be told."""
    if list(robot["joint_names"]) != list(machine.JOINTS):
        raise RuntimeFault(
            f"{where}: joints {robot['joint_names']}, this robot's are {list(machine.JOINTS)}, in that order."
        )
    return reach_of(robot, where)


def _rate(control: Mapping[str, Any], where: str) -> float:
    """Control steps in a second; targets are made as they are made here."""
    rate = float(control["rate_hz"])
    if not 1 <= rate <= 500:
        raise RuntimeFault(f"{where}: control rate {rate:g} Hz, expected 1 to 500.")
    target, clip = control.get("target", TARGET), control.get("action_clip")
    if target != TARGET or clip is not None:
        raise RuntimeFault(
            f"{where}: control says target '{str(target)[:60]}', action_clip {str(clip)[:20]}; this runtime makes "
            f"targets as {TARGET} and clips no action (null). Make the bundle with hts."
        )
    return rate


def _check_entry(entry: Mapping[str, Any], rate: float, reach: Reach, where: str) -> None:
    """Joint order, gains, scale, pose, rate and observation of a policy are such that this robot may run it."""
    if list(entry["joint_names"]) != list(machine.JOINTS):
        raise RuntimeFault(f"{where}: made for joints {entry['joint_names']}, expected {list(machine.JOINTS)}.")
    if float(entry["control_rate_hz"]) != rate:
        raise RuntimeFault(f"{where}: trained at {entry['control_rate_hz']} Hz, the bundle runs at {rate:g} Hz.")
    for key, low, high in (
        ("kp", 0.0, machine.LARGEST_KP),
        ("kd", 0.0, machine.LARGEST_KD),
        ("action_scale", -machine.LARGEST_SCALE, machine.LARGEST_SCALE),
    ):
        values = _numbers(entry, key, where)
        if (joint := machine.first_of((values < low) | (values > high))) is not None:
            raise RuntimeFault(
                f"{where}: {key} {values[joint]:g} of {machine.JOINTS[joint]}, this robot takes {low:g} to {high:g}."
            )
    pose = _numbers(entry, "default_pose", where)
    if (joint := machine.first_of((pose < reach.low) | (pose > reach.high))) is not None:
        raise RuntimeFault(
            f"{where}: default_pose {pose[joint]:g} rad of {machine.JOINTS[joint]}, its range is "
            f"{reach.low[joint]:g} to {reach.high[joint]:g}."
        )
    for part in entry["observation"]:
        if PARTS.get(part["name"]) != part["size"]:
            raise RuntimeFault(
                f"{where}: observes '{part['name']}' ({part['size']} numbers), which this robot does not measure so; "
                f"it measures {', '.join(f'{name} ({size})' for name, size in PARTS.items())}. "
                "Distil or train the policy without it."
            )
    if not 1 <= int(entry["history"]) <= 1000:
        raise RuntimeFault(f"{where}: history {entry['history']}, expected 1 to 1000 observations.")


def _checked_card(policy: Policy) -> Mapping[str, Any]:
    """What the graph carries itself, which agrees with the manifest."""
    try:
        card = json.loads(policy.metadata["hts"])
    except (KeyError, ValueError) as error:
        raise RuntimeFault(f"{policy.where}: carries no card. Make the bundle again.") from error
    for key in ("joint_names", "default_pose", "action_scale", "kp", "kd", "control_rate_hz", "policy_hash"):
        if card.get(key) != policy.entry[key]:
            raise RuntimeFault(
                f"{policy.where}: its own card says {key} {str(card.get(key))[:60]}, the manifest "
                f"{str(policy.entry[key])[:60]}. Make the bundle again."
            )
    # Parts of one size in another order fit the graph: the gyroscope would be taken for gravity.
    both = (card.get("observation") or (), policy.entry["observation"])
    seen, said = ([(one["name"], one["size"]) for one in parts] for parts in both)
    if seen != said or card.get("history", 1) != policy.entry["history"]:
        raise RuntimeFault(
            f"{policy.where}: its own card says that it observes {', '.join(name for name, _ in seen) or 'nothing'} "
            f"(history {card.get('history', 1)}), the manifest {', '.join(name for name, _ in said)} "
            f"(history {policy.entry['history']}). Make the bundle again."
        )
    if bool(policy.entry["exploration"]) != ("hts_exploration" in policy.metadata):
        raise RuntimeFault(
            f"{policy.where}: manifest and graph disagree about exploration noise. Make the bundle again."
        )
    return card  # type: ignore[no-any-return]


def _hold(hold: Mapping[str, Any] | None, where: str) -> Hold | None:
    if hold is None:
        return None
    low, high = (float(one) for one in hold["commands"])
    seconds = float(hold["seconds"])
    if not (-FASTEST <= low < high <= FASTEST and 0 < seconds <= LONGEST_ROW):
        raise RuntimeFault(
            f"{where}: hold commands {low:g} to {high:g} m/s for {seconds:g} s, expected a range within 3."
        )
    return Hold((low, high), seconds)


def _frozen(said: Mapping[str, Any] | None, where: str) -> FrozenSeconds:
    """Bundles of before this key say nothing."""
    if said is None:
        return FrozenSeconds()
    found = {key: float(said[f"{key}_seconds"]) for key in ("seen", "real")}
    for key, seconds in found.items():
        if not 0 <= seconds <= LONGEST_FROZEN:
            raise RuntimeFault(
                f"{where}: frozen.{key}_seconds {seconds:g}, expected 0 (never) to {LONGEST_FROZEN:g}. Make the bundle "
                "again."
            )
    return FrozenSeconds(**found)


def _check_visit(manifest: Mapping[str, Any], where: str) -> None:
    """How a visit begins: numbers that a session reads later."""
    first = manifest["first_runs"]
    for content, key, low, high in (
        (manifest, "warmup_seconds", 0.0, LONGEST_ROW),
        (manifest["control"], "unsteady_seconds", 0.0, 60.0),
        *((first, key, low, high) for key, (low, high) in FIRST_RUNS.items()),
    ):
        value = float(content[key])
        if not low <= value <= high:
            raise RuntimeFault(f"{where}: {key} {value:g}, expected {low:g} to {high:g}.")
    if not isinstance(manifest["channels"], Mapping):
        raise RuntimeFault(f"{where}: channels {str(manifest['channels'])[:60]}, expected names with units.")


def _numbers(values: Mapping[str, Any], key: str, where: str) -> np.ndarray:
    """Twelve finite numbers."""
    found = np.asarray(values[key], float)
    if found.shape != (12,) or not np.isfinite(found).all():
        raise RuntimeFault(f"{where}: {key} {str(values[key])[:60]}, expected 12 numbers.")
    return found
