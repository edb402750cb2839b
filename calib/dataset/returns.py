"""Returns to the first target, written by `calib capture`, from the text of their table."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.dataset.cells import Cells, read_cells, require_columns
from calib.dataset.readers import Scanned, filled, identities, scanned
from calib.dataset.tables import ReturnTable

COLUMNS: Final = (
    "id", "of", "after", "alpha2_deg", "change_deg", "u_change_deg", "u_first_deg",
)  # fmt: skip
TIME: Final = "time"


def scan_returns(text: str, *, name: str) -> Scanned[ReturnTable]:
    """Return the returns of a table and their faults; errors as `readers.scan_gaze`."""
    cells = read_cells(text, file=name, known=(*COLUMNS, TIME))
    require_columns(cells, [(column,) for column in COLUMNS])
    change, u_change, u_first = (np.deg2rad(_numbers(cells, column)) for column in COLUMNS[4:])
    for column, values in (("u_change_deg", u_change), ("u_first_deg", u_first)):
        cells.report(
            values <= 0, column, "is not above 0", "give a standard uncertainty, in degrees"
        )
    table = ReturnTable(
        file=name,
        line=cells.lines,
        ids=identities(cells),
        of=filled(cells, "of"),
        after=filled(cells, "after"),
        change_rad=change,
        u_change_rad=u_change,
        u_first_rad=u_first,
    )
    return scanned(cells, table)


def _numbers(cells: Cells, column: str) -> np.typing.NDArray[np.float64]:
    filled(cells, column)
    return cells.numbers(column)
