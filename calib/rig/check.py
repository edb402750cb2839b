"""The check of a rig before it is used: what would spoil rows is found by C2's own pictures.

A board at rest is all it needs. C2 turns before it, and its pictures are held against the readings:
the direction and size of a step, play, how long C2 trembles, whether a picture asked for after a
move was exposed after it, and how well C2 comes back.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.geometry.camera import Camera, normalise
from calib.rig.check_file import Check, Devices, FrameAge, RigCheck
from calib.rig.clock import NS_PER_S, wait
from calib.rig.devices import RigDevices
from calib.rig.looking import Curve, Look, Looking, columns, curve
from calib.rig.protocols import Camera as CameraDevice
from calib.rig.protocols import Refused

SWEEP_STEPS: Final = 33
"""Readings of the fine sweep, one motor step apart: two full steps of 16 microsteps."""

WHOLE_STEPS: Final = 15
"""Whole steps of the motor at which C2 is looked through where it will rest at these."""

RETURNS: Final = 10
AWAY_RAD: Final = float(np.deg2rad(3.0))
"""How far C2 goes between returns; more than any play."""

PAUSES_S: Final = (0.0, 0.4, 1.2)
"""Before moves after which a picture must be new: a queue of frames fills while nobody asks."""

SETTLE_FRAMES: Final = 16
"""Pictures after a move among which the last third tells where C2 comes to rest."""

SETTLE_FACTOR: Final = 1.5
"""On the time after which C2 was seen to tremble no more: pictures are few."""

ASK_AHEAD_S: Final = 0.2
"""A frame is asked for that begins so much later: it cannot be handed out before."""

SETTLE_MAX_S: Final = 0.5
"""C2 that trembles longer is mounted loosely."""

OLD_SHARE: Final = 0.1
"""A first picture off by more than this share of the move before it is an old one."""

STEP_TOLERANCE: Final = 0.2
"""C2's centre stands off its axis, so that a near board turns by some 5 % more or less."""

STILL_RAD: Final = 5e-5
"""Tremor below this is noise: 0.03 px at 600 px focal length."""

Announce = Callable[[str], None]


@dataclass(frozen=True)
class _Fresh:
    """What pictures after moves showed: worst share of the move that was missing, and tremor."""

    worst_share: float
    settle_s: float


def check_rig(
    rig: RigDevices,
    board: Board,
    *,
    lens_c2: Camera | None = None,
    announce: Announce = lambda _: None,
) -> RigCheck:
    """Return what is right and wrong with a rig; the board stands still before C2.

    Parameters
    ----------
    lens_c2
        C2's lens, as far as it is known: the size of a step is then held against the picture.
    announce
        Told what is done.

    Raises
    ------
    RigError
        If a device does not answer, the axis does not arrive, or C2 does not see the board.
    """
    looking = Looking(rig, board)
    announce("frames")
    ages, lies = _frames(rig)
    announce("looking for the board")
    look, slope = looking.centre(looking.find())
    centre = look.standing.reading_rad
    announce("pictures after moves")
    fresh = _fresh(looking, rig, centre, slope)
    looking.settle_s = fresh.settle_s
    announce("play")
    backlash = _backlash(looking, centre, slope)
    announce("steps")
    sweep = _sweep(looking, rig, centre)
    announce("returns")
    way = _approach_from(rig, backlash)
    returns = _returns(looking, centre, sweep.slope, way)
    whole = _at_whole_steps(looking, rig, centre)
    ratio = None if lens_c2 is None else -sweep.slope / _px_per_rad(lens_c2, look)
    checks = (
        _direction(sweep.slope),
        _step(ratio),
        _frame_check(lies, fresh),
        Check(
            name="standstill",
            passed=fresh.settle_s < SETTLE_MAX_S,
            detail=f"C2 is at rest {fresh.settle_s:.3f} s after the axis says so",
        ),
    )
    reading = max(sweep.std_rad, returns)
    used = reading if whole is None else max(whole.std_rad, returns)
    section = rig.settings.axis
    if section.reads != "counts":
        used = max(used, rig.axis.resolution_rad / math.sqrt(12))
    return RigCheck(
        serial=rig.serial,
        time=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        devices=Devices(c1=rig.c1.identity, c2=rig.c2.identity, axis=rig.axis.identity),
        reads=section.reads,
        checks=checks,
        direction=-1 if sweep.slope > 0 else 1,
        step_deg=_deg(rig.axis.step_rad),
        step_ratio=None if ratio is None else round(ratio, 6),
        backlash_deg=_deg(backlash),
        backlash_steps=round(backlash / rig.axis.step_rad, 3),
        settle_s=round(fresh.settle_s, 4),
        frame_age_ms=FrameAge(c1=round(ages[0], 3), c2=round(ages[1], 3)),
        repeatability_deg=_deg(returns),
        u_reading_deg=_deg(reading),
        whole_steps=whole is not None,
        u_alpha2_deg=_deg(used),
    )


def _frames(rig: RigDevices) -> tuple[tuple[float, float], list[str]]:
    """Return the ages of frames of C1 and C2, ms, and what was impossible about them."""
    lies: list[str] = []
    ages = []
    for name, camera in (("C1", rig.c1), ("C2", rig.c2)):
        found = [_one_frame(rig, camera, name, lies) for _ in range(3)]
        ages.append(float(np.median([age for age, _ in found])))
        if any(np.array_equal(a, b) for (_, a), (_, b) in pairwise(found)):
            lies.append(f"{name} hands out one and the same picture twice")
    return (ages[0], ages[1]), list(dict.fromkeys(lies))


def _one_frame(
    rig: RigDevices, camera: CameraDevice, name: str, lies: list[str]
) -> tuple[float, np.typing.NDArray[np.uint8]]:
    moment = rig.clock.now_ns() + round(ASK_AHEAD_S * NS_PER_S)
    frame = camera.after(moment, timeout_s=3.0)
    now = rig.clock.now_ns()
    if now < moment:
        lies.append(
            f"{name} hands out a frame {(moment - now) / 1e6:.0f} ms before the moment after which "
            "it was to be exposed"
        )
    if frame.exposed_ns < moment:
        lies.append(f"{name} hands out a frame that was exposed before the moment asked for")
    return max(0.0, (now - frame.exposed_ns) / 1e6), frame.pixels


def _fresh(looking: Looking, rig: RigDevices, centre: float, slope: float) -> _Fresh:
    """Return whether pictures after moves are new, and how long C2 trembles."""
    share, settle = 0.0, 0.0
    for i, pause in enumerate(PAUSES_S):
        # From one side and the other: an old picture shows C2 where it came from.
        start = centre - AWAY_RAD if i % 2 == 0 else centre + AWAY_RAD
        looking.look_from(start, approach=0)
        wait(rig.clock, pause)
        standing = looking.go(centre, approach=0)
        looks: list[Look] = []
        moment = standing.since_ns
        while len(looks) < SETTLE_FRAMES:
            look = looking.look(standing, moment)
            looks.append(look)
            moment = look.frame.exposed_ns + 1_000_000
        seen = [look for look in looks if look.is_seen]
        if len(seen) < SETTLE_FRAMES // 2:
            raise Refused("C2 loses the board while nothing moves; light it evenly")
        way, trembling = _trembling(seen, slope)
        share = max(share, way / AWAY_RAD)
        settle = max(settle, trembling)
    return _Fresh(share, SETTLE_FACTOR * settle)


def _trembling(looks: list[Look], slope: float) -> tuple[float, float]:
    """Return how far the first pictures are off, rad, and until when C2 trembles, s."""
    angle = columns(looks) / slope
    last = angle[-len(looks) // 3 :]
    away: FloatArray = np.abs(angle - np.median(last))
    limit = max(STILL_RAD, 5 * float(np.std(last)))
    restless = np.flatnonzero(away > limit)
    if not len(restless):
        return float(away[0]), 0.0
    ends = looks[min(int(restless[-1]) + 1, len(looks) - 1)]
    since = (ends.frame.exposed_ns - ends.standing.since_ns) / NS_PER_S
    return float(away.max()), float(since)


def _backlash(looking: Looking, centre: float, slope: float) -> float:
    """Return the play between reading and C2, rad."""
    sides: list[list[float]] = []
    for sign in (1, -1):
        found = []
        for _ in range(3):
            looking.go(centre - sign * AWAY_RAD, approach=0)
            look = looking.look_from(centre, approach=0)
            found.append(look)
        off = columns(found) / slope - np.array([f.standing.reading_rad for f in found])
        sides.append(off.tolist())
    return float(abs(np.median(sides[0]) - np.median(sides[1])))


def _approach_from(rig: RigDevices, backlash: float) -> float:
    """Return from how far below a reading C2 has to come, rad."""
    return max(1.5 * backlash + 2 * rig.axis.step_rad, 8 * rig.axis.step_rad)


def _sweep(looking: Looking, rig: RigDevices, centre: float) -> Curve:
    """Look from readings one motor step apart, upwards."""
    step = rig.axis.step_rad
    first = centre - step * (SWEEP_STEPS // 2)
    looking.go(first - AWAY_RAD, approach=0)
    looks = [looking.look_from(first + k * step) for k in range(SWEEP_STEPS)]
    return curve(looks, degree=3)


def _returns(looking: Looking, centre: float, slope: float, way: float) -> float:
    """Return the standard deviation of what C2 shows at one reading, rad, by `RETURNS` returns."""
    looks = []
    for k in range(RETURNS):
        looking.go(centre + AWAY_RAD * (0.3 + 0.07 * k) * (-1) ** k, approach=0)
        looking.go(centre - way, approach=0)
        looks.append(looking.look_from(centre))
    off = columns(looks) / slope - np.array([look.standing.reading_rad for look in looks])
    # So few returns understate it: the standard deviation of Student's t (GUM supplement 1, 6.4.9).
    return float(np.std(off, ddof=1) * math.sqrt((RETURNS - 1) / (RETURNS - 3)))


def _at_whole_steps(looking: Looking, rig: RigDevices, centre: float) -> Curve | None:
    """Look from whole steps of the motor, upwards, where rows will be taken at these."""
    section = rig.settings.axis
    if section.reads != "counts" or section.full_step_deg is None:
        return None
    full = math.radians(section.full_step_deg)
    standing = rig.axis.standstill()
    origin = standing.reading_rad - standing.counts * rig.axis.resolution_rad
    middle = round((centre - origin) / full)
    first = origin + full * (middle - WHOLE_STEPS // 2)
    looking.go(first - AWAY_RAD, approach=0)
    looks = [looking.look(looking.go(first + k * full)) for k in range(WHOLE_STEPS)]
    return curve([look for look in looks if look.is_seen], degree=5)


def _px_per_rad(lens: Camera, look: Look) -> float:
    """Return how fast the board crosses C2's picture by its lens, px by rad."""
    middle = np.nanmean(look.corners, axis=0)
    across = np.array([5.0, 0.0])
    ends = np.array([middle - across, middle + across])
    angles = np.arctan(normalise(lens, ends)[:, 0])
    return float(10.0 / (angles[1] - angles[0]))


def _direction(slope: float) -> Check:
    right = slope < 0
    detail = (
        "what C2 sees moves left as the reading grows"
        if right
        else "what C2 sees moves right as the reading grows: the encoder counts the wrong way; "
        "exchange its channels, or turn the direction in the controller"
    )
    return Check(name="encoder direction", passed=right, detail=detail)


def _step(ratio: float | None) -> Check:
    if ratio is None:
        return Check(name="step", passed=True, detail="not held against the picture: no lens of C2")
    right = abs(abs(ratio) - 1) < STEP_TOLERANCE
    detail = f"C2 turns by {abs(ratio):.3f} of what is read"
    if not right:
        detail += "; correct resolution_deg and step_deg in rig.toml, gears included"
    return Check(name="step", passed=right, detail=detail)


def _frame_check(lies: list[str], fresh: _Fresh) -> Check:
    faults = list(lies)
    if fresh.worst_share > OLD_SHARE:
        faults.append(
            f"a picture asked for after a move shows C2 {100 * fresh.worst_share:.0f} % of the way "
            "back: it was exposed before"
        )
    if faults:
        detail = "; ".join(faults) + "; drain the driver's queue, or trigger the camera"
        return Check(name="frame age", passed=False, detail=detail)
    return Check(
        name="frame age",
        passed=True,
        detail="pictures asked for after a move were exposed after it",
    )


def _deg(angle: float) -> float:
    """Return an angle in degrees, to a millionth."""
    return round(math.degrees(angle), 6)
