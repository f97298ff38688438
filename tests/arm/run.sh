#!/usr/bin/env bash
# Runs tests/arm/check.py on Linux for aarch64, under emulation on an x86-64 machine, as root (make test-arm).
# Needs Debian's packages qemu-user-static, proot and mmdebstrap. The system and the wheels (0.5 GB) stay in $ARM.
set -euo pipefail
cd "$(dirname "$0")/../.."
ARM=${ARM:-/tmp/sumo-env-arm}
PYTHON=${PYTHON:-python3}
for tool in qemu-aarch64-static proot mmdebstrap; do
  command -v "$tool" > /dev/null || { echo "$tool is missing: apt-get install qemu-user-static proot mmdebstrap" >&2; exit 1; }
done
mkdir -p "$ARM"
if ! test -e "$ARM/root/.done"; then
  rm -rf "$ARM/root"
  # runs no program of the other processor; libX11 and libGL are what SUMO's wheel expects of a system
  mmdebstrap --mode=root --architectures=arm64 --variant=extract \
    --include=python3.11,coreutils,libstdc++6,libx11-6,libxext6,libxrender1,libgl1 \
    --hook-dir=/usr/share/mmdebstrap/hooks/merged-usr bookworm "$ARM/root"
  touch "$ARM/root/.done"
fi
if ! test -e "$ARM/site/.done"; then
  rm -rf "$ARM/site" "$ARM/wheels"
  packages='gymnasium|libsumo|numpy|pillow|sumolib|cloudpickle|farama-notifications|typing[-_]extensions|pytest|pluggy|iniconfig|packaging|pygments'
  wanted=$(grep -iE "^($packages)==" requirements.lock)
  platforms=(--platform manylinux2014_aarch64 --platform manylinux_2_17_aarch64 --platform manylinux_2_27_aarch64 --platform manylinux_2_28_aarch64)
  common=(--only-binary=:all: "${platforms[@]}" --python-version 3.11 --implementation cp)
  $PYTHON -m pip download --quiet "${common[@]}" -d "$ARM/wheels" $wanted
  $PYTHON -m pip install --quiet --no-index --find-links "$ARM/wheels" --no-compile "${common[@]}" --target "$ARM/site" $wanted
  touch "$ARM/site/.done"
fi
# At the same path inside and outside: at another one SUMO cannot read its files.
rm -rf "$ARM/code"
mkdir "$ARM/code"
cp -r sumo_env networks tests "$ARM/code"
exec proot -q qemu-aarch64-static -r "$ARM/root" -b /proc -b /dev -b /sys -b /tmp -w "$ARM/code" /usr/bin/env -i \
  PATH=/usr/bin:/bin HOME=/tmp PYTHONPATH="$ARM/site:$ARM/code" OMP_NUM_THREADS=1 python3.11 -m tests.arm.check
