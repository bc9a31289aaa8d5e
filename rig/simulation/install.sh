#!/usr/bin/env bash
# What the simulated bench needs of Debian (or Ubuntu): the AVR's compiler and C library, simavr, make and a C compiler.
set -euo pipefail
packages=(gcc make libc6-dev gcc-avr avr-libc libsimavr-dev)
as_root() { if [[ $(id -u) -eq 0 ]]; then "$@"; else sudo -n "$@"; fi; }
missing=()
for package in "${packages[@]}"; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q "install ok installed" || missing+=("$package")
done
if [[ ${#missing[@]} -gt 0 ]]; then
    command -v apt-get >/dev/null || { echo "no apt-get here to install ${missing[*]}" >&2; exit 1; }
    quick=(-qq -o Acquire::Retries=1 -o Acquire::http::Timeout=15 -o Acquire::https::Timeout=15)
    as_root apt-get "${quick[@]}" update
    as_root env DEBIAN_FRONTEND=noninteractive apt-get "${quick[@]}" install -y --no-install-recommends "${missing[@]}"
fi
make -s -C "$(dirname "${BASH_SOURCE[0]}")" all
