#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Runs the steps of the container's build without a container: sh deploy/container/check.sh
# What stays untested is the base image and the engine.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sh "$root/deploy/container/prepare.sh" "$work/prepared"
sh "$work/prepared/install.sh" "$work/prepared" "$work/opt"
cd "$work"
opt/bin/authguard doctor
opt/bin/authguard demo >/dev/null
# a wheel that is not the one that was prepared is not installed
printf 'x' >> "$(ls prepared/*.whl)"
if sh prepared/install.sh "$work/prepared" "$work/other" 2>/dev/null; then
  echo "a changed wheel was installed" >&2
  exit 1
fi
echo "container steps: as they must be"
