"""What ends a session.

RuntimeFault    something is wrong before or beside walking: one line that says what to do
Stopped         the robot was brought to a safe command; reason and numbers
"""

from __future__ import annotations


class RuntimeFault(Exception):
    """One line: what was found, where, what was expected, what to do."""


class Stopped(Exception):
    """The robot has been given the damping command. reason: one word of `safety.REASONS`; detail: numbers."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason, self.detail = reason, detail
