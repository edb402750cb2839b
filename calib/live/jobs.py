"""The jobs of a session, each as its command does it at the terminal, one after the other."""

from __future__ import annotations

import math
import os
import subprocess
import threading
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from calib.capture.description import describe, read_manifest, refuse_other
from calib.capture.ready import lens_c2, reading_uncertainty, return_uncertainty
from calib.capture.references import ByHand, source_of
from calib.capture.rows import Capture as CaptureSettings
from calib.capture.rows import capture_rows
from calib.capture.writer import GrowingFolder, growing
from calib.core.errors import UsageError
from calib.core.parent import ending_with_this
from calib.core.words import counted
from calib.gaze import length as lengths
from calib.gaze.length import gaze_length
from calib.gaze.measured import position
from calib.gaze.placing import Placing
from calib.gaze.row import GazeRow
from calib.gaze.table import line, refused
from calib.instrument.measured_text import is_extrapolated, status_of
from calib.instrument.measuring import Positions
from calib.live.bench import Bench, RigCalibration
from calib.live.commands import Calibrate, Capture, Check, Gaze, Job, Length, Pictures
from calib.live.guarded import Stopped
from calib.live.guided import count_pictures, take_pictures
from calib.live.scene import ellipse95
from calib.rig.check import check_rig
from calib.rig.check_file import check_path, check_text, read_check
from calib.rig.known import known_lens
from calib.rig.protocols import RigError
from calib.stages.files import write_bytes

MODEL: Final = "selected"
U_Z_MM: Final = 1.0
"""Standard uncertainty of depths that an operator types in, mm, as of `calib capture`."""

POLL_S: Final = 0.05
GRACE_S: Final = 10.0
"""The chain keeps its finished stages when it is interrupted; so long it may take for that."""

RUN_FILES: Final = {
    "report.html": "Report",
    "certificate.html": "Certificate",
    "certificate.pdf": "Certificate, PDF",
    "certificate.xml": "Certificate, DCC",
    "calibration.json": "calibration.json",
    "run.toml": "run.toml",
}
"""Files of a run that a page may have, with their titles."""

KINDS: Final = {"intrinsics": "lenses", "stereo": "pairs", "sweep": "sweep"}
"""Guided pictures as the page's list of them has it."""

DONE, GATE_FAILED_STATUS = 0, 3


class _StoppableHand:
    """A hand that puts nothing up after a stop."""

    def __init__(self, bench: Bench, hand: Placing) -> None:
        self._bench = bench
        self._hand = hand

    def place(self, name: str) -> None:
        """Put the next target up."""
        if self._bench.axis.is_stopped:
            raise Stopped("stopped")
        self._hand.place(name)

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:
        """Return its depth."""
        return self._hand.depth_mm(name)

    def place_again(self, name: str, *, of: str) -> None:
        """Put a target up again."""
        if self._bench.axis.is_stopped:
            raise Stopped("stopped")
        self._hand.place_again(name, of=of)


def run(bench: Bench, job: Job) -> None:
    """Do a job.

    Raises
    ------
    CalibError
        If it cannot be done, or Stop was pressed; the message says why.
    """
    doing: dict[type, Callable[[Bench, Any], None]] = {
        Check: _check,
        Capture: _capture,
        Pictures: take_pictures,
        Calibrate: _calibrate,
        Gaze: _gaze,
        Length: _length,
    }
    doing[type(job)](bench, job)


def title(job: Job) -> str:
    """Return a job's name as pages show it."""
    name = type(job).__name__
    return f"{name}: {KINDS[job.kind]}" if isinstance(job, Pictures) else name


def look_around(bench: Bench) -> None:
    """Publish what lies in the folders already."""
    found = read_check(check_path(bench.places.rig_file), serial=bench.rig.serial)
    if found is not None:
        bench.record.put(check=found.model_dump(mode="json"))
    _count_rows(bench)
    count_pictures(bench)
    _list_run(bench)


def _check(bench: Bench, _: Check) -> None:
    if bench.board is None:
        raise UsageError("rig.toml has no [board]; add the board that C2 is to look at")
    bench.hand("board").place("check")
    found = check_rig(
        bench.rig,
        bench.board,
        lens_c2=known_lens(bench.rig, "c2"),
        announce=lambda what: _step(bench, what),
    )
    path = check_path(bench.places.rig_file)
    write_bytes(path, check_text(found).encode())
    bench.record.put(check=found.model_dump(mode="json"))
    for one in found.failed:
        bench.record.tell(f"{one.name}: {one.detail}", bad=True)
    if not found.failed:
        bench.record.tell(f"the rig is fit; u of a reading {found.u_alpha2_deg:.5f} deg")


def _capture(bench: Bench, job: Capture) -> None:
    at = bench.target(job.target)
    known = describe(bench.rig, u_alpha2_deg=reading_uncertainty(bench.rig, bench.places.rig_file))
    with growing(bench.places.dataset) as folder:
        manifest = read_manifest(folder)
        if manifest is not None:
            refuse_other(manifest, known)
        if source_of(manifest, job.kind, None) != "hand":
            raise UsageError(
                f"the rows of [{job.kind}] have their depths by pictures; go on with "
                "`calib capture`"
            )
        hand = _StoppableHand(bench, bench.hand(job.target))
        capture = CaptureSettings(
            gazer=bench.gazer(at, lens_c2(known, manifest, folder)),
            hand=hand,
            reference=ByHand(hand, U_Z_MM),
            folder=folder,
            known=known,
            kind=job.kind,
            announce=lambda text: _captured(bench, text, job),
            u_return_rad=return_uncertainty(bench.rig, bench.places.rig_file),
        )
        _captured(bench, "", job)
        ended = capture_rows(capture, count=job.count)
    _count_rows(bench)
    bench.axis.refuse_stopped()
    if ended.rows < job.count:
        raise RigError(f"{ended.refused} targets were refused, the last ones in a row")
    bench.record.tell(f"{bench.places.dataset}: {counted(ended.rows, 'row')} in {capture.table}")


def _captured(bench: Bench, text: str, job: Capture) -> None:
    if text:
        bench.record.tell(text)
    _count_rows(bench)
    rows = (bench.record.get("rows") or {}).get(job.kind, 0)
    _step(bench, f"{job.kind} rows", done=rows, of=job.count)


def _calibrate(bench: Bench, _: Calibrate) -> None:
    """Run the chain as a process of its own: it takes minutes and all of a core."""
    places = bench.places
    command = [*bench.calib, "calibrate", str(places.dataset), "--out", str(places.run)]
    chain = subprocess.Popen(  # noqa: S603 - the program itself, with folders as arguments
        command,
        env={**os.environ, **ending_with_this()},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
    said: list[str] = []
    reader = threading.Thread(target=_read_stages, args=(bench, chain, said), daemon=True)
    reader.start()
    try:
        while chain.poll() is None and not bench.axis.is_stopped:
            reader.join(POLL_S)
    finally:
        _end(chain)
        reader.join(GRACE_S)
        if chain.stderr is not None:
            chain.stderr.close()
    if bench.axis.is_stopped:
        raise Stopped("stopped; the stages that were finished are kept")
    _list_run(bench)
    if chain.returncode not in (DONE, GATE_FAILED_STATUS):
        raise UsageError("; ".join(said[-3:]) or f"the chain ended with status {chain.returncode}")
    bench.use(places.run / "calibration.json")
    if chain.returncode == GATE_FAILED_STATUS:
        bench.record.tell("calibrated, but a gate failed: see the report", bad=True)
    else:
        bench.record.tell("calibrated, all gates passed")


def _read_stages(bench: Bench, chain: subprocess.Popen[str], said: list[str]) -> None:
    """Publish each stage that the chain names; keep what it complains of."""
    count = 0
    for text in chain.stderr or ():
        if text.startswith("  "):
            count += 1
            _step(bench, text.strip(), done=count)
        else:
            said[:] = [*said[-9:], text.strip().removeprefix("calib: ")]


def _end(chain: subprocess.Popen[str]) -> None:
    """End the chain's process if it still runs, gently first."""
    if chain.poll() is None:
        chain.terminate()
        try:
            chain.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            chain.kill()
            chain.wait()


def _gaze(bench: Bench, job: Gaze) -> None:
    known = _calibrated(bench)
    at = bench.target(job.target)
    gazer = bench.gazer(at, known.c2, known.c1)
    for number in range(1, job.count + 1):
        bench.axis.refuse_stopped()
        name = f"t{len(bench.csv) + 1:02d}"
        _step(bench, name, done=number - 1, of=job.count)
        if bench.rig.world is not None or job.count > 1:
            bench.hand(job.target).place(name)
        try:
            row = gazer.gaze(known.aiming, depth_mm=bench.last_mm)
            found = position(known.measuring, row, model=MODEL)
            if found.faults:
                raise RigError(found.faults[0])
        except RigError as error:
            bench.axis.refuse_stopped()
            bench.csv.append(refused(name, str(error)))
            bench.record.add("measurements", {"id": name, "status": str(error)})
            bench.record.tell(f"{name}: {error}", bad=True)
            continue
        bench.last_mm = float(found.position_mm[0, 2])
        bench.csv.append(
            line(
                name, row, found,
                calibrated_mm=known.measuring.calibrated_mm, gate_failed=known.gate_failed,
            )
        )  # fmt: skip
        bench.record.add("measurements", _shown(name, row, found, known))


def _shown(name: str, row: GazeRow, found: Positions, known: RigCalibration) -> dict[str, Any]:
    """Return a measurement as pages show it."""
    beyond = is_extrapolated(found.position_mm[:, 2], known.measuring.calibrated_mm)
    interval = [float(found.low95_mm[0]), float(found.high95_mm[0])]
    return {
        "id": name,
        "xyz_mm": found.position_mm[0].tolist(),
        "u_mm": found.std_mm[0].tolist(),
        "z95_mm": [end if math.isfinite(end) else None for end in interval],
        "alpha2_deg": float(np.degrees(row.standstill.reading_rad)),
        "moves": row.moves,
        "age_ms": max(seen.age_ms for seen in (*row.c1, *row.c2)),
        "ellipse": ellipse95(found.covariance_mm2[0]),
        "status": status_of(beyond, gate_failed=known.gate_failed),
    }


def _length(bench: Bench, job: Length) -> None:
    if job.start == job.end:
        raise UsageError("the length between a point and itself: name two targets")
    known = _calibrated(bench)
    ends = bench.target(job.start), bench.target(job.end)
    name = f"l{len(bench.lengths_csv) + 1:02d}"
    _step(bench, f"{job.start} to {job.end}")
    if bench.rig.world is not None:
        bench.hand(job.start).place(name)
    gazer = bench.gazer(ends[0], known.c2, known.c1)
    try:
        found = gaze_length(gazer, known.aiming, known.measuring, ends, model=MODEL)
    except RigError as error:
        bench.axis.refuse_stopped()
        bench.lengths_csv.append(lengths.refused(name, ends, str(error)))
        entry = {"id": name, "from": job.start, "to": job.end, "status": str(error)}
        bench.record.add("lengths", entry)
        raise
    bench.lengths_csv.append(lengths.line(name, ends, found, gate_failed=known.gate_failed))
    bench.record.add(
        "lengths",
        {
            "id": name,
            "from": job.start,
            "to": job.end,
            "length_mm": found.length_mm,
            "u_mm": found.u_mm,
            "ends_mm": found.positions.position_mm.tolist(),
            "status": found.status(gate_failed=known.gate_failed),
        },
    )


def _calibrated(bench: Bench) -> RigCalibration:
    if bench.calibrated is None:
        raise UsageError("there is no calibration; calibrate first, or begin with a file")
    return bench.calibrated


def _step(bench: Bench, what: str, *, done: int | None = None, of: int | None = None) -> None:
    """Publish how far a job is; nothing goes on after a stop."""
    job = bench.record.get("job")
    if job is not None:
        bench.record.put(job={**job, "step": what, "done": done, "of": of})


def _count_rows(bench: Bench) -> None:
    folder = GrowingFolder(bench.places.dataset)
    counts = {kind: len(folder.rows(f"{kind}.csv")) for kind in ("gaze", "validation")}
    bench.record.put(rows=counts)


def _list_run(bench: Bench) -> None:
    """Publish which files there are, with a number that changes as they do."""
    found = []
    for name, words in RUN_FILES.items():
        path = bench.places.run / name
        if path.is_file():
            found.append({"name": name, "title": words, "at": path.stat().st_mtime_ns // 10**6})
    bench.record.put(files=found)
