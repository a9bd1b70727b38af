"""Messages of a megabyte: who may lose them is told what mends it."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
import structlog
from sensor_msgs.msg import Image
from structlog.testing import capture_logs

import rcp_ros2
from rcp_ros2 import topics
from rcp_ros2.config import Qos
from rcp_ros2.qos import Profile
from rcp_ros2.topics import TopicSubscription, TopicSubscriptions


def logged(
    monkeypatch: pytest.MonkeyPatch, size: int, *, reliable: bool, prepared: bool = False
) -> list[dict]:
    """Let two messages be heard; return what was said."""
    monkeypatch.delenv("FASTDDS_DEFAULT_PROFILES_FILE", raising=False)
    if prepared:
        monkeypatch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", str(rcp_ros2.PROFILE))
    # Whatever level a gateway of an earlier test was told to log from.
    monkeypatch.setattr(
        topics,
        "log",
        structlog.wrap_logger(
            structlog.PrintLogger(), wrapper_class=structlog.make_filtering_bound_logger(0)
        ),
    )
    subscription = TopicSubscription("/camera", Image, Qos(), profile=Profile(reliable, False, 5))
    with capture_logs() as found:
        hear = TopicSubscriptions(None, None, lambda _key, _detail: None).callback_for(subscription)
        for _ in range(2):
            hear(bytes(size))
    return found


def test_best_effort_images_are_warned_of_once_with_what_mends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (said,) = logged(monkeypatch, 900_000, reliable=False)
    assert (said["log_level"], said["topic"]) == ("warning", "/camera")
    assert str(rcp_ros2.PROFILE) in said["remedy"]


def test_what_is_small_or_reliable_or_provided_for_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    assert logged(monkeypatch, 1000, reliable=False) == []
    assert logged(monkeypatch, 900_000, reliable=True) == []
    assert logged(monkeypatch, 900_000, reliable=False, prepared=True) == []


def test_the_profile_is_shipped() -> None:
    root = ET.parse(rcp_ros2.PROFILE).getroot()
    size = root.findtext(".//{*}segment_size")
    assert int(size) >= 32 * 2**20
