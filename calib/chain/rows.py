"""Gaze rows as stages: what holds for all rows of a table, and the rows themselves."""

from __future__ import annotations

from calib.chain.images import ImageStages, sightings
from calib.dataset.contents import Dataset
from calib.dataset.tables import GazeTable
from calib.rows.from_table import RowSettings, Setup, row_settings
from calib.rows.observations import Observations
from calib.stages.store import Staged, Store, given


def setup_stage(
    store: Store, images: ImageStages, name: str, settings: RowSettings
) -> Staged[Setup]:
    """Return what holds for all rows of a table."""
    return store.stage(
        f"setup {name}", "calib.rows.from_table:set_up",
        given("settings", settings), images.cameras, images.shared,
    )  # fmt: skip


def gaze_rows(
    dataset: Dataset, table: GazeTable, store: Store, images: ImageStages
) -> Staged[Observations]:
    """Return the calibration rows with their covariance."""
    setup = setup_stage(store, images, "gaze", row_settings(dataset))
    seen = sightings(dataset, table, store, images)
    return store.stage(
        "observations",
        "calib.rows.repeated_readings:observe_gazes",
        given("gaze", table),
        setup,
        seen,
    )
