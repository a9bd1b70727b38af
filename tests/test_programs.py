"""A test without its program is left out on a machine of somebody, and fails where everything is a must."""

from __future__ import annotations

import pytest

from programs import program


@pytest.mark.parametrize(
    ("must", "outcome"), [("", pytest.skip.Exception), ("1", pytest.fail.Exception)]
)
def test_a_missing_program_is_told(
    must: str, outcome: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RCP_CI", must)
    with pytest.raises(outcome, match="no-such-program is not installed"):
        program("no-such-program")
