"""Datasets in the mirror: the same rig with C2 on the other side, written decimal for decimal."""

from __future__ import annotations

import csv
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

import tomli_w

SIGN_CHANGES = ("x1c", "ctan_alpha2")
ODD = (
    "baseline_mm",
    "delta2_rad",
    "eccentricity_mm",
    "axis_tilt_z_rad",
    "gaze_roll_rad",
    "encoder_sin_rad",
    "effective_baseline_mm",
)
"""Parameters that change their sign when X of C1 does."""


def mirror_dataset(right: Path, left: Path) -> Path:
    """Write the mirror image of a dataset whose pictures, if any, are in a corner cache."""
    left.mkdir(parents=True)
    manifest = tomllib.loads((right / "dataset.toml").read_text())
    manifest["rig"] = {"c2": "left"}
    widths = {name: c["image_size"][0] for name, c in manifest.get("cameras", {}).items()}
    for section in ("gaze", "validation", "sweep"):
        if section in manifest:
            name = manifest[section]["table"]
            _write_table(right / name, left / name, widths)
    if "lengths" in manifest:
        name = manifest["lengths"]["table"]
        (left / name).write_bytes((right / name).read_bytes())
    for camera in manifest.get("cameras", {}).values():
        _mirror_camera(camera)
    _mirror_stereo(manifest.get("stereo", {}))
    for name, (mean, std) in manifest.get("priors", {}).items():
        manifest["priors"][name] = [-mean if name in ODD else mean, std]
    if "corners" in manifest.get("board", {}):
        _write_corners(right, left, manifest["board"], widths)
    (left / "dataset.toml").write_text(tomli_w.dumps(manifest))
    return left


def _mirror_stereo(stereo: dict[str, Any]) -> None:
    if "alpha2_deg" in stereo:
        stereo["alpha2_deg"] = float(180 - Decimal(str(stereo["alpha2_deg"])))
    for i, row in enumerate(stereo.get("transform", ())):
        row[:] = [-v if (i == 0) != (j == 0) else v for j, v in enumerate(row)]


def _mirror_camera(camera: dict[str, Any]) -> None:
    if "matrix" in camera:
        camera["matrix"][0][2] = camera["image_size"][0] - 1 - camera["matrix"][0][2]
    if len(camera.get("distortion", ())) > 3:
        camera["distortion"][3] *= -1


def _write_table(right: Path, left: Path, widths: dict[str, int]) -> None:
    with right.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        for column in row.keys() & set(SIGN_CHANGES):
            row[column] = str(-Decimal(row[column]))
        if "alpha2_deg" in row:
            row["alpha2_deg"] = str(180 - Decimal(row["alpha2_deg"]))
        for column, camera in (("u1_px", "c1"), ("u2_px", "c2")):
            if column in row:
                row[column] = str(widths[camera] - 1 - Decimal(row[column]))
    with left.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


def _write_corners(right: Path, left: Path, board: dict[str, Any], widths: dict[str, int]) -> None:
    """Write the cache with each row of corners from the other end: boards stay boards."""
    views: dict[str, list[list[str]]] = {}
    lines = (right / board["corners"]).read_text().splitlines()
    for line in lines:
        if not line.startswith("#"):
            views.setdefault(line.split()[0], []).append(line.split())
    written = [lines[0]]
    for name, corners in views.items():
        width = widths["c2" if "c2" in name or name.startswith("sweep") else "c1"]
        columns = board["columns"] if len(corners) > 1 else 1
        for first in range(0, len(corners), columns):
            for _, x, *rest in reversed(corners[first : first + columns]):
                u = x if x == "-" else str(width - 1 - Decimal(x))
                written.append(" ".join([name, u, *rest]))
    (left / board["corners"]).write_text("\n".join(written) + "\n")
