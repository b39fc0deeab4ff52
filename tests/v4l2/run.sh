#!/usr/bin/env bash
# Runs the tests marked `vivid`: against the kernel's virtual cameras (driver vivid) and virtual USB port (vhci-hcd), on this machine where its
# kernel has them and we may load them, else in a small virtual machine (QEMU without hardware help, Debian's own kernel) that sees this machine's files read-only.
# Arguments go to pytest. Nothing is a network device here: the virtual machine has none.
set -euo pipefail
cd "$(dirname "$0")/../.."

# Whether this kernel lets us have the virtual cameras; `was_loaded` then says whether they were here before.
load_vivid() {
  [ "$(id -u)" = 0 ] && [ -d "/lib/modules/$(uname -r)" ] || return 1
  was_loaded=$(lsmod | grep -c '^vivid ' || true)
  [ "$was_loaded" != 0 ] || modprobe -q vivid n_devs=2 node_types=0x1,0x1 multiplanar=1,2 num_inputs=1,1 input_types=0,0
}

load_vivid || exec tests/v4l2/guest.sh "$@"
echo "vivid: on this machine (kernel $(uname -r))"
modprobe -a vhci-hcd uvcvideo || echo "vivid: no virtual USB port here"
trap '[ "$was_loaded" != 0 ] || rmmod vivid' EXIT
.venv/bin/python -m pytest -m vivid --confcutdir=tests/v4l2 tests/v4l2 "$@"
