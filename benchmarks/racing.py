"""Selector `racing` against `hierarchical`: the same best policy, for how much less of the robot's time?

    python benchmarks/racing.py --seeds 0 1 2 --out DIR           whole runs with both selectors, then the table
    python benchmarks/racing.py --collect DIR                     the table of the runs that lie in DIR
    python benchmarks/racing.py --replay RUN RUN                  races among the elites of finished runs
    python benchmarks/racing.py --tables --trials 1500            error rate among equals, in tables of random numbers
    python benchmarks/racing.py --monte-carlo --trials 100        worlds with known answers, as recordings
    python benchmarks/racing.py --own LINES                       what sessions of a coverage batch have of their own

Prints JSON. Runs go to DIR/SELECTOR-SEED; a finished one is not repeated, a stopped one goes on, so seeds may run side
by side and on several machines. Arguments after `--` go to `hts run` of both selectors.

`improvement` is the objective's primary score in the final head-to-head at the speed of the selection,
`selection_score` what selectors choose by, from the same head-to-head (for some objectives not the same: a selector may
then rightly take the one with the smaller improvement).

Real seconds are seconds that are recorded in the world, of policy and reference. `selection` is what the tests of the
elites take, which is what a selector decides about; `collection` (before the first fit) and `final` (every speed of the
evaluation) are the same for both. `warm_up` is walking before a session that is not recorded: one session for each
whole head-to-head, one for each round; `selection_with_warm_up` adds it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import mean
from typing import Any

from racing_errors import tables

SELECTORS = ("hierarchical", "racing")
POINT = 0.01  # one percentage point of the improvement
SHARE = 0.6  # of the real seconds of selection

Json = dict[str, Any]


# --------------------------------------------------------------------------------------------------- whole runs


def whole_runs(out: Path, seeds: Sequence[int], objective: str, robot: str, arguments: Sequence[str]) -> None:
    """Both selectors for each seed, one after the other. Raises CalledProcessError if a run fails."""
    for seed in seeds:
        for selector in SELECTORS:
            folder = out / f"{selector}-{seed}"
            if (folder / "summary.json").exists():
                continue
            if (folder / "config.yaml").exists():
                command = ["resume", str(folder)]
            else:
                command = ["run", "--objective", objective, "--robot", robot, "--preset", "quick", "--seed", str(seed)]
                command += ["--set", f"selection.selector.name={selector}", *arguments, "--out", str(folder)]
            print("hts", *command, file=sys.stderr, flush=True)
            subprocess.run([sys.executable, "-m", "hts.cli.main", *command], check=True, stdout=sys.stderr)


def read(folder: Path) -> Json:
    """What a finished run came to and what it took."""
    from hts.config_loading import read_config
    from hts.plugins import load
    from hts.worlds.twin.parameters import TwinSettings

    summary, config = _json(folder / "summary.json"), read_config(folder / "config.yaml")
    rate = load().make_robot(config.robot.name, config.robot.settings).spec.control_rate_hz
    tests = [_json(folder / f"iterations/{index:02d}/test.json") for index in range(config.iterations)]
    sessions = [len(test["rounds"]) if "rounds" in test else len(test["elites"]) for test in tests]
    warm_up = TwinSettings.model_validate(config.world.settings).warmup_seconds if config.world.name == "twin" else 0.0
    selection = sum(test["samples"] for test in tests) / rate
    speed, (objective, *_) = str(float(config.selection.speed)), summary["objectives"]
    found = summary["final"]["objectives"].get(objective, {}).get("speeds", {}).get(speed)
    score = 0.0
    if found:
        segments = _json(folder / "segments.json")[objective][speed]
        means = [{name: mean(values) for name, values in segments[role].items()} for role in ("policy", "reference")]
        score = load().make_objective(objective, config.objectives[objective]).compare(*means).selection_score
    return {
        "selector": config.selection.selector.name,
        "seed": config.seed,
        "folder": str(folder),
        "best": summary["final"]["policy"],
        "speed": float(speed),
        "improvement": found["improvement"] if found else 0.0,  # the pretrained policy stayed the best
        "selection_score": score,
        "improvement_ci95": found["improvement_ci95"] if found else None,
        "metrics": found["metrics"] if found else {},
        "falls": found["falls"] if found else 0,
        "chosen": [test["best"] for test in tests],
        "measured": [
            {name: row.get("tested", {}).get("selection_score") for name, row in test["results"].items()}
            for test in tests
        ],
        "rounds": [len(test.get("rounds", ())) for test in tests],
        "seconds": {
            "collection": _json(folder / "collect.json")["samples"] / rate,
            "selection": selection,
            "warm_up": warm_up * sum(sessions),
            "selection_with_warm_up": selection + warm_up * sum(sessions),
            "final": _json(folder / "final.json")["samples"] / rate,
            "all": summary["real_samples"] / rate,
        },
        "wall_seconds": summary["wall_seconds"],
    }


def collect(out: Path) -> Json:
    """The table of the runs in `out`, seed by seed, and how often what was to be shown is so."""
    runs: dict[int, dict[str, Json]] = {}
    for path in sorted(out.glob("*/summary.json")):
        run = read(path.parent)
        runs.setdefault(run["seed"], {})[run["selector"]] = run
    pairs = {seed: found for seed, found in sorted(runs.items()) if set(SELECTORS) <= set(found)}
    rows = [_pair(seed, *(found[selector] for selector in SELECTORS)) for seed, found in pairs.items()]
    total = {
        what: {selector: sum(found[selector]["seconds"][what] for found in pairs.values()) for selector in SELECTORS}
        for what in ("selection", "selection_with_warm_up", "all")
    }
    return {
        "seeds": len(rows),
        "not_worse_than_a_point": sum(row["not_worse_than_a_point"] for row in rows),
        "within_a_point": sum(row["within_a_point"] for row in rows),
        "score_not_worse_than_a_point": sum(row["score_difference"] >= -POINT for row in rows),
        "mean_difference": sum(row["difference"] for row in rows) / len(rows) if rows else None,
        "seconds": total,
        "seconds_ratio": {
            what: found["racing"] / found["hierarchical"] if rows else None for what, found in total.items()
        },
        "largest_selection_ratio": max((row["selection_ratio"] for row in rows), default=None),
        "shown": bool(rows)
        and sum(row["not_worse_than_a_point"] and row["selection_ratio"] <= SHARE for row in rows) >= 0.8 * len(rows),
        "rows": rows,
        "unpaired": sorted(
            run["folder"] for seed, found in runs.items() if seed not in pairs for run in found.values()
        ),
    }


def _pair(seed: int, hierarchical: Json, racing: Json) -> Json:
    """One seed. regret: selection score lost in the first iteration, with the same candidates, by its whole tests."""
    difference = racing["improvement"] - hierarchical["improvement"]
    seconds = (racing["seconds"]["selection"], hierarchical["seconds"]["selection"])
    return {
        "seed": seed,
        "difference": difference,
        "score_difference": racing["selection_score"] - hierarchical["selection_score"],
        "within_a_point": abs(difference) <= POINT,
        "not_worse_than_a_point": difference >= -POINT,
        "selection_ratio": seconds[0] / seconds[1],
        "first_choice_regret": _regret(hierarchical["measured"][0], racing["chosen"][0]),
        "hierarchical": hierarchical,
        "racing": racing,
    }


def _regret(measured: Json, chosen: str | None) -> float | None:
    scores = {name: next(iter(score.values())) for name, score in measured.items() if score}
    if not scores or chosen not in scores:
        return None
    return max(scores.values()) - scores[chosen]


# ------------------------------------------------------------------------------------------------------ replays


def replay(folder: Path, settings: Json) -> list[Json]:
    """Race the elites of a finished run on a twin of its own; the run stays as it is."""
    import shutil

    from hts.config_loading import read_config
    from hts.plugins import load
    from hts.run.job import Job
    from hts.run.progress import Progress
    from hts.run.stages import Stages
    from hts.run.testing_elites import in_rounds

    rows = []
    with tempfile.TemporaryDirectory(prefix="hts-racing-") as place:
        copy = Path(shutil.copytree(folder, Path(place) / "run", ignore=shutil.ignore_patterns("data.zarr", "world")))
        config, stages = read_config(copy / "config.yaml"), Stages(copy, Progress(1))
        job = Job(config, copy, load(), stages)
        selector = job.registry.make_selector("racing", settings)
        for index in range(config.iterations):
            test, rounds = job.read("test", index), selector.rounds()
            assert rounds is not None
            raced = in_rounds(job, test["elites"], selector, rounds, lambda share: None)
            assert raced is not None
            best = selector.best(raced.for_best(selector))
            measured = {name: row.get("tested", {}).get("selection_score") for name, row in test["results"].items()}
            seconds = sum(recording.seconds for recording in raced.recorded)
            whole = test["samples"] / job.robot.spec.control_rate_hz
            rows.append(
                {
                    "run": str(folder),
                    "iteration": index,
                    "measured": measured,
                    "best": test["best"],
                    "raced_best": best,
                    "regret": _regret(measured, best),
                    "seconds": seconds,
                    "ratio": seconds / whole,
                    "rounds": raced.races,
                }
            )
        job.close()
        stages.close()
    return rows


# -------------------------------------------------------------------------------------------------- Monte Carlo

WORLDS: dict[str, Json] = {
    "three equal": {"savings": [0.10] * 3},
    "three equal, neighbours 0.8 alike": {"savings": [0.10] * 3, "correlation": 0.8},
    "three equal, blocks differ by 0.3 %": {"savings": [0.10] * 3, "block_scatter": 0.003},
    "three equal, drift of 2 %": {"savings": [0.10] * 3, "drift": 0.02},
    "three equal, no better than the reference": {"savings": [0.0] * 3},
    "six equal": {"savings": [0.10] * 6},
    "best by 0.3 points": {"savings": [0.103, 0.10, 0.10]},
    "best by 1 point": {"savings": [0.11, 0.10, 0.08]},
    "six, best by 1 point": {"savings": [0.12, 0.11, 0.10, 0.09, 0.08, 0.07]},
    "six, best by 0.3 points": {"savings": [0.123, 0.12, 0.11, 0.10, 0.09, 0.08]},
}
"""Known worlds; candidate 0 is the best or one of the best."""


def monte_carlo(trials: int, whole_seconds: float = 320.0) -> Json:
    """How often the best one is dropped, what the choice loses, and what share of whole tests' seconds the race takes.

    Without indifference every early end is a claim that the others are worse: `best_dropped` counts wrong ones. With
    the default one, `lost_more_than_indifferent` counts choices that are worse than the best by more than that.
    """
    from hts.selection.racing import RacingSettings
    from hts.testing.known_race import KnownRounds

    strict, default = RacingSettings(indifference=0.0), RacingSettings()
    result: Json = {"trials": trials, "error": default.error}
    for name, about in WORLDS.items():
        world = KnownRounds(**about)
        races = [_race(world, strict, seed) for seed in range(trials)]
        claims = {
            "best_dropped": sum(row["best_dropped"] for row in races) / trials,
            **_averages(races, world, whole_seconds),
        }
        races = [_race(world, default, seed) for seed in range(trials)]
        lost = sum(row["loss"] > default.indifference * max(world.savings) for row in races) / trials
        usual = {"lost_more_than_indifferent": lost, **_averages(races, world, whole_seconds)}
        result[name] = {"no indifference": claims, "default": usual}
        print(name, json.dumps(result[name]), file=sys.stderr, flush=True)
    return result


def _race(world: Any, settings: Any, seed: int) -> Json:
    """One race; candidate 0 is the best. It is dropped if others went on or were chosen without it."""
    from hts.selection.racing import Racing
    from hts.testing.known_race import run_race

    raced = run_race(world, settings, seed)
    selector = Racing(settings)
    best = selector.best(raced.for_best(selector))
    first, last = world.names[0], raced.races[-1]
    left_out = any(first in one["racing"] and one["going_on"] and first not in one["going_on"] for one in raced.races)
    early = len(raced.races) < settings.rounds and first in last["racing"] and best not in (first, None)
    return {
        "best_dropped": left_out or early,
        "loss": max(world.savings) - (world.savings[world.names.index(best)] if best else 0.0),
        "seconds": sum(recording.seconds for recording in raced.recorded),
    }


def _averages(races: Sequence[Json], world: Any, whole_seconds: float) -> Json:
    seconds, losses = sum(row["seconds"] for row in races) / len(races), [row["loss"] for row in races]
    share = seconds / (whole_seconds * len(world.savings))
    return {
        "mean_loss": sum(losses) / len(races),
        "largest_loss": max(losses),
        "seconds": seconds,
        "share_of_whole": share,
    }


def _json(path: Path) -> Json:
    return json.loads(path.read_text(encoding="utf-8"))


def main() -> int:
    """0, or 1 if `--seeds` or `--collect` do not show what was to be shown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--seeds", type=int, nargs="+", help="run these seeds with both selectors")
    what.add_argument("--collect", type=Path, metavar="DIR", help="only the table of the runs in DIR")
    what.add_argument("--replay", type=Path, nargs="+", metavar="RUN", help="race the elites of finished runs")
    what.add_argument("--tables", action="store_true", help="error rate among equals, in tables of random numbers")
    what.add_argument("--monte-carlo", action="store_true", help="worlds with known answers")
    what.add_argument("--own", type=Path, nargs="+", metavar="LINES", help="sessions' own scatter, of coverage lines")
    parser.add_argument("--out", type=Path, default=Path("runs/racing"), help="where runs go (default: runs/racing)")
    parser.add_argument("--objective", default="power")
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--trials", type=int, default=100, help="of --tables and --monte-carlo, each")
    parser.add_argument("--settings", type=json.loads, default={}, help="of `racing`, as JSON, for --replay")
    parser.add_argument("arguments", nargs="*", help="of `hts run`, after --")
    given = parser.parse_args()
    if given.tables:
        print(json.dumps(tables(given.trials), indent=1))
        return 0
    if given.monte_carlo:
        print(json.dumps(monte_carlo(given.trials), indent=1))
        return 0
    if given.own:
        from batch.coverage_lines import read_coverage
        from batch.coverage_sessions import own_of_sessions

        found = own_of_sessions(read_coverage(given.own))
        if found is None:
            parser.error("--own: no pair of a policy and a reality has enough sessions in these lines.")
        print(json.dumps(asdict(found), indent=1))
        return 0
    if given.replay:
        print(json.dumps([row for folder in given.replay for row in replay(folder, given.settings)], indent=1))
        return 0
    if given.seeds:
        whole_runs(given.out, given.seeds, given.objective, given.robot, given.arguments)
    table = collect(given.collect or given.out)
    print(json.dumps(table, indent=1))
    return 0 if table["shown"] else 1


if __name__ == "__main__":
    sys.exit(main())
