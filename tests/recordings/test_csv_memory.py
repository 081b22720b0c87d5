"""A comma-separated log of gigabytes takes the memory of the columns that are read, not of its text."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from two_joint_log import a_log, a_mapping, read

UNUSED = 300
"""Columns that nobody asks for."""


@pytest.fixture
def pool():
    """Counts what pyarrow takes."""
    usual = pa.default_memory_pool()
    counted = pa.proxy_memory_pool(usual)
    pa.set_memory_pool(counted)
    yield counted
    pa.set_memory_pool(usual)


@pytest.mark.parametrize("ending", ["\n", "\n9,9"])
def test_what_is_not_read_of_a_long_log_is_not_kept(tmp_path, pool, ending):
    rest = ",0.12345678" * UNUSED
    rows = [f"{20 * i},{i % 7},{-(i % 5)},{-1000 * (2 + i % 3)}{rest}" for i in range(4000)]
    log = a_log(tmp_path, rows, "t,K_tau,H_tau,amps" + "".join(f",x{i}" for i in range(UNUSED)))
    log.write_text(log.read_text().rstrip("\n") + ending)
    assert read(log, a_mapping()).num_samples == 4000
    assert pool.max_memory() < 0.5 * log.stat().st_size


@pytest.mark.parametrize("later", [lambda i: f"{20 * i}.0", lambda i: f"{20 * i}.0" if i % 2 else f"{20 * i}"])
def test_stamps_may_become_of_another_kind_far_into_the_log(tmp_path, later):
    rest = ",0.12345678" * UNUSED
    stamps = [str(20 * i) if i < 1000 else later(i) for i in range(1200)]
    rows = [f"{stamp},{i % 7},{-(i % 5)},{-1000 * (2 + i % 3)}{rest}" for i, stamp in enumerate(stamps)]
    log = a_log(tmp_path, rows, "t,K_tau,H_tau,amps" + "".join(f",x{i}" for i in range(UNUSED)))
    assert log.stat().st_size > 1 << 20
    np.testing.assert_allclose(read(log, a_mapping()).values("draw"), 2 + np.arange(1200) % 3)
