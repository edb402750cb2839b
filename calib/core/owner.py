"""Whose run the outputs of a calibration are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Owner:
    """A dataset, as far as it says whose a run is.

    Parameters
    ----------
    root, sha256
        Its folder and the digest of its files.
    name, serial
        Of the dataset, and of its rig; "" where it does not state them.
    """

    root: Path
    sha256: str
    name: str = ""
    serial: str = ""
