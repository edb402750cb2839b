"""Run as a program that a signal ends in mid-move: ximc's virtual controller, virtual cameras.

Says "moving" when the axis moves, then, in order, what the signal brings about.
"""

from __future__ import annotations

import math
import signal
import sys
import threading

from calib.rig.devices import open_rig
from calib.rig.settings import embedded


def say(*words):
    sys.stdout.write(" ".join(map(str, words)) + "\n")
    sys.stdout.flush()


def main(device):
    # Where this runs under nohup, a hang-up would be ignored from the start.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    settings = embedded().model_dump(exclude_none=True)
    settings["axis"] = {
        "driver": "ximc", "device": device, "reads": "counts", "resolution_deg": 0.05625,
        "full_step_deg": 0.9,
    }  # fmt: skip
    with open_rig(embedded().model_validate(settings)) as rig:
        controller = rig.axis._controller
        slow = controller._axis.get_move_settings()
        slow.Speed = 20
        controller._axis.set_move_settings(slow)
        stop = controller.stop
        controller.stop = lambda: (stop(), say("stop"))
        threading.Timer(0.3, say, ["moving"]).start()
        try:
            rig.axis.move(math.radians(135))
        except BaseException as error:
            say(type(error).__name__)
            rest = rig.axis.standstill()
            say("rests", math.degrees(rest.reading_rad))
            raise
        finally:
            say("files")


if __name__ == "__main__":
    main(sys.argv[1])
