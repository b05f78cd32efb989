#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Makes the folder that a container is built from: sh deploy/container/prepare.sh FOLDER
# Needs .venv (python3 dev.py setup): uv and the build backend are the locked ones.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
folder=$1
python="$root/.venv/bin/python"
PATH="$root/.venv/bin:$PATH"
mkdir -p "$folder"
rm -f "$folder"/*.whl
uv build --quiet --wheel --no-build-isolation --python "$python" --out-dir "$folder" "$root"
rm -f "$folder/.gitignore"
cp "$root/deploy/container/requirements.lock" "$root/deploy/container/install.sh" "$folder"
cd "$folder"
for wheel in *.whl; do
  printf './%s --hash=sha256:%s\n' "$wheel" "$(sha256sum "$wheel" | cut -d ' ' -f 1)"
done > wheel.lock
