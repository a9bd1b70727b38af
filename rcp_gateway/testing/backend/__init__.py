"""The backend suite: subclass it, give what only the author knows, and it proves the rest."""

from __future__ import annotations

from rcp_gateway.testing.backend._base import BackendTests, Goal, Robot
from rcp_gateway.testing.backend._commands import CommandTests
from rcp_gateway.testing.backend._life import LifeTests
from rcp_gateway.testing.backend._link import LinkTests
from rcp_gateway.testing.backend._motion import MotionTests
from rcp_gateway.testing.backend._streams import StreamTests
from rcp_gateway.testing.backend._tree import TreeTests
from rcp_gateway.testing.backend._values import ValueTests
from rcp_kernel.model import Kind, Operation

__all__ = ["BackendSuite", "BackendTests", "Goal", "Robot"]


class BackendSuite(
    LifeTests, TreeTests, ValueTests, CommandTests, MotionTests, StreamTests, LinkTests
):
    """All tests of a backend.

    Give `kind` (and `config`), `truth` for what can be written, `goals` for what can be executed,
    `at_rest` for what moves, `refusing` for what is written as one, and `break_link` with `mend_link` where the link can be cut::

        class TestTurtle(BackendSuite):
            kind = rcp_turtle.TURTLE

            async def truth(self, name: str) -> object:
                return self.backend.pen.colour

    A test of the suite that cannot hold is overridden under `pytest.mark.xfail(reason=…)`.
    """

    def test_no_test_of_the_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert self.altered(BackendSuite) == []

    async def test_all_that_is_declared_is_proved(self, robot: Robot) -> None:
        """See that the author gave what each declared resource needs for its proof."""
        own, missing = type(self), list[str]()
        goals = self.goals()
        missing += [
            f"goals() has none for {resource.name}"
            for resource in robot.having(Operation.EXECUTE)
            if resource.name not in goals
            and (resource.name.startswith("action/") or (resource.input and not resource.examples))
        ]
        missing += [
            f"goals() names {name}, which is not there"
            for name in goals.keys() - robot.resources.keys()
        ]
        if robot.having(Operation.WRITE) and own.truth is BackendTests.truth:
            missing.append("truth() is not given, and it can be written")
        if robot.having(Operation.EXECUTE, Kind.ACTION) and own.at_rest is BackendTests.at_rest:
            missing.append("at_rest() is not given, and it has actions")
        if self.link_breaks and BackendTests.mend_link in (own.mend_link, own.break_link):
            missing.append("of break_link() and mend_link() only one is given")
        if self.groups() and own.refusing is BackendTests.refusing:
            missing.append("refusing() is not given, and it writes several as one")
        missing += [
            f"{group[0].name} is alone in its group '{group[0].atomic}'"
            for group in self.groups()
            if len(group) == 1
        ]
        missing += [
            f"values() gives fewer than two for {resource.name}"
            for resource in robot.having(Operation.WRITE)
            if len(self.values(resource.name)) < 2
        ]
        assert not missing, "; ".join(missing)
