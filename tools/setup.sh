#!/usr/bin/env bash
# Sets up all that calib needs: Debian packages, a virtual environment, the locked set.
# Usage: tools/setup.sh runtime|dev. Called by make; running it again costs nothing.
set -euo pipefail
cd "$(dirname "$0")/.."
level=${1:?usage: tools/setup.sh runtime|dev}
venv=.venv

say() { printf 'setup: %s\n' "$*" >&2; }
fail() { say "$*"; exit 2; }

# mrcal (second intrinsics backend), Pango (PDF certificate), fonts; the tests also open pages in a
# browser and serve cameras on loopback addresses of their own (Aravis, iproute2).
packages=(python3-venv python3-mrcal libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0 fonts-dejavu-core)
[ "$level" = dev ] && packages+=(chromium poppler-utils git libaravis-0.8-0 iproute2)

installed() { dpkg-query -W -f='${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }

install_packages() {
    command -v apt-get >/dev/null 2>&1 && command -v dpkg-query >/dev/null 2>&1 || {
        say "no apt on this machine: the cross-check by mrcal and the PDF certificate need, in its own packages:"
        say "  ${packages[*]}"
        return 0
    }
    local missing=() p
    for p in "${packages[@]}"; do installed "$p" || missing+=("$p"); done
    [ ${#missing[@]} -eq 0 ] && return 0
    local as=()
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null 2>&1 || {
            say "these Debian packages are missing and there is no sudo; ask an administrator to run:"
            say "  apt-get install ${missing[*]}"
            return 0
        }
        as=(sudo)
    fi
    say "installing Debian packages: ${missing[*]}"
    "${as[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq || say "apt-get update failed; trying with the lists at hand"
    "${as[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null ||
        say "apt-get could not install ${missing[*]}; going on without"
}

find_python() {
    local p
    for p in "${PYTHON:-python3}" python3 /usr/bin/python3 python3.13 python3.12 python3.11; do
        if command -v "$p" >/dev/null 2>&1 &&
            "$p" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            printf '%s' "$p"
            return 0
        fi
    done
    return 1
}

lock=requirements.lock
[ "$level" = dev ] && lock=requirements-dev.lock
stamp=$venv/.ready-$level
wanted=$(cat "$lock" pyproject.toml tools/setup.sh | sha256sum)
# A virtual environment knows its own path.
in_place() { [ -x $venv/bin/calib ] && grep -qF "$(pwd -P)/" $venv/bin/calib; }
[ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && in_place && exit 0

install_packages
if ! $venv/bin/python -m pip --version >/dev/null 2>&1 || { [ -e $venv/bin/calib ] && ! in_place; }; then
    python=$(find_python) || fail "needs Python 3.11 or newer with venv; on Debian 12: apt-get install python3 python3-venv"
    say "creating $venv with $("$python" --version)"
    "$python" -m venv --clear $venv
fi
say "installing the locked packages ($lock)"
pip() { $venv/bin/python -m pip install --quiet --disable-pip-version-check "$@"; }
# The lock is the whole set: what cvxpy requires and no fit calls (SCS, 150 MB) is not in it.
pip --no-deps --require-hashes -r "$lock" ||
    fail "pip could not install them; is there a network, or a proxy to name in PIP_INDEX_URL?"
# Environments of earlier sets hold the distribution under its former name, and SCS.
$venv/bin/python -m pip uninstall --quiet --yes calib scs >/dev/null 2>&1 || true
pip --no-deps --no-build-isolation -e . || fail "pip could not install calib itself"
# The dev set contains the runtime set, pinned alike.
printf '%s' "$wanted" >"$stamp"
[ "$level" = dev ] && printf '%s' "$(cat requirements.lock pyproject.toml tools/setup.sh | sha256sum)" >$venv/.ready-runtime
say "ready"
