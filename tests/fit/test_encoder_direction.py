"""Wrong signs of encoder and x1c, told from each other and from a rig on the other side.

Negative controls on simulated rows, of rigs with C2 on the right and, as their mirror images, left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_rows import simulated

from calib.checks.encoder_direction import check_encoder_direction

FAULTS = {
    "as stated": (1, 1, None),
    "encoder reversed": (1, -1, "the encoder counts the wrong way"),
    "x1c reversed": (-1, 1, "x1c has the wrong sign"),
    "other side": (-1, -1, "C2 stands at {there} of C1, not at {here}"),
}


@pytest.mark.parametrize("is_left", [False, True])
@pytest.mark.parametrize(("x", "encoder", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_sense_of_rotation(x: int, encoder: int, said: str | None, is_left: bool) -> None:
    here, there, other = ("-X", "+X", "right") if is_left else ("+X", "-X", "left")
    for seed in range(4):
        rows, _ = simulated(np.random.default_rng(10 + seed), count=14, axis_z_mm=-10.0)
        alpha2 = rows.alpha2_rad if encoder > 0 else np.pi - rows.alpha2_rad
        turned = replace(rows, x1c=x * rows.x1c, alpha2_rad=alpha2)
        gate = check_encoder_direction(turned, is_left=is_left)
        assert gate.passed == (said is None), gate.detail
        assert gate.detail.startswith((said or "as read").format(here=here, there=there))
        assert (f'c2 = "{other}" in [rig]' in gate.detail) == (x < 0)


@pytest.mark.parametrize(("is_left", "sign"), [(False, 1), (True, -1)])
def test_figures_are_those_of_the_rig_itself(is_left: bool, sign: int) -> None:
    rows, theta = simulated(np.random.default_rng(10), count=14, axis_z_mm=-10.0)
    detail = check_encoder_direction(rows, is_left=is_left).detail
    read = float(detail.split("L_b = ")[1].split(" mm")[0])
    assert read == pytest.approx(sign * theta[0], abs=5)
