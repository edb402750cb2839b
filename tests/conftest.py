"""What all tests share."""

from __future__ import annotations

import os

# One BLAS thread: results do not hang on the machine, and tests running side by side do not starve.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"


def pytest_terminal_summary(terminalreporter):
    """Say aloud what this machine does not let the tests try."""
    for report in terminalreporter.stats.get("passed", []):
        for name, value in report.user_properties:
            if name == "not tested":
                terminalreporter.write_line(f"NOT TESTED {report.nodeid}: {value}", red=True)
