"""All board images of a dataset as one problem: each picture once, each board with a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.images.bundle import finite
from calib.images.joint.model import BoardImages, JointProblem
from calib.images.joint.reduced import Unknowns
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.pairs import PairStart, single_view_pose


@dataclass(frozen=True)
class Extra:
    """Images of one camera besides those of the pairs.

    Parameters
    ----------
    lens
        Those for its intrinsics, less what was rejected there.
    rows
        Those of gaze rows.
    """

    lens: Corners
    rows: Corners


def gather(
    start: PairStart,
    pairs: tuple[Corners, Corners],
    extra: tuple[Extra, Extra],
    board: Board,
    *,
    cameras: tuple[Camera, Camera],
    free: tuple[bool, bool],
) -> tuple[JointProblem, Unknowns]:
    """Return the problem and where to start it.

    A picture named for several purposes, or under several names, counts once: first as part of a
    pair, then for a lens. The pictures of pairs come first, pair by pair, C1 before C2.

    Parameters
    ----------
    start
        The pairs to use.
    pairs
        Corners of all pairs, as found.
    extra
        Further images of C1 and of C2.
    free
        Whether the intrinsics of C1 and of C2 are to be solved; the images for a given lens are
        left out.
    """
    points = board.object_points()
    names, kinds, camera, view, pixels = [], [], [], [], []
    known: list[set[bytes]] = [set(), set()]
    poses = list(start.poses)
    for i, pair in enumerate(start.pairs):
        for c in (0, 1):
            names.append(pairs[c].images[pair])
            kinds.append("pair")
            camera.append(c)
            view.append(i)
            pixels.append(start.pixels[c, i])
            known[c].add(pairs[c].pixels[pair].tobytes())
    for c in (0, 1):
        for kind, found in (("lens", extra[c].lens), ("row", extra[c].rows)):
            for name, corners in zip(found.images, found.pixels, strict=True):
                content = corners.tobytes()
                if not free[c] or content in known[c] or finite(corners).sum() < MIN_CORNERS:
                    continue
                known[c].add(content)
                names.append(name)
                kinds.append(kind)
                camera.append(c)
                view.append(len(poses))
                pixels.append(corners)
                poses.append(single_view_pose(cameras[c], points=points, pixels=corners)[0])
    images = BoardImages(
        names=tuple(names),
        kinds=tuple(kinds),
        camera=np.array(camera),
        view=np.array(view),
        in_pair=np.array(
            [c == 1 and kind == "pair" for c, kind in zip(camera, kinds, strict=True)]
        ),
        pixels=np.array(pixels),
    )
    problem = JointProblem(images, points, cameras, free)
    return problem, problem.start(start.pose_12, np.array(poses))
