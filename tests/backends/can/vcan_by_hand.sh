#!/bin/sh
# The backend on a real SocketCAN bus, where the kernel has none: vcan in a user-mode Linux. By hand, two minutes:
#
#     tests/backends/can/vcan_by_hand.sh [python]
#
# It unpacks Debian's user-mode-linux (apt-get download) into a directory of its own and boots it with this machine's
# file system, which it only reads. Nothing is installed, and no privilege is needed.
set -eu
here="$(cd "$(dirname "$0")/../../.." && pwd)"
python="$(command -v "${1:-python3}")"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
apt-get download -qq user-mode-linux
dpkg-deb -x user-mode-linux_*.deb uml
modules="$(dirname "$(find "$work/uml" -name kernel -type d | head -1)")/kernel"

cat >init <<END
#!/bin/sh
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t tmpfs tmp /dev/shm 2>/dev/null
export PATH="\$PATH:/usr/sbin:/sbin"
for each in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev drivers/net/can/vcan; do
  # finit_module, for not every machine has an insmod
  "$python" -c "import ctypes, sys; f = open(sys.argv[1]); sys.exit(-ctypes.CDLL(None).syscall(313, f.fileno(), b'', 0))" \
    "$modules/\$each.ko"
done
ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72
ip link set up vcan0
ip link set up lo
export HOME="$work" PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$here:$here/transports:$here/plugins:$here/backends:$here/tests"
cd "$here"
"$python" tests/backends/can/vcan_by_hand.py
echo "vcan: exit \$?"
halt -f 2>/dev/null || echo o >/proc/sysrq-trigger
END
chmod +x init
"$work"/uml/usr/bin/linux.uml rootfstype=hostfs root=/dev/root ro mem=1G init="$work/init" con=null con0=null,fd:1 \
  </dev/null 2>&1 | tee log
grep -q '^vcan: exit 0' log
