"""A run: Algorithm 1 in `algorithm`, its stages' work in `learning` and `reality`, its bookkeeping in the rest."""

from hts.run.algorithm import resume_run as resume_run, start_run as start_run
