"""mjlab + rsl_rl on its own flat Go1 task, for `compare_gpu.py`: runs in mjlab's environment, imports nothing of `hts`.

    python mjlab_rival.py --worlds 4096 --rounds 5 --iterations 5 [--device cuda:0]

Prints one line of JSON: control steps per second of whole iterations (24 steps a world, 5 epochs of 4 minibatches,
networks 512-256-128, as its Go1 task is configured), collection and update. Viewers, video writers and loggers that
mjlab imports and this does not use are replaced by empty modules where they are not installed, so that few wheels have
to be carried to a machine without network: mjlab, mujoco ~=3.11, mujoco-warp ~=3.11, rsl-rl-lib, tyro, prettytable,
warp-lang and what these need.
"""

from __future__ import annotations

import argparse
import importlib.machinery
import importlib.util
import json
import os
import statistics
import sys
import time
from contextlib import redirect_stdout
from importlib.abc import Loader, MetaPathFinder
from types import ModuleType
from typing import Any

UNUSED = ("mediapy", "viser", "mjviser", "wandb", "torchrunx", "trimesh", "git", "IPython", "imageio_ffmpeg")
TASK = "Mjlab-Velocity-Flat-Unitree-Go1"


class Nothing(ModuleType):
    """A module in which everything is a class that does nothing."""

    __path__: list[str] = []  # noqa: RUF012 - makes it a package

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        made = type(
            name, (), {"__init__": lambda self, *a, **k: None, "__getattr__": lambda self, n: lambda *a, **k: None}
        )
        setattr(self, name, made)
        return made


class StandIns(MetaPathFinder, Loader):
    """Finds what nobody else found, if it is in UNUSED."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        return importlib.util.spec_from_loader(name, self) if name.split(".")[0] in UNUSED else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return Nothing(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        pass


def make_runner(worlds: int, device: str):
    """The env and the runner as mjlab's own training script makes them, without logging."""
    from dataclasses import asdict

    import mjlab.tasks.velocity.config.go1  # noqa: F401 - registers the task
    from mjlab.envs import ManagerBasedRlEnv
    from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
    from mjlab.tasks.registry import load_env_cfg, load_rl_cfg
    from mjlab.utils.torch import configure_torch_backends

    configure_torch_backends()
    env_config, agent = load_env_cfg(TASK), load_rl_cfg(TASK)
    env_config.scene.num_envs = worlds
    env_config.seed = agent.seed = 0
    env = RslRlVecEnvWrapper(ManagerBasedRlEnv(cfg=env_config, device=device), clip_actions=agent.clip_actions)
    return env, MjlabOnPolicyRunner(env, asdict(agent), None, device), agent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=4096)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=5, help="in each round")
    parser.add_argument("--device", default="cuda:0")
    given = parser.parse_args()
    os.environ.setdefault("MUJOCO_GL", "disable")
    os.environ.setdefault("WANDB_MODE", "disabled")
    sys.meta_path.append(StandIns())
    with redirect_stdout(sys.stderr):
        import mujoco
        import torch

        env, runner, agent = make_runner(given.worlds, given.device)
        wait = torch.cuda.synchronize if given.device.startswith("cuda") else lambda: None
        runner.learn(num_learning_iterations=3, init_at_random_ep_len=True)
        steps = given.worlds * agent.num_steps_per_env * given.iterations
        rates = []
        for _ in range(given.rounds):
            wait()
            start = time.perf_counter()
            runner.learn(num_learning_iterations=given.iterations)
            wait()
            rates.append(steps / (time.perf_counter() - start))
        env.close()
        versions = {name: getattr(sys.modules.get(name), "__version__", None) for name in ("mujoco_warp", "warp")}
        versions |= {"mujoco": mujoco.__version__, "torch": str(torch.__version__)}
    result = {
        "task": TASK,
        "worlds": given.worlds,
        "steps_per_s": statistics.median(rates),
        "rounds": rates,
        "hidden": list(agent.actor.hidden_dims),
        "epochs": agent.algorithm.num_learning_epochs,
        "minibatches": agent.algorithm.num_mini_batches,
        "horizon": agent.num_steps_per_env,
        "versions": versions,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
