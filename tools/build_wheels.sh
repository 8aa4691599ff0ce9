#!/usr/bin/env bash
# Builds the wheels of all packages into a folder. Usage: tools/build_wheels.sh VENV OUT
# VENV is what tools/setup.sh made; the wheel of the interfaces is taken from there.
set -euo pipefail
cd "$(dirname "$0")/.."

VENV=$1
OUT=$2

mkdir -p "$OUT"
rm -f "$OUT"/*.whl
cp "$VENV"/wheels/flowbothd_interfaces-*.whl "$OUT"
for build in src/*/setup.py; do
  package=$(dirname "$build")
  # setuptools packs whatever an earlier build has left there, removed modules included.
  rm -rf "$package/build"
  .uv/bin/uv build -q --wheel --no-build-isolation --python "$VENV/bin/python" --out-dir "$OUT" "$package"
  rm -rf "$package/build"
done
rm -f "$OUT/.gitignore"
