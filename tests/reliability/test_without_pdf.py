"""A certificate that cannot be made as PDF says so. Evidence: property."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from short_chain import dataset, shorten

from calib.certificate.forms import Forms
from calib.certificate.inputs import CertificateInputs
from calib.chain import outputs
from calib.cli.main import main
from calib.stages.manifest import end_outputs

REASON = "WeasyPrint's libraries are missing: libpango"


def test_missing_pdf_is_told_and_an_old_one_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shorten(monkeypatch.setattr)
    made = outputs.render_forms

    def without(inputs: CertificateInputs) -> Forms:
        return replace(made(inputs), pdf=None, pdf_missing=REASON)

    data, out = dataset(tmp_path / "data"), tmp_path / "out"
    (out / ".stages").mkdir(parents=True)
    (out / "certificate.pdf").write_text("of an earlier run")
    end_outputs(out, "", ["certificate.pdf"])
    monkeypatch.setattr(outputs, "render_forms", without)
    status = main(["calibrate", str(data), "--out", str(out)])
    told = capsys.readouterr()
    assert status == 0, told.err
    assert f"warning: no certificate.pdf: {REASON}" in told.out
    run = tomllib.loads((out / "run.toml").read_text())
    assert run["certificate"]["pdf_missing"] == REASON
    assert (out / "certificate.html").exists()
    assert not (out / "certificate.pdf").exists()
