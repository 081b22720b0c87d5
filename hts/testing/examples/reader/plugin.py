"""Registers the log reader `jsonl`. Imports nothing heavy: the factory imports what it makes when it is called."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 2


def make_reader(settings):
    """Log reader `jsonl`: which files it reads, in one line."""
    from hts.testing.examples.reader import reader

    reader.Settings(**settings)
    return reader.Jsonl()


@hookimpl
def hts_log_readers(register):
    register("jsonl", make_reader)
