"""What somebody may do in a part of the tree is found out in steps, and then known."""

from __future__ import annotations

from typing import Any

import pytest

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.config.role import Role, Rule
from rcp_kernel.features import Scope
from rcp_kernel.model import Operation, Resource
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_kernel.types import quantity
from rcp_scheduling.turns import at_once

COMMANDING = Operation.WRITE | Operation.EXECUTE
ALL = Scope("/tenant/alpha")


class Owner:
    """A backend that owns resources, and does nothing."""

    tenant = "alpha"
    robot = None
    samples = 0

    def __init__(self, name: str) -> None:
        self.name = name
        self.entries: dict[str, Any] = {}
        owner: Any = self
        self._unit = RobotUnit(owner, None)

    def unit(self, robot: str | None) -> RobotUnit:
        return self._unit


class Tree:
    """A tree, and what is asked of it."""

    def __init__(self, *names: str, robot: str = "robot") -> None:
        self.registry = Registry(SYSTEM_CLOCK)
        self.scopes = ScopeRights(self.registry)
        self.owner = Owner(robot)
        for name in names:
            self.declare(name)

    def declare(self, name: str) -> Entry:
        resource = Resource(name=name, description="One of many.", value=quantity("m"))
        owner: Any = self.owner
        entry = self.registry.declare(owner, resource, tenant="alpha")
        entry.unit.own[name] = entry
        return entry

    def rights(self, *paths: str, operations: tuple[Any, ...] = ("*",)) -> Rights:
        role = Role(allow=(Rule(operations, paths),))
        return Rights((("alpha", ("r",)),), {"r": role})


def steps(work: Any) -> tuple[int, bool]:
    """Go through some work; return the number of its steps, and what it found."""
    count = 0
    while True:
        try:
            next(work)
        except StopIteration as end:
            return count, end.value
        count += 1


@pytest.fixture
def tree() -> Tree:
    return Tree(*(f"param/p{number:04}" for number in range(1000)))


def test_what_is_not_known_is_found_out_in_steps_and_not_again(tree: Tree) -> None:
    nothing = tree.rights("/sensor/**")
    count, seen = steps(tree.scopes.look(nothing, ALL))
    assert (count, seen) == (1000 // 128, False)
    assert steps(tree.scopes.look(nothing, ALL)) == (0, False)
    last = tree.rights("/param/p0999")
    count, seen = steps(tree.scopes.look(last, ALL))
    assert (count, seen) == (999 // 128, True)
    assert steps(tree.scopes.look(last, ALL)) == (0, True)


def test_an_answer_follows_the_tree(tree: Tree) -> None:
    rights = tree.rights("/param/new", "/param/p0500")
    assert tree.scopes.sees(rights, ALL)
    tree.registry.withdraw("/tenant/alpha/param/p0500")
    assert not tree.scopes.sees(rights, ALL)
    tree.declare("param/new")
    assert tree.scopes.sees(rights, ALL)


def test_an_answer_is_for_one_scope_and_one_kind_of_right(tree: Tree) -> None:
    looks = tree.rights("/param/p0001", operations=("read",))
    below = Scope("/tenant/alpha/param/p0001")
    assert tree.scopes.sees(looks, below)
    assert not tree.scopes.may(looks, below, COMMANDING)
    assert not tree.scopes.sees(looks, Scope("/tenant/alpha/param/p0002"))
    assert tree.scopes.may(tree.rights("/param/p0001"), below, COMMANDING)


@pytest.mark.parametrize(
    ("scope", "found"),
    [
        ("/tenant/alpha", ["param/a", "param/a-b/x", "param/a/x", "param/ab", "sensor/a/x"]),
        ("/tenant/alpha/param/a", ["param/a", "param/a/x"]),
        ("/tenant/alpha/a", ["param/a", "param/a/x", "sensor/a/x"]),
        ("/tenant/alpha/param/b", []),
        ("/tenant/beta", []),
    ],
)
def test_a_scope_finds_all_that_it_covers_and_nothing_beside_it(
    scope: str, found: list[str]
) -> None:
    tree = Tree("param/a", "param/ab", "param/a-b/x", "param/a/x", "sensor/a/x")
    assert sorted(entry.name for entry in tree.scopes.entries(Scope(scope))) == found


def test_a_robot_is_seen_by_any_of_its_own_resources(tree: Tree) -> None:
    robot, last = tree.owner.unit(None), tree.rights("/param/p0999")
    sees = tree.scopes.sees_robot
    assert sees(last, robot)
    assert not sees(tree.rights("/sensor/**"), robot)
    assert sees(last, robot, Scope("/tenant/alpha/param/p0999"))
    assert not sees(last, robot, Scope("/tenant/alpha/param/p0001"))
    tree.registry.withdraw("/tenant/alpha/param/p0999")
    del robot.own["param/p0999"]
    assert not sees(last, robot)


def test_a_resource_that_another_robot_has_by_now_shows_that_one(tree: Tree) -> None:
    robot, rights = tree.owner.unit(None), tree.rights("/param/p0001")
    assert tree.scopes.sees_robot(rights, robot)
    path = "/tenant/alpha/param/p0001"
    tree.registry.withdraw(path)
    del robot.own["param/p0001"]
    other = Tree(robot="other")
    entry = other.declare("param/p0001")
    tree.registry.entries[path] = entry
    assert not tree.scopes.sees_robot(rights, robot)
    assert tree.scopes.sees_robot(rights, other.owner.unit(None))


def test_a_tree_that_changes_while_it_is_gone_through_is_no_error(tree: Tree) -> None:
    work = tree.scopes.look(tree.rights("/sensor/**"), ALL)
    next(work)
    for number in range(1000):
        tree.registry.withdraw(f"/tenant/alpha/param/p{number:04}")
    assert at_once(work) is False
