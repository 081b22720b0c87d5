"""The table of the simulated robot against its anchors, as programs read it."""

import json

import numpy as np

from hts_power.calibration import json_text


def test_what_numpy_computed_is_printed_as_json():
    row = {
        "standing_ok": np.bool_(True),
        "standing_watts": np.float64(58.5),
        "walking": {"0.8": {"falls": np.int64(0)}},
    }
    assert json.loads(json_text(row)) == {"standing_ok": True, "standing_watts": 58.5, "walking": {"0.8": {"falls": 0}}}
