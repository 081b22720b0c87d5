"""`hts realities`: plausible twins: drawn, looked at, held against public facts."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hts.cli import options

if TYPE_CHECKING:
    from hts.worlds.realities.like import Likeness
    from hts.worlds.twin.reality import Measured

app = options.group("Plausible twins: draw, show, check, list, ranges, posterior, expect.")

Which = Annotated[str, typer.Argument(metavar="FILE|NAME", help="A reality's file, or its name (see list).")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for programs.")]


@app.command()
def draw(
    count: Annotated[int, typer.Option(min=1, help="Realities to keep.")],
    seed: Annotated[str, typer.Option(help="Any text; the same text gives the same realities.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for them; one that was begun is gone on with.")],
    robot: Annotated[str, typer.Option(metavar="NAME", help="The machine.")] = "",
    name: Annotated[str, typer.Option(help="They are called NAME-00 and so on.")] = "reality",
    processes: Annotated[int, typer.Option(min=0, help="Side by side; 0: one per core.")] = 0,
    like: Annotated[
        Path | None,
        typer.Option(metavar="STORE|RUN", help="Agree with these recordings instead of public facts, by a sampler."),
    ] = None,
    policy_file: Annotated[
        Path | None, typer.Option("--policy", metavar="FILE", help="With --like: the policy that walked (safetensors).")
    ] = None,
    population: Annotated[int, typer.Option(min=4, help="With --like: draws that are moved until they agree.")] = 32,
    budget: Annotated[int, typer.Option(min=1, help="With --like: simulations at most, over all calls.")] = 4000,
    within: Annotated[float, typer.Option(min=0.1, help="With --like: tolerances that draws may be away.")] = 1.0,
    discrepancy: Annotated[
        float, typer.Option(min=0.001, max=1, help="With --like: share of a figure that no twin is trusted to.")
    ] = 0.05,
) -> None:
    """Draw twins over the published ranges until so many agree with public facts, or with a lab's own recordings."""
    from hts.worlds.realities import batch, posterior_like
    from hts.worlds.realities import population as like_ours
    from hts.worlds.realities.folder import check_name
    from hts.worlds.realities.posterior import accepted

    check_name(name, out)
    robot = robot or _only_robot()
    if policy_file is not None and like is None:
        raise typer.BadParameter("says who walked in the recordings of --like; there are none.", param_hint="--policy")

    def tell(line: Mapping[str, Any], kept: str) -> None:
        typer.echo(f"draw {line['index']}: {'kept as ' + kept if kept else line['why']}", err=True)

    with tempfile.TemporaryDirectory() as folder:
        policy = batch.exported_policy(robot, Path(folder), policy_file)
        if like is None:
            first = partial(batch.check_walks, robot, policy)
            files = batch.draw_many(batch.Asked(count, seed, robot, name, str(policy)), out, processes, tell, first)
        else:
            own = _likeness(like, robot, policy, discrepancy)
            asked = like_ours.Asked(count, seed, robot, name, str(policy), own, population)
            files = like_ours.draw_like(
                asked,
                out,
                within=within,
                budget=budget,
                processes=processes,
                tell=lambda text: typer.echo(text, err=True),
            )
    for path in files:
        typer.echo(str(path))
    typer.echo(accepted(out) if like is None else posterior_like.accepted(out), err=True)
    typer.echo(f"Drawn with {_taking_part()}.", err=True)


def _taking_part() -> str:
    """The instruments whose parameters are drawn, and the packages they are of."""
    from hts.plugins import load
    from hts.worlds.realities.ranges import drawn_parameters, instruments_in

    registry = load()
    names = instruments_in(drawn_parameters(registry))
    return ", ".join(f"{name} (from {registry.instruments[name].package})" for name in names) or "no instrument"


@app.command()
def show(reality: Which, as_json: AsJson = False) -> None:
    """Show what a reality is: its structures, and where it differs from the default twin."""
    from hts.worlds.realities.batch import read_to_show
    from hts.worlds.twin.parameters import TwinSettings
    from hts.worlds.twin.reality import locate, sha256

    found, unchecked = read_to_show(reality)
    if unchecked:
        typer.echo(unchecked, err=True)
    if as_json:
        typer.echo(json.dumps({**found.model_dump(mode="json"), "sha256": sha256(locate(reality))}, indent=1))
        return
    typer.echo(f"{found.name}: a {found.robot}, draw {found.index} of seed '{found.seed}'")
    typer.echo(f"sha256: {sha256(locate(reality))}")
    typer.echo(f"structures: {', '.join(found.switches) or 'none'}")
    for fact in found.facts:
        typer.echo(f"{_measured(fact)} ({fact.low:.4g} to {fact.high:.4g})")
    default = dict(_flat(TwinSettings().model_dump(mode="json"), ""))
    for key, value in _flat(found.parameters, ""):
        if value != default.get(key):
            typer.echo(f"  {key}: {value}" + (f" (default twin: {default[key]})" if key in default else ""))


def _measured(fact: Measured) -> str:
    """What a reality showed, with its unit; a share has none."""
    return f"{fact.name}: {fact.value:.4g}" + ("" if fact.unit == "1" else f" {fact.unit}")


@app.command()
def check(reality: Which, as_json: AsJson = False) -> None:
    """Hold a reality against public facts. Exit code 1 if it does not agree."""
    from hts.worlds.realities.batch import read_whole, verdict_on

    verdict = verdict_on(read_whole(reality))
    if as_json:
        facts = [one.model_dump(mode="json") for one in verdict.measured]
        typer.echo(json.dumps({"agrees": verdict.kept, "why": verdict.why, "facts": facts}, indent=1))
    else:
        for fact in verdict.measured:
            mark = "ok" if fact.low <= fact.value <= fact.high else "OUTSIDE"
            typer.echo(f"{_measured(fact)} ({fact.low:.4g} to {fact.high:.4g}: {mark})")
        typer.echo("agrees" if verdict.kept else f"does not agree: {verdict.why}")
    if not verdict.kept:
        raise typer.Exit(1)


@app.command()
def truth(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="Its file: .onnx or .safetensors.")],
    reality: Annotated[str, typer.Option(metavar="NAME|FILE", help="Where; `default` is the default twin.")],
    objective: Annotated[str, typer.Option(metavar="NAME", help="What is measured.")],
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Against this one; default: the one that the robot ships.")
    ] = None,
    speed: Annotated[list[float] | None, typer.Option(help="m/s; repeat for several. Default: 0.5, 0.8, 1.1.")] = None,
    sessions: Annotated[int, typer.Option(min=2, help="How many, of the machine's kind of day each.")] = 50,
    block: Annotated[float, typer.Option(min=5, help="Length of each of four blocks, s.")] = 20.0,
    trim: Annotated[float, typer.Option(min=4, help="Trimming by the true speed, s.")] = 20.0,
    warmup: Annotated[float, typer.Option(min=1, help="Before the first block, s.")] = 20.0,
    robot: Annotated[str, typer.Option(metavar="NAME", help="The machine.")] = "",
    processes: Annotated[int, typer.Option(min=0, help="Side by side; 0: one per core.")] = 0,
) -> None:
    """What a policy truly saves there: no noise, true speed, many sessions. As JSON."""
    from hts.config import EvaluationConfig
    from hts.cores import available
    from hts.evaluation.evaluate import policy_file
    from hts.worlds.realities.batch import exported_policy
    from hts.worlds.realities.truth import Truth
    from hts.worlds.realities.truth import truth as found

    robot = robot or _only_robot()

    def tell(done: int, groups: int) -> None:
        typer.echo(f"{done} of {groups} groups of sessions", err=True)

    with tempfile.TemporaryDirectory() as folder:
        against = policy_file(Path(folder), reference) if reference else exported_policy(robot, Path(folder))
        asked = Truth(
            robot,
            objective,
            {},
            str(policy_file(Path(folder), policy)),
            str(against),
            reality,
            tuple(speed or EvaluationConfig().speeds),
            sessions,
            warmup,
            trim,
            block,
        )
        typer.echo(json.dumps(found(asked, processes or available(), tell), indent=1))


@app.command()
def posterior(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that draw wrote.")],
    most: Annotated[int, typer.Option(min=1, help="Parameters to show.")] = 12,
) -> None:
    """Print what was kept against what was drawn: acceptance, reasons, and the parameters that moved."""
    from hts import plugins
    from hts.worlds.realities import posterior_like
    from hts.worlds.realities.folder import draws_of
    from hts.worlds.realities.posterior import text
    from hts.worlds.realities.ranges import drawn_parameters, switches

    parameters = drawn_parameters(plugins.load())
    if posterior_like.is_population(folder):
        typer.echo(posterior_like.text(parameters, folder, most))
        return
    typer.echo(text(parameters, switches(parameters), draws_of(folder).lines, most))


@app.command()
def expect(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Realities that draw kept.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the runs; one that was begun is gone on with.")],
    objective: options.Objectives = None,
    preset: options.Preset = None,
    runs: Annotated[int, typer.Option(min=2, help="On so many of the realities, the first ones.")] = 4,
    set_: options.Overrides = None,
    engine: options.Engine = None,
    seed: options.Seed = None,
    measured: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Compare with this finished run on the robot itself.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what a run will save, with an interval, from whole runs on realities like the robot."""
    from hts import plugins
    from hts.config_loading import check_names, load_config
    from hts.errors import RunError
    from hts.run.expected import compared, expect, shown, shown_compared
    from hts.run.stage_files import read_stage
    from hts.worlds.realities.batch import read_whole
    from hts.worlds.realities.population import weights_of

    files = sorted(folder.glob("*.json"))[:runs]
    if len(files) < runs:
        raise RunError(
            f"{folder}: holds {len(files)} realities, {runs} are asked for. Draw more, `hts realities draw --count "
            f"{runs} --out {folder} …`, or ask for fewer: --runs."
        )
    finished = None if measured is None else read_stage(measured / "summary.json")
    registry, configs = plugins.load(), {}
    for path in files:
        configs[path.stem] = load_config(
            preset=preset,
            objectives=objective or (),
            robot=read_whole(str(path)).robot,
            world="twin",
            engine=engine,
            seed=seed,
            overrides=[*(set_ or ()), f"world.reality={path.resolve()}"],
            registry=registry,
            option_names=options.NAMES,
        )
        check_names(configs[path.stem], registry)
    weights = weights_of(folder)
    unknown = sorted(set(configs) - set(weights)) if weights else []
    if unknown:
        raise RunError(
            f"{folder}: kept.jsonl does not name {', '.join(unknown)}. Take files away that are not its own."
        )
    result = expect(configs, out, lambda line: typer.echo(line, err=True), weights=weights)
    rows = compared(result, finished) if finished is not None else []
    if as_json:
        typer.echo(json.dumps({**result, **({"compared": rows} if rows else {})}, indent=1))
        return
    typer.echo("\n".join([*shown(result), *shown_compared(rows)]))


@app.command("list")
def list_() -> None:
    """List the realities that come with installed robots."""
    from hts.worlds.twin.reality import known_names, sha256

    for name, path in known_names().items():
        typer.echo(f"{name}  {sha256(path)}")


@app.command()
def ranges() -> None:
    """Print all that is drawn, and over what, as a table in markdown."""
    from hts import plugins
    from hts.worlds.realities.ranges import drawn_parameters, table

    typer.echo(table(drawn_parameters(plugins.load())))


def _likeness(store: Path, robot: str, policy: Path, discrepancy: float) -> Likeness:
    """What the recordings of a store, or of a run, say of the robot; prints it."""
    from hts import plugins
    from hts.worlds.realities.like import of_store, table

    found = of_store(store, robot, policy, plugins.load(), discrepancy)
    how = "recorded warm, at one speed each" if found.schedule is None else "recorded from cold, schedule and all"
    text = table(found.figures)
    typer.echo(f"{len(found.figures)} figures of {store} ({how}), instead of the public ones:\n\n{text}\n", err=True)
    typer.echo(
        f"From and to: by how far all stretches of a figure lie apart, within a session and from one to the next taken "
        f"together, and {discrepancy:.0%} of the mean on top. They are not the error of a sensor, and stretches of one "
        "session do not say how far another day lies from them.\n",
        err=True,
    )
    return found


def _only_robot() -> str:
    """The robot that is installed, if there is one with a policy; else --robot is needed."""
    from hts import plugins
    from hts.errors import ConfigError, HtsError

    registry, found = plugins.load(), []
    for name in registry.robots:
        try:
            if registry.make_robot(name).pretrained_policy() is not None:
                found.append(name)
        except HtsError:  # one that needs settings
            continue
    if len(found) != 1:
        raise ConfigError(f"--robot: say which machine: {', '.join(found) or 'none that is installed ships a policy'}.")
    return found[0]


def _flat(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
