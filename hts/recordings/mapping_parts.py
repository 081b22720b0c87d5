"""Parts of a mapping that say which rows of a log make a recording."""

from __future__ import annotations

from pydantic import Field, model_validator

from hts.config import Config
from hts.recordings.table import ColumnName


class RunsMapping(Config):
    """Several runs in one file: each becomes a recording."""

    column: ColumnName | None = Field(None, description="holds a number for each row; where it changes a run begins")
    gap_seconds: float | None = Field(None, gt=0, description="a step in time longer than this begins a run, s")
    take: tuple[float, ...] | None = Field(None, description="only these numbers of the column")

    @model_validator(mode="after")
    def _one_way(self) -> RunsMapping:
        if (self.column is None) == (self.gap_seconds is None):
            raise ValueError("runs: give either `column` or `gap_seconds`")
        if self.take is not None and self.column is None:
            raise ValueError("runs: `take` names numbers of a `column`")
        return self


class LabelsMapping(Config):
    """A file of labels: stretches of time, s after the log's first stamp, each with a word."""

    file: str = Field(description="which of `files` it is: comma-separated, with a header line")
    start: str = Field("start", description="its column of beginnings, s after the first stamp")
    end: str = Field("end", description="its column of ends, s after the first stamp")
    label: str = Field("label", description="its column of words")
    take: tuple[str, ...] | None = Field(
        None, description="each stretch with one of these words becomes a recording; left out: labels are only noted"
    )


class JoinMapping(Config):
    """Two files of one run whose stamps count different clocks: a signal in both says how far these are apart."""

    file: str = Field(description="the file whose clock is moved, one of `files`")
    channel: str = Field(description="its channel that another file has, too")
    match: str = Field(description="that channel in the other file, whose clock stays")


class OnlyMapping(Config):
    """Rows of a run that count, where a log holds others between them; the clock is closed up over those."""

    column: ColumnName = Field(description="holds a number for each row; a row without one is as the row before it")
    number: float = Field(0.0, description="that of the rows that count; all others are left out")
    file: str | None = Field(None, description="which of `files` it is in")
    topic: str | None = Field(None, description="of a file of messages: the topic, where it is not the mapping's own")
