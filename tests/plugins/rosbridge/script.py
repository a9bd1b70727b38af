"""A script made with roslibpy for any rosbridge. Run: python script.py HOST PORT TOPIC-FACTS."""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import roslibpy

BOUND = 60.0
host, port, text = sys.argv[1:4]
facts: dict[str, Any] = json.loads(text)
found: dict[str, Any] = {}
ros = roslibpy.Ros(host=host, port=int(port))
ros.run(timeout=BOUND)


def first(topic: roslibpy.Topic, wanted: Any) -> Any:
    """Return the first message that is wanted."""
    got: list[Any] = []
    arrived = threading.Event()

    def take(message: Any) -> None:
        if not got and wanted(message):
            got.append(message)
            arrived.set()

    topic.subscribe(take)
    assert arrived.wait(BOUND), topic.name
    topic.unsubscribe()
    return got[0]


found["topics"] = facts["odom"] in ros.get_topics()
found["type"] = ros.get_topic_type(facts["odom"])
found["services"] = facts["trigger"] in ros.get_services()
found["service_type"] = ros.get_service_type(facts["trigger"])
found["nodes"] = ros.get_nodes()
found["time"] = ros.get_time().secs
found["details"] = [one["type"] for one in ros.get_message_details("nav_msgs/Odometry")["typedefs"]]

cmd_vel = roslibpy.Topic(ros, facts["cmd_vel"], "geometry_msgs/Twist")
cmd_vel.advertise()
stop = threading.Event()


def drive() -> None:
    """Publish a velocity until told to stop."""
    while not stop.wait(0.05):
        cmd_vel.publish(roslibpy.Message({"linear": {"x": 0.3}, "angular": {"z": 0.0}}))


driver = threading.Thread(target=drive)
driver.start()
odom = roslibpy.Topic(ros, facts["odom"], "nav_msgs/Odometry", throttle_rate=20, queue_length=1)
found["speed"] = first(odom, lambda m: m["twist"]["twist"]["linear"]["x"] > 0.1)["twist"]["twist"][
    "linear"
]["x"]
stop.set()
driver.join()
cmd_vel.unadvertise()

trigger = roslibpy.Service(ros, facts["trigger"], "std_srvs/Trigger")
found["trigger"] = dict(trigger.call(roslibpy.ServiceRequest(), timeout=BOUND))
# An operation that is refused is told in a status message, and must not end the connection.
nobody = roslibpy.Topic(ros, "/nobody_at_all", "std_msgs/String")
nobody.publish(roslibpy.Message({"data": "x"}))
if "param" in facts:
    param = roslibpy.Param(ros, facts["param"])
    param.set(facts["value"])
    found["param"] = param.get()
if "action" in facts:
    action = roslibpy.ActionClient(ros, facts["action"]["name"], facts["action"]["type"])
    ended = threading.Event()
    told: list[Any] = []

    def result(value: Any) -> None:
        """Keep the result."""
        found["status"] = value["status"].name
        ended.set()

    action.send_goal(roslibpy.Goal(facts["action"]["goal"]), result, told.append, result)
    assert ended.wait(BOUND), "no result"
    found["feedback"] = len(told)
found["connected"] = ros.is_connected
sys.stdout.write(json.dumps(found) + "\n")
sys.stdout.flush()
ros.terminate()
