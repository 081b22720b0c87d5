"""What every stage of a run needs: configuration, folder, plugins, store, world, policies."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from hts.checked_selector import checked_selector
from hts.config import RunConfig, ScheduleConfig
from hts.contracts import HoldSpeed, MeasurementModel, Robot, Selector, World
from hts.errors import PolicyError, RecordingError, RunError
from hts.evaluation.held import ask_to_hold, hold_of
from hts.measurement import files
from hts.measurement.transform import Measured
from hts.parts import objectives_of, robot_of, world_of
from hts.places import resume_command
from hts.plugins import Registry
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy, pretrained_file, save_policy
from hts.policies.onnx_ours import what_differs
from hts.policies.with_critic import critic_line
from hts.policy_ids import PRETRAINED
from hts.recordings.doubts import remarks
from hts.recordings.needs import check_judged_by, check_rate, check_recorded
from hts.recordings.recording import Recording
from hts.recordings.store import Dataset, RecordingStore
from hts.run.budget import Budget, plan, second_trials
from hts.run.provenance import collect as collect_provenance
from hts.run.provenance import config_sha256, other_versions
from hts.run.stage_files import read_stage
from hts.run.stages import Report, Stages, write_json
from hts.training.sweep import is_nearer, weights_of

HASH = "_sha256"


class Job:
    """One run in one folder. Objects that cost time are made when a stage first needs them."""

    def __init__(self, config: RunConfig, folder: Path, registry: Registry, stages: Stages) -> None:
        self.config, self.folder, self.registry, self.stages = config, folder, registry, stages
        self.first = PRETRAINED  # the policy that is the best before anything was tried
        self.note: str | None = None  # what must be said beside every result
        self._said: set[str] = set()
        self.robot: Robot = robot_of(config, registry)
        self.objectives = objectives_of(config, registry)

    # ------------------------------------------------------------------------------------------------- stages

    def do(self, name: str, title: str, work: Callable[[Report], Any]) -> Any:
        """See `Stages.do`."""
        return self.stages.do(name, title, work)

    def say(self, line: str) -> None:
        """One line to whoever waits for the run."""
        self.stages.progress.say(line)

    def say_once(self, about: str, line: str) -> None:
        """One line of the run, unless one about the same was said since it was begun or resumed."""
        if about not in self._said:
            self._said.add(about)
            self.say(line)

    def path(self, stage: str, iteration: int | None = None) -> Path:
        """Where the result of a stage lies; iteration: whose it is, where it is none of the whole run."""
        return (self.folder if iteration is None else self.iteration_folder(iteration)) / f"{stage}.json"

    def iteration_folder(self, iteration: int) -> Path:
        """What belongs to one iteration: results of its stages, candidates, models."""
        return self.folder / "iterations" / f"{iteration:02d}"

    def read(self, stage: str, iteration: int | None = None) -> Any:
        """Result of a finished stage. Raises RunError as `read_stage`."""
        return read_stage(self.path(stage, iteration))

    def prepare(self) -> None:
        """The pretrained policy and the provenance, before anything is spent."""
        _ = self.combinations  # raises ConfigError where there is nothing to learn from
        source = pretrained_file(self.robot)
        begun = (self.folder / "provenance.json").exists()
        kept = self.read("provenance") if begun else {}
        if not self.policy_path(PRETRAINED).exists():
            policy = load_policy(source, self.robot.spec)
            found, expected = policy.card.policy_hash, kept.get("pretrained_policy")
            if expected not in (None, found):
                raise RunError(
                    f"{source}: holds policy {found[:12]}, the run was begun with {expected[:12]}. Put that one there, "
                    "or begin a new run."
                )
            self.save(PRETRAINED, policy)
            if line := critic_line(policy.card.made, self.config.finetune.ppo.warmup_batches):
                self.say(line)
        identity = dict(self.world.identity())
        if begun:
            before = kept.get("world", {})
            if not _same_machine(before, identity):
                raise RunError(
                    f"{self.folder}: was begun on another machine ({_told(before)}, now {_told(identity)}). "
                    "Put that one back, or begin a new run."
                )
            if (other := other_versions(kept)) and not (self.folder / "summary.json").exists():
                self.say(
                    f"{self.folder}: was begun with {other}. Stages that are done are of that version, what follows is "
                    "of this one; install that one again, or begin a new run, for a result of one version."
                )
        else:
            plugins = {plugin.entry_point: plugin.package for plugin in self.registry.plugins}
            provenance = collect_provenance(self.config.seed, self.config.engine, plugins, self.config.provenance.diff)
            provenance["config_sha256"] = config_sha256(self.folder, self.config, self.registry)
            provenance["pretrained_policy"] = self.policy(PRETRAINED).card.policy_hash
            write_json(self.folder / "provenance.json", {**provenance, **({"world": identity} if identity else {})})

    @cached_property
    def combinations(self) -> list[dict[str, float]]:
        """The λ of the sweep's candidates, one per objective."""
        return weights_of(self.objectives, self.config)

    def rewards(self, iteration: int) -> list[Measured] | None:
        """What is paid for in training where it is neither models nor proxies; None: it is one of these."""
        return None

    def untrained(self, iteration: int) -> list[dict[str, Any]]:
        """Rows of finetune.json for candidates of an iteration that are there already."""
        return []

    def seed(self, *what: object) -> int:
        """A seed for one purpose, from the run's seed."""
        text = "/".join(str(part) for part in (self.config.seed, *what))
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")

    # ----------------------------------------------------------------------------------------------- policies

    def policy_path(self, name: str) -> Path:
        """Where a policy lies: pretrained and best in policies/, candidate 01-03 in iterations/01/candidates/."""
        if name in (PRETRAINED, "best"):
            return self.folder / "policies" / f"{name}.safetensors"
        return self.folder / "iterations" / name.split("-")[0] / "candidates" / f"{name}.safetensors"

    def save(self, name: str, policy: Policy) -> Path:
        """Write a policy and, beside it, the ONNX file that worlds get; returns the latter."""
        path = save_policy(self.policy_path(name), policy)
        return to_onnx(policy, path.with_suffix(".onnx"))

    def save_exploring(self, share: float) -> Path:
        """The ONNX file of the pretrained policy that adds `share` of its own sigma as noise;
        another policy to a model, with its own hash."""
        policy = self.policy(PRETRAINED)
        std = tuple((policy.tensors["log_std"].exp() * share).tolist())
        own = hashlib.sha256(f"{policy.card.policy_hash}{std}".encode()).hexdigest()
        card = dataclasses.replace(policy.card, exploration_std=std, policy_hash=own)
        place = self.policy_path(PRETRAINED).with_name(f"{PRETRAINED}-exploring.onnx")
        return to_onnx(Policy(policy.tensors, card), place)

    def policy(self, name: str) -> Policy:
        """Read a policy of this run. Raises PolicyError, which says how to get it back, if a file is damaged."""
        try:
            return load_policy(self.policy_path(name), self.robot.spec)
        except PolicyError as error:
            maker = {
                PRETRAINED: self.policy_path(PRETRAINED),  # `prepare` writes all of it again
                "best": self.folder / "final.json",
            }.get(name, self.policy_path(name).parent.with_name("nearer.json" if is_nearer(name) else "finetune.json"))
            raise PolicyError(
                f"{error} Or delete {maker} and `{resume_command(self.folder)}` makes it anew."
            ) from error

    def anchor(self, name: str) -> Policy:
        """A policy as candidates begin at it, and as their KL is counted from it: with `finetune.renew_noise` its sigma
        is the pretrained policy's. The card stays its own. Raises PolicyError as `policy` does."""
        policy = self.policy(name)
        if not self.config.finetune.renew_noise or name == PRETRAINED:
            return policy
        log_std = self.policy(PRETRAINED).tensors["log_std"]
        return dataclasses.replace(policy, tensors={**policy.tensors, "log_std": log_std})

    def onnx_path(self, name: str) -> Path:
        """Where the ONNX file of a policy lies."""
        return self.policy_path(name).with_suffix(".onnx")

    def exported(self, name: str) -> Path:
        """The ONNX file of a policy of this run, for a world: it is that policy's. Written again where it is missing.

        Raises PolicyError, which says how to get it back, for a file that is damaged or of another policy.
        """
        policy, path, own = self.policy(name), self.onnx_path(name), self.policy_path(name).name
        if not path.exists():
            self.say(f"{path}: is missing, so it is written again from {own}.")
            return to_onnx(policy, path)
        other = what_differs(path, policy)
        if other is not None:
            raise PolicyError(
                f"{path}: damaged, or of another policy ({other}). Expected that of {own}, "
                f"{policy.card.policy_hash[:12]}. Delete it and `{resume_command(self.folder)}` writes it again."
            )
        return path

    def model_path(self, iteration: int, objective: str) -> Path:
        """Where a measurement model lies."""
        return self.iteration_folder(iteration) / "models" / f"{objective}.safetensors"

    def model(self, iteration: int, objective: str) -> MeasurementModel:
        """A measurement model of this run. Raises PolicyError, which says how to get it back, if a file is damaged."""
        path = self.model_path(iteration, objective)
        try:
            return files.load(path, registry=self.registry)
        except PolicyError as error:
            maker = path.parent.with_name("fit.json")
            raise PolicyError(
                f"{error} In this run: delete {maker} and `{resume_command(self.folder)}` fits it anew."
            ) from error

    @property
    def gate_is_strict(self) -> bool:
        """Whether who fails at the gate is kept from the world. One that does not say what it is may be a machine."""
        strict = self.config.gate.strict
        return self.world.simulated is not True if strict is None else strict

    def note_gate(self, name: str, found: Mapping[str, Any]) -> None:
        """What the gate found of a policy, and whose hash it is, beside its ONNX file: worlds that are machines pass it
        on."""
        whose = {} if "policy_hash" in found else {"policy_hash": self.policy(name).card.policy_hash}
        write_json(self.onnx_path(name).with_suffix(".gate.json"), {**whose, **found})

    # ---------------------------------------------------------------------------------------- world and recordings

    @cached_property
    def world(self) -> World:
        """Where policies run "for real"."""
        command = resume_command(self.folder)
        world = world_of(self.config, self.registry, self.world_folder, command=command)
        if self.hold is not None:
            ask_to_hold(world, self.hold)
        return world

    def selector(self) -> Selector:
        """Who names the elites that are tried for real, and the best of those."""
        capped = self.config.max_real_samples is not None
        return checked_selector(self.registry, self.config.selection.selector, capped)

    @cached_property
    def budget(self) -> Budget:
        """What a run with a cap on its real samples may record and test."""
        return plan(self.config, self.registry, self.world)

    def spent(self, iteration: int) -> int:
        """Real samples before an iteration."""
        first = self.read("collect")["samples"] if self.config.records_first else 0
        return first + sum(self.read("test", earlier)["samples"] for earlier in range(iteration))

    def elites(self, iteration: int) -> int:
        """How many elites an iteration may test: as the plan says, within what is left of the real samples."""
        if self.config.max_real_samples is None:
            return self.config.selection.elites
        tried = [len(self.read("test", earlier)["elites"]) for earlier in range(iteration)]
        return self.budget.affordable(tried, self.spent(iteration))

    def confirmations(self, iterations: int) -> int:
        """How many of the best may be tried again after so many iterations, within what is left of the real samples."""
        wanted, most = second_trials(self.config), self.config.max_real_samples
        return wanted if most is None else min(wanted, (most - self.spent(iterations)) // self.budget.each)

    @property
    def schedule(self) -> ScheduleConfig:
        """Of first data."""
        return self.config.collection.schedule if self.config.max_real_samples is None else self.budget.schedule

    @property
    def done_iterations(self) -> int:
        """Iterations whose elites were tested; fewer than planned where the real samples ran out."""
        return sum(self.path("test", index).exists() for index in range(self.config.iterations))

    @cached_property
    def hold(self) -> HoldSpeed | None:
        """How the world holds the speed of head-to-heads; None: it does not."""
        return hold_of(self.config)

    @cached_property
    def store(self) -> RecordingStore:
        """The run's real data."""
        return RecordingStore(self.folder / "data.zarr", create=True)

    def check_recordings(self, recordings: Sequence[Recording]) -> None:
        """Raise RecordingError if one lacks what an objective of this run measures, its model reads or the task is
        judged by, or has it in another unit or shape, or is of another rate than the policies'."""
        check_recorded(self.objectives.values(), recordings, inputs=self.config.fits_models)
        check_judged_by(recordings, self.robot)
        check_rate(recordings, self.robot.spec)

    def keep(self, recordings: Sequence[Recording], iteration: int) -> list[str]:
        """Store recordings, and say what `remarks` has to say of them; writing one twice is harmless.
        Returns their ids. Raises RecordingError as `check_recordings` does, with nothing stored."""
        self.check_recordings(recordings)
        for line in remarks(recordings):
            self.say(line)
        return [self.store.write(recording.replace(iteration=iteration)) for recording in recordings]

    def recordings(self, ids: Sequence[str]) -> list[Recording]:
        """Read recordings back. Raises RecordingError, which says how to get it back, if one is damaged."""
        return [self._from_store(name, self.store.read) for name in ids]

    def dataset(self, ids: Sequence[str]) -> Dataset:
        """What a model is fitted to; reads and hashes every recording. Raises RecordingError as `recordings` does."""
        try:
            return self.store.dataset(ids)
        except RecordingError:
            for name in ids:
                self._from_store(name, lambda one: self.store.dataset([one]))
            raise

    def _from_store(self, name: str, read: Callable[[str], Any]) -> Any:
        try:
            return read(name)
        except RecordingError as error:
            stages = [self.folder / "collect.json", *sorted(self.folder.glob("iterations/*/test.json"))]
            maker = next(
                (stage for stage in stages if stage.exists() and name in read_stage(stage)["recordings"]), None
            )
            if maker is None:
                raise
            raise RecordingError(
                f"{error} In this run: then delete {maker} too, and `{resume_command(self.folder)}` makes it anew."
            ) from error

    def known(self, iteration: int) -> list[str]:
        """Ids of all recordings made before the fine-tuning of this iteration: D_i."""
        ids = list(self.read("collect")["recordings"])
        for earlier in range(iteration):
            ids += self.read("test", earlier)["recordings"]
        return ids

    @property
    def world_folder(self) -> Path:
        """Where the world may write."""
        return self.folder / "world"

    def watch(self, report: Report) -> None:
        """Let the world report its progress."""
        self.world.on_progress(report)

    def close(self) -> None:
        if "world" in self.__dict__:
            self.world.close()
            with contextlib.suppress(OSError):  # what a world kept for itself is still there
                self.world_folder.rmdir()


def _same_machine(before: Mapping[str, str], now: Mapping[str, str]) -> bool:
    """Whether two identities name one machine. Of a file whose hash both hold the name says only where it lies."""
    return before.keys() == now.keys() and all(before[name] == now[name] for name in now if f"{name}{HASH}" not in now)


def _told(identity: Mapping[str, str]) -> str:
    told = [f"{name} {value[:12] if name.endswith(HASH) else value}" for name, value in identity.items()]
    return ", ".join(told) or "none was named"
