"""The adjustment of all pictures, where a dataset has some that tell the rig."""

from __future__ import annotations

import numpy as np

from calib.chain.images import ImageStages, besides_pairs, camera_pair
from calib.dataset.contents import Dataset
from calib.dataset.encoder import Encoder
from calib.images.adjustment.gather import Rows, Swept, Taken
from calib.images.adjustment.result import Adjustment, adjust
from calib.stages.store import Staged, Store, given, stage


def adjustment_stage(
    dataset: Dataset, store: Store, images: ImageStages
) -> Staged[Adjustment] | None:
    """Return the adjustment; None if no pictures of both cameras go with readings."""
    encoder, rig = dataset.manifest.encoder, camera_pair(dataset, images.intrinsics)
    if encoder is None or rig is None or dataset.board is None or len(images.corners) < 2:
        return None
    taken = pictures_taken(dataset, images, encoder)
    rows = zip(taken.rows.image_c1, taken.rows.image_c2, strict=True)
    if not any(one is not None and two is not None for one, two in (*taken.pairs, *rows)):
        return None
    return store.run(stage(
        "adjustment", adjust,
        images.corners["c1"], images.corners["c2"], given("pictures taken", taken),
        given("board", dataset.board), rig,
    ))  # fmt: skip


def pictures_taken(dataset: Dataset, images: ImageStages, encoder: Encoder) -> Taken:
    """Return the pictures that are used to fit: never those of validation."""
    gaze, sweep, stereo = dataset.gaze, dataset.sweep, dataset.manifest.stereo
    held = None if stereo is None else stereo.alpha2_deg
    rows, swept = Rows(), Swept()
    if gaze is not None:
        rows = Rows(gaze.ids, gaze.image_c1, gaze.image_c2, np.array(gaze.alpha2_rad))
    if sweep is not None:
        swept = Swept(sweep.image_c2, sweep.placements, np.array(sweep.alpha2_rad))
    step = np.deg2rad(encoder.resolution_deg) / np.sqrt(12)
    return Taken(
        lens=besides_pairs(dataset, images.intrinsics).lens,
        pairs=tuple(dataset.stereo_pairs.values()),
        held_rad=None if held is None else float(np.deg2rad(held)),
        rows=rows,
        sweep=swept,
        reading_std_rad=float(np.hypot(step, np.deg2rad(encoder.further_u_deg))),
        priors={name: (p.mean, p.std) for name, p in dataset.manifest.priors.items()},
    )
