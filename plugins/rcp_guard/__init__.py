"""A separate process that stops robots when the gateway's event loop hangs or its process dies.

It imports nothing from the gateway, so that a fault of the gateway's code cannot affect it. The
gateway starts it (`python -m rcp_guard --fd N`) in a separate session and sends it lines over a
socket. An empty line is a heartbeat; any other is a JSON object with one of these keys:

    {"plans": {"<name>": {"group": str, "sender": str, "data": {…}, "period": seconds,
                          "lasts": seconds or null}}}   all plans
    {"armed": ["<group>", …]}    the groups (backends) that may move, or that a latch holds
    {"bye": true}                the gateway shuts down cleanly: nothing is sent, the guard ends

If no line arrives for longer than `--after` seconds while a group is armed, or the socket closes
without a `bye`, every plan of the armed groups is sent at once and then at its period, until three
consecutive heartbeats have arrived in time or `--bound` seconds have passed. By then the stop was
sent some hundred times, and continuing would keep people from moving the robot by other means. A
plan with `lasts` is sent for at most that many seconds, counted from its first transmission, so
that it does not override what the robot does later (a failsafe that lands it). A guard whose gateway
is gone then ends. The guard reports in JSON lines, over the same socket and on standard error:

    {"event": "sender", "plan": name, "state": state, "detail": text}
    {"event": "stopped", "groups": […], "reason": text}
    {"event": "released", "groups": […], "reason": text}
    {"event": "alive"}           once a second, to the gateway only

A sender is `opening`, `ready`, `waiting` (no receiver is present, as far as can be known), `failed`
(it will be retried) or `missing` (it requires a change of the plan or the installation).

Data of the senders (bytes are hexadecimal text):

`can`   {"bus": {keyword arguments of python-can's `Bus`: interface, channel, bitrate, …},
         "frames": [{"id": int, "data": hex, "extended": bool, "fd": bool, "brs": bool}]}
`ros2`  {"domain_id": int or null,
         "publishers": [{"topic": name, "type": "pkg/msg/Type", "data": hex of CDR, "reliable": bool}],
         "cancel": [names of actions of which all goals are cancelled],
         "services": [{"name": name, "type": "pkg/srv/Type", "data": hex of the request's CDR}]}
`udp`   {"to": [host, port], "frames": [hex]}

CDR includes its header of four bytes, as written by `rclpy.serialization.serialize_message`. Senders
are opened when their plan arrives, so that a stop is sent within milliseconds.
"""
