"""A whole dataset: each file read once, every fault collected, the files it rests on hashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Protocol, TypeVar

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset import manifest as spec
from calib.dataset.board_section import board_of
from calib.dataset.camera_file import MODEL_LIMIT_BYTES, read_camera
from calib.dataset.checks import faults
from calib.dataset.contents import Dataset
from calib.dataset.corner_cache import read_cache
from calib.dataset.doubts import doubts
from calib.dataset.excluded import excluded
from calib.dataset.faults import MANIFEST, MANIFEST_LIMIT_BYTES, parse_manifest
from calib.dataset.folder import (
    TABLE_LIMIT_BYTES,
    Folder,
    by_star,
    decode,
    fingerprint,
    matches,
    path_fault,
)
from calib.dataset.lens_section import stated_camera
from calib.dataset.messages import shortened, shown, text_fault
from calib.dataset.pictures import missing_sizes, picture_faults, with_sizes
from calib.dataset.readers import Scanned, scan_gaze, scan_lengths, scan_sweep
from calib.dataset.returns import scan_returns
from calib.dataset.tables import SweepTable
from calib.geometry.board import Board
from calib.geometry.camera import Camera

T = TypeVar("T")

_NOTHING: Mapping[str, FloatArray] = MappingProxyType({})


def load_dataset(root: Path, *, rows_to_come: bool = False) -> Dataset:
    """Return the dataset in a folder.

    Parameters
    ----------
    rows_to_come
        Whether gaze rows are still to be taken: few of them, none, or a table that is but a header
        are no fault then.

    Raises
    ------
    InputError
        With all its problems.
    """
    loading = _Loading(Folder.open(root), rows_to_come)
    dataset = loading.dataset()
    if dataset is None or loading.problems:
        raise InputError(loading.problems)
    digests = loading.folder.digests(loading.contents, loading.images)
    dataset = replace(
        dataset,
        sha256=fingerprint(digests),
        image_sha256={name: digests[name] for name in sorted(loading.images)},
    )
    return replace(dataset, warnings=(*loading.warnings, *doubts(dataset)))


def check_dataset(root: Path) -> tuple[Problem, ...]:
    """Return all problems of the dataset in a folder; none if it can be calibrated."""
    try:
        loading = _Loading(Folder.open(root))
    except InputError as error:
        return error.problems
    loading.dataset()
    return tuple(loading.problems)


class _Scan(Protocol[T]):
    """Reads the text of one kind of table."""

    def __call__(self, text: str, *, name: str) -> Scanned[T]: ...


@dataclass
class _Loading:
    """What has been read so far, and what is wrong with it.

    Parameters
    ----------
    folder
        The dataset's folder.
    rows_to_come
        Whether gaze rows are still to be taken.
    contents
        Bytes of the text files read, by relative name.
    images
        Images that exist, by relative name; read only to be hashed.
    problems, warnings
        Grow as the dataset is read.
    """

    folder: Folder
    rows_to_come: bool = False
    contents: dict[str, bytes] = field(default_factory=dict)
    images: set[str] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def dataset(self) -> Dataset | None:
        """Read the whole folder; None if that is impossible, else as far as the problems allow."""
        data = self.attempt(self._manifest)
        if data is None:
            return None
        parsed = parse_manifest(data)
        self.problems += parsed.problems
        tables = parsed.tables
        scan_rows = partial(scan_gaze, is_left=parsed.is_left, step_deg=parsed.step_deg)
        gaze = self._table(tables, "gaze", partial(scan_rows, by_board=True))
        validation = self._table(tables, "validation", scan_rows)
        sweep = self._table(tables, "sweep", scan_sweep)
        lengths = self._table(tables, "lengths", scan_lengths)
        returns = self._table(tables, "returns", scan_returns)
        manifest = parsed.manifest
        if manifest is None:
            return None
        board = None if manifest.board is None else board_of(manifest.board)
        cache = self._corner_cache(manifest.board, board)
        dataset = Dataset(
            root=self.folder.root,
            manifest=manifest,
            sha256="",
            gaze=gaze,
            validation=validation,
            sweep=self._sweep(sweep, manifest.sweep),
            lengths=lengths,
            returns=returns,
            board=board,
            images=self._intrinsic_images(manifest, cache),
            stereo_pairs=self._stereo_pairs(manifest.stereo, cache),
            cameras=self._cameras(manifest),
            corner_cache=cache,
            warnings=(),
            image_sha256={},
        )
        self._require_images(dataset)
        self.problems += picture_faults(dataset, self.folder.root, self.images)
        dataset = with_sizes(dataset, self.folder.root, self.images)
        self.problems += missing_sizes(dataset)
        self.problems += faults(dataset, rows_to_come=self.rows_to_come)
        return dataset

    def attempt(self, step: Callable[[], T]) -> T | None:
        """Return what a step returns; collect its problems and return None if it fails."""
        try:
            return step()
        except InputError as error:
            self.problems += error.problems
            return None

    def _manifest(self) -> bytes:
        if not (self.folder.root / MANIFEST).exists():
            raise InputError.single(
                where=str(self.folder.root),
                what=f"holds no {MANIFEST}",
                remedy="give the folder of a dataset; datasets/README.md says what is in it",
            )
        return self._bytes(MANIFEST, limit=MANIFEST_LIMIT_BYTES, where=MANIFEST)

    def _bytes(self, name: str, *, limit: int, where: str) -> bytes:
        data = self.folder.read(name, limit=limit, where=where)
        self.contents[name] = data
        return data

    def _text(self, name: str, *, limit: int, where: str) -> str:
        return decode(self._bytes(name, limit=limit, where=where), where=name)

    def _table(self, tables: Mapping[str, str], section: str, scan: _Scan[T]) -> T | None:
        """Return a section's table, faults or not; None if it has none that can be read."""
        name = tables.get(section)
        if name is None:
            return None
        where = f"{MANIFEST}, [{section}] table"
        text = self.attempt(lambda: self._text(name, limit=TABLE_LIMIT_BYTES, where=where))
        if text is None:
            return None
        # Returns may all have been struck, which leaves the header.
        may_be_empty = section == "returns" or (self.rows_to_come and section == "gaze")
        if may_be_empty and len(text.strip().splitlines()) == 1:
            return None
        scanned = self.attempt(lambda: scan(text, name=name))
        if scanned is None:
            return None
        self.problems += scanned.problems
        return scanned.table

    def _corner_cache(
        self, section: spec.BoardSection | None, board: Board | None
    ) -> Mapping[str, FloatArray]:
        """Return the corners found before; none if the manifest names no cache."""
        if section is None or section.corners is None or board is None:
            return _NOTHING
        name = section.corners
        where = f"{MANIFEST}, [board] corners"

        def read() -> Mapping[str, FloatArray]:
            text = self._text(name, limit=TABLE_LIMIT_BYTES, where=where)
            if text.strip() and (fault := text_fault(text, one_line=False)):
                remedy = "write it with mrgingham or calib"
                raise InputError.single(where=name, what=fault, remedy=remedy)
            try:
                cache = read_cache(text, board, where=name)
            except InputError as error:
                raise InputError(shortened(error.problems, where=name)) from error
            wrong = [(image, fault) for image in cache if (fault := path_fault(image))]
            remedy = "name images relative to the dataset folder"
            if wrong:
                problems = [Problem(where=name, what=fault, remedy=remedy) for _, fault in wrong]
                raise InputError(shortened(problems, where=name))
            return cache

        return self.attempt(read) or _NOTHING

    def _intrinsic_images(
        self, manifest: spec.Manifest, cache: Mapping[str, FloatArray]
    ) -> Mapping[str, tuple[str, ...]]:
        images = {}
        for name in spec.CAMERAS:
            camera = manifest.camera(name)
            if camera is not None and camera.images is not None:
                where = f"{MANIFEST}, [cameras.{name}] images"
                found = self._expand(camera.images, cache, where=where)
                out = self._excluded(camera.exclude, found, section=f"cameras.{name}")
                images[name] = tuple(image for image in found if image not in out)
        return MappingProxyType(images)

    def _excluded(
        self, names: tuple[str, ...], images: Sequence[str], *, section: str
    ) -> frozenset[str]:
        """Return the images of a section that its `exclude` leaves out."""
        out, problems = excluded(names, images, where=f"{MANIFEST}, [{section}] exclude")
        self.problems += problems
        return out

    def _expand(
        self, pattern: str, cache: Mapping[str, FloatArray], *, where: str
    ) -> tuple[str, ...]:
        """Return the images that a pattern names, in the folder or in the corner cache."""
        found = self.attempt(lambda: self.folder.expand(pattern, where=where))
        if found is None:
            return ()
        named = tuple(sorted({*found, *(name for name in cache if matches(name, pattern))}))
        if not named:
            what = f"no image matches {shown(pattern)}"
            remedy = self.folder.near_pattern(pattern)
            self.problems.append(Problem(where=where, what=what, remedy=remedy))
        return named

    def _stereo_pairs(
        self, stereo: spec.StereoSection | None, cache: Mapping[str, FloatArray]
    ) -> Mapping[str, tuple[str, str]]:
        """Return the pairs by their common name; an image without its partner is a warning.

        The name is the stem of both images, or, where no stems are common, what the stars in the
        two patterns' file names stand for: 01 of left01.jpg and right01.jpg.
        """
        if stereo is None or stereo.c1 is None or stereo.c2 is None:
            return MappingProxyType({})
        sides, starred = [], []
        for name, pattern in zip(spec.CAMERAS, (stereo.c1, stereo.c2), strict=True):
            where = f"{MANIFEST}, [stereo] {name}"
            images = self._expand(pattern, cache, where=where)
            sides.append(self._by_stem(images, where=where))
            starred.append(by_star(images, pattern))
        if not sides[0].keys() & sides[1].keys() and starred[0].keys() & starred[1].keys():
            sides = starred
        first, second = sides
        stems = sorted(first.keys() & second.keys())
        alone = len(first) + len(second) - 2 * len(stems)
        if first and second and not stems:
            pair = f"{shown(next(iter(first.values())))} and {shown(next(iter(second.values())))}"
            self.problems.append(
                Problem(
                    where=f"{MANIFEST}, [stereo]",
                    what=f"no image of c1 has a partner in c2: {pair} differ in their stems",
                    remedy="give both images of a pair the same name, in a folder for each camera, "
                    'or patterns whose stars stand for the same: "left*.png", "right*.png"',
                )
            )
        elif alone:
            self.warnings.append(f"[stereo]: {alone} image(s) without a partner are not used")
        named = [image for side in sides for image in side.values()]
        out = self._excluded(stereo.exclude, named, section="stereo")
        pairs = {stem: (first[stem], second[stem]) for stem in stems}
        return MappingProxyType({s: pair for s, pair in pairs.items() if not out & {*pair}})

    def _sweep(
        self, table: SweepTable | None, section: spec.SweepSection | None
    ) -> SweepTable | None:
        """Return the sweep without the images that are left out."""
        if table is None or section is None or not section.exclude:
            return table
        images = tuple(dict.fromkeys(table.image_c2))
        out = self._excluded(section.exclude, images, section="sweep")
        return table.only([i for i, image in enumerate(table.image_c2) if image not in out])

    def _by_stem(self, images: tuple[str, ...], *, where: str) -> dict[str, str]:
        stems: dict[str, str] = {}
        for image in images:
            other = stems.setdefault(PurePosixPath(image).stem, image)
            if other != image:
                what = f"{shown(other)} and {shown(image)} have the same stem"
                remedy = "rename one: the stem tells which pair an image belongs to"
                self.problems.append(Problem(where=where, what=what, remedy=remedy))
        return stems

    def _cameras(self, manifest: spec.Manifest) -> Mapping[str, Camera]:
        """Return the cameras that are given, by matrix or by model file."""
        cameras = {}
        for name in spec.CAMERAS:
            section = manifest.camera(name)
            if section is None:
                continue
            camera = self.attempt(partial(self._camera, section, name))
            if camera is not None:
                cameras[name] = camera
        return MappingProxyType(cameras)

    def _camera(self, section: spec.CameraSection, name: str) -> Camera | None:
        where = f"{MANIFEST}, [cameras.{name}] model"
        if section.image_size is not None and section.matrix is not None:
            return stated_camera(section, section.image_size)
        if section.model is None:
            return None
        text = self._text(section.model, limit=MODEL_LIMIT_BYTES, where=where)
        camera = read_camera(text, name=section.model, camera=name)
        if section.image_size not in (None, camera.image_size):
            raise InputError.single(
                where=f"{MANIFEST}, [cameras.{name}] image_size",
                what=f"{section.image_size} differs from {camera.image_size} in the model",
                remedy="leave image_size out, or name the model of this camera",
            )
        return camera

    def _require_images(self, dataset: Dataset) -> None:
        """Collect the images that exist; report those that neither exist nor have known corners."""
        named: dict[str, str] = {}
        for name, images in dataset.images.items():
            named |= dict.fromkeys(images, f"{MANIFEST}, [cameras.{name}] images")
        for pair in dataset.stereo_pairs.values():
            named |= dict.fromkeys(pair, f"{MANIFEST}, [stereo]")
        named |= dataset.row_images
        known = dataset.corner_cache
        problems = []
        for image, where in named.items():
            try:
                if self.folder.file(image, where=where).stat().st_size > 0:
                    self.images.add(image)
                    continue
                what, remedy = f"{shown(image)} is empty", "copy the image again"
                problems.append(Problem(where=where, what=what, remedy=remedy))
            except InputError as error:
                if image not in known or path_fault(image):
                    problems += error.problems
        absent = len(named) - len(self.images) - len(problems)
        if absent:
            self.warnings.append(f"{absent} image(s) are absent; their corners are in the cache")
        self.problems += shortened(problems, where="images")
