"""A board from its section in a manifest or rig.toml, and its section again."""

from __future__ import annotations

from typing import Any

from calib.dataset import manifest
from calib.geometry.board import Board


def board_of(section: manifest.BoardSection) -> Board:
    """Return the board that a section describes; without a target its middle corner."""
    return Board(
        type=section.type,
        columns=section.columns,
        rows=section.rows,
        square_mm=section.square_mm,
        target=section.target_corner or (section.columns // 2, section.rows // 2),
        dictionary=section.dictionary,
        marker_mm=section.marker_mm,
        legacy=section.legacy,
    )


def section_of(board: Board) -> dict[str, Any]:
    """Return the section of a manifest that describes a board."""
    described: dict[str, Any] = {
        "type": board.type,
        "columns": board.columns,
        "rows": board.rows,
        "square_mm": board.square_mm,
        "target": list(board.target),
    }
    if board.type == "charuco":
        described |= {
            "dictionary": board.dictionary,
            "marker_mm": board.marker_mm,
            "legacy": board.legacy,
        }
    return described
