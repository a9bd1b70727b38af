"""`rcpd check` and the start agree on the numbers that a file may contain."""

from __future__ import annotations

import pytest

from rcp_gateway.server import prepare
from rcp_kernel.config.file import parse
from rcp_kernel.errors import StartupError
from rcpd.diagnosis import Diagnosis

SIM = '[[backends]]\nuse = "sim"\ntenant = "alpha"\n'
GOOD = (
    "[limits]\naction_timeout = inf\n",
    "[limits]\naction_timeout = 1e19\n",
    "[audit]\nkeep_days = inf\nkeep_mb = inf\n",
    "[transports.asgi]\ngrace = inf\n",
    "[limits]\nmessage = 9223372036854775807\n",
)
BAD = (
    "[limits]\naction_timeout = nan\n",
    "[limits]\naction_timeout = 9223372036854775808\n",
    "[limits]\nmessage = 9223372036854775808\n",
    "[limits]\nmessage = inf\n",
    "[limits]\nheartbeat = inf\n",
    "[limits]\nsession_ttl = inf\n",
    "[safety]\nlease_ttl_max = inf\n",
    '[features.recorder]\nfolder = "x"\nqueue_mb = inf\n',
    '[[envelopes]]\nname = "a"\npaths = ["/actuator/x"]\nbounds.x = { max = nan }\n',
    SIM + "rate = nan\n",
    SIM + "rate = inf\n",
)


@pytest.mark.parametrize("text", GOOD)
def test_a_number_that_the_start_takes_is_good(text: str) -> None:
    prepare(parse(text, "rcp.toml"), "rcp.toml")
    assert Diagnosis(text, "rcp.toml").findings == []


@pytest.mark.parametrize("text", BAD)
def test_a_number_that_the_start_refuses_is_a_fault(text: str) -> None:
    with pytest.raises(StartupError):
        prepare(parse(text, "rcp.toml"), "rcp.toml")
    (one,) = Diagnosis(text, "rcp.toml").findings
    assert one.line == len(text.rstrip("\n").split("\n"))
