"""What the configuration says of plans and approvals has to make sense before the gateway starts."""

from __future__ import annotations

import pytest

from rcp_gateway.features import active
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError
from rcp_plans import rcp_features


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[plans.actions.go]\npath = "/nowhere/{0}"', "[plans.actions.go] path = '/nowhere/{0}'"),
        ('[plans.actions.go]\npath = "/action/{0.x}"', "[plans.actions.go] path"),
        ('[plans.actions.go]\npath = "action/go"', "plans.actions"),
        ('[plans.actions.set]\npath = "/param/limit"\ndo = "write"', "has no `value`"),
        ("[plans]\nsteps = 0", "plans.steps = 0"),
        (
            '[roles.a]\napprove = ["action/dock"]',
            "[roles.a] approve has a rule with an invalid path",
        ),
        ('[roles.a]\napprove = ["/system/estop"]', "need no approval"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused_with_its_name(text: str, told: str) -> None:
    with pytest.raises(ConfigError) as wrong:
        active(parse(text, "rcp.toml"), {kind.name: kind for kind in rcp_features()}, "rcp.toml")
    assert told in str(wrong.value)
    assert str(wrong.value).startswith("rcp.toml: ")
