"""`hts calibrate-twin`: how the twin's power stands against what is known of real robots.

Anchors, none of which knows anything about fine-tuned policies:

idle share   of gross battery power with the policy to start from: 0.310, 0.248, 0.198 at 0.5, 0.8, 1.1 m/s
             (Table I of arXiv 2502.10956: gross and net reductions give 1 - P_idle/P_gross), within 15 %
standing     53 to 65 W (manual 1.4 "about 1 h" from 133 Wh at most down to 2.5 h; statics give 49-62 (N m)^2)
copper       55 to 80 % of net power (MIT Cheetah: 76 % motor heat, Seok et al. 2013)
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from hts_power.anchors import IDLE_SHARE, STANDING_WATTS

if TYPE_CHECKING:
    from hts.contracts import Robot
    from hts.recordings.recording import Recording
    from hts.testing.twin import TwinSettings
    from hts_power.gauge import BatteryGauge

GRAVITY = 9.81  # m/s^2
IDLE_SHARE_TOLERANCE = 0.15
COPPER_SHARE = (0.55, 0.80)
INSTRUMENT = "battery_gauge"


def calibrate_twin(
    robot: Annotated[str, typer.Option(metavar="NAME", help="The machine.")] = "go1",
    policy: Annotated[
        Path | None, typer.Option(help="Exported policy (.onnx) or .safetensors; default: the robot's own.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=5, help="Measured at each speed, after the warm-up, s.")] = 20.0,
    robots: Annotated[int, typer.Option(min=1, help="Twins at each speed.")] = 1,
    gap: Annotated[bool, typer.Option("--gap", help="Also: how far training simulation and twin are apart.")] = False,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="e.g. world.dynamics.gear_loss=0.04")
    ] = None,
    write: Annotated[Path | None, typer.Option(help="Write parameters, their hash and the table as JSON.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """The twin's standing power, idle and copper share against the anchors; with --gap, against training simulation."""
    from hts import plugins
    from hts.config_loading import load_config
    from hts.policies.deploy import DeployedPolicy
    from hts.testing.twin import TwinSettings, parameters_hash, resolved, resolved_settings

    config = load_config(objectives=["power"], robot=robot, world="twin", overrides=set_ or ())
    registry = plugins.load()
    machine = registry.make_robot(robot, config.robot.settings)
    settings = resolved_settings(TwinSettings.model_validate(config.world.settings), robot)
    instrument = settings.instruments.get(INSTRUMENT, {})

    def make() -> BatteryGauge:
        return cast("BatteryGauge", registry.make_instrument(INSTRUMENT, instrument, machine))

    with tempfile.TemporaryDirectory() as folder:
        path = exported(policy or machine.pretrained_policy(), Path(folder))
        result = measure(machine, settings, make(), path, tuple(IDLE_SHARE), seconds, robots, config.seed)
        if gap:
            from hts_power.gap import compare

            result["gap"] = compare(machine, settings, make, path, seconds, result)
        result["policy_hash"] = DeployedPolicy(path).card.policy_hash
    described = {INSTRUMENT: make().describe()}
    result["parameters_sha256"] = parameters_hash(settings, described)
    if write is not None:
        content = {**result, "parameters": resolved(settings, described)}
        write.write_text(json_text(content) + "\n", encoding="utf-8")
    typer.echo(json_text(result) if as_json else text(result))


def json_text(result: Mapping[str, Any]) -> str:
    """JSON of a result; NumPy's numbers and truth values, which json does not know, become Python's."""
    return json.dumps(result, indent=1, sort_keys=True, default=lambda number: number.item())


def exported(policy: Path | None, folder: Path) -> Path:
    """The policy as ONNX: itself, or exported into the folder. Raises PolicyError if there is none."""
    from hts.errors import PolicyError

    if policy is None or not Path(policy).exists():
        raise PolicyError(
            f"{policy}: there is no policy to calibrate with. Make one: `hts pretrain --robot NAME --out DIR`."
        )
    if Path(policy).suffix == ".onnx":
        return Path(policy)
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    return to_onnx(load_policy(Path(policy)), folder / "policy.onnx")


def measure(
    robot: Robot,
    settings: TwinSettings,
    gauge: BatteryGauge,
    policy: Path,
    speeds: Sequence[float],
    seconds: float,
    robots: int,
    seed: int,
) -> dict[str, Any]:
    """Standing and walking on twins side by side, warmed up to steady state first."""
    from hts.testing.twin import Batch, Block, Session, request_id, seed_sequence, walking, warm_up

    cases = [(None, 0.0)] + [(str(policy), speed) for speed in speeds for _ in range(robots)]
    batch = Batch(robot, settings, {INSTRUMENT: gauge}, len(cases), seed_sequence(seed, request_id("calibrate")))
    try:
        batch.run([Session(id="", blocks=warm_up(p, v, settings.warmup_seconds)) for p, v in cases], "twin")
        before, started = {name: joules.copy() for name, joules in gauge.energy.items()}, gauge.seconds
        rows = batch.run(
            [Session(id="", blocks=(Block(policy=p, schedule=walking(v, seconds)),)) for p, v in cases], "twin"
        )
        gauge.read()
        watts = {name: (gauge.energy[name] - before[name]) / (gauge.seconds - started) for name in gauge.energy}
        mass = batch.mass_kg
    finally:
        batch.close()
    recordings = [row[0] for row in rows]
    standing = power(recordings[0])
    walks = {}
    for index, speed in enumerate(speeds):
        members = range(1 + index * robots, 1 + (index + 1) * robots)
        drawn = {n: w[list(members)].mean() for n, w in watts.items()}
        walks[f"{speed:g}"] = _walk(speed, [recordings[i] for i in members], drawn, mass)
    return {
        "standing_watts": standing,
        "standing_ok": STANDING_WATTS[0] <= standing <= STANDING_WATTS[1],
        "mass_kg": mass,
        "idle_watts": idle_power(recordings[0]),
        "walking": walks,
    }


def _walk(speed: float, recordings: Sequence[Recording], watts: Mapping[str, float], mass_kg: float) -> dict[str, Any]:
    """One speed's row. watts: true mean powers by where they go, seen by the simulator only."""
    from hts.evaluation.segments import cut

    segments = cut(recordings)
    gross = sum(power(recording) for recording in recordings) / len(recordings)
    idle = idle_power(recordings[0])
    mean_speed = sum(forward_speed(recording) for recording in recordings) / len(recordings)
    share, copper = idle / gross, watts["copper"] / (watts["battery"] - watts["idle"])
    anchor = IDLE_SHARE.get(speed)
    return {
        "mean_speed": mean_speed,
        "valid_segments": segments.valid,
        "falls": segments.falls,
        "gross_watts": gross,
        "net_watts": gross - idle,
        "cost_of_transport": (gross - idle) / (mass_kg * GRAVITY * mean_speed),
        "idle_share": share,
        "idle_share_anchor": anchor,
        "idle_share_ok": anchor is None or abs(share / anchor - 1) <= IDLE_SHARE_TOLERANCE,
        "copper_share_of_net": copper,
        "copper_ok": COPPER_SHARE[0] <= copper <= COPPER_SHARE[1],
        "true_watts": {name: float(value) for name, value in watts.items()},
        "torque_rms": rms(recordings, "joint_torque"),
        "velocity_rms": rms(recordings, "joint_velocity"),
    }


def power(recording: Recording, skip_seconds: float = 2.0) -> float:
    """Mean of current times voltage as the gauge shows them, W, without the unsteady start."""
    skip = round(skip_seconds * recording.rate_hz)
    return float(
        (recording.values("battery_current")[skip:].astype(float) * recording.values("battery_voltage")[skip:]).mean()
    )


def idle_power(recording: Recording) -> float:
    return recording.idle["battery_current"] * recording.idle["battery_voltage"]


def forward_speed(recording: Recording, skip_seconds: float = 2.0) -> float:
    return float(recording.values("base_velocity")[round(skip_seconds * recording.rate_hz) :, 0].mean())


def rms(recordings: Sequence[Recording], channel: str) -> float:
    """Root mean square over time, joints and recordings."""
    return float(sum((recording.values(channel) ** 2).mean() for recording in recordings) / len(recordings)) ** 0.5


def text(result: Mapping[str, Any]) -> str:
    """The tables, as GitHub-flavoured markdown."""
    mark = {True: "ok", False: "OUTSIDE"}
    lines = [
        (
            f"standing {result['standing_watts']:.1f} W (53 to 65: {mark[result['standing_ok']]}), "
            f"idle {result['idle_watts']:.1f} W, mass {result['mass_kg']:.2f} kg"
        ),
        "",
        "| told m/s | walks m/s | valid | falls | gross W | net W | net CoT | idle share | anchor | copper of net |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for speed, row in result["walking"].items():
        anchor = f"{row['idle_share_anchor']:.3f} ({mark[row['idle_share_ok']]})" if row["idle_share_anchor"] else "-"
        lines.append(
            f"| {speed} | {row['mean_speed']:.3f} | {row['valid_segments']:.0%} | {row['falls']} "
            f"| {row['gross_watts']:.1f} | {row['net_watts']:.1f} | {row['cost_of_transport']:.2f} "
            f"| {row['idle_share']:.3f} | {anchor} | {row['copper_share_of_net']:.0%} ({mark[row['copper_ok']]}) |"
        )
    if "gap" in result:
        from hts_power.gap import table

        lines += ["", *table(result["gap"])]
    return "\n".join([*lines, "", f"parameters sha256 {result['parameters_sha256']}"])
