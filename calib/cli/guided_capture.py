"""`calib capture intrinsics`, `stereo` and `sweep`: pictures of the board, guided."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.arguments import add_output, depth, positive
from calib.cli.rig_options import add_rig, last_check, opened
from calib.core.errors import UsageError, harmless
from calib.stages.output_guard import OutputKind

if TYPE_CHECKING:
    from calib.capture.guided import Ended, Guided
    from calib.rig.devices import RigDevices

DONE, NOT_ENOUGH = 0, 3

DATASET = OutputKind(
    is_folder=True,
    files=(("dataset.toml", ()), ("session.jsonl", (b'{"event": ',))),
    hidden=(".capture.lock",),
    is_dataset=True,
)

COUNTED = {"intrinsics": "pictures", "stereo": "pairs", "sweep": "placements of the board"}

KINDS = {
    "intrinsics": "each camera's own pictures of the board",
    "stereo": "pictures of one board by both cameras",
    "sweep": "pictures of C2 as it turns before a board at rest",
}


def add_commands(commands: Any) -> None:
    """Add the commands."""
    for kind, purpose in KINDS.items():
        add = commands.add_parser(kind, help=purpose)
        add_output(add, "dataset", kind=DATASET, metavar="DATASET", help="folder to add to")
        add_rig(add)
        if kind == "intrinsics":
            add.add_argument(
                "--camera", choices=("c1", "c2"), action="append",
                help="one of them; default: both, c1 first",
            )  # fmt: skip
        add.add_argument(
            "--count", type=positive, default=None, metavar="N",
            help=f"{COUNTED[kind]} after which to end even if more are needed; default: 40",
        )  # fmt: skip
        add.add_argument(
            "--depths", type=depth, nargs=2, metavar=("NEAR", "FAR"),
            help="depths to be measured, mm; default: 5 to 12 baselines",
        )  # fmt: skip
        add.add_argument(
            "--tolerance", type=_share, metavar="REL",
            help="of depth, in parts of it; default: that of the dataset's certificate, or 0.02",
        )  # fmt: skip
        add.set_defaults(run=_run)


def _share(text: str) -> float:
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError("between 0 and 1, such as 0.02 for 2 %")
    return value


def _run(arguments: argparse.Namespace) -> int:
    """Capture and return the exit status: 3 if less is known than needed."""
    from calib.capture.writer import growing

    with ExitStack() as stack:
        rig = stack.enter_context(opened(arguments.rig))
        folder = stack.enter_context(growing(arguments.dataset))
        ended = _capture(arguments, _guided(arguments, rig, folder))
    enough = True
    for what, one in ended.items():
        print(f"{harmless(str(arguments.dataset))}: {what}: {one.words}")
        enough &= one.is_done
    return DONE if enough else NOT_ENOUGH


def _capture(arguments: argparse.Namespace, guided: Guided) -> dict[str, Ended]:
    from calib.capture.intrinsics import capture_intrinsics
    from calib.capture.stereo import capture_stereo
    from calib.capture.sweep import capture_sweep

    need = _need(arguments, guided)
    if arguments.capture_command == "stereo":
        return {"stereo": capture_stereo(guided, need)}
    if arguments.capture_command == "sweep":
        check = last_check(arguments.rig, guided.rig.serial)
        settle = 0.0 if check is None else check.settle_s
        return {"sweep": capture_sweep(guided, need, settle_s=settle)}
    roles = arguments.camera or ["c1", "c2"]
    return {role: capture_intrinsics(guided, role, need) for role in roles}


def _need(arguments: argparse.Namespace, guided: Guided) -> Any:
    from calib.capture.description import read_manifest
    from calib.capture.guidance.need import need_for

    manifest = read_manifest(guided.folder)
    stated = None if manifest is None else manifest.certificate.tolerance
    tolerance = arguments.tolerance or (None if stated is None else stated.depth_rel)
    depths = None if arguments.depths is None else (min(arguments.depths), max(arguments.depths))
    return need_for(
        tolerance=tolerance,
        depths_mm=depths,
        baseline_mm=guided.rig.settings.nominal_baseline_mm,
    )


def _guided(arguments: argparse.Namespace, rig: RigDevices, folder: Any) -> Guided:
    from calib.capture import guided
    from calib.capture.description import describe, read_manifest, refuse_other
    from calib.capture.holding import holding_for
    from calib.capture.outline import FILE, OutlineFile
    from calib.capture.ready import reading_uncertainty
    from calib.rig.known import known_board

    board = known_board(rig)
    if board is None:
        raise UsageError("rig.toml has no [board]; add the board that is held before the cameras")
    turns = arguments.capture_command == "sweep"
    known = describe(rig, u_alpha2_deg=reading_uncertainty(rig, arguments.rig) if turns else 0.0)
    manifest = read_manifest(folder)
    if manifest is not None:
        refuse_other(manifest, known)
    path = Path(arguments.dataset) / FILE
    if rig.world is None:
        _tell(f"fill the outline in {harmless(str(path))}, which is renewed as you move")
    return guided.Guided(
        rig=rig,
        board=board,
        holding=holding_for(rig, _tell, done=len(folder.events("view"))),
        folder=folder,
        known=known,
        announce=_tell,
        show=OutlineFile(path).show,
        count=arguments.count or guided.VIEWS_MAX,
    )


def _tell(line: str) -> None:
    print(harmless(line), file=sys.stderr, flush=True)
