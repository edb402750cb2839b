#!/usr/bin/env bash
# Adds the extra `web`, what `calib live` needs, to .venv, pinned as in requirements-dev.lock.
# Called by `make live` after setup.sh; running it again costs nothing.
set -euo pipefail
cd "$(dirname "$0")/.."
packages="anyio click h11 idna starlette uvicorn websockets"
.venv/bin/python -c 'import starlette, uvicorn, websockets' 2>/dev/null && exit 0
lock=$(mktemp)
trap 'rm -f "$lock"' EXIT
awk -v names=" $packages " '/^[a-z0-9]/ { split($1, name, "=="); on = index(names, " " name[1] " ") } on' \
    requirements-dev.lock >"$lock"
echo "setup: installing $packages" >&2
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r "$lock" || {
    echo "setup: pip could not install what the page needs; its words are above" >&2
    exit 2
}
