"""What the journal of a capture says of rows and returns beyond their tables."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

from calib.core.errors import UsageError
from calib.gaze.row import GazeRow, SeenTarget


def row_journal(row: GazeRow, kept: Mapping[str, SeenTarget]) -> dict[str, Any]:
    """Return what the journal says of a row beyond the table."""
    standing = row.standstill
    return {
        "time": now(),
        "standstill": {
            "reading_deg": math.degrees(standing.reading_rad),
            "counts": standing.counts,
            "source": standing.source,
            "approached": standing.approached,
            "home": standing.home,
            "since_ns": standing.since_ns,
        },
        "pixel_c1": row.pixel_c1.tolist(),
        "pixel_c2": row.pixel_c2.tolist(),
        "u_c1_px": row.u_c1_px,
        "u_c2_px": row.u_c2_px,
        "frames": {
            role: {
                "serial": seen.frame.serial,
                "exposed_ns": seen.frame.exposed_ns,
                "sure": seen.frame.sure,
                "age_ms": round(seen.age_ms, 3),
            }
            for role, seen in kept.items()
        },
        "moves": row.moves,
        "looks": row.looks,
    }


BEHIND_S: Final = 60.0
"""Clocks that are kept by a time server step by less."""

_FORMAT: Final = "%Y-%m-%dT%H:%M:%SZ"

_START: Final = time.time() - time.monotonic()
"""Time of day at the zero of the monotonic clock, as this program began."""


def now() -> str:
    """Return the time of day, by a clock that was set once, as this program began.

    Rows are in order by it although the machine's clock is set meanwhile, by an hour in autumn or
    by a time server: what drifts with time would be sought in the wrong order.
    """
    return time.strftime(_FORMAT, time.gmtime(_START + time.monotonic()))


def refuse_earlier(events: Iterable[Mapping[str, Any]]) -> None:
    """Refuse to go on with a journal whose last times are still to come.

    Raises
    ------
    UsageError
        If they are by over `BEHIND_S`: new rows would come before the old ones.
    """
    times = [e["time"] for e in events if isinstance(e.get("time"), str)]
    limit = time.strftime(_FORMAT, time.gmtime(_START + time.monotonic() + BEHIND_S))
    if times and max(times) > limit:
        raise UsageError(
            f"the last row was captured at {max(times)}, and this computer's clock says {now()}: "
            "rows would be in a wrong order; set the clock, or capture into a new folder"
        )
