"""rig.toml: what it says, and at most ten clear errors."""

import json

import pytest

from calib.core.errors import InputError, UsageError
from calib.rig.registry import axis_driver, camera_driver
from calib.rig.settings import embedded, parse_settings, rig_schema
from tests.rig.virtual_rigs import virtual_rig

WHOLE = """
format = 1
serial = "rig-07"
[cameras.c1]
driver = "lab"
image_size = [1280, 960]
address = "127.0.0.2"
[cameras.c2]
driver = "virtual"
[axis]
driver = "virtual"
resolution_deg = 0.05625
reads = "counts"
[virtual]
seed = 3
baseline_mm = 150
backlash_steps = 2.0
"""


def faults(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_settings(text.encode())
    assert len(caught.value.problems) <= 11
    return str(caught.value)


def test_a_whole_file_keeps_what_a_driver_needs():
    rig = parse_settings(WHOLE.encode())
    assert rig.cameras.c1.model_dump()["address"] == "127.0.0.2"
    assert rig.virtual.parameters == {"baseline_mm": 150.0}
    assert rig.virtual.backlash_steps == 2.0
    assert rig.axis.range_deg == (40.0, 140.0)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("resolution_deg = 0.05625\n", "", "rig.toml, [axis] resolution_deg (line 10): is missing"),
        ("0.05625", '"fine"', "is a text, not a number"),
        ('"counts"', '"count"', "write 'load encoder', 'motor encoder' or 'counts'"),
        ("seed = 3", "sede = 3", "did you mean 'seed'?"),
        ("format = 1", "format = 2", "no format of rig.toml that this version reads"),
        ("backlash_steps = 2.0", "backlash_steps = -1", "give a value of at least 0"),
        ("baseline_mm = 150", "baseline_mm = nan", "is not a finite number"),
        ('reads = "counts"', 'reads = "counts"\nrange_deg = [140, 40]', "is no range"),
        ("[virtual]", "[vitual]", "did you mean 'virtual'?"),
        ('reads = "counts"', 'reads = "counts"\nfull_step_deg = 0.01', "smallest move, 0.05625"),
        ("seed = 3", "seed = 3\nframe_ms = 1e-300", "give a value of at least 1"),
        ("seed = 3", "seed = 3\nclock_offset_s = 1e300", "give a value of at most 1e+09"),
        ("baseline_mm = 150", "baseline_mm = 1e300", "give at most 100000, in mm or rad"),
    ],
)
def test_a_fault_is_named_with_its_remedy(old, new, expected):
    assert expected in faults(WHOLE.replace(old, new))


def test_many_faults_are_listed_ten_at_most():
    more = "\n".join(f"unknown_{i} = 1" for i in range(30))
    assert "more problems" in faults(more + WHOLE)


def test_what_is_no_toml_is_told_with_its_line():
    assert "rig.toml, line 2: is not TOML" in faults("format = 1\nserial = rig\n")


def test_unknown_drivers_are_named():
    with pytest.raises(InputError, match=r"there is no driver 'gigee'"):
        camera_driver("gigee", where="rig.toml, [cameras.c1] driver")
    with pytest.raises(InputError, match=r"there is no driver"):
        axis_driver("nothing of the kind", where="rig.toml, [axis] driver")


def test_the_embedded_rig_and_the_schema():
    assert {s.driver for s in embedded().devices.values()} == {"virtual"}
    schema = rig_schema()
    assert json.dumps(schema)
    assert {"format", "serial", "cameras", "axis"} <= set(schema["required"])


def test_the_baseline_by_tape_measure_goes_before_that_of_the_virtual_rig():
    rig = parse_settings(WHOLE.encode())
    assert rig.nominal_baseline_mm == 150.0
    stated = parse_settings(WHOLE.replace('"rig-07"', '"rig-07"\nbaseline_mm = -170').encode())
    assert stated.nominal_baseline_mm == -170.0


def test_the_truth_is_not_written_to_the_end_of_another_file(tmp_path):
    mine = tmp_path / "rig.toml"
    mine.write_text("format = 1\n")
    with (
        pytest.raises(UsageError, match="is there and no file of truths"),
        virtual_rig(truth=str(mine)),
    ):
        pass
    assert mine.read_text() == "format = 1\n"
    for _ in range(2):
        with virtual_rig(truth=str(tmp_path / "truth.jsonl")):
            pass
    assert (tmp_path / "truth.jsonl").read_text().count('"event": "rig"') == 2
