"""Pictures of boards, drawn, for the tests of this folder."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import lens_scenes as scenes
import numpy as np

from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.simulate.pattern import board_pattern
from calib.simulate.render import Imager, Optics, prepare, render


def picture(
    pose: np.ndarray,
    board: Board = scenes.BOARD,
    camera: Camera = scenes.CAMERA,
    seed: int = 0,
) -> np.ndarray:
    imager = plain_imager() if camera is scenes.CAMERA else prepare(camera, Optics())
    return render(imager, board_pattern(board), pose, np.random.default_rng(seed))


@functools.cache
def plain_imager() -> Imager:
    return prepare(scenes.CAMERA, Optics())


def write(folder: Path, name: str, image: np.ndarray) -> str:
    assert cv2.imwrite(str(folder / name), image)
    return name
