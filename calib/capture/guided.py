"""Guided captures: a pose is asked for, held, and its picture taken, until enough is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from calib.capture.description import Description
from calib.capture.guidance.asked import AskedPose, Role
from calib.capture.holding import Holding
from calib.capture.journal import now
from calib.capture.shutter import Finder, View
from calib.capture.writer import GrowingFolder
from calib.core.errors import EstimationError
from calib.core.version import __version__
from calib.core.words import counted
from calib.geometry.board import Board
from calib.images.detection.picture import Grey
from calib.rig.clock import NS_PER_S
from calib.rig.devices import RigDevices
from calib.rig.protocols import Frame, Refused

TIMEOUT_S: Final = 3.0

REFUSALS_MAX: Final = 5
"""Poses in a row that cannot be held before a capture ends."""

VIEWS_MAX: Final = 40
"""Pictures after which a capture ends even if more is asked for: what then is missing is not
pictures."""


class Guide(Protocol):
    """Knows what the pictures so far say, and which one to take next."""

    @property
    def noun(self) -> str:
        """What is counted: pictures, pairs, or placements of the board."""

    @property
    def count(self) -> int:
        """How many so far."""

    @property
    def u(self) -> float:
        """Standard uncertainty of what the pictures are taken for."""

    @property
    def needed(self) -> float:
        """What it is to be."""

    @property
    def unit(self) -> str:
        """Of both."""

    @property
    def is_done(self) -> bool:
        """Whether enough is known."""

    def ask(self) -> AskedPose:
        """Return the pose to hold the board at next."""

    def fault(self, views: Mapping[Role, View]) -> str:
        """Return why no picture is to be taken yet; "" if it is to be."""

    def take(self, views: Mapping[Role, View]) -> None:
        """Take pictures into account."""

    def refuse(self) -> None:
        """Never ask again for the pose asked for last."""


Show = Callable[[AskedPose | None, Mapping[Role, Grey], str], None]
"""Shows what is asked for in the newest pictures, and what keeps the shutter; None ends it."""


@dataclass(frozen=True)
class Guided:
    """What a guided capture needs.

    Parameters
    ----------
    rig
        Its devices.
    board
        The board that is held.
    holding
        Who holds it.
    folder
        Where pictures go.
    known
        What the manifest says of the rig.
    announce
        Told of each pose asked for, each picture, and what is refused.
    show
        Shows what is asked for.
    count
        Pictures after which to end in any case.
    """

    rig: RigDevices
    board: Board
    holding: Holding
    folder: GrowingFolder
    known: Description
    announce: Callable[[str], None]
    show: Show
    count: int = VIEWS_MAX


@dataclass(frozen=True)
class Shot:
    """A picture taken, and what it shows."""

    frame: Frame
    view: View


@dataclass(frozen=True)
class Ended:
    """How a capture ended: what was counted, what is known and needed, whether it is enough."""

    count: int
    noun: str
    u: float
    needed: float
    unit: str
    is_done: bool

    @property
    def words(self) -> str:
        """In a line."""
        known = f"u {self.u:.2g} {self.unit} of {self.needed:.2g} needed"
        return f"{counted(self.count, self.noun)}, {known}"


Taken = Callable[[Mapping[Role, Shot]], None]
"""Writes the pictures of a pose that is held."""


def capture_guided(guided: Guided, guide: Guide, roles: tuple[Role, ...], taken: Taken) -> Ended:
    """Take pictures until enough is known, or too many poses in a row cannot be held."""
    note_start(guided)
    refused = 0
    while not guide.is_done and guide.count < guided.count and refused < REFUSALS_MAX:
        asked = guide.ask()
        guided.announce(f"{guide.count + 1}: {asked.why} (needed: {asked.needed:.2g})")
        try:
            shots = await_view(guided, asked, roles, guide)
            guide.take({role: shot.view for role, shot in shots.items()})
        except (Refused, EstimationError) as error:
            refused += 1
            guide.refuse()
            guided.folder.note("refused", reason=str(error))
            guided.announce(f"{guide.count + 1}: {error}")
            continue
        taken(shots)
        refused = 0
    guided.show(None, {}, "")
    return Ended(guide.count, guide.noun, guide.u, guide.needed, guide.unit, guide.is_done)


def await_view(
    guided: Guided, asked: AskedPose, roles: tuple[Role, ...], guide: Guide
) -> dict[Role, Shot]:
    """Return the first pictures that the guide's shutter takes.

    Raises
    ------
    Refused
        If the board cannot be held as asked.
    Lost
        If a camera does not answer.
    """
    guided.holding.hold(asked)
    clock = guided.rig.clock
    began = clock.now_ns()
    finder = Finder(guided.board)
    while True:
        shots: dict[Role, Shot] = {}
        for role in roles:
            frame = _camera(guided, role).after(clock.now_ns(), timeout_s=TIMEOUT_S)
            shots[role] = Shot(frame, finder.view(frame.pixels))
        fault = guide.fault({role: shot.view for role, shot in shots.items()})
        guided.show(asked, {role: shot.frame.pixels for role, shot in shots.items()}, fault)
        if not fault:
            return shots
        guided.holding.wait(fault, (clock.now_ns() - began) / NS_PER_S)


def _camera(guided: Guided, role: Role) -> Any:
    return guided.rig.c1 if role == "c1" else guided.rig.c2


def note_start(guided: Guided) -> None:
    """Write into the journal with which devices a capture begins."""
    rig = guided.rig
    guided.folder.note(
        "start",
        time=now(),
        version=__version__,
        serial=rig.serial,
        devices={"c1": rig.c1.identity, "c2": rig.c2.identity, "axis": rig.axis.identity},
    )


def shot_journal(shots: Mapping[Role, Shot]) -> dict[str, Any]:
    """Return what the journal says of pictures."""
    return {
        role: {
            "serial": shot.frame.serial,
            "exposed_ns": shot.frame.exposed_ns,
            "sure": shot.frame.sure,
            "edge_px": round(shot.view.edge_px, 3),
        }
        for role, shot in shots.items()
    }
