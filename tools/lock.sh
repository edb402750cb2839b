#!/usr/bin/env bash
# Solvers that cvxpy requires, does without and no fit calls, with what they alone require, are left out: 210 MB.
# tools/audit.py names them.
# Rewrites requirements.lock and requirements-dev.lock from pyproject.toml (make lock). Needs network.
set -euo pipefail
cd "$(dirname "$0")/.."
[ -x .venv/bin/uv ] || .venv/bin/python -m pip install --quiet uv
left_out=()
for name in scs highspy osqp sparsediffpy joblib setuptools; do left_out+=(--no-emit-package "$name"); done
common=(pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links
        --no-emit-package active-gazing-calib "${left_out[@]}" --custom-compile-command "make lock" pyproject.toml)
.venv/bin/uv "${common[@]}" --group build -o requirements.lock
.venv/bin/uv "${common[@]}" --group build --group dev -c requirements.lock -o requirements-dev.lock
