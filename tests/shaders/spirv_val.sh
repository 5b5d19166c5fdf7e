#!/usr/bin/env bash
# Every shader, in both builds (shaders/texels.glsl), as the build compiles it, is valid SPIR-V in every Vulkan from 1.1 on; and so
# is what tests make of it (tests/layer/arithmetic.h).
#   tests/shaders/spirv_val.sh build/tests/as_gpus_round
set -euo pipefail
rounder=$(realpath "$1")
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
checked=0 failed=0
for shader in shaders/*/*.comp apps/embed/*.comp tests/*/*.comp; do
  for build in "" -DICLK_STORAGE_READS; do
    # shellcheck disable=SC2086 # no argument where there is none
    glslangValidator -V --target-env vulkan1.1 --quiet -Ishaders $build -o "$out/a.spv" "$shader"
    "$rounder" "$out/a.spv" "$out/b.spv"
    spirv-val --target-env vulkan1.1 "$out/b.spv" || { echo "$shader $build: not valid as GPUs round"; failed=1; }
    for environment in vulkan1.1 vulkan1.2 vulkan1.3; do
      checked=$((checked + 1))
      spirv-val --target-env $environment "$out/a.spv" || { echo "$shader $build: not valid in $environment"; failed=1; }
    done
  done
done
echo "$checked checked"
[ "$failed" = 0 ] && [ "$checked" -gt 300 ]
