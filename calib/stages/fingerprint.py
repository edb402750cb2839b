"""Fingerprints: what a stage's result depends on, in one hash.

A stage depends on its inputs and settings, on the source of its module and of every module of
calib that it imports, and on the versions of the packages that those import. Change one and
exactly the stages that depend on it run again.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import platform
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from calib.core.mrcal_python import mrcal_identity

PACKAGE = "calib"

_NAME_ENDS = re.compile(r"[^\w.-]")

# Distributions that are not called as their module is.
_DISTRIBUTIONS = {
    "cv2": "opencv-contrib-python-headless", "PIL": "pillow", "yaml": "PyYAML",
}  # fmt: skip


def digest(*parts: object) -> str:
    """Return the SHA-256, hex, of JSON-able parts."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


_ROOT = Path(__file__).parents[1]


@cache
def _source(module: str) -> Path | None:
    """Return the file of a module of calib, or None if there is no such module.

    Looked for among the files: the import system would run the packages above it.
    """
    place = _ROOT.joinpath(*module.split(".")[1:])
    files = (place / "__init__.py", place.with_suffix(".py"))
    return next((path for path in files if path.is_file()), None)


@dataclass(frozen=True)
class _Code:
    """What a module's source imports, anywhere in it, and what it is.

    Parameters
    ----------
    modules, packages
        Modules of calib, and other packages.
    files
        SHA-256, hex, of the source and of the templates beside it.
    """

    modules: frozenset[str]
    packages: frozenset[str]
    files: tuple[str, ...]


@cache
def _imports(module: str) -> _Code:
    """Return what a module's source imports and is; nothing if there is no such module."""
    path = _source(module)
    own: set[str] = set()
    foreign: set[str] = set()
    if path is None:
        return _Code(frozenset(), frozenset(), ())
    tree = ast.parse(path.read_bytes())
    if module == PACKAGE:
        # Its names are looked up when they are used: no module reaches them by their package.
        tree.body = [node for node in tree.body if not _for_types_alone(node)]
    for node in _statements(tree):
        for name in _imported(node):
            if name.split(".")[0] != PACKAGE:
                foreign.add(name.split(".")[0])
            elif _is_module(name):
                own.add(name)
    # A package's __init__ runs before its modules.
    parents = {name.rsplit(".", 1)[0] for name in own | {module} if "." in name}
    files = [path, *sorted(path.parent.glob("templates/*"))]
    hashes = tuple(hashlib.sha256(f.read_bytes()).hexdigest() for f in files)
    return _Code(frozenset(own | (parents - {module})), frozenset(foreign), hashes)


_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
"""Where a statement holds others; expressions hold none, and make up nine tenths of a tree."""


def _statements(node: ast.AST) -> Iterable[ast.AST]:
    """Return all statements below `node`, at any depth."""
    for block in _BLOCKS:
        for statement in getattr(node, block, ()):
            yield statement
            yield from _statements(statement)


def _for_types_alone(node: ast.AST) -> bool:
    """Return whether a statement's body is read by type checkers and never run."""
    test = getattr(node, "test", None)
    return isinstance(node, ast.If) and isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"


def _imported(node: ast.AST) -> Iterable[str]:
    """Return the names an import statement may mean: ``from a import b`` is a and a.b."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module is not None:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []


@cache
def _is_module(name: str) -> bool:
    return _source(name) is not None


@cache
def _closure(module: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return all modules of calib that a module reaches, and the packages they import."""
    seen: set[str] = set()
    packages: set[str] = set()
    waiting = [module]
    while waiting:
        current = waiting.pop()
        if current in seen:
            continue
        seen.add(current)
        code = _imports(current)
        packages |= code.packages
        waiting.extend(code.modules - seen)
    return frozenset(seen), frozenset(packages)


@cache
def package_version(package: str) -> str | None:
    """Return the version of an installed package by its import name, None if it has none."""
    if package == "mrcal":
        return mrcal_identity()
    try:
        return importlib.metadata.version(_DISTRIBUTIONS.get(package, package))
    except importlib.metadata.PackageNotFoundError:
        return None


@cache
def _requirements(package: str) -> frozenset[str]:
    """Return the packages that an installed package cannot do without."""
    try:
        lines = importlib.metadata.requires(_DISTRIBUTIONS.get(package, package)) or []
    except importlib.metadata.PackageNotFoundError:
        return frozenset()
    return frozenset(_NAME_ENDS.split(line)[0] for line in lines if "extra ==" not in line)


def _versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Return the versions of packages and of all that they require, by name."""
    found: dict[str, str | None] = {}
    waiting = list(packages)
    while waiting:
        package = waiting.pop()
        if package not in found and package not in sys.stdlib_module_names:
            found[package] = package_version(package)
            waiting.extend(_requirements(package))
    return found


@cache
def code_fingerprint(module: str) -> str:
    """Return the hash of all code that a module's results depend on."""
    modules, packages = _closure(module)
    sources = {name: _imports(name).files for name in sorted(modules) if _source(name)}
    return digest(sources, _versions(packages), platform.python_version())


def whole_code() -> str:
    """Return the hash of all source of calib: what the run as a whole depends on."""
    root = Path(__file__).resolve().parents[1]
    files = sorted(p for p in root.rglob("*") if p.suffix in {".py", ".html", ".css", ".js", ".j2"})
    sources = {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    return digest(sources, platform.python_version())
