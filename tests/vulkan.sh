#!/usr/bin/env bash
# Sees to it that there is a Vulkan driver for the tests of the GPU twin: a GPU's, or Mesa's in software.
set -euo pipefail
shopt -s nullglob

drivers=(/usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json)
loader=$(ldconfig -p 2>/dev/null | grep -c 'libvulkan\.so' || true)
if [[ $(uname) != Linux ]] || ((${#drivers[@]} > 0 && loader > 0)); then
  exit 0
fi
if [[ $EUID -eq 0 ]] && command -v apt-get >/dev/null; then
  echo "no Vulkan driver found: installing Mesa's software driver for the tests of the GPU twin" >&2
  apt-get update -qq
  apt-get install -y -qq libvulkan1 mesa-vulkan-drivers >/dev/null
else
  echo "no Vulkan driver found: install libvulkan1 and mesa-vulkan-drivers (Debian's names)," \
    "or set FUSE_NO_GPU_TESTS=1 to leave the tests of the GPU twin out" >&2
  [[ -n ${FUSE_NO_GPU_TESTS:-} ]] || exit 2
fi
