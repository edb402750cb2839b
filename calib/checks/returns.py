"""Gate on the returns to the first target: the zero stood still while the rows were taken."""

from __future__ import annotations

from calib.core.gate import Gate
from calib.dataset.contents import Dataset
from calib.instrument.returns import control_of, control_words


def returns_gates(dataset: Dataset) -> tuple[Gate, ...]:
    """Return the gate of a dataset's returns; none where C2 never returned."""
    if dataset.returns is None or not len(dataset.returns):
        return ()
    encoder = dataset.manifest.encoder
    firsts = [dataset.returns.to(first) for first in dict.fromkeys(dataset.returns.of)]
    return (
        Gate(
            "returns",
            passed=all(control_of(table, encoder).first_alarm is None for table in firsts),
            detail="; ".join(control_words(table, encoder) for table in firsts),
        ),
    )
