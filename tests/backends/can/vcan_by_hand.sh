#!/bin/sh
# The backend on a real SocketCAN bus, where the kernel has none: vcan in a user-mode Linux. By hand, a minute or two:
#
#     tests/backends/can/vcan_by_hand.sh [python]
#
# It unpacks Debian's user-mode-linux (apt-get download) into a directory of its own and boots it with this machine's
# file system, which it only reads. Nothing is installed, and no privilege is needed. The last line says what failed.
set -eu
here="$(cd "$(dirname "$0")/../../.." && pwd)"
python="$(command -v "${1:-python3}")"
work="$(mktemp -d)"
uml=""
trap '[ -z "$uml" ] || kill "$uml" 2>/dev/null || true; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
cd "$work"

fail() {
  echo "vcan: $1" >&2
  exit 1
}

apt-get download -qq user-mode-linux || fail "user-mode-linux cannot be downloaded; is there a Debian mirror (apt-get update)?"
dpkg-deb -x user-mode-linux_*.deb uml
modules="$(find "$work/uml" -name kernel -type d | head -1)"

cat >init <<END
#!/bin/sh
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t tmpfs tmp /dev/shm 2>/dev/null
export PATH="\$PATH:/usr/sbin:/sbin"
for each in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev drivers/net/can/vcan; do
  # finit_module, for not every machine has an insmod
  "$python" -c "import ctypes, sys; f = open(sys.argv[1]); sys.exit(-ctypes.CDLL(None).syscall(313, f.fileno(), b'', 0))" \
    "$modules/\$each.ko" || echo "vcan: module \$each was not loaded"
done
ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 && ip link set up vcan0 && ip link set up lo ||
  echo "vcan: vcan0 was not set up"
export HOME="$work" PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$here:$here/transports:$here/plugins:$here/backends:$here/tests"
cd "$here"
"$python" tests/backends/can/vcan_by_hand.py
echo "vcan: exit \$?"
halt -f 2>/dev/null || echo o >/proc/sysrq-trigger
END
chmod +x init
# The end of its console is no sign of success, nor is its own exit code, which is that of a machine that was halted.
timeout 900 "$work"/uml/usr/bin/linux.uml rootfstype=hostfs root=/dev/root ro mem=1G init="$work/init" con=null con0=null,fd:1 \
  </dev/null >log 2>&1 &
uml=$!
tail -f -n +1 --pid="$uml" log
wait "$uml" || true
grep -aq '^vcan: exit' log || fail "it did not run to its end within 15 minutes; the console above says how far it came"
failed="$(grep -a '^FAILED' log | cut -d: -f1 | cut -c8- | tr '\n' ',' | sed 's/,$//')"
grep -aq '^vcan: exit 0' log || fail "failed: ${failed:-before the first check; see above}"
echo "vcan: all passed"
