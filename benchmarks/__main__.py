"""Run every benchmark, or those named: `make bench`, `make bench ARGS="scale startup"`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ALL = (
    "ws_rtt",
    "http_get",
    "sse_fanout",
    "fanout",
    "beside_foxglove",
    "foxglove_cdr",
    "starvation",
    "scale",
    "startup",
    "tls",
    "estop",
    "deadman",
    "guarded",
    "hostile",
    "mavlink",
    "can_axes",
    "dashboard",
    "beside_rosbridge",
    "recorder",
)

wanted = sys.argv[1:] or ALL
unknown = [name for name in wanted if name not in ALL]
if unknown:
    sys.exit(f"no benchmark is called {unknown[0]!r}; there are {', '.join(ALL)}")
for name in wanted:
    print(f"== {name}", flush=True)
    subprocess.run([sys.executable, str(HERE / f"{name}.py")], check=False)
