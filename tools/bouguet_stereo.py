#!/usr/bin/env python3
"""Makes datasets/bouguet-stereo from the pictures in Debian's package opencv-doc.

Usage: tools/bouguet_stereo.py OUT [--deb FILE]

Needs Debian or Ubuntu (apt-get and dpkg-deb) and, without --deb, the network: the package has 96 MB
and is fetched into a temporary folder. Nothing is installed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path

PACKAGE = "opencv-doc"
PICTURE = re.compile(r"/opencv-doc/examples/data/(left|right)(\d\d)\.jpg$")
SIDES = {"left": "c1", "right": "c2"}
PAIRS = (*range(1, 10), *range(11, 15))

MANIFEST = '''\
format = 1
name = "bouguet-stereo"
title = "Stereo example of Bouguet's toolbox, 13 pairs as shipped by Debian"

[source]
citation = "J.-Y. Bouguet, Camera Calibration Toolbox for Matlab, fifth example"
url = "https://packages.debian.org/stable/opencv-doc"
license = "Apache-2.0 AND BSD-3-Clause (package opencv-doc)"
notes = """
Two cameras fixed to each other; there are no gaze rows, and alpha2_deg is a placeholder. Published
by Bouguet for 14 pairs, of which Debian ships 13, in his convention X_right = R X_left + T:
T = (-99.80, 1.12, 0.05) +- (0.14, 0.11, 0.50) mm,
om = (0.00669, 0.00452, -0.00350) +- (0.0027, 0.0031, 0.0003) rad,
left f 533.5, principal point (341.6, 235.2) px; right f 536.8 and 536.5, (326.3, 250.1) px.
"""

[published]                 # value and standard uncertainty; his +- are three of them
"c1_in_c2.rotation_x_rad" = [0.00669, 0.0009]
"c1_in_c2.rotation_y_rad" = [0.00452, 0.00103]
"c1_in_c2.rotation_z_rad" = [-0.00350, 0.0001]
"c1_in_c2.translation_x_mm" = [-99.80, 0.0467]
"c1_in_c2.translation_y_mm" = [1.12, 0.0367]
"c1_in_c2.translation_z_mm" = [0.05, 0.167]

[board]
type = "chessboard"
columns = 9
rows = 6
square_mm = 30.0

[cameras.c1]
image_size = [640, 480]
images = "c1/*.jpg"

[cameras.c2]
image_size = [640, 480]
images = "c2/*.jpg"

[stereo]
c1 = "c1/*.jpg"
c2 = "c2/*.jpg"
alpha2_deg = 90.0
'''


class DatasetError(Exception):
    """What keeps the dataset from being made, in words for the user."""


def main(arguments: list[str]) -> int:
    """Make the dataset; return the exit status."""
    parser = argparse.ArgumentParser(description="Makes the dataset bouguet-stereo.")
    parser.add_argument("out", type=Path, help="folder to create")
    parser.add_argument("--deb", type=Path, help="a copy of the package, instead of fetching it")
    asked = parser.parse_args(arguments)
    try:
        make(asked.out, asked.deb)
    except (DatasetError, OSError) as error:
        print(f"bouguet-stereo: {error}", file=sys.stderr)
        return 2
    return 0


def make(out: Path, deb: Path | None) -> None:
    """Write the dataset, whole or not at all."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out} exists already; remove it first")
    with tempfile.TemporaryDirectory() as scratch:
        pictures = read_pictures(deb or download(Path(scratch)))
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        for (camera, number), data in pictures.items():
            path = partial / camera / f"{number:02d}.jpg"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        (partial / "dataset.toml").write_text(MANIFEST, encoding="utf-8")
        partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def download(folder: Path) -> Path:
    """Fetch the package into the folder and return its file."""
    remedy = f"fetch {PACKAGE} by hand from https://packages.debian.org and pass it with --deb"
    apt = shutil.which("apt-get")
    if apt is None:
        raise DatasetError(f"there is no apt-get on this machine; {remedy}")
    done = subprocess.run(
        [apt, "download", PACKAGE], cwd=folder, capture_output=True, text=True, check=False
    )
    found = sorted(folder.glob("*.deb"))
    if done.returncode or not found:
        said = [line for line in done.stderr.splitlines() if line.startswith("E:")]
        raise DatasetError(
            f"apt-get could not download {PACKAGE}: {' '.join(said) or done.stderr.strip()}; run "
            f"apt-get update as root and check the network, or {remedy}"
        )
    return found[0]


def read_pictures(deb: Path) -> Mapping[tuple[str, int], bytes]:
    """Return the pictures of the package, by camera and number."""
    unpack = shutil.which("dpkg-deb")
    if unpack is None:
        raise DatasetError(
            "there is no dpkg-deb on this machine; make the dataset on Debian or Ubuntu"
        )
    pictures: dict[tuple[str, int], bytes] = {}
    command = [unpack, "--fsys-tarfile", str(deb)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        try:
            with tarfile.open(fileobj=process.stdout, mode="r|") as archive:
                for member in archive:
                    name = PICTURE.search(member.name)
                    if name and (file := archive.extractfile(member)):
                        pictures[SIDES[name[1]], int(name[2])] = file.read()
        except tarfile.TarError as error:
            raise DatasetError(f"{deb} is no readable Debian package") from error
    wanted = {(camera, number) for camera in SIDES.values() for number in PAIRS}
    if missing := sorted(wanted - pictures.keys()):
        camera, number = missing[0]
        raise DatasetError(
            f"{deb.name} lacks {len(missing)} of the {len(wanted)} pictures, among them number "
            f"{number} of {camera}; take the package of another release"
        )
    return {key: pictures[key] for key in sorted(wanted)}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
