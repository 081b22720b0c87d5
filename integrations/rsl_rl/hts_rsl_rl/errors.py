"""What can go wrong here and a user can put right: each message is one line that says what, where and what to do."""

from __future__ import annotations


class IntegrationError(Exception):
    """Base of the errors of this package."""


class AnchorError(IntegrationError):
    """The checkpoint to stay close to cannot be used, or a setting of the bound is wrong."""


class ModelFileError(IntegrationError):
    """A file of a measurement model that cannot be used, or does not fit the task it is put into."""
