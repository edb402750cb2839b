"""Pixels of rows that no ray of a lens reaches: it folds back before them."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError, InputError, Problem
from calib.dataset.messages import LISTED_PROBLEMS, row_place, shortened
from calib.dataset.tables import GazeTable
from calib.geometry.camera import Camera, normalise, without_ray


def refuse_rayless(table: GazeTable, camera: Camera, pixels: FloatArray) -> None:
    """Raise an InputError that names the rows whose pixel no ray of the lens reaches."""
    problems = []
    for i in np.flatnonzero(without_ray(camera, pixels)):
        where = row_place(table.file, table.line[i], table.ids[i])
        what = ""
        try:
            normalise(camera, pixels[[i]])
        except EstimationError as error:
            what = str(error)
        remedy = "check the pixel against image_size and the camera's intrinsics"
        problems.append(Problem(where, what, remedy))
        if len(problems) > LISTED_PROBLEMS:
            break
    if problems:
        raise InputError(shortened(problems, where=table.file))
