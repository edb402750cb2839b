"""Gaze rows as stages: what holds for all rows of a table, and the rows themselves."""

from __future__ import annotations

from calib.dataset.contents import Dataset
from calib.dataset.tables import GazeTable
from calib.image_chain import ImageStages, sightings
from calib.observations import Observations
from calib.observe import RowSettings, Setup, row_settings
from calib.store import Staged, Store, given


def setup_stage(
    store: Store, images: ImageStages, name: str, settings: RowSettings
) -> Staged[Setup]:
    """Return what holds for all rows of a table."""
    return store.stage(
        f"setup {name}", "calib.observe:set_up",
        given("settings", settings), images.cameras, images.shared,
    )  # fmt: skip


def gaze_rows(
    dataset: Dataset, table: GazeTable, store: Store, images: ImageStages
) -> Staged[Observations]:
    """Return the calibration rows with their covariance."""
    setup = setup_stage(store, images, "gaze", row_settings(dataset))
    seen = sightings(dataset, table, store, images)
    return store.stage(
        "observations", "calib.repeats:observe_gazes", given("gaze", table), setup, seen
    )
