"""Guided pictures as jobs of a session: the outline on the page, the hand of whoever holds it."""

from __future__ import annotations

from collections.abc import Mapping

from calib.capture.description import describe, read_manifest, refuse_other
from calib.capture.guidance.asked import AskedPose, Role
from calib.capture.guidance.need import Need, need_for
from calib.capture.guided import Ended, Guided
from calib.capture.holding import Holding, VirtualHolding
from calib.capture.intrinsics import capture_intrinsics
from calib.capture.ready import reading_uncertainty
from calib.capture.stereo import capture_stereo
from calib.capture.sweep import capture_sweep
from calib.capture.writer import GrowingFolder, growing
from calib.core.errors import UsageError
from calib.images.detection.picture import Grey
from calib.live.bench import BOARD, Bench
from calib.live.commands import Pictures
from calib.live.guarded import Stopped
from calib.rig.check_file import check_path, read_check
from calib.rig.protocols import RigError


class _PageHolding:
    """Whoever holds the board before the page; nothing goes on after a stop."""

    def __init__(self, bench: Bench, virtual: Holding | None) -> None:
        self._bench = bench
        self._virtual = virtual

    def hold(self, asked: AskedPose) -> None:
        """Begin to hold the board as asked."""
        self._refuse_stopped()
        if self._virtual is not None:
            self._virtual.hold(asked)

    def wait(self, fault: str, waited_s: float) -> None:
        """Go on holding it, until Stop is pressed."""
        self._refuse_stopped()
        if self._virtual is not None:
            self._virtual.wait(fault, waited_s)

    def _refuse_stopped(self) -> None:
        if self._bench.axis.is_stopped:
            raise Stopped("stopped; the pictures taken are kept")


def take_pictures(bench: Bench, job: Pictures) -> None:
    """Take guided pictures.

    Raises
    ------
    CalibError
        If they cannot be taken, Stop was pressed, or less is known in the end than is needed.
    """
    if bench.board is None:
        raise UsageError("rig.toml has no [board]; add the board that is held before the cameras")
    bench.hand(BOARD)
    rig_file = bench.places.rig_file
    u_alpha2 = reading_uncertainty(bench.rig, rig_file) if job.kind == "sweep" else 0.0
    known = describe(bench.rig, u_alpha2_deg=u_alpha2)
    world = bench.rig.world
    try:
        with growing(bench.places.dataset) as folder:
            manifest = read_manifest(folder)
            if manifest is not None:
                refuse_other(manifest, known)
            done = len(folder.events("view"))
            guided = Guided(
                rig=bench.rig,
                board=bench.board,
                holding=_PageHolding(
                    bench, None if world is None else VirtualHolding(world, done=done)
                ),
                folder=folder,
                known=known,
                announce=lambda text: _told(bench, text),
                show=lambda asked, pictures, fault: _show(bench, asked, pictures, fault),
            )
            ended = _taken(bench, guided, job)
    finally:
        bench.record.put(asked=None)
        count_pictures(bench)
    short = [f"{what}: {one.words}" for what, one in ended.items() if not one.is_done]
    if short:
        raise RigError("; ".join(short))


def _taken(bench: Bench, guided: Guided, job: Pictures) -> dict[str, Ended]:
    stated = read_manifest(guided.folder)
    tolerance = None if stated is None else stated.certificate.tolerance
    need: Need = need_for(
        tolerance=None if tolerance is None else tolerance.depth_rel,
        depths_mm=None,
        baseline_mm=bench.rig.settings.nominal_baseline_mm,
    )
    if job.kind == "stereo":
        return {"stereo": capture_stereo(guided, need)}
    if job.kind == "sweep":
        check = read_check(check_path(bench.places.rig_file), serial=bench.rig.serial)
        settle = 0.0 if check is None else check.settle_s
        return {"sweep": capture_sweep(guided, need, settle_s=settle)}
    roles: tuple[Role, Role] = ("c1", "c2")
    return {role: capture_intrinsics(guided, role, need) for role in roles}


def _told(bench: Bench, text: str) -> None:
    bench.record.tell(text)
    count_pictures(bench)


def _show(bench: Bench, asked: AskedPose | None, _: Mapping[Role, Grey], fault: str) -> None:
    """Publish what is asked for; the page draws it over its own pictures."""
    if asked is None:
        bench.record.put(asked=None)
        return
    bench.record.put(
        asked={
            "camera": asked.role,
            "outline": [[round(float(v), 1) for v in point] for point in asked.outline_px],
            "first": [round(float(v), 1) for v in asked.corners_px[0]],
            "taken": [[[round(float(v), 1) for v in p] for p in quad] for quad in asked.taken_px],
            "why": asked.why,
            "fault": fault,
        }
    )


def count_pictures(bench: Bench) -> None:
    """Publish how many pictures of the board the dataset has."""
    folder = GrowingFolder(bench.places.dataset)
    counts = {
        "c1": len(folder.pictures("intrinsics/c1")),
        "c2": len(folder.pictures("intrinsics/c2")),
        "pairs": len(folder.pictures("stereo/c2")),
        "sweep": len(folder.pictures("sweep/c2")),
    }
    bench.record.put(pictures=counts)
