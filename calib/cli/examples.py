"""An example or two for the help of each command."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "calib calibrate": (
        "calib calibrate datasets/xu-wang-2017",
        "calib calibrate datasets/my-rig --out reports/tuesday --depths 400 2500 --quiet",
    ),
    "calib batch": ("calib batch datasets/rig-a datasets/rig-b --out reports/batch --jobs 2",),
    "calib check": ("calib check datasets/my-rig", "calib check datasets/my-rig --json"),
    "calib verify": ("calib verify reports/my-rig",),
    "calib schema": ("calib schema dataset",),
    "calib measure": (
        "calib measure reports/my-rig/calibration.json readings.csv --out positions.csv",
        "calib measure reports/my-rig/calibration.json - --json",
    ),
    "calib export": ("calib export reports/my-rig/calibration.json --format opencv --out cameras",),
    "calib plan": ("calib plan datasets/my-rig --depth 800 1500 --rows 5",),
    "calib compare": ("calib compare reports/monday reports/tuesday --out change.html",),
    "calib history index": ("calib history index reports",),
    "calib history show": ("calib history show", "calib history show rig-a"),
    "calib history chart": ("calib history chart rig-a --out chart.svg",),
    "calib history page": ("calib history page",),
    "calib history check": (
        "calib history check reports/my-rig/calibration.json standard.toml readings.csv",
        "calib history check reports/my-rig/calibration.json standard.toml mornings.csv "
        "--gaze --rig rig.toml",
    ),
    "calib history due": ("calib history due rig-a --tolerance 5",),
    "calib capture intrinsics": ("calib capture intrinsics datasets/my-rig --rig rig.toml",),
    "calib capture stereo": ("calib capture stereo datasets/my-rig --rig rig.toml",),
    "calib capture sweep": ("calib capture sweep datasets/my-rig --rig rig.toml",),
    "calib capture gaze": ("calib capture gaze datasets/my-rig --count 20",),
    "calib capture validation": ("calib capture validation datasets/my-rig --count 10",),
    "calib gaze": ("calib gaze reports/my-rig/calibration.json --count 10 --out positions.csv",),
    "calib live": ("calib live --rig rig.toml --dataset datasets/my-rig",),
    "calib length": ("calib length reports/my-rig/calibration.json --count 5",),
    "calib rig check": ("calib rig check rig.toml",),
    "calib simulate": (
        "calib simulate datasets/example --seed 1 --rows 20",
        "calib simulate datasets/demo --seed 1 --images --set baseline_mm=120",
    ),
    "calib study": ("calib study --rigs 200 --jobs 4",),
    "calib completion": (
        "calib completion bash > ~/.local/share/bash-completion/completions/calib",
        "calib completion zsh > ~/.zfunc/_calib",
    ),
}


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parsers of commands, and of commands of commands."""
    nested = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not nested:
        yield parser
    for action in nested:
        for child in dict.fromkeys(action.choices.values()):
            yield from leaves(child)


def add_examples(parser: argparse.ArgumentParser) -> None:
    """Show the examples at the end of each command's help."""
    for leaf in leaves(parser):
        lines = EXAMPLES.get(leaf.prog, ())
        if lines:
            leaf.formatter_class = argparse.RawDescriptionHelpFormatter
            leaf.epilog = "examples:\n" + "\n".join(f"  {line}" for line in lines)
