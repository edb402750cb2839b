#!/usr/bin/env bash
# SCS, a solver that cvxpy requires and no fit calls, is left out: 150 MB.
# Rewrites requirements.lock and requirements-dev.lock from pyproject.toml (make lock). Needs network.
set -euo pipefail
cd "$(dirname "$0")/.."
[ -x .venv/bin/uv ] || .venv/bin/python -m pip install --quiet uv
common=(pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links
        --no-emit-package active-gazing-calib --no-emit-package scs --custom-compile-command "make lock" pyproject.toml)
.venv/bin/uv "${common[@]}" --group build -o requirements.lock
.venv/bin/uv "${common[@]}" --group build --group dev -c requirements.lock -o requirements-dev.lock
