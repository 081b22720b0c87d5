"""How strongly the world pulls at the machine, by how far the pretrained policy's speed wandered in the trials.

No simulator knows the slopes, the wind and the worn patches of the place where a machine walks; the reference of each
head-to-head has walked there. In simulation its speed wanders in proportion to the pull on its trunk, so

    pull_v = probe · sqrt((W_v / A_v + ΣW / ΣA) / 2)        W measured, A simulated under the probe

is the pull under which it wanders in simulation as it did in reality. A slow walk is moved more by what pulls than a
fast one, and by more than simulation knows, so each speed has its own, between its own ratio of W and that of all (the
blocks of a few trials say little of one speed). Candidates that save much hold their speed less stiffly than the
pretrained policy does; under that pull one sees by how much.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hts.config import EnvConfig
from hts.contracts import HoldSpeed
from hts.evaluation import wandering
from hts.evaluation.simulation import simulate as trials
from hts.evaluation.simulation import test_config, trial_seconds, trial_steps
from hts.policy_ids import PRETRAINED
from hts.rl.population import Population
from hts.run.job import Job

PROBE = 0.2  # m/s²: well above what wanders without any pull, and the answer is still in proportion
SECONDS = 10.0  # s, until it is another: trials differ more from block to block than within one
MOST = 0.6  # m/s², a slope of 3.5 degrees: what is more than that is no steady pull, and training would only suffer
GRAVITY = 9.81  # m/s²
LEAST_ANSWER = 1e-6  # of A: an env below it knows no pulls


def pulled(config: EnvConfig, pull: tuple[float, ...]) -> EnvConfig:
    """The env with slow pulls of that size in it, m/s²; several: in the order of its fixed speeds."""
    changed = config.randomisation.model_copy(update={"pull": pull, "pull_seconds": SECONDS})
    return config.model_copy(update={"randomisation": changed})


def felt_pull(job: Job, iteration: int) -> dict[str, Any] | None:
    """What the trials before an iteration say: {"pull": m/s² at each of `simulation_test.speeds`, "measured",
    "simulated": W at each speed where both are known, "sessions": how many walked at it, "steps": control steps that
    were simulated for it}.

    None where nothing asks for it, before the first trials, where no speed was held (in simulation or in them), or in
    an env without pulls. A speed that was not tried gets what all others say together.
    """
    test = job.config.simulation_test
    if not (test.measured_pull or job.config.finetune.measured_pull) or not test.hold_speed:
        return None
    ids = [name for earlier in range(iteration) for name in job.read("test", earlier)["recordings"]]
    references = [recording for recording in job.recordings(ids) if recording.role == "reference"]
    measured = wandering.measured(references, job.robot.task())
    if not any(speed in measured for speed in test.speeds):
        return None
    simulated = _answer(job)
    known = [speed for speed in test.speeds if speed in measured and simulated[speed] > LEAST_ANSWER]
    if not known:
        return None
    together = sum(measured[speed].size for speed in known) / sum(simulated[speed] for speed in known)
    own = {speed: measured[speed].size / simulated[speed] for speed in known}
    ratios = [(own[speed] + together) / 2 if speed in known else together for speed in test.speeds]
    return {
        "pull": [min(MOST, PROBE * math.sqrt(max(0.0, ratio))) for ratio in ratios],
        "measured": {f"{speed:g}": measured[speed].size for speed in known},
        "simulated": {f"{speed:g}": simulated[speed] for speed in known},
        "sessions": {f"{speed:g}": measured[speed].sessions for speed in known},
        "steps": trial_steps(test, job.robot.spec.control_rate_hz) * test.num_envs * len(test.speeds),
    }


def pull_line(found: Mapping[str, Any], speeds: Sequence[float]) -> str:
    """What was found, for the person who waits. speeds: `simulation_test.speeds`."""
    each = ", ".join(f"{pull:.2f} at {speed:g} m/s" for pull, speed in zip(found["pull"], speeds, strict=True))
    steepest = math.degrees(math.atan(max(found["pull"]) / GRAVITY))
    return f"the world pulls at the machine, by its trials, in m/s²: {each} (a slope of {steepest:.1f}° at most)"


def _answer(job: Job) -> Mapping[float, float]:
    """W of the pretrained policy in simulation under the probe."""
    config, test = job.config, job.config.simulation_test
    seed, task = job.seed("pull"), job.robot.task()
    env_config = pulled(test_config(config.finetune.env, test.speeds, trial_seconds(test), seed), (PROBE,))
    worlds = test.num_envs * len(test.speeds)
    env = job.robot.make_env(config.engine, 1, worlds, env_config, channels=tuple(task.channels), seeds=[seed])
    policy = job.policy(PRETRAINED)
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors], env.device)
    hold = HoldSpeed(config.finetune.env.commands.vx)
    try:
        (row,) = trials(env, population, test.speeds, test.seconds, test.speed_tolerance, task, hold)
    finally:
        env.close()
    return wandering.simulated(row)
