"""`rcpd check` and the start agree on the numbers that a file may contain."""

from __future__ import annotations

import pytest

from rcp_gateway.server import prepare
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, StartupError
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


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("[" * 400 + "]" * 400, "nested too deep"),
        ("{ a = " * 400 + "1" + "}" * 400, "nested too deep"),
        ("[" * 50_000, "nested too deep"),
        ("9" * 5000, "Too many digits"),
    ],
    ids=["lists", "tables", "open", "digits"],
)
def test_what_no_parser_reads_is_a_fault_of_its_line(value: str, says: str) -> None:
    text = f'name = "a"\n[[jwt]]\nissuer = "https://issuer.example"\naudience = {value}\n'
    with pytest.raises(ConfigError, match=says):
        parse(text, "rcp.toml")
    (one,) = Diagnosis(text, "rcp.toml").findings
    assert one.line == 4
    assert says in one.message


VALUES = (
    *("inf", "nan", "99999999999999999999", "true", "[[1]]", "{}", "07:32:00"),
    *('"a\\u0000b"', '"~nobody-of-this-name/x"', '"${file:a\\u0000b}"', '"/tenant/zz/**"'),
)
WHOLE = f"""\
name = "a"
include = ["absent/*.toml"]
{SIM}name = "one"
rate = 10
[[keys]]
name = "ann"
key = "a-long-key-of-this-test-1"
role = "operator"
expires = "2027-01-01"
[store]
path = "rcp.db"
[limits]
session_ttl = 5
[safety]
lease_ttl = 3
groups.cell = ["/tenant/alpha/one"]
[transports.asgi]
port = 8080
[[roles.driver.allow]]
operations = ["read"]
paths = ["/tenant/alpha/**"]
"""


@pytest.mark.parametrize("value", VALUES, ids=lambda value: value[:20])
def test_no_value_of_any_key_ends_the_check(value: str) -> None:
    lines = WHOLE.split("\n")
    for index, line in enumerate(lines):
        key, is_, _ = line.partition("= ")
        if is_:
            found = Diagnosis(
                "\n".join([*lines[:index], key + is_ + value, *lines[index + 1 :]]), ""
            )
            assert found.warnings is not None
            assert found.findings or found.prepared()
