#!/usr/bin/env bash
# roslib 2.1.0 (npm): a server's refusal of `advertise` reaches no listener of `ros.on("status")` or `ros.on("error")`.
#
# A rosbridge server answers with a message `{"op": "status", "level": "error", "msg": ..., "id": ...}`, with the id of the
# request (protocol, section 3.2). The library gives every request an id, and emits the answer as `status:ID` alone: the
# event `status` is for messages without id. Nothing is written to the console. A program listens to
# `status:${topic.advertiseId}`, which is set by `advertise`.
#
# Seen: {"status":0,"error":0,"console":0,"status:ID":1,"status without id":1} (times)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init --yes >/dev/null
npm install --silent --no-audit --no-fund roslib@2.1.0 ws@8.23.0 >/dev/null
cat >status.mjs <<'JAVASCRIPT'
import * as ROSLIB from "roslib";
import { WebSocketServer } from "ws";

const server = new WebSocketServer({ host: "localhost", port: 0 });
await new Promise((resolve) => server.once("listening", resolve));
server.on("connection", (socket) =>
  socket.on("message", (text) => {
    const request = JSON.parse(text);
    if (request.op !== "advertise") return;
    const answer = { op: "status", level: "error", msg: "another type" };
    socket.send(JSON.stringify({ ...answer, id: request.id }));
    socket.send(JSON.stringify({ op: "publish", topic: "/refused", msg: {} }));
    socket.send(JSON.stringify(answer));
    socket.send(JSON.stringify({ op: "publish", topic: "/end", msg: {} }));
  }),
);
const found = { status: 0, error: 0, console: 0, "status:ID": 0, "status without id": 0 };
let refused = false;
for (const level of ["error", "warn", "log", "info"]) console[level] = () => found.console++;
const ros = new ROSLIB.Ros({ url: `ws://localhost:${server.address().port}` });
await new Promise((resolve) => ros.on("connection", resolve));
ros.on("status", () => found[refused ? "status without id" : "status"]++);
ros.on("error", () => found.error++);
ros.on("/refused", () => (refused = true));
const end = new Promise((resolve) => ros.on("/end", resolve));
const topic = new ROSLIB.Topic({ ros, name: "/cmd_vel", messageType: "geometry_msgs/msg/Twist" });
topic.advertise();
ros.on(`status:${topic.advertiseId}`, () => found["status:ID"]++);
await end;
const text = JSON.stringify(found);
process.stdout.write(text + "\n");
process.exit(text === '{"status":0,"error":0,"console":0,"status:ID":1,"status without id":1}' ? 0 : 1);
JAVASCRIPT
node status.mjs
