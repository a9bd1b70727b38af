"""The values of a step response and a chirp, at the joint."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.motor_messages import Radians, Seconds, Speed

__all__ = ["Chirp", "Excitation", "ExcitationFeedback", "Response", "Step", "StepResponse"]

Ratio = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "1"})]
Hertz = Annotated[float, Meta(ge=0.05, le=100, extra_json_schema={"unit": "Hz"})]
Duration = Annotated[float, Meta(ge=0.1, le=30, extra_json_schema={"unit": "s"})]


class Excitation(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A test signal: of the position, relative to where the joint is, or of the velocity."""

    position: Radians | None = None
    """Amplitude, if the position is commanded; give either this or `velocity`."""
    velocity: Speed | None = None
    """Amplitude, if the velocity is commanded."""
    duration: Duration


class Step(Excitation, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One step, kept for `duration`."""


class Chirp(Excitation, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A sine whose frequency changes linearly; it begins and ends gently."""

    start_frequency: Hertz
    end_frequency: Hertz


class ExcitationFeedback(Struct, frozen=True, kw_only=True):
    """Progress of a measurement."""

    time: Seconds
    position: Radians | None = None


class Response(Struct, frozen=True, kw_only=True):
    """What was commanded and measured; all lists have one element for each report of the drive."""

    time: list[Seconds]
    """Since the first set-point, when the gateway received the report."""
    position: list[Radians]
    velocity: list[Speed]
    commanded_position: list[Radians] = []
    """What had been sent by then, within the motor's limits; empty if the velocity is commanded."""
    commanded_velocity: list[Speed] = []
    """Empty if the position is commanded."""


class StepResponse(Response, frozen=True, kw_only=True):
    """A step response, and its figures; these are None if the joint does not arrive anywhere."""

    rise_time: Seconds | None = None
    """From 10 % to 90 % of the way from the first value to the last."""
    overshoot: Ratio | None = None
    """How far it went beyond its last value, as part of the way."""
    settling_time: Seconds | None = None
    """Until it stays within 2 % of the way around its last value."""
