"""A small process outside the gateway that stops robots when the gateway's event loop has stopped.

It imports nothing of the gateway, so that no fault of the gateway's code can reach it. The gateway
starts it (`python -m rcp_guard --fd N`) in a session of its own and talks to it over a socket, in
lines. An empty line is a heartbeat; any other is a JSON object with one of these keys:

    {"plans": {"<name>": {"group": str, "sender": str, "data": {…}, "period": seconds,
                          "lasts": seconds or null}}}   all plans
    {"armed": ["<group>", …]}    the groups (backends) that may move, or that a latch holds
    {"bye": true}                the gateway ends in order: nothing is sent, the guard ends

When no line came for longer than `--after` seconds while a group is armed, or the socket was closed
without a `bye`, every plan of the armed groups is sent at once and again at its period: until three
heartbeats have come in time, or `--bound` seconds have passed. By then the stop was told some
hundred times, and longer would keep people from moving the robot by other means. A plan that has
`lasts` is sent for that many seconds at most, from its first transmission on: what the robot does by
itself later (a failsafe that lands it) is not overruled. A guard whose
gateway is gone ends after that. The guard reports in JSON lines, to the gateway over the same socket
and to its standard error:

    {"event": "sender", "plan": name, "state": state, "detail": text}
    {"event": "stopped", "groups": […], "reason": text}
    {"event": "released", "groups": […], "reason": text}
    {"event": "alive"}           once a second, to the gateway only

A sender is `opening`, `ready`, `waiting` (nobody is there to hear it, as far as can be known), `failed`
(and tried again) or `missing` (it cannot work without a change of the plan or the installation).

Data of the senders (bytes are hexadecimal text):

`can`   {"bus": {keyword arguments of python-can's `Bus`: interface, channel, bitrate, …},
         "frames": [{"id": int, "data": hex, "extended": bool, "fd": bool, "brs": bool}]}
`ros2`  {"domain_id": int or null,
         "publishers": [{"topic": name, "type": "pkg/msg/Type", "data": hex of CDR, "reliable": bool}],
         "cancel": [names of actions of which all goals are cancelled],
         "services": [{"name": name, "type": "pkg/srv/Type", "data": hex of the request's CDR}]}
`udp`   {"to": [host, port], "frames": [hex]}

CDR is with its header of four bytes, as `rclpy.serialization.serialize_message` writes it. Senders
are opened when their plan arrives, so that a stop leaves within milliseconds.
"""
