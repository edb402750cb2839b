"""A rig.toml in simulated time and what its check would say."""

RIG = """\
format = 1
serial = "rig-07"
[cameras.c1]
driver = "virtual"
[cameras.c2]
driver = "virtual"
[axis]
driver = "virtual"
resolution_deg = 0.009
step_deg = 0.05625
full_step_deg = 0.9
reads = "load encoder"
[virtual]
time = "simulated"
baseline_mm = 200
seed = 1
"""

CHECK = {
    "kind": "calib rig check", "format": 1, "serial": "rig-07", "time": "2026-11-27T08:00:00Z",
    "devices": {"c1": "c1", "c2": "c2", "axis": "axis"}, "reads": "load encoder",
    "checks": [{"name": "frame age", "passed": True, "detail": "new"}], "direction": 1,
    "step_deg": 0.05625, "step_ratio": None, "backlash_deg": 0.0, "backlash_steps": 0.0,
    "settle_s": 0.0, "frame_age_ms": {"c1": 10.0, "c2": 10.0}, "repeatability_deg": 0.0002,
    "u_reading_deg": 0.0027, "whole_steps": False, "u_alpha2_deg": 0.0027,
}  # fmt: skip
