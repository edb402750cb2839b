"""What the certificate says of the lens of C1."""

from __future__ import annotations

import numpy as np
import pytest

from calib.certificate.assemble import lens_words
from calib.dataset.manifest import CameraSection as Stated
from calib.geometry.camera import Camera
from calib.geometry.lens import ProjectionName

SIZE = (640, 480)
MATRIX = ((300.0, 0.0, 320.0), (0.0, 300.0, 240.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("projection", "said"),
    [
        ("perspective", "given in the dataset"),
        ("equidistant", "given in the dataset, lens model equidistant (fisheye)"),
    ],
)
def test_a_lens_that_is_no_pinhole_is_named(projection: ProjectionName, said: str) -> None:
    stated = Stated(matrix=MATRIX, distortion=(0.0,) * 4, image_size=SIZE, projection=projection)
    camera = Camera(np.array(MATRIX), np.zeros(4), SIZE, projection)
    assert lens_words(stated, camera) == said


def test_source_of_the_lens() -> None:
    assert lens_words(None, None) is None
    pictures = Stated(images="c1/*.png")
    assert lens_words(pictures, None) == "calibrated from images of the board in the dataset"
    assert lens_words(Stated(model="c1.yaml"), None) == "taken from a finished model"
