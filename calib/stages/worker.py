"""Computes the stages asked for on standard input, until it ends: ``python -m`` of this module.

Whoever started it handles Ctrl-C, and takes it along when it dies.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from typing import IO, Any

from calib.core.errors import CalibError
from calib.core.parent import end_with_parent
from calib.stages.message import receive, send

ASKED_TO_END = 128 + signal.SIGTERM
"""Exit status of a worker that got SIGTERM, from its parent or from outside."""


def serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Answer each request: messages of progress, then one that ends it."""
    # It takes half a second and is not needed to be told to stop.
    from calib.stages.call import call_stage, function_at, input_types
    from calib.stages.stage_file import pack, unpack

    def progress(_: str, done: int, expected: int) -> None:
        send(replies, {"is": "progress", "steps": [done, expected]})

    def answer(header: dict[str, Any], content: bytes) -> bytes:
        function, sizes = function_at(header["target"]), header["sizes"]
        inputs: list[Any] = []
        for size, kind in zip(sizes, input_types(function, len(sizes)), strict=True):
            inputs.append(unpack(content[:size], kind))
            content = content[size:]
        return pack(call_stage(function, header["name"], inputs, header["settings"], progress))

    while (request := receive(requests)) is not None:
        try:
            ending, content = "outcome", answer(*request)
        except BrokenPipeError:
            raise
        except CalibError as error:
            ending, content = "refusal", str(error).encode()
        except Exception:
            ending, content = "defect", traceback.format_exc().encode()
        send(replies, {"is": ending}, content)


def main() -> None:
    """Serve, with all that libraries may print kept out of the replies."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(ASKED_TO_END))
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        serve(sys.stdin.buffer, replies)
    except BrokenPipeError:
        # Nobody is left to be told; nor can what is buffered be sent at exit.
        os._exit(1)


if __name__ == "__main__":
    main()
