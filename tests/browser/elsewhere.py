"""Pages that are not the gateway's, and all that such a page might try."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

PAGE = b"<!doctype html><meta charset=utf-8><title>elsewhere</title><body>"


@asynccontextmanager
async def elsewhere() -> AsyncGenerator[int]:
    """Serve an empty page at every path of a port, with every name of loopback."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        head = b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\n"
        writer.write(head + b"Content-Length: %d\r\n\r\n" % len(PAGE) + PAGE)
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(serve, ["127.0.0.1", "::1"], 0)
    port: int = server.sockets[0].getsockname()[1]
    if server.sockets[-1].getsockname()[1] != port:  # the other family got another port
        server.close()
        server = await asyncio.start_server(serve, "127.0.0.1", port)
    try:
        yield port
    finally:
        server.close()


ATTEMPTS = """
async ([url, ws]) => {
  const write = '{"type":"write","path":"/tenant/alpha/param/limit","body":2}';
  const go = '{"type":"execute","path":"/tenant/alpha/action/go","body":1}';
  const param = url + "/rcp/v1/context/tenant/alpha/param/limit";
  const pose = url + "/rcp/v1/context/tenant/alpha/sensor/pose";
  const text = url + "/rcp/v1/context/tenant/alpha/sensor/text";
  const action = url + "/rcp/v1/context/tenant/alpha/action/go";
  const messages = url + "/rcp/v1/messages";
  const events = url + "/rcp/v1/events?path=/tenant/alpha/sensor/pose";
  const json = {"content-type": "application/json"};
  const plain = {"content-type": "text/plain"};
  const tried = {};

  const asked = (name, to, how) => tried[name] = fetch(to, how).then(
    async (got) => got.type === "opaque" ? "opaque" : "read: " + await got.text(),
    () => "blocked");
  asked("post as text", messages, {method: "POST", headers: plain, body: write});
  asked("post as text without cors", messages,
        {method: "POST", mode: "no-cors", headers: plain, body: write});
  asked("post without a type", messages,
        {method: "POST", mode: "no-cors", body: new Blob([go])});
  asked("post as json", messages, {method: "POST", headers: json, body: write});
  asked("post with credentials", messages,
        {method: "POST", credentials: "include", headers: plain, body: write});
  asked("post a query", messages, {method: "POST", mode: "no-cors",
        body: new URLSearchParams({type: "execute"})});
  asked("execute", action, {method: "POST", body: "1"});
  asked("execute without cors", action, {method: "POST", mode: "no-cors", body: "1"});
  asked("put", param, {method: "PUT", body: "2"});
  asked("put as json", param, {method: "PUT", headers: json, body: "2"});
  asked("delete", url + "/rcp/v1/commands/x", {method: "DELETE"});
  asked("get", pose, {});
  asked("get without cors", pose, {mode: "no-cors"});
  asked("get with a header", pose, {headers: {"x-rcp-tenant": "alpha"}});
  asked("metrics", url + "/metrics", {});

  tried["xmlhttprequest"] = new Promise((done) => {
    const request = new XMLHttpRequest();
    request.open("POST", messages);
    request.onload = () => done("read: " + request.responseText);
    request.onerror = () => done("blocked");
    request.send(write);
  });
  navigator.sendBeacon(messages, write);

  const embedded = (tag, to) => new Promise((done) => {
    const element = document.createElement(tag);
    element.onload = () => done("read: loaded");
    element.onerror = () => done("blocked");
    if (tag === "link") { element.rel = "stylesheet"; element.href = to; } else element.src = to;
    document.body.append(element);
  });
  tried["image"] = embedded("img", pose);
  tried["script"] = embedded("script", text);
  tried["style sheet"] = embedded("link", pose);

  const frame = (name) => {
    const made = document.createElement("iframe");
    made.name = name;
    const loaded = new Promise((done) => made.onload = done);
    document.body.append(made);
    return [made, loaded];
  };
  tried["frame"] = (async () => {
    const [made] = frame("reading");
    await new Promise((done) => { made.onload = done; made.src = pose; });
    try { return "read: " + made.contentWindow.document.body.innerText; }
    catch { return "blocked"; }
  })();
  const posted = (name, to, type, field, value) => tried[name] = (async () => {
    const [made] = frame(name);
    const form = document.createElement("form");
    Object.assign(form, {action: to, method: "post", enctype: type, target: name});
    const input = document.createElement("input");
    Object.assign(input, {name: field, value});
    form.append(input);
    document.body.append(form);
    await new Promise((done) => { made.onload = done; form.submit(); });
    try { return "read: " + made.contentWindow.document.body.innerText; }
    catch { return "blocked"; }
  })();
  posted("form as text", messages, "text/plain", go.slice(0, -1) + ',"x-f":"', '"}');
  posted("form", action, "application/x-www-form-urlencoded", "x", "1");
  posted("form of many parts", action, "multipart/form-data", "x", "1");

  tried["events"] = new Promise((done) => {
    const source = new EventSource(events);
    source.addEventListener("update", (got) => { source.close(); done("read: " + got.data); });
    source.onerror = () => { source.close(); done("blocked"); };
  });
  const opened = (name, protocols) => tried[name] = new Promise((done) => {
    const socket = new WebSocket(ws, protocols);
    socket.onopen = () => socket.send(go);
    socket.onmessage = (got) => { socket.close(); done("read: " + got.data); };
    socket.onclose = () => done("blocked");
  });
  opened("websocket", []);
  opened("websocket of json", ["rcp.v1.json"]);
  opened("websocket of cbor", ["rcp.v1.cbor"]);

  const names = Object.keys(tried);
  const found = await Promise.all(names.map((name) => Promise.race(
    [tried[name], new Promise((done) => setTimeout(() => done("hangs"), 8000))])));
  return Object.fromEntries(names.map((name, at) => [name, found[at]]));
}
"""
"""Each attempt by its name: `blocked`, `opaque` (no byte and no status is shown) or `read: …`."""
