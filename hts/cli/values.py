"""Options that do not take each other for their values: `--measurement-model --to F` lacks a value, and says so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperCommand, TyperOption


class Command(TyperCommand):
    """A command of hts or of a plugin."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        check_values(self, ctx, args)
        return super().parse_args(ctx, args)


def check_values(command: TyperCommand, ctx: Any, args: Sequence[str]) -> None:
    """Raises BadParameter for an option whose value is missing, since what follows is another option: it would be taken
    for the value, and what is then said is of something else. `--policy=--odd` gives such a value all the same."""
    options = [one for one in command.get_params(ctx) if isinstance(one, TyperOption)]
    known = {name for one in options for name in (*one.opts, *one.secondary_opts)}
    valued = {name for one in options if not one.is_flag and not one.count for name in one.opts}
    left = iter(args)
    for word in left:
        if word == "--":
            return
        if word not in valued:
            continue
        value = next(left, "")
        if value in known:
            raise typer.BadParameter(f"expected a value, found the option {value}.", ctx=ctx, param_hint=word)
