#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Installs the prepared wheel, every byte by its hash: sh install.sh PREPARED TARGET
set -eu
prepared=$1 target=$2
python3 -m venv "$target"
cd "$prepared"
pip="$target/bin/python -m pip install --quiet --no-cache-dir --disable-pip-version-check"
$pip --require-hashes --only-binary :all: -r requirements.lock
$pip --require-hashes --no-deps -r wheel.lock
