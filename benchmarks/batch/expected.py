"""What realities fitted from the logs of another one say that a run there will save, against what one there saved.

For each reality: its logs as a lab would have made them, draws that agree with these alone, the method on each draw;
and the method on the reality itself, unless there are lines of that already. Rules of savings are those of groups.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from batch.expected_lines import MEAN, Expected, Speed
from batch.expected_logs import Visit, record
from batch.groups import saving
from batch.lines import Line
from hts import plugins
from hts.errors import RunError
from hts.run.expected import prediction
from hts.worlds.realities.batch import exported_policy
from hts.worlds.realities.like import DISCREPANCY, of_store
from hts.worlds.realities.population import Asked, draw_like, weights_of
from hts.worlds.realities.posterior_like import accepted, generations_in


@dataclass(frozen=True)
class Fitting:
    """How realities are fitted. count: draws to run on; others as of `hts realities draw --like`.

    at_most: tolerances that draws may be away when the budget is spent, before the reality counts as failed.
    """

    robot: str
    count: int = 4
    population: int = 32
    budget: int = 3000
    within: float = 1.0
    at_most: float = 2.0
    discrepancy: float = DISCREPANCY
    seed: str = "expected"
    processes: int = 0


def fitted(
    reality: str,
    name: str,
    folder: Path,
    how: Fitting,
    visit: Visit,
    objectives: Sequence[str],
    tell: Callable[[str], None],
) -> list[Path]:
    """Files of draws that agree with the logs of the reality; logs and draws are made if they are not there.

    Raises RunError where no population within `at_most` tolerances was reached.
    """
    folder.mkdir(parents=True, exist_ok=True)
    policy = folder / "pretrained.onnx"
    if not policy.exists():
        policy = exported_policy(how.robot, folder)
    tell(f"{name}: logs")
    store = record(visit, how.robot, reality, objectives, policy, folder / "logs.zarr")
    like = of_store(store, how.robot, policy, plugins.load(), how.discrepancy)
    asked = Asked(how.count, how.seed, how.robot, f"like-{name}", str(policy), like, how.population)
    draws, within = folder / "draws", how.within

    def drawn(within: float) -> list[Path]:
        return draw_like(
            asked,
            draws,
            within=within,
            budget=how.budget,
            processes=how.processes,
            tell=lambda text: tell(f"{name}: {text}"),
        )

    try:
        files = drawn(within)
    except RunError:
        within = reached(draws)
        if within > how.at_most:
            raise
        files = drawn(within)
    tell(f"{name}: {accepted(draws)}")
    return files


def reached(draws: Path) -> float:
    """Tolerances that the last whole generation is within; infinite where there is none beside the prior."""
    if not (draws / "draws.jsonl").is_file():
        return float("inf")
    whole = generations_in(draws)
    bound = whole[-1].bound if whole else None
    return float("inf") if bound is None else float(bound)


def compared(
    reality: tuple[str, str],
    draws: Path,
    lines: Mapping[str, Line],
    measured: Sequence[Line],
    objective: str,
    about: Mapping[str, Any],
) -> Expected:
    """One reality's line. reality: name and hash; lines: of the runs on draws, by the draw's name; measured: of runs on
    the reality itself. Raises RunError where no run on a draw ended well."""
    weights = weights_of(draws)
    there = {name: line.result for name, line in lines.items() if line.result is not None and name in weights}
    if not there:
        raise RunError(f"{reality[0]}: no run on its draws ended well; `benchmarks/realities.py run` says why.")
    results = [line.result for line in measured if line.result is not None]
    first = next(iter(there.values()))
    speeds: dict[str, Speed] = {}
    share = [weights[name] for name in there]
    for key in [*(str(speed) for speed in first.asked_speeds), MEAN]:
        speed = None if key == MEAN else key
        told = prediction([saving(result, objective, speed) for result in there.values()], share)
        value = None
        if results:
            value = sum(saving(result, objective, speed) for result in results) / len(results)
        bounds = told["interval95"]
        speeds[key] = Speed(
            predicted=told["mean"],
            interval95=bounds and (bounds[0], bounds[1]),
            measured=value,
            error=None if value is None else value - told["mean"],
            inside=None if value is None or bounds is None else bounds[0] <= value <= bounds[1],
        )
    outcomes = [result.objectives[objective] for result in there.values() if objective in result.objectives]
    return Expected(
        reality=reality[0],
        reality_hash=reality[1],
        objective=objective,
        unit=outcomes[0].unit if outcomes else "1",
        within=reached(draws),
        draws=len(there),
        worth=told["worth"],
        failed=sum(line.result is None for line in lines.values()),
        refused=sum(len(one.refused) for one in outcomes),
        measured_runs=len(results),
        measured_commits=tuple(sorted({line.commit for line in measured})),
        speeds=speeds,
        **about,
    )
