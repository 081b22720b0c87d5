"""Draws like a lab's own robot: the sampler at work on twins, side by side, resumable, until the population agrees.

    DIR/draws.jsonl     first line: what was asked; then one line a particle, generation by generation
    DIR/NAME-00.json    realities of the last generation, at most as many as asked for
    DIR/kept.jsonl      one line each: its weight, and how far it is from the recordings, in tolerances

All follows from seed, size and figures: each particle of each generation has random numbers of its own, so neither
processes nor interruptions change a digit.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from hts import plugins
from hts.atomic import atomic_write
from hts.contracts import Instrument
from hts.cores import available
from hts.errors import RunError
from hts.worlds.realities import batch, sampler
from hts.worlds.realities.check import Tried
from hts.worlds.realities.draw import rng_of
from hts.worlds.realities.folder import LINES, begun, damaged, only_one, rows_of
from hts.worlds.realities.like import Likeness
from hts.worlds.realities.misfit import free_distance, measured_of, misfit
from hts.worlds.realities.ranges import drawn_parameters, instruments_in, ranges_sha256
from hts.worlds.realities.sampler import Found, Particle
from hts.worlds.realities.space import Space
from hts.worlds.realities.workers import worker_processes
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.reality import Reality

KEPT = "kept.jsonl"
FORMAT = 2  # of draws.jsonl, where 1 is that of draws held against public facts


@dataclass(frozen=True)
class Asked(batch.Asked):
    """What to draw: at most `count` realities like these recordings, from a population of `size` draws.

    steps: Metropolis steps of each draw in each generation.
    """

    like: Likeness
    size: int = 32
    steps: int = 3


@dataclass(frozen=True)
class Task:
    """What becomes of one place of one generation. begin: None in the first."""

    generation: int
    place: int
    begin: Particle | None
    bound: float | None
    step: float


@dataclass(frozen=True)
class Generation:
    """A whole one. bound: largest distance; None: the prior, which has none. step: of the moves that led to it."""

    number: int
    bound: float | None
    step: float
    population: tuple[Particle, ...]


Told = Callable[[str], None]


class Machines:
    """Points of the space as twins of a robot, held against its recordings."""

    def __init__(self, asked: Asked) -> None:
        self.asked, self.registry = asked, plugins.load()
        self.robot = self.registry.make_robot(asked.robot)
        self.space = Space(drawn_parameters(self.registry))
        self._read = {one.instrument for one in asked.like.figures}

    def free(self, point: np.ndarray) -> float:
        """By its idle levels."""
        given = self.space.draw(point).nested().get("instruments", {})
        made = self._made({name: given.get(name, {}) for name in self.registry.instruments if name in self._read})
        return free_distance(self.asked.like.figures, made)

    def simulate(self, point: np.ndarray, bound: float) -> Found:
        """By everything."""
        settings = TwinSettings.model_validate(self.space.draw(point).nested())
        twin = Tried(self.robot, settings, self._made(settings.instruments))
        return misfit(twin, self.asked.policy, self.asked.like, bound)

    def _made(self, given: Mapping[str, Mapping[str, Any]]) -> dict[str, Instrument]:
        return {name: self.registry.make_instrument(name, one, self.robot) for name, one in given.items()}


_machines = cache(Machines)  # of this process, by its work: made once


def one_task(asked: Asked, task: Task, within: float) -> Particle:
    """Do it, on twins; in a process that goes on to do others."""
    return done(asked, task, within, _machines(asked))


def done(asked: Asked, task: Task, within: float, on: Machines) -> Particle:
    """What becomes of the place."""
    rng = rng_of(asked.seed, "population", f"place {task.place} of {task.generation}")
    if task.begin is None or task.bound is None:
        return sampler.first(on.space, on.free, within, on.simulate, rng)
    return sampler.walk(on.space, task.begin, task.bound, within, task.step, asked.steps, on.free, on.simulate, rng)


def side_by_side(asked: Asked, tasks: Sequence[Task], processes: int, within: float = 1.0) -> Iterator[Particle]:
    """Particles of the tasks, in their order."""
    number = min(processes or available(), len(tasks))
    with worker_processes(number) as pool:
        yield from pool.map(partial(one_task, asked, within=within), tasks)


def draw_like(
    asked: Asked,
    folder: Path,
    *,
    within: float = 1.0,
    budget: int | None = None,
    processes: int = 0,
    tell: Told = lambda text: None,
    work: Callable[..., Iterator[Particle]] = side_by_side,
) -> list[Path]:
    """Files of realities that agree with the recordings to `within` tolerances. Goes on with what the folder holds.

    budget: simulations at most, over all calls; None: no bound. Raises RunError where it was not enough; called again
    with a larger one, or a larger `within`, it goes on.
    """
    parameters = drawn_parameters(plugins.load())
    heading = {
        "format": FORMAT,
        "seed": asked.seed,
        "robot": asked.robot,
        "name": asked.name,
        "size": asked.size,
        "steps": asked.steps,
        "ranges_sha256": ranges_sha256(parameters),
        "like": asked.like.model_dump(mode="json"),
    }
    with only_one(folder):
        lines = begun(folder, heading, instruments_in(parameters))
        generations = generations_of(lines, asked.size)
        rest = lines[len(generations) * asked.size :]
        while not generations or not _agrees(generations[-1], within):
            spent = sum(line["simulated"] for line in lines)
            if budget is not None and spent >= budget:
                raise RunError(_not_enough(folder, budget, generations))
            tasks = _next(asked, generations, within, rest)
            for particle in work(asked, tasks[len(rest) :], processes, within):
                task = tasks[len(rest)]
                line = {"generation": task.generation, "place": task.place, "bound": task.bound, "step": task.step}
                line |= particle.plain()
                with (folder / LINES).open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
                lines.append(line)
                rest.append(line)
                spent += particle.simulated
                tell(_said(line, len(rest), asked.size, spent, budget))
                if budget is not None and spent >= budget and len(rest) < asked.size:
                    raise RunError(_not_enough(folder, budget, generations))
            generations, rest = generations_of(lines, asked.size), []
            tell(_summed_up(generations[-1]))
        return _written(asked, folder, generations[-1])


def generations_of(lines: Sequence[Mapping[str, Any]], size: int) -> list[Generation]:
    """Those that are whole."""
    found = []
    for begin in range(0, len(lines) - size + 1, size):
        rows = lines[begin : begin + size]
        particles = tuple(Particle.of(row) for row in rows)
        found.append(Generation(rows[0]["generation"], rows[0]["bound"], rows[0]["step"], particles))
    return found


def _agrees(last: Generation, within: float) -> bool:
    return last.bound is not None and last.bound <= within


def _next(
    asked: Asked, generations: Sequence[Generation], within: float, rest: Sequence[Mapping[str, Any]]
) -> list[Task]:
    """Tasks of the generation after these. rest: lines of it that there are already, whose bound stays."""
    if not generations:
        return [Task(0, place, None, None, sampler.FIRST_STEP) for place in range(asked.size)]
    last = generations[-1]
    distances = [one.found.distance for one in last.population]
    bound = rest[0]["bound"] if rest else sampler.next_bound(distances, within)
    step = sampler.next_step(last.step, last.population) if last.bound is not None else last.step
    begins = sampler.ancestors(distances, bound, rng_of(asked.seed, "population", f"ancestors of {last.number + 1}"))
    return [Task(last.number + 1, place, last.population[at], bound, step) for place, at in enumerate(begins)]


def _written(asked: Asked, folder: Path, last: Generation) -> list[Path]:
    """The realities' files, and then kept.jsonl, which says that they are all there."""
    registry = plugins.load()
    space = Space(drawn_parameters(registry))
    weights = sampler.chosen(sampler.copies(last.population), asked.count, rng_of(asked.seed, "population", "chosen"))
    files, rows = [], []
    for number, (place, weight) in enumerate(sorted(weights.items())):
        one = last.population[place]
        drawn, name = space.draw(one.point), f"{asked.name}-{number:02d}"
        reality = Reality(
            name=name,
            robot=asked.robot,
            seed=asked.seed,
            index=place,
            switches=drawn.switches,
            parameters=batch.parameters_of(drawn, registry),
            facts=measured_of(asked.like.figures, one.found),
        )
        files.append(folder / f"{name}.json")
        atomic_write(files[-1], json.dumps(reality.model_dump(mode="json"), indent=1) + "\n")
        rows.append({"reality": name, "weight": round(weight, 9), "distance": round(one.found.distance, 4)})
    atomic_write(folder / KEPT, "".join(json.dumps(row) + "\n" for row in rows))
    return files


def kept_of(folder: Path) -> list[dict[str, Any]]:
    """Realities with their weights and distances; none for a folder of draws that all weigh the same. Raises RunError
    for a damaged file."""
    path = folder / KEPT
    rows = rows_of(path) if path.is_file() else []
    for number, row in enumerate(rows, 1):
        numbers = [row.get(key) for key in ("weight", "distance")]
        if not isinstance(row.get("reality"), str) or not all(type(one) in (int, float) for one in numbers):
            raise damaged(path, number, "expected reality, weight and distance")
    return rows


def weights_of(folder: Path) -> dict[str, float]:
    """Name of a reality -> its weight; empty for a folder of draws that all weigh the same."""
    return {row["reality"]: float(row["weight"]) for row in kept_of(folder)}


def _said(line: Mapping[str, Any], done: int, size: int, spent: int, budget: int | None) -> str:
    """Progress, one line a particle."""
    distance = "fell or broke down" if line["distance"] is None else f"{line['distance']:.2f} tolerances away"
    most = "" if budget is None else f" of {budget}"
    return f"generation {line['generation']}, {done} of {size}: {distance}; {spent}{most} simulations"


def _summed_up(last: Generation) -> str:
    distances = [one.found.distance for one in last.population]
    simulated, accepted = sampler.effort(last.population)
    moves = "the prior" if last.bound is None else f"within {last.bound:.2f}, {accepted} of {simulated} moves accepted"
    return (
        f"generation {last.number}: {moves}; distance {min(distances):.2f} at best, {np.median(distances):.2f} median"
    )


def _not_enough(folder: Path, budget: int, generations: Sequence[Generation]) -> str:
    bound = generations[-1].bound if generations else None
    reached = "that is no more than the prior" if bound is None else f"all draws are within {bound:.2f} tolerances"
    return (
        f"{folder}: {budget} simulations are spent; {reached}. The same command with a larger --budget goes on; "
        "--within takes draws that agree less."
    )
