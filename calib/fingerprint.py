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
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from calib.mrcal_python import mrcal_identity

PACKAGE = "calib"

_NAME_ENDS = re.compile(r"[^\w.-]")

# Distributions that are not called as their module is.
_DISTRIBUTIONS = {"cv2": "opencv-contrib-python-headless"}


def digest(*parts: object) -> str:
    """Return the SHA-256, hex, of JSON-able parts."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _source(module: str) -> Path | None:
    """Return the file of a module of calib, or None if there is no such module."""
    spec = find_spec(module)
    return None if spec is None or spec.origin is None else Path(spec.origin)


@cache
def _imports(module: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the modules of calib and the packages that a module's source imports, anywhere."""
    path = _source(module)
    own: set[str] = set()
    foreign: set[str] = set()
    if path is None:
        return frozenset(), frozenset()
    for node in ast.walk(ast.parse(path.read_bytes())):
        for name in _imported(node):
            if name.split(".")[0] != PACKAGE:
                foreign.add(name.split(".")[0])
            elif _is_module(name):
                own.add(name)
    # A package's __init__ runs before its modules.
    parents = {name.rsplit(".", 1)[0] for name in own | {module} if "." in name}
    return frozenset(own | (parents - {module})), frozenset(foreign)


def _imported(node: ast.AST) -> Iterable[str]:
    """Return the names an import statement may mean: ``from a import b`` is a and a.b."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module is not None:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []


@cache
def _is_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


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
        own, foreign = _imports(current)
        packages |= foreign
        waiting.extend(own - seen)
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
    sources = {}
    for name in sorted(modules):
        path = _source(name)
        if path is not None:
            files = [path, *sorted(path.parent.glob("templates/*"))]
            sources[name] = [hashlib.sha256(f.read_bytes()).hexdigest() for f in files]
    return digest(sources, _versions(packages), platform.python_version())


def whole_code() -> str:
    """Return the hash of all source of calib: what the run as a whole depends on."""
    root = Path(__file__).resolve().parent
    files = sorted(p for p in root.rglob("*") if p.suffix in {".py", ".html", ".css", ".js", ".j2"})
    sources = {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    return digest(sources, platform.python_version())
