"""The gaze rows of a table, from its cells and the images that it names."""

from __future__ import annotations

from calib.chain.images import ImageStages, image_observations
from calib.dataset.contents import Dataset
from calib.dataset.tables import GazeTable
from calib.rows.from_table import Setup, row_settings, validation_settings
from calib.rows.observations import Observations
from calib.rows.repeated_readings import observe_gazes
from calib.stages.store import Staged, Store, given, optional, stage


def gaze_setup(dataset: Dataset, images: ImageStages) -> Setup:
    """Return what holds for all calibration rows."""
    return Setup(row_settings(dataset), images.cameras, images.shared.value)


def validation_setup(dataset: Dataset, images: ImageStages) -> Setup:
    """Return what holds for all validation rows."""
    return Setup(validation_settings(dataset), images.cameras, images.shared.value)


def gaze_rows(
    dataset: Dataset, table: GazeTable, store: Store, images: ImageStages
) -> Staged[Observations]:
    """Return the calibration rows with their covariance."""
    setup = given("setup", gaze_setup(dataset, images))
    seen = image_observations(dataset, table, store, images)
    return store.run(
        stage("observations", observe_gazes, given("gaze", table), setup, optional(seen))
    )
