"""The commands of the core: name, module, and the line that `hts --help` shows. Data only, so that help is quick.

A module offers `command`, a function with typer annotations, or `app`, a `typer.Typer` with subcommands.
"""

from __future__ import annotations

COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("hts.cli.run", "Improve a robot's policy on an objective (Algorithm 1)"),
    "resume": ("hts.cli.resume", "Go on with a run where it stopped"),
    "baseline": ("hts.cli.baseline", "The same as run, with the analytic proxy instead of measurements"),
    "oracle": ("hts.cli.oracle", "What was possible: the same, looking into the twin; no method"),
    "evaluate": ("hts.cli.evaluate", "A run's policy against the pretrained one, head to head"),
    "report": ("hts.cli.report", "Write a run's report.html and figures again"),
    "play": ("hts.cli.play", "See a policy walk, in a window or as a video"),
    "export": ("hts.cli.export", "A policy as ONNX or TorchScript, for the robot; a measurement model for rsl_rl"),
    "policy": ("hts.cli.policy", "Policies made elsewhere, to start from: import"),
    "import": ("hts.cli.import_", "Real logs into a recording store"),
    "data": ("hts.cli.data", "What a recording store holds: ls, show, compare, validate"),
    "fit": ("hts.cli.fit", "Fit one measurement model on a recording store, with its checks"),
    "pretrain": ("hts.cli.pretrain", "Train the policy to start from"),
    "plugins": ("hts.cli.plugins", "What is installed, and what could not be loaded"),
    "new": ("hts.cli.new", "A package to start from: objective, robot, world, reader, …"),
    "check": ("hts.cli.check", "Test a plugin package against the conformance kit"),
    "bench": ("hts.cli.bench", "Speed against bare physics: env, train, sweep, fit"),
    "realities": ("hts.cli.realities", "Plausible twins: drawn, looked at, held against public facts"),
    "config": ("hts.cli.config", "The resolved configuration, or its JSON schema"),
}
