#!/usr/bin/env bash
# Sets up all that calib needs: Debian packages, a virtual environment, the locked set.
# Usage: tools/setup.sh runtime|dev. Called by make; running it again costs nothing.
set -euo pipefail
cd "$(dirname "$0")/.."
level=${1:?usage: tools/setup.sh runtime|dev}
venv=.venv

say() { printf 'setup: %s\n' "$*" >&2; }
fail() { say "$*"; exit 2; }

# Start scripts of an environment hold its path between double quotes, for /bin/sh; venv refuses colons.
case $PWD in
    *:* | *[\"\$\`\\[:cntrl:]]*)
        printf 'setup: the path of this folder, %q, has a quote, colon, $, backslash or control character: move or rename it\n' "$PWD" >&2
        exit 2 ;;
esac

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
ready() { [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && in_place; }
ready && exit 0

# Two at once would build one environment over the other. The lock dies with its process.
if command -v flock >/dev/null 2>&1; then
    exec 9>.setup.lock
    flock -n 9 || { say "another set-up is at work here; waiting for it"; flock 9; }
    ready && exit 0
fi

install_packages
if ! $venv/bin/python -m pip --version >/dev/null 2>&1 || { [ -e $venv/bin/calib ] && ! in_place; }; then
    python=$(find_python) || fail "needs Python 3.11 or newer with venv; on Debian 12: apt-get install python3 python3-venv"
    say "creating $venv with $("$python" --version)"
    "$python" -m venv --clear $venv
fi
say "installing the locked packages ($lock)"
words=$venv/.pip-words
pip() {
    local status=0
    $venv/bin/python -m pip install --quiet --disable-pip-version-check "$@" 9>&- 2>"$words" || status=$?
    cat "$words" >&2
    return $status
}
said() { grep -qiE "$1" "$words"; }
# Why pip failed, from its own words, which stand above. Without a network it also says that it found no version.
why() {
    if said 'no space left|disk quota'; then
        say "the disk is full: free 1 GB here and in ${TMPDIR:-/tmp}, and run again"
    elif said 'do not match the hashes|hash(es)? mismatch'; then
        say "a package is not the one that the lock names: a mirror or proxy changed it; install nothing from there"
    elif said 'certificate|ssl'; then
        say "the certificate of the index is not trusted; behind a proxy that opens TLS, name its authority in PIP_CERT"
    elif said 'failed to establish a new connection|name resolution|connection (refused|reset|timed out|aborted|broken)|network is unreachable|proxyerror|timed? ?out'; then
        say "the package index cannot be reached: is there a network, or a proxy to name in HTTPS_PROXY or PIP_INDEX_URL?"
    elif said '(401|403|407) client error'; then
        say "the package index refuses access: check PIP_INDEX_URL and its login"
    elif said 'no matching distribution|could not find a version|not a supported wheel'; then
        say "the index has no package for $($venv/bin/python --version) on $(uname -m): use Python 3.11 to 3.13 on x86-64 or ARM64, or another index"
    elif said 'permission denied|read-only file system'; then
        say "files may not be written: check who owns this folder and pip's cache"
    else
        say "its words are above"
    fi
}
# The lock is the whole set: solvers that cvxpy requires and no fit calls (210 MB) are not in it.
pip --no-deps --require-hashes -r "$lock" ||
    { why; fail "pip could not install the locked packages"; }
# Environments of earlier sets hold the distribution under its former name, and those solvers.
$venv/bin/python -m pip uninstall --quiet --yes calib scs highspy osqp sparsediffpy joblib >/dev/null 2>&1 || true
pip --no-deps --no-build-isolation -e . || { why; fail "pip could not install calib itself"; }
# Where Python may write no compiled modules beside sources, each start would compile them all anew.
$venv/bin/python -m compileall -q calib || true
# The dev set contains the runtime set, pinned alike.
printf '%s' "$wanted" >"$stamp"
[ "$level" = dev ] && printf '%s' "$(cat requirements.lock pyproject.toml tools/setup.sh | sha256sum)" >$venv/.ready-runtime
say "ready"
