"""A run on rows in poses, one reference depth each: what it says and what it leaves behind.

Evidence: simulated truth with groups that err by far more than rows do; properties of the files.
The chains are short, see short_chain.py.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_chain import shorten

from calib.cli.main import main
from calib.rows.observations import GROUP_SOURCE
from calib.simulate.rig import draw_rig
from calib.simulate.tables import draw_targets, observe

U_GROUP = 0.01
ERRORS = np.array([1.2, -0.8, 0.3, -1.4, 0.9, -0.5, 1.1, -0.8])
"""Of the poses, in units of it: no model's parameters take up such ups and downs."""

POSES, TARGETS = len(ERRORS), 5

MANIFEST = """\
format = 1
name = "poses"
[encoder]
resolution_deg = {step}
u_alpha2_deg = {noise}
[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = {u_x1c}
u_z_rel = {u_z_rel}
{groups}
"""


def dataset(folder: Path, groups: str) -> Path:
    """Write a dataset of a rig of the paper's form; `groups` is what the manifest says of them."""
    rng = np.random.default_rng(12)
    rig = draw_rig(rng, model="base", fixed={})
    depths = np.linspace(*rig.depth_range_mm, POSES)
    points = [
        draw_targets(rig, rng, count=TARGETS, depth_range_mm=(0.98 * z, 1.02 * z)) for z in depths
    ]
    rows = observe(rig, rng, np.concatenate(points)).observed
    z = rows.z_mm * (1 + U_GROUP * np.repeat(ERRORS, TARGETS))
    lines = ["id,group,x1c,y1c,alpha2_deg,z_mm"]
    for i in range(len(rows)):
        reading = f"{rows.x1c[i]:.6f},{rows.y1c[i]:.6f},{np.rad2deg(rows.alpha2_rad[i]):.8f}"
        lines.append(f"r{i},pose {i // TARGETS},{reading},{z[i]:.3f}")
    folder.mkdir()
    (folder / "gaze.csv").write_text("\n".join(lines) + "\n")
    (folder / "dataset.toml").write_text(
        MANIFEST.format(
            step=np.rad2deg(rig.resolution_rad),
            noise=np.rad2deg(rig.noise.encoder_rad),
            u_x1c=rig.noise.pixel_px / rig.c1.matrix[0, 0],
            u_z_rel=rig.noise.z_rel,
            groups=groups,
        )
    )
    return folder


@dataclass(frozen=True)
class Done:
    """A finished run."""

    folder: Path
    document: dict[str, Any]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Done]]:
    """Runs on the same rows, with the groups' error stated and not."""
    root, found = tmp_path_factory.mktemp("poses"), {}
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        for name, said in (("silent", ""), ("stated", f"u_z_group_rel = {U_GROUP}")):
            data, out = dataset(root / name, said), root / f"{name} out"
            assert main(["calibrate", str(data), "--out", str(out)]) == 0
            found[name] = Done(out, json.loads((out / "calibration.json").read_text()))
        yield found


def warned(done: Done) -> list[str]:
    return [text for text in done.document["warnings"] if "have a common error" in text]


def test_silence_is_warned_of_with_what_to_state(runs: dict[str, Done]) -> None:
    (text,) = warned(runs["silent"])
    size = float(text.split("u_z_group_rel = ")[1].split()[0])
    assert 0.5 * U_GROUP < size < 2 * U_GROUP
    assert "shared_by_rows" not in runs["silent"].document["measurement"]


def test_a_statement_widens_the_parameters_and_not_the_readings(runs: dict[str, Done]) -> None:
    silent, stated = (runs[name].document for name in ("silent", "stated"))
    assert not warned(runs["stated"])
    assert stated["fits"]["base/robust"]["diagnostics"]["noise_scale"] < 2
    assert silent["fits"]["base/robust"]["diagnostics"]["noise_scale"] > 2
    spread = [d["measurement"]["reading"]["alpha2_rad"]["width"] for d in (silent, stated)]
    assert spread[1] < 0.7 * spread[0]


def positions(path: Path, table: Path, *options: str, capsys: Any) -> list[dict[str, str]]:
    capsys.readouterr()
    assert main(["measure", str(path), str(table), *options]) == 0
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


def test_measure_names_the_source(
    runs: dict[str, Done], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table = runs["stated"].folder / "calibration.json", tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.01,0.0,88\nb,0.02,0.0,87\n")
    sources = positions(path, table, "--sources", capsys=capsys)
    lines = [row for row in sources if row["source"] == GROUP_SOURCE]
    assert [row["id"] for row in lines] == ["a", "b"]
    assert float(lines[0]["share_percent"]) > 10
    shares = sum(float(row["share_percent"]) for row in sources if row["id"] == "a")
    assert shares == pytest.approx(100, abs=0.1)
    assert len(positions(path, table, "--model", "average", capsys=capsys)) == 2
    # A program that does not know the new section finds the same uncertainty, less finely told.
    document = json.loads(path.read_text())
    del document["measurement"]["shared_by_rows"], document["integrity"]
    older = tmp_path / "older.json"
    older.write_text(json.dumps(document))
    new, old = (positions(p, table, "--allow-edited", capsys=capsys) for p in (path, older))
    for one, other in zip(new, old, strict=True):
        assert float(one["u_z_mm"]) == pytest.approx(float(other["u_z_mm"]), rel=1e-4)


def test_damaged_section_is_refused(
    runs: dict[str, Done], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads((runs["stated"].folder / "calibration.json").read_text())
    document["measurement"]["shared_by_rows"]["sources"].append("another")
    path, table = tmp_path / "calibration.json", tmp_path / "t.csv"
    path.write_text(json.dumps(document))
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.01,0.0,88\n")
    assert main(["measure", str(path), str(table)]) == 2
    assert "errors that rows share" in capsys.readouterr().err


def test_certificate_and_report_name_the_source(runs: dict[str, Done]) -> None:
    for name in ("certificate.html", "certificate.xml", "report.html"):
        assert GROUP_SOURCE in (runs["stated"].folder / name).read_text()
        assert GROUP_SOURCE not in (runs["silent"].folder / name).read_text()
    report = (runs["stated"].folder / "report.html").read_text()
    assert "that calibration rows of one group have in common" in report
