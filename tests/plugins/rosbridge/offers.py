"""A script made with roslibpy that offers a service, and another client that calls it. Run: python offers.py HOST PORT."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from typing import Any

import roslibpy

BOUND = 60.0  # s
SET = "/script/set_it"
host, port = sys.argv[1:3]


def connected() -> roslibpy.Ros:
    ros = roslibpy.Ros(host=host, port=int(port))
    ros.run(timeout=BOUND)
    return ros


def until_listed(ros: roslibpy.Ros) -> None:
    end = time.monotonic() + BOUND
    while SET not in ros.get_services():
        assert time.monotonic() < end, f"{SET} is not there"


def respond(request: Any, response: Any) -> bool:
    response["success"] = request["data"]
    response["message"] = f"set to {request['data']}"
    return True


provider, caller = connected(), connected()
offered = roslibpy.Service(provider, SET, "std_srvs/srv/SetBool")
offered.advertise(respond)
until_listed(caller)
called = roslibpy.Service(caller, SET, "std_srvs/srv/SetBool")
answers: list[Any] = []
arrived = threading.Event()


def take(answer: Any) -> None:
    answers.append(dict(answer))
    arrived.set()


called.call(roslibpy.ServiceRequest({"data": True}), take, take)
assert arrived.wait(BOUND)
offered.unadvertise()
sys.stdout.write(json.dumps({"set": answers[0]}) + "\n")
sys.stdout.flush()
os._exit(0)  # with two connections, roslibpy's reactor has no end of its own
