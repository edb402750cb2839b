"""What changes makes exactly the stages run again that depend on it.

Evidence: property. The chains are short, see short_chain.py; fingerprints are those of full runs.
Lines of code are changed in a copy of the package that the fingerprints are pointed to.
"""

from __future__ import annotations

import importlib.metadata
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from short_chain import dataset, shorten

import calib.chain.calibrate
from calib.chain.calibrate import Options, calibrate
from calib.dataset.load import load_dataset
from calib.stages import fingerprint

OBSERVED = {"observations", "encoder direction", "base/linear", "base/convex"}
ROBUST = {f"{model}/robust" for model in ("base", "axis-offset", "axis-tilt", "encoder")}
POSTERIOR = {"base/posterior", "axis-offset/posterior"}
TOLD = {"base/identifiability", "axis-offset/identifiability"}
GROUPS = {"groups"}
AFTER = {
    "comparison", "diagnosis", "instrument", "average", "depths", "validation", "certified depths",
    "independent references",
}  # fmt: skip
GAZE = OBSERVED | ROBUST | POSTERIOR | TOLD | GROUPS | AFTER
ALL = GAZE | {"validation rows"}


def run(data: Path, out: Path, **options: object) -> set[str]:
    """Run the chain; return the stages that ran."""
    done = calibrate(
        load_dataset(data),
        out,
        Options(**options),  # type: ignore[arg-type] # by name
        announce=lambda _: None,
        progress=lambda *_: None,
        command="test",
    )
    return set(done.stages_run)


@dataclass(frozen=True)
class Case:
    """A finished run that a test may spoil."""

    data: Path
    out: Path

    def edit(self, file: str, old: str, new: str) -> None:
        path = self.data / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))


def without_files(patch: pytest.MonkeyPatch) -> None:
    """Write no report: it is written whatever has run, and these tests look at stages."""
    patch.setattr(calib.chain.calibrate, "write_outputs", lambda *_, **__: ())


def clear_caches() -> None:
    for function in (
        fingerprint._imports,
        fingerprint._is_module,
        fingerprint._closure,
        fingerprint._requirements,
        fingerprint.package_version,
        fingerprint.code_fingerprint,
    ):
        function.cache_clear()


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Point the fingerprints to a copy of the package; yield its folder."""
    real = Path(fingerprint.__file__).parents[1]
    copy = tmp_path_factory.mktemp("copy") / "calib"
    shutil.copytree(real, copy, ignore=shutil.ignore_patterns("__pycache__"))
    find = fingerprint._source

    def source(module: str) -> Path | None:
        path = find(module)
        return None if path is None else copy / path.relative_to(real)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fingerprint, "_source", source)
        patch.setattr(fingerprint, "__file__", str(copy / "stages" / "fingerprint.py"))
        clear_caches()
        yield copy
    clear_caches()


@pytest.fixture(scope="module")
def finished(copied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    data = dataset(folder / "data")
    assert (copied / "chain" / "calibrate.py").exists()
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        without_files(patch)
        assert run(data, folder / "out") == ALL
    return folder


@pytest.fixture
def case(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Case:
    shorten(monkeypatch.setattr)
    without_files(monkeypatch)
    shutil.copytree(finished, tmp_path / "case")
    return Case(tmp_path / "case" / "data", tmp_path / "case" / "out")


def test_nothing_changed(case: Case) -> None:
    assert run(case.data, case.out) == set()


INPUTS = {
    "a gaze row": ("gaze.csv", "486.5", "486.6", GAZE),
    # The comparison shows validation errors; its winner's instrument is the same.
    "a validation row": (
        "validation.csv",
        "900",
        "901",
        {
            "validation rows",
            "comparison",
            "average",
            "validation",
            "certified depths",
            "independent references",
        },
    ),
    "an uncertainty": ("dataset.toml", "u_x1c = 0.0002", "u_x1c = 0.0003", ALL),
    "an uncertainty of z": ("dataset.toml", "u_z_rel = 0.002", "u_z_rel = 0.003", GAZE),
    "a prior": (
        "dataset.toml",
        "[gaze]",
        "[priors]\naxis_z_mm = [0, 30]\n[gaze]",
        ROBUST | POSTERIOR | TOLD | GROUPS | AFTER,
    ),
    "words": ("dataset.toml", 'name = "rig"', 'name = "rig"\ntitle = "A rig"', set()),
    "a comment": ("dataset.toml", "format = 1", "format = 1  # the first", set()),
}


@pytest.mark.parametrize(("file", "old", "new", "stages"), INPUTS.values(), ids=INPUTS.keys())
def test_input_changed(case: Case, file: str, old: str, new: str, stages: set[str]) -> None:
    case.edit(file, old, new)
    ran = run(case.data, case.out)
    if stages == GAZE:
        # Of the setup only the gaze rows' own part may differ.
        ran -= {"validation rows"}
    assert ran == stages


def test_seed_changed(case: Case) -> None:
    assert run(case.data, case.out, seed=1) == POSTERIOR | AFTER


def test_depths_changed(case: Case) -> None:
    assert run(case.data, case.out, depths_mm=(300.0, 2000.0)) == {
        "average",
        "depths",
        "diagnosis",
        "independent references",
    }


CODE = {
    "fit/convex.py": {"base/convex"},
    "fit/importance.py": POSTERIOR | AFTER,
    "fit/compare.py": {"comparison", "average"},
    "fit/weights.py": {"comparison", "average"},
    "fit/identifiability.py": TOLD,
    "fit/group_check.py": GROUPS,
    "uncertainty/predictive.py": AFTER - {"comparison"},
    "uncertainty/mixture.py": {"average"},
    "geometry/plane.py": ALL,
    "geometry/misclosure.py": GAZE - {"observations"},
    "report/page.py": set(),
    "cli/console.py": set(),
    "images/mrcal/worker.py": set(),
}


@pytest.mark.parametrize(("file", "stages"), CODE.items(), ids=CODE.keys())
def test_line_of_code_changed(case: Case, copied: Path, file: str, stages: set[str]) -> None:
    with line_added(copied / file):
        assert run(case.data, case.out) == stages


@contextmanager
def line_added(path: Path) -> Iterator[None]:
    """Add a comment to a module's source for a while."""
    before = path.read_text()
    path.write_text(before + "# changed\n")
    clear_caches()
    try:
        yield
    finally:
        path.write_text(before)
        clear_caches()


def test_worker_of_mrcal_belongs_to_the_code_of_image_stages(copied: Path) -> None:
    before = fingerprint.code_fingerprint("calib.images.stages")
    with line_added(copied / "images" / "mrcal" / "worker.py"):
        assert fingerprint.code_fingerprint("calib.images.stages") != before


PACKAGES = {
    "cvxpy": {"base/convex"},
    "clarabel": {"base/convex"},  # cvxpy's solver, which calib does not import itself
    "emcee": POSTERIOR | AFTER,
    "weasyprint": set(),
}


@pytest.mark.parametrize(("package", "stages"), PACKAGES.items(), ids=PACKAGES.keys())
def test_package_changed(
    case: Case, package: str, stages: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "9.9" if name == package else real(name)
    )
    clear_caches()
    assert run(case.data, case.out) == stages
    monkeypatch.undo()
    clear_caches()


@pytest.mark.parametrize("other", [None, "('/opt/mrcal/__init__.py', 1, 2)"])
def test_mrcal_changed(copied: Path, other: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    assert copied.exists()
    before = fingerprint.code_fingerprint("calib.images.stages")
    monkeypatch.setattr(fingerprint, "mrcal_identity", lambda: other)
    clear_caches()
    changed = fingerprint.code_fingerprint("calib.images.stages")
    monkeypatch.undo()
    clear_caches()
    assert changed != before
    assert fingerprint.code_fingerprint("calib.images.stages") == before


def test_every_package_imported_has_a_version(copied: Path) -> None:
    root = copied
    modules = {
        ".".join(("calib", *p.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        for p in root.rglob("*.py")
    }
    # Drivers and what they need are extras; no stage of a run reaches them.
    modules = {m for m in modules if not m.startswith("calib.rig.drivers.")}
    packages = set().union(*(fingerprint._closure(m)[1] for m in modules))
    assert {"numpy", "scipy", "emcee", "cvxpy", "h5py", "cv2"} <= packages
    versions = fingerprint._versions(packages - {"mrcal"})
    missing = {name for name, version in versions.items() if version is None}
    assert not missing & packages, "a release of these would go unnoticed"
