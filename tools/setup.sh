#!/usr/bin/env bash
# Makes .venv: system libraries, uv (in .uv), Python 3.11 or 3.12, the locked packages, our packages.
# Safe to run again: every step does only what is missing. Usage: tools/setup.sh [venv folder] [Python version]
set -euo pipefail
cd "$(dirname "$0")/.."

VENV=${1:-.venv}
PYTHONS=${2:-3.11 3.12}
UV_VERSION=0.13.9
export UV_LINK_MODE=${UV_LINK_MODE:-copy}
# Behind a proxy with a certificate of its own only the system's store knows it.
[ -s /etc/ssl/certs/ca-certificates.crt ] && export UV_SYSTEM_CERTS=${UV_SYSTEM_CERTS:-1}

say() { printf '== %s\n' "$*" >&2; }
fail() { printf 'setup: %s\n' "$*" >&2; exit 1; }

# Packages of Debian and Ubuntu whose absence shows; prints their names.
missing_packages() {
  local libraries
  libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p)
  for pair in libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1 libX11.so.6:libx11-6 \
              libudev.so.1:libudev1 libgomp.so.1:libgomp1; do
    case "$libraries" in *"${pair%%:*}"*) ;; *) echo "${pair#*:}" ;; esac
  done
  command -v g++ >/dev/null || echo g++
  # The interfaces compile against Python's headers, which Debian packages apart.
  python3 - <<'PYTHON'
import importlib.util, os, sys, sysconfig
if importlib.util.find_spec("ensurepip") is None:
    print("python3-venv")
if not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
    print("python3-dev")
PYTHON
}

install_system_packages() {
  local missing
  missing=$(missing_packages | tr '\n' ' ')
  [ -z "${missing// }" ] && return
  local command="apt-get install -y --no-install-recommends $missing"
  command -v apt-get >/dev/null || fail "these system packages are missing: $missing"
  if [ "$(id -u)" = 0 ]; then
    say "installing system packages: $missing"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive $command >/dev/null
  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    say "installing system packages with sudo: $missing"
    sudo apt-get update -qq && sudo DEBIAN_FRONTEND=noninteractive $command >/dev/null
  else
    fail "system packages are missing. Run this once, then try again:
    sudo apt-get update && sudo $command"
  fi
}

install_uv() {
  if ! .uv/bin/uv --version 2>/dev/null | grep -q " $UV_VERSION"; then
    say "installing uv $UV_VERSION into .uv"
    python3 -m venv .uv && .uv/bin/python -m pip install -q "uv==$UV_VERSION"
  fi
}

find_python() {
  tools/find_python.sh $PYTHONS && return
  local version=${PYTHONS%% *}
  say "no Python ${PYTHONS// / or } with headers here: uv fetches $version"
  .uv/bin/uv python install -q "$version" && .uv/bin/uv python find "$version" && return
  fail "no Python ${PYTHONS// / or } found, and none could be fetched. Install one with its headers, e.g. apt-get install python$version-dev"
}

# Whether the stamp $1 was written for the present content of the given files.
fresh() {
  local stamp=$1; shift
  [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(cat "$@" | sha256sum)" ]
}
stamp() { local stamp=$1; shift; cat "$@" | sha256sum >"$stamp"; }

install_locked_packages() {
  fresh "$VENV/.locked" requirements.lock && return
  if [ ! -x "$VENV/bin/python" ]; then
    local python; python=$(find_python)
    say "making $VENV with $python"
    .uv/bin/uv venv -q --python "$python" "$VENV"
  fi
  say "installing the locked packages"
  if "$VENV/bin/python" -c 'import sys; sys.exit(sys.version_info < (3, 12))'; then
    # PyBullet has no wheel here: it compiles for some minutes, and finds numpy only without isolation.
    say "(PyBullet compiles for Python 3.12: about five minutes)"
    .uv/bin/uv pip install -q --python "$VENV/bin/python" -c requirements.lock numpy setuptools wheel
  fi
  .uv/bin/uv pip install -q --python "$VENV/bin/python" --require-hashes \
    --no-build-isolation-package pybullet -r requirements.lock
  stamp "$VENV/.locked" requirements.lock
}

install_our_packages() {
  local sources=(src/flowbothd_interfaces/{CMakeLists.txt,package.xml,pyproject.toml,msg/*,srv/*,action/*})
  if [ ! -d "$VENV/wheels" ] || ! fresh "$VENV/.interfaces" "${sources[@]}"; then
    say "building flowbothd_interfaces (about a minute)"
    # The wheel stays: `make dist` and the test of an installation need it too.
    rm -rf "$VENV/wheels" "$VENV/.interfaces"
    PATH="$PWD/$VENV/bin:$PATH" AMENT_PREFIX_PATH="$PWD/$VENV" .uv/bin/uv build -q --wheel \
      --python "$VENV/bin/python" --no-build-isolation --out-dir "$VENV/wheels" \
      src/flowbothd_interfaces
    .uv/bin/uv pip install -q --python "$VENV/bin/python" --no-deps --reinstall --no-cache \
      "$VENV"/wheels/flowbothd_interfaces-*.whl
    stamp "$VENV/.interfaces" "${sources[@]}"
  fi
  local builds=(src/*/{setup.py,package.xml,pyproject.toml})
  if ! fresh "$VENV/.packages" "${builds[@]}"; then
    say "installing our packages"
    local editable=()
    for build in src/*/setup.py; do editable+=(-e "./$(dirname "$build")"); done
    .uv/bin/uv pip install -q --python "$VENV/bin/python" --no-build-isolation --no-deps "${editable[@]}"
    stamp "$VENV/.packages" "${builds[@]}"
  fi
}

for version in $PYTHONS; do
  case $version in 3.11 | 3.12) ;; *) fail "Python $version is not supported: choose PYTHON=3.11 or PYTHON=3.12" ;; esac
done
install_system_packages
install_uv
install_locked_packages
install_our_packages
