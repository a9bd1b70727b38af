"""What was probably meant is proposed; a name that is only somewhat like another is not."""

from __future__ import annotations

import pytest

from rcp_protocol.similarity import closest, nearest

_PATHS = [
    "/tenant/alpha/action/move_to",
    "/tenant/alpha/param/speed_limit",
    "/tenant/alpha/sensor/pose",
    "/tenant/alpha/sensor/battery",
    "/tenant/alpha/sensor/r1/pose",
    "/system/robots",
]


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("mesage", "message"),
        ("nmae", "name"),
        ("lvl", "level"),
        ("prot", "port"),
        ("alfa", "alpha"),
        ("sin", "sim"),
        ("tsl", "tls"),
        ("rat", "rate"),
        ("operater", "operator"),
        ("ardupilot", "ardupilotmega"),
        ("ROBOT", "robot"),
        ("Do_Set_Serv0", "DO_SET_SERVO"),
        ("speed-limit", "speed_limit"),
    ],
)
def test_a_misspelt_name_is_recognised(wrong: str, meant: str) -> None:
    assert closest(wrong, ["backend", meant, "unrelated"]) == meant


@pytest.mark.parametrize(
    ("wrong", "known"),
    [
        ("foo", "robot"),
        ("mean", "name"),
        ("host", "port"),
        ("web", "ws"),
        ("sensor", "store"),
        ("frames", "places"),
        ("gateway", "mqtt"),
        ("a", "b"),
        ("", "name"),
    ],
)
def test_a_name_that_is_only_somewhat_like_another_is_not_proposed(wrong: str, known: str) -> None:
    assert closest(wrong, [known]) is None


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("/tenant/alpha/sensor/pos", "/tenant/alpha/sensor/pose"),
        ("/tenant/alfa/sensor/pose", "/tenant/alpha/sensor/pose"),
        ("/tenant/alpha/senor/poze", "/tenant/alpha/sensor/pose"),
        ("/tenant/alpha/action/moveto", "/tenant/alpha/action/move_to"),
        ("/tenant/alpha/speed_limit", "/tenant/alpha/param/speed_limit"),
        ("/tenant/alpha/sensor/r1/battery", "/tenant/alpha/sensor/battery"),
        ("/system/robot", "/system/robots"),
    ],
)
def test_a_path_is_recognised_by_the_segments_in_which_it_differs(wrong: str, meant: str) -> None:
    assert closest(wrong, _PATHS) == meant


@pytest.mark.parametrize(
    "wrong",
    [
        "/tenant/alpha/sensor/foo",
        "/tenant/alpha/sensor/r7/pose/raw",
        "/tenant/alpha/sensor/nothing_of_the_kind",
        "/tenant/beta/sensor/camera",
        "/tenant/alpha/sensor",
        "/system/places",
        "/",
    ],
)
def test_what_paths_have_in_common_makes_them_no_more_alike(wrong: str) -> None:
    assert nearest(wrong, _PATHS) == []


def test_the_most_similar_come_first_and_no_more_than_wanted() -> None:
    assert nearest("limit", ["limits", "limit_1", "time", "limit-", "lime"], 2) == [
        "limit-",
        "limits",
    ]


def test_a_name_of_any_length_is_compared_in_bounded_time() -> None:
    assert nearest("a" * 1_000_000, ["b" * 1_000_000, "c/" * 500_000]) == []
