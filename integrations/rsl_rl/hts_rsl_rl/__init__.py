"""For those who train with rsl_rl, mjlab or Isaac Lab: a KL-anchored PPO, and measured quantities as reward terms.

    hts_rsl_rl:AnchoredPPO            `class_name` of the algorithm
    hts_rsl_rl:MeasurementModel       a fitted model in one file, as `hts export --measurement-model` writes it
    hts_rsl_rl.mjlab:MeasuredReward   a reward term of mjlab
    hts_rsl_rl.isaaclab:MeasuredReward  the same for Isaac Lab

Needs torch and rsl_rl. hts itself, and with it MuJoCo, is not needed; a MeasurementModel does without rsl_rl too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hts_rsl_rl.errors import AnchorError, IntegrationError, ModelFileError

if TYPE_CHECKING:
    from hts_rsl_rl.measurement import MeasurementModel
    from hts_rsl_rl.ppo import AnchoredPPO
    from hts_rsl_rl.projection import finish

__all__ = ["AnchorError", "AnchoredPPO", "IntegrationError", "MeasurementModel", "ModelFileError", "finish"]

LATER = {"AnchoredPPO": "ppo", "MeasurementModel": "measurement", "finish": "projection"}
"""Name -> module that is imported when it is asked for: a reward term must not import an algorithm."""


def __getattr__(name: str) -> Any:
    if name not in LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{LATER[name]}"), name)
