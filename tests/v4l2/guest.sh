#!/usr/bin/env bash
# Boots a Debian kernel under QEMU, loads vivid, vhci-hcd and uvcvideo, and runs `pytest -m vivid` in it, on this machine's files over 9p, read-only.
# QEMU simulates the processor (TCG), which works everywhere; QEMU_ACCEL=kvm is faster where it works.
# Downloads (the packages of QEMU by apt, and the kernel, 70 MB, by apt-get download, which checks its hash) are kept.
# Ends with 75 if the virtual machine cannot be had here (no packages, no boot), which says nothing about the tests.
set -euo pipefail
unavailable() { echo "vivid: $1" >&2; exit 75; }
cd "$(dirname "$0")/../.."
project=$PWD
cache=${NEARFIELD_CACHE_DIR:-$HOME/.cache/nearfield}/v4l2
mkdir -p "$cache"

for tool in qemu-system-x86_64 busybox kmod cpio; do
  command -v "$tool" >/dev/null || missing="${missing:-} $tool"
done
if [ -n "${missing:-}" ]; then
  echo "vivid: installing$missing"
  sudo=$([ "$(id -u)" = 0 ] || echo sudo)
  { $sudo apt-get update -qq &&
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends qemu-system-x86 busybox-static kmod cpio; } ||
    unavailable "apt cannot install$missing; install qemu-system-x86 busybox-static kmod cpio"
fi

# The kernel: the newest package of this Debian, unless one is kept already.
deb=$(ls -t "$cache"/linux-image-*.deb 2>/dev/null | head -n 1 || true)
kernel_package() { apt-cache depends linux-image-amd64 2>/dev/null | awk '/Depends:/ { print $2; exit }'; }
if [ -z "$deb" ]; then
  [ -n "$(kernel_package)" ] || [ "$(id -u)" != 0 ] || apt-get update -qq || true
  package=$(kernel_package)
  [ -n "$package" ] || unavailable "apt knows no linux-image-amd64; run apt-get update"
  echo "vivid: downloading $package"
  (cd "$cache" && apt-get download -qq -o APT::Sandbox::User="$(id -un)" "$package") || unavailable "apt cannot download $package; run apt-get update"
  deb=$(ls -t "$cache"/linux-image-*.deb | head -n 1)
fi

# Its modules: only those that are needed, in the order in which they are loaded.
kernel=$cache/$(basename "$deb" .deb)
if [ ! -e "$kernel/complete" ]; then
  rm -rf "$kernel" && mkdir -p "$kernel"
  dpkg --fsys-tarfile "$deb" | tar -x -C "$kernel" --wildcards './boot/vmlinuz-*' '*/modules/*/modules.*' '*/modules/*/kernel/drivers/media/*' \
    '*/modules/*/kernel/drivers/usb/*' '*/modules/*/kernel/drivers/virtio/*' '*/modules/*/kernel/drivers/video/*' \
    '*/modules/*/kernel/drivers/i2c/*' '*/modules/*/kernel/net/9p/*' '*/modules/*/kernel/fs/*'
  [ -d "$kernel/lib" ] || ln -s usr/lib "$kernel/lib"
  find "$kernel" -name '*.ko.xz' -exec xz -d {} +
  depmod -b "$kernel" "$(ls "$kernel/lib/modules")"
  touch "$kernel/complete"
fi
release=$(ls "$kernel/lib/modules")

# Kernels of numba for the processor that QEMU simulates (AVX2, half floats), compiled here: there it would take minutes.
kernels=(NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=)
echo "vivid: compiling"
env "${kernels[@]}" NUMBA_CACHE_DIR="$cache/numba" PYTHONPATH="$project:$project/server:$project/calibration:$project/protocol" \
  .venv/bin/python tests/v4l2/warm_kernels.py

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root
mkdir -p "$root"/{bin,dev,host,modules,proc,sys}
cp "$(command -v busybox)" "$root/bin/busybox"
cp tests/v4l2/guest_init "$root/init"
chmod +x "$root/init"
for module in virtio_pci 9pnet_virtio 9p vivid uvcvideo vhci-hcd; do
  modprobe -d "$kernel" -S "$release" --show-depends "$module" | awk '$1 == "insmod" { print $2 }'
done | awk '!seen[$0]++' | while read -r file; do
  cp "$file" "$root/modules/"
  basename "$file" >>"$root/modules/list"
done
{
  printf 'cd %q\n' "$project"
  printf 'export HOME=/tmp PATH=%q PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 TERM=dumb PYTEST_DISABLE_PLUGIN_AUTOLOAD=1\n' "$PATH"
  printf 'cp -a %q /tmp/numba; export NUMBA_CACHE_DIR=/tmp/numba %s\n' "$cache/numba" "${kernels[*]}"
  printf 'exec .venv/bin/python -m pytest -m vivid -p no:cacheprovider -p pytest_asyncio.plugin -p pytest_timeout --color=no --confcutdir=tests/v4l2 tests/v4l2'
  [ $# = 0 ] || printf ' %q' "$@"
  printf '\n'
} >"$root/command"
(cd "$root" && find . | cpio -o -H newc --quiet | gzip -1) >"$work/initrd"

echo "vivid: booting $release"
timeout 400 qemu-system-x86_64 -accel "${QEMU_ACCEL:-tcg,thread=multi}" -cpu max -smp 2 -m 2048 -display none -vga none -serial stdio -no-reboot -nic none -monitor none \
  -kernel "$kernel/boot/vmlinuz-$release" -initrd "$work/initrd" -append "console=ttyS0 loglevel=3 panic=-1 mitigations=off" \
  -virtfs local,path=/,mount_tag=hostroot,security_model=none,readonly=on,multidevs=remap </dev/null | tr -d '\r' | tee "$work/console" || true
result=$(sed -n 's/^guest: the tests ended with \([0-9]*\)$/\1/p' "$work/console" | tail -n 1)
if [ -z "$result" ]; then
  grep -q '^guest: files mounted' "$work/console" || unavailable "the virtual machine does not boot under QEMU"
  echo "vivid: the virtual machine ended before the tests did" >&2
  exit 1
fi
exit "$result"
