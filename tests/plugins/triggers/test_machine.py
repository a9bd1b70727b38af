"""The state of a trigger, whatever its condition does in time."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from rcp_triggers.machine import Machine, Outcome, Timing

KNOWN = st.sampled_from([True, True, False, None])
STEP = st.tuples(st.floats(0.01, 4.0), KNOWN, KNOWN)
TIMING = st.builds(
    Timing,
    held=st.sampled_from([0.0, 0.5, 3.0]),
    edge=st.booleans(),
    repeat=st.sampled_from([None, None, 1.0, 5.0]),
    cool_down=st.sampled_from([0.0, 0.0, 2.0, 10.0]),
    hysteresis=st.booleans(),
).map(
    lambda one: one if not one.edge else Timing(one.held, True, None, one.cool_down, one.hysteresis)
)


@dataclass
class Seen:
    """What was said of a condition, and what came of it."""

    timing: Timing
    times: list[float] = field(default_factory=list)
    when: list[bool | None] = field(default_factory=list)
    clear: list[bool | None] = field(default_factory=list)
    outcomes: list[Outcome | None] = field(default_factory=list)

    def run(self, steps: list[tuple[float, bool | None, bool | None]]) -> Seen:
        machine, now = Machine(self.timing), 100.0
        for pause, when, clear in steps:
            # As a gateway does: it looks again when time alone may change something.
            before = (self.when[-1], self.clear[-1]) if self.when else (None, None)
            end = now + pause
            while (due := machine.due) is not None and now < due <= end:
                now = due
                self._look(machine, now, when=before[0], clear=before[1])
            now = end
            self._look(machine, now, when=when, clear=clear)
        return self

    def _look(self, machine: Machine, now: float, *, when: bool | None, clear: bool | None) -> None:
        self.times.append(now)
        self.when.append(when)
        self.clear.append(clear)
        self.outcomes.append(machine.step(now, when=when, clear=clear))

    @property
    def fired(self) -> list[int]:
        return [place for place, one in enumerate(self.outcomes) if one == "fire"]

    def active_before(self, place: int) -> bool:
        past = [one for one in self.outcomes[:place] if one is not None]
        return bool(past) and past[-1] != "clear"

    def true_since(self, place: int) -> float | None:
        """Return since when the condition holds without a gap, as seen at some moment."""
        since = None
        for at in range(place, -1, -1):
            if (
                self.when[at] is not True
                or self.outcomes[at] == "clear"
                or (at < place and self.active_before(at + 1))
            ):
                break
            since = self.times[at]
        return since


@given(TIMING, st.lists(STEP, max_size=30))
def test_it_fires_only_after_its_condition_has_held_for_its_time(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]]
) -> None:
    seen = Seen(timing).run(steps)
    for place in seen.fired:
        if seen.active_before(place):
            assert timing.repeat is not None
            continue
        since = seen.true_since(place)
        assert since is not None
        assert seen.times[place] - since >= timing.held - 1e-9


@given(TIMING, st.lists(STEP, max_size=30))
def test_two_firings_are_apart_by_the_cool_down_and_the_repetition(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]]
) -> None:
    seen = Seen(timing).run(steps)
    for first, second in zip(seen.fired, seen.fired[1:], strict=False):
        apart = seen.times[second] - seen.times[first]
        assert apart >= timing.cool_down - 1e-9
        if "clear" not in seen.outcomes[first:second]:
            assert timing.repeat is not None
            assert apart >= timing.repeat - 1e-9


@given(TIMING, st.lists(STEP, max_size=30))
def test_what_is_unknown_neither_fires_nor_clears(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]]
) -> None:
    seen = Seen(timing).run(steps)
    for when, clear, outcome in zip(seen.when, seen.clear, seen.outcomes, strict=True):
        if outcome == "fire":
            assert when is not None
        if outcome == "clear":
            assert clear is True if timing.hysteresis else when is False


@given(TIMING, st.lists(STEP, max_size=30))
def test_it_clears_only_what_was_active_and_by_the_condition_for_it(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]]
) -> None:
    seen = Seen(timing).run(steps)
    for place, outcome in enumerate(seen.outcomes):
        over = seen.when[place] is False
        if timing.hysteresis:
            over = seen.clear[place] is True and seen.when[place] is not True
        assert (outcome == "clear") == (seen.active_before(place) and over)


@given(TIMING, st.lists(STEP, max_size=30))
def test_an_edge_needs_to_have_been_false_since_it_fired(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]]
) -> None:
    seen = Seen(timing).run(steps)
    if not timing.edge:
        assert "suppress" not in seen.outcomes
        return
    last = 0
    for place, outcome in enumerate(seen.outcomes):
        if outcome in ("fire", "suppress"):
            between = slice(last, place)
            assert False in seen.when[between] or "clear" in seen.outcomes[between]
            last = place


@given(TIMING, st.lists(STEP, max_size=30), st.floats(0.0, 1.0))
def test_a_level_that_holds_long_enough_always_fires(
    timing: Timing, steps: list[tuple[float, bool | None, bool | None]], more: float
) -> None:
    seen = Seen(timing).run([*steps, (0.1, False, True), (0.1, True, False)])
    if timing.edge:  # of an edge, one in the cool-down is lost, and counted
        return
    wait = timing.held + timing.cool_down + 0.1 + more
    count = len(seen.fired)
    again = Seen(timing).run([*steps, (0.1, False, True), (0.1, True, False), (wait, True, False)])
    # It fired at the first look already, if it need not hold for a time.
    assert len(again.fired) > count or seen.outcomes[-1] == "fire"


def test_a_restart_goes_on_where_it_left_off() -> None:
    machine = Machine(Timing(cool_down=10.0))
    machine.resume(95.0, active=True)
    assert machine.step(100.0, when=True) is None
    assert machine.step(101.0, when=False) == "clear"
    assert machine.step(102.0, when=True) is None
    assert machine.due == 105.0
    assert machine.step(105.0, when=True) == "fire"
