"""What is installed, as something that a plugin may ask for what others offer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from hts.contracts.instrument import Instrument
    from hts.contracts.log_reader import LogReader
    from hts.contracts.measurement_model import MeasurementModel, ModelContext
    from hts.contracts.objective import Objective
    from hts.contracts.robot import Robot
    from hts.contracts.settings import Settings


class Installed(Protocol):
    """`hts.plugins.Registry`, as far as worlds and models made of models need it.
    Each raises ConfigError for an unknown name or wrong settings."""

    def make_robot(self, name: str, settings: Settings | None = None) -> Robot: ...

    def make_objective(self, name: str, settings: Settings | None = None) -> Objective: ...

    def make_instrument(self, name: str, settings: Settings | None, robot: Robot) -> Instrument: ...

    def make_measurement_model(
        self, name: str, settings: Settings | None, context: ModelContext
    ) -> MeasurementModel: ...

    def make_log_reader(self, name: str, settings: Settings | None = None) -> LogReader: ...
